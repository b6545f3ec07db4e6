// Inverse of a node's nearly diagonal Hessian on a GPU: hardly any term but the trust region couples the variables.
//
//     H = Q + by S^2 - c v v',    v = S w,   c = 2 by / (1 + 2 |w|^2)
//
// S holds the trust region's scales, w is the tail of the scaling point of its cone, and by = 1 / eta^2. Q collects
// cost, half-spaces and user's cones; it is diagonal except for a few coupled variables. So is A = Q + by S^2, and by
// the Sherman-Morrison formula
//
//     H^-1 = A^-1 + u u',   u = A^-1 v (by / k)^1/2,   k = 1/2 + w'(w - by S A^-1 v).
//
// For an uncoupled variable, term i of w'(w - by S A^-1 v) is w_i^2 q_i / a_i, without cancellation.
#pragma once

#include "elimination_by_warp.h"
#include "scaling.h"

namespace jaxscp {

class NearlyDiagonal {
 public:
  NearlyDiagonal(const Program& program, Arena& arena)
      : program_(program), inverse_(arena.take(program.packs * kPerNode)) {}

  // Prepares for the program that was read: finds the variables that are coupled to others at any node.
  JAXSCP_CALLED void read() {
    const Program& g = program_;
    parallel_for(n, [&](int j) {
      bool is_coupled = false;
      g.hessian.each_of_row(j, [&](int, int i) { is_coupled |= i != j; });
      g.rows.each_of_column(j, [&](int, int i) {
        g.rows.each_of_row(i, [&](int, int other) { is_coupled |= other != j; });
      });
      g.user.each_of_column(j, [&](int, int) { is_coupled = true; });
      coupled()[j] = is_coupled ? 1 : 0;
    });
    once([&] {
      int found = 0;
      for (int j = 0; j < n; ++j)
        if (coupled()[j]) coupled()[j] = ++found;
      count_ = found;
      for (int j = 0; j < n; ++j)
        if (coupled()[j] && coupled()[j] <= kMaxCoupled) variable_[coupled()[j] - 1] = j;
    });
  }

  // Whether few enough variables are coupled, and a cone's registers can hold a node's variables. With a trust region
  // they can.
  bool supports() const { return count_ <= kMaxCoupled && n <= soc::ConeRegisters::kSlots * kLanesOfCone; }

  // Computes the inverses at all nodes.
  JAXSCP_CALLED void find(const Scaling& scaling, double regularisation) {
    parallel_for(program_.packs, Parts{0, 1}, [&](int p, int) {
      const Program& g = program_;
      const Entries w = g.of_cones(scaling.w, p);
      Pack by = 0.0, of_coupled[kMaxCoupled][kMaxCoupled];
      soc::ConeRegisters tail{n}, scale{n}, a{n}, ratio{n}, u{n}, first{n};  // all zero; ratio: q / a
      if (g.has_norm) {
        const Pack eta = scaling.eta_of(p, g.trust_cone);
        by = inverse(eta * eta), tail = soc::load(w + (g.trust + 1), n), scale = soc::load(g.scale.of(p, n), n);
      }
      soc::each_entry(a, [&](int k, int j) {
        if (number(k)) return all(1.0);
        const Pack q = of_cost(scaling, regularisation, p, j, j), whole = q + by * scale[k] * scale[k];
        ratio[k] = q * inverse(whole);
        return whole;
      });
      // Each lane computes one entry of Q's lower triangle among the coupled variables.
      const int lane = lane_of_cone(), row = lane < 1 ? 0 : lane < 3 ? 1 : 2, column = lane - row * (row + 1) / 2;
      const bool has_entry = row < count_ && column <= row;
      const Pack mine = has_entry ? of_cost(scaling, regularisation, p, variable_[row], variable_[column]) : 0.0;
#pragma unroll
      for (int i = 0; i < kMaxCoupled; ++i)
#pragma unroll
        for (int j = 0; j < kMaxCoupled; ++j)
          of_coupled[i][j] = __shfl_sync(kAllLanes, mine, lane_of_warp() - lane + (j <= i ? i * (i + 1) / 2 + j : 0));
      // M' = L^-1 of the coupled block
      Pack s[kMaxCoupled], t[kMaxCoupled], v[kMaxCoupled], solved[kMaxCoupled], denominator = 0.0;
      Pack m[kMaxCoupled][kMaxCoupled], whole[kMaxCoupled][kMaxCoupled];
#pragma unroll
      for (int i = 0; i < kMaxCoupled; ++i) {
        s[i] = entry(scale, i), t[i] = entry(tail, i), v[i] = i < count_ ? s[i] * t[i] : 0.0;
#pragma unroll
        for (int j = 0; j <= i; ++j)
          whole[i][j] = of_coupled[i][j] + (i == j ? i < count_ ? by * s[i] * s[i] : 1.0 : 0.0);
      }
      invert(whole, m);
      times(m, v, solved);
      // (w - by S A^-1 v)_i is (Q A^-1 v)_i / s_i
#pragma unroll
      for (int i = 0; i < kMaxCoupled; ++i) {
        if (i >= count_) break;
        Pack product = 0.0;
#pragma unroll
        for (int j = 0; j < kMaxCoupled; ++j) product += (j < i ? of_coupled[i][j] : of_coupled[j][i]) * solved[j];
        denominator += s[i] != 0.0 ? t[i] * product * inverse(s[i]) : t[i] * t[i];
      }
      denominator = larger(denominator, 0.0) + 0.5;
      denominator += soc::total(n, [&](int k) { return number(k) ? 0.0 : tail[k] * tail[k] * ratio[k]; });
      const Pack size = root(by * inverse(denominator));
      soc::each_entry(first, [&](int k, int) { return number(k) ? 0.0 : inverse_root(a[k]); });
      soc::each_entry(u, [&](int k, int) {
        const int i = number(k);
        return size * (i ? chosen(solved, i) : scale[k] * tail[k] * inverse(a[k]));
      });
      double* to = at(p);
#pragma unroll
      for (int k = 0; k < soc::ConeRegisters::kSlots; ++k)
        if (const int j = soc::entry_of(k); j < n) to[j] = first[k], to[n + j] = u[k];
#pragma unroll
      for (int i = 0; i < kMaxCoupled; ++i)
        for (int j = 0; j < kMaxCoupled; ++j)
          if (lane_of_cone() == i) to[2 * n + i * kMaxCoupled + j] = m[i][j];
    });
  }

  // H^-1 v, by the lanes that hold v.
  soc::ConeRegisters times(int p, const soc::ConeRegisters& v) const {
    const double* of = at(p);
    soc::ConeRegisters out{n}, first{n}, u{n};
    Pack of_coupled[kMaxCoupled], solved[kMaxCoupled], m[kMaxCoupled][kMaxCoupled];
    soc::each_entry(first, [&](int, int j) { return of[j]; });
    soc::each_entry(u, [&](int, int j) { return of[n + j]; });
#pragma unroll
    for (int i = 0; i < kMaxCoupled; ++i)
#pragma unroll
      for (int j = 0; j <= i; ++j) m[i][j] = of[2 * n + i * kMaxCoupled + j];
#pragma unroll
    for (int i = 0; i < kMaxCoupled; ++i) of_coupled[i] = i < count_ ? entry(v, i) : 0.0;
    times(m, of_coupled, solved);
    const Pack part = soc::dot(u, v);
    soc::each(out, [&](int k) {
      const int i = number(k);
      return u[k] * part + (i ? chosen(solved, i) : first[k] * first[k] * v[k]);
    });
    return out;
  }

  // Products with H^-1 = R R', R = [1 / sqrt(a) M u]: rows of K = B R. A ``Row`` is eight rows as a factor for the
  // tensor cores, four columns at a time; the last four columns belong to M and u.
  class Products {
   public:
    static constexpr int kSteps = (ProgramLayout::n + 3) / 4;
    struct Row {
      static constexpr int kFactors = kSteps + 1;
      double steps[kFactors];
      double factor(int k) const { return steps[k]; }
    };

    Products(const NearlyDiagonal& inverse, int p) : of_(inverse.at(p)) {}

    // Eight rows of K, from the entries b(i, j), i < 8, of B.
    template <typename Below>
    Row find(Below below) const {
      Row found;
      const int row = lane_of_warp() / 4, column = lane_of_warp() % 4;
      double last[2] = {}, x[kSteps];
      // The sums have columns 0 .. 7. A lane holds two neighbouring columns, of which the first is one of the four.
      const int c = row % 2 == 0 ? row / 2 : -1;
#pragma unroll
      for (int k = 0; k < kSteps; ++k) {
        const int j = 4 * k + column, i = j < n ? coupled()[j] : 0;
        found.steps[k] = j < n ? below(row, j) : 0.0;
        // entry (i - 1, c) of M, or an entry of u
        const int from = c == kMaxCoupled ? n + j : i > 0 && i - 1 <= c ? 2 * n + c * kMaxCoupled + i - 1 : -1;
        x[k] = j < n && from >= 0 ? of_[from] : 0.0;
      }
      __syncwarp();
#pragma unroll
      for (int k = 0; k < kSteps; ++k) add_products(last, found.steps[k], x[k]);
#pragma unroll
      for (int k = 0; k < kSteps; ++k)
        found.steps[k] *= 4 * k + column < n ? of_[4 * k + column] : 0.0;
      found.steps[kSteps] = last[0];
      return found;
    }

   private:
    const double* of_;
  };

 private:
  static constexpr int n = ProgramLayout::n;
  static constexpr int kMaxCoupled = 3;  // coupled variables; with u they are four columns
  static constexpr int kPerNode = even(2 * n + kMaxCoupled * kMaxCoupled);

  // Number of each variable among the coupled ones, from one on; zero for an uncoupled variable.
  static int* coupled() {
    __shared__ int of_variable[n];
    return of_variable;
  }
  static int number(int k) { return soc::entry_of(k) < n ? coupled()[soc::entry_of(k)] : 0; }
  static Pack chosen(const Pack (&v)[kMaxCoupled], int number) {
    Pack found = v[0];
#pragma unroll
    for (int i = 1; i < kMaxCoupled; ++i)
      if (number == i + 1) found = v[i];
    return found;
  }
  double* at(int p) const { return &inverse_[p * kPerNode]; }

  // Entry of coupled variable i of a vector in registers, on all lanes.
  Pack entry(const soc::ConeRegisters& v, int i) const {
    const int j = i < count_ ? variable_[i] : 0;
    Pack found = v[0];
#pragma unroll
    for (int k = 1; k < soc::ConeRegisters::kSlots; ++k)
      if (j / kLanesOfCone == k) found = v[k];
    return __shfl_sync(kAllLanes, found, lane_of_warp() - lane_of_cone() + j % kLanesOfCone);
  }

  // Entry of Q for two variables.
  JAXSCP_CALLED Pack of_cost(const Scaling& scaling, double regularisation, int p, int one, int other) const {
    const Program& g = program_;
    const Entries w = g.of_cones(scaling.w, p), of_rows = g.rows.at(p), of_user = g.user.at(p);
    const int entry_number = g.hessian.number(one, other);
    Pack total = (one == other ? regularisation : 0.0) + (entry_number >= 0 ? g.hessian.at(p)[entry_number] : 0.0);
    g.rows.each_of_column(one, [&](int e, int row) {
      const int f = one == other ? e : g.rows.number(row, other);
      if (f >= 0) total += of_rows[e] * of_rows[f] * inverse(w[row] * w[row]);
    });
    for (int c = 0; c < g.user_cones; ++c) {
      const auto [offset, d, _] = g.cone_at(c);
      const Pack eta = scaling.eta_of(p, c), by = inverse(eta * eta);
      Pack along = 0.0, along_other = 0.0, product = 0.0;
#pragma unroll 1
      for (int r = 0; r < d; ++r) {
        const int e = g.user.number(offset - g.r + r, one), f = g.user.number(offset - g.r + r, other);
        const Pack mine = e < 0 ? 0.0 : of_user[e], theirs = f < 0 ? 0.0 : of_user[f];
        const Pack here = r == 0 ? w[offset] : -w[offset + r];
        along += here * mine, along_other += here * theirs, product += r == 0 ? -mine * theirs : mine * theirs;
      }
      total += by * (product + 2.0 * along * along_other);
    }
    return total;
  }

  // m = L^-1, for a = L L' given by its lower triangle.
  static void invert(const Pack (&a)[kMaxCoupled][kMaxCoupled], Pack (&m)[kMaxCoupled][kMaxCoupled]) {
    Pack l[kMaxCoupled][kMaxCoupled] = {};
#pragma unroll
    for (int j = 0; j < kMaxCoupled; ++j) {
#pragma unroll
      for (int i = j; i < kMaxCoupled; ++i) {
        Pack left = a[i][j];
#pragma unroll
        for (int k = 0; k < j; ++k) left -= l[i][k] * l[j][k];
        l[i][j] = i == j ? inverse_root(left) : left * l[j][j];
      }
    }
#pragma unroll
    for (int i = 0; i < kMaxCoupled; ++i)
#pragma unroll
      for (int j = 0; j < kMaxCoupled; ++j) {
        Pack sum = 0.0;
#pragma unroll
        for (int k = j; k < i; ++k) sum += l[i][k] * m[k][j];
        m[i][j] = i == j ? l[i][i] : i > j ? -sum * l[i][i] : 0.0;
      }
  }

  // out = m'm v
  static void times(const Pack (&m)[kMaxCoupled][kMaxCoupled], const Pack (&v)[kMaxCoupled], Pack (&out)[kMaxCoupled]) {
    Pack half[kMaxCoupled];
#pragma unroll
    for (int i = 0; i < kMaxCoupled; ++i) {
      half[i] = 0.0;
#pragma unroll
      for (int j = 0; j <= i; ++j) half[i] += m[i][j] * v[j];
    }
#pragma unroll
    for (int j = 0; j < kMaxCoupled; ++j) {
      out[j] = 0.0;
#pragma unroll
      for (int i = j; i < kMaxCoupled; ++i) out[j] += m[i][j] * half[i];
    }
  }

  const Program& program_;
  int count_ = 0, variable_[kMaxCoupled] = {};  // coupled variables
  Packs inverse_;  // 1 / sqrt(a), u and M' by rows, of each node
};

}  // namespace jaxscp

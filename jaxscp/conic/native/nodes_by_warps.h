// Elimination of the nodes' variables on a GPU: one warp per node.
//
// Of a node's Hessian A = L L' only M = L'^-1 is stored, with A^-1 = M M'. The node's coefficients B in the links are
// sparse, so that products with B read fewer numbers than products with B M.
#pragma once

#include "chain_by_warps.h"
#include "nearly_diagonal.h"

namespace jaxscp {

class Nodes {
 public:
  Nodes(const Program& program, Arena& arena)
      : program_(program), inverse_(program, arena), factors_(arena.take(nodes * kTriangle)),
        coupling_(arena.take(nodes * kPerNode)), right_(arena.take(program.packs * n * kMaxRhs)),
        found_(arena.take(right_.size)) {}

  // Prepares for the program that was read: copies the nodes' coefficients in the links, and indexes their entries.
  JAXSCP_CALLED void read() {
    const Matrix &after = program_.after, &before = program_.before;
    if (program_.changed) {
      inverse_.read();
      parallel_for(2 * kPadded * n, [&](int k) {
        const int i = k / n, j = k % n, of_link = i % kPadded;
        const int e = of_link >= m ? -1 : i < kPadded ? after.number(i, j) : before.number(of_link, j);
        coefficient_index()[k] = e < 0 ? -1 : i < kPadded ? e : after.entries + e;
      });
    }
    // A thread copies several numbers of a node, which are adjacent in the destination but not in the source.
    const int many = after.entries + before.entries;
    parallel_for(program_.packs, Parts{(many + kAtOnce - 1) / kAtOnce}, [&](int p, int k) {
      if (p >= nodes) return;
      const Entries of_after = after.at(p), of_before = before.at(p);
      double* coupling_of = coupling(p);
#pragma unroll
      for (int e = kAtOnce * k; e < kAtOnce * (k + 1); ++e)
        if (e < many) coupling_of[e] = e < after.entries ? of_after[e] : of_before[e - after.entries];
    });
  }

  // Eliminates the nodes and factors the Schur complement in the links. add(p, Triangle) adds up the lower triangle of
  // a node's Hessian. A link's own compliance is own(p, i) own(p, j), plus diagonal(p, i) on the diagonal.
  template <typename Add, typename Own, typename Diagonal>
  JAXSCP_CALLED void factor(Chain& chain, const Scaling& scaling, double regularisation, Add add, Own own,
                            Diagonal diagonal) {
    const bool nearly_diagonal = inverse_.supports();
    if (nearly_diagonal) inverse_.find(scaling, regularisation);
    parallel_for_teams(nodes + 1, [&](int p) {
      double *tile = warp_tile(), *of_link = warp_scratch();
      auto compliance = [&](int i, int j) {
        return i < m && j < m ? of_link[i] * of_link[j] + (i == j ? of_link[m + i] : 0.0) : 0.0;
      };
      auto begin_link = [&] { in_team(m, [&](int i) { of_link[i] = own(p, i), of_link[m + i] = diagonal(p, i); }); };
      if (p == nodes) {  // the last link has no node
        begin_link();
        each_lower_tile([&](int tile, int i, int j) {
          put_pair(chain.own(p) + tile + 2 * lane_of_warp(), compliance(i, j), compliance(i, j + 1));
        });
        return;
      }
      if (nearly_diagonal) {
        begin_link();
        put(NearlyDiagonal::Products(inverse_, p), chain, p, compliance);
        return;
      }
      in_team(n * n, [&](int e) { tile[e] = 0.0; });
      add(p, Triangle{tile}, warp_scratch());
      invert_factor<n>(tile);
      double* factor = &factors_[p * kTriangle];
      for (int j = 0; j < n; ++j)
        if (int i = lane_of_warp(); i <= j) factor[j * (j + 1) / 2 + i] = tile[j * n + i];
      begin_link();
      put(Products<n>(tile), chain, p, compliance);
      __syncwarp();
    });
    chain.factor();
  }

  // Row j of right-hand side s of a node.
  template <int S>
  Pack& right(int p, int j, int s) const {
    return right(p, s)[j];
  }

  // Solves for nodes and links; right-hand sides of links are link_rhs(p, i, s).
  template <int S, typename LinkRhs>
  void solve(Chain& chain, LinkRhs link_rhs) {
    const Program& g = program_;
    times_inverses<S>();
    chain.template solve<S>([&](int p, int i, double (&total)[S]) {
      for (int s = 0; s < S; ++s) total[s] = -link_rhs(p, i, s);
      auto add = [&](const Matrix& matrix, int p) {
        Entries a = matrix.at(p), v = found(p);
        matrix.each_of_row(i, [&](int e, int j) {
          for (int s = 0; s < S; ++s) total[s] += a[e] * v[s * n + j];
        });
      };
      if (p < nodes) add(g.after, p);
      if (p > 0) add(g.before, p - 1);
    });
    parallel_for(g.packs, Parts{n}, [&](int p, int j) {
      if (p >= nodes) return;
      double left[S];
      for (int s = 0; s < S; ++s) left[s] = right(p, s)[j];
      auto take = [&](const Matrix& matrix, int l) {
        Entries a = matrix.at(p);
        matrix.each_of_column(j, [&](int e, int i) {
          for (int s = 0; s < S; ++s) left[s] -= a[e] * chain.solution(l, i, s);
        });
      };
      take(g.after, p);
      take(g.before, p + 1);
      for (int s = 0; s < S; ++s) right(p, s)[j] = left[s];
    });
    times_inverses<S>();
  }

  // Row j of solution s.
  template <int S>
  Pack solution(int p, int j, int s) const {
    return found(p)[s * n + j];
  }

 private:
  static constexpr int n = ProgramLayout::n, m = ProgramLayout::m, nodes = ProgramLayout::nodes;
  static constexpr int kPerNode = 2 * m * n;  // coefficients of a node in its links, at most
  static constexpr int kAtOnce = 4;  // coefficients that a thread copies

  // Matrix stored by columns.
  struct Triangle {
    double* first;
    double& operator()(int i, int j) const { return first[j * n + i]; }
  };

  Entries right(int p, int s) const { return right_.of(p, n * kMaxRhs) + s * n; }
  Entries found(int p) const { return found_.of(p, n * kMaxRhs); }
  // Index of each entry among a node's coefficients: rows of its link, then of the next link, both padded.
  static short* coefficient_index() {
    __shared__ short of_entry[2 * kPadded * n];
    return of_entry;
  }

  // Coefficients of node p in its link, and then in the next link.
  double* coupling(int p) const { return &coupling_[p * kPerNode]; }

  // Contribution of node p to its links' Schur complement, for few rows of K at a time to save registers.
  template <typename Products, typename Compliance>
  void put(const Products& products, const Chain& chain, int p, Compliance compliance) const {
    using Row = typename Products::Row;
    const int lane = lane_of_warp(), row = lane / 4, column = lane % 4 * 2;
    const double* coupling_of = coupling(p);
    auto find = [&](int s) {
      return products.find([&](int i, int j) {
        const int e = coefficient_index()[(8 * s + i) * n + j];
        return e < 0 ? 0.0 : coupling_of[e];
      });
    };
    Row later[kAcross];  // rows of the next link
    double* from_before = chain.from_before(p + 1) + 2 * lane;
#pragma unroll
    for (int s = 0; s < kAcross; ++s) {
      later[s] = find(kAcross + s);
#pragma unroll
      for (int t = 0; t <= s; ++t)
        gram(later[s], later[t], [&](const double (&sums)[2]) {
          put_pair(from_before + lower_tile(s, t), sums[0], sums[1]);
        });
    }
    const bool goes_on = Chain::goes_on(p);
    double *between = chain.neighbour(p) + 2 * lane, *turned = chain.neighbour(p + 1) + 8 * column + row;
#pragma unroll
    for (int t = 0; t < kAcross; ++t) {
      const Row k = find(t);
#pragma unroll
      for (int s = 0; s < kAcross; ++s)
        gram(later[s], k, [&](const double (&sums)[2]) {
          if (goes_on) put_pair(between + square_tile(s, t), sums[0], sums[1]);
          else turned[square_tile(t, s)] = sums[0], turned[square_tile(t, s) + 8] = sums[1];
        });
    }
    Row first[kAcross];  // computed again, to save registers
    double* own = chain.own(p) + 2 * lane;
#pragma unroll
    for (int s = 0; s < kAcross; ++s) {
      first[s] = find(s);
#pragma unroll
      for (int t = 0; t <= s; ++t)
        gram(first[s], first[t], [&](const double (&sums)[2]) {
          const int i = 8 * s + row, j = 8 * t + column;
          put_pair(own + lower_tile(s, t), sums[0] + compliance(i, j), sums[1] + compliance(i, j + 1));
        });
    }
  }

  // found_ = A^-1 right_ at all nodes.
  template <int S>
  void times_inverses() {
    if (!inverse_.supports()) return times_factors<S>();
    parallel_for(program_.packs, Parts{0, S}, [&](int p, int s) {
      soc::store(inverse_.times(p, soc::load(right(p, s), n)), found(p) + s * n);
    });
  }

  // The same by factors M; the next factor is copied while the current one is used.
  template <int S>
  JAXSCP_CALLED void times_factors() {
    static_assert(2 * n * kMaxRhs <= kWarpScratch);
    parallel_for_teams(warps(), [&](int w) {
      const int lane = lane_of_warp();
      auto begin = [&](double* buffer, int p) {
        copy_async(buffer, &factors_[p * kTriangle], p < nodes ? kTriangle : 0);
      };
      double *buffer = warp_tile(), *other = buffer + kTriangle;
      begin(buffer, w);
#pragma unroll 1
      for (int p = w; p < nodes; p += warps()) {
        double *v = warp_scratch(), *u = warp_scratch() + n * S;
        begin(other, p + warps());
        in_team(n * S, [&](int k) { v[k] = right(p, k % S)[k / S]; });
        wait_for_copies<1>();
        times_transposed<S, n>(buffer, v, u);
        if (lane < n) {
          double part[2][S] = {};  // independent sums hide the latency of additions
#pragma unroll
          for (int j = 0; j < n; ++j)
            if (j >= lane)
              for (int s = 0; s < S; ++s) part[j % 2][s] += buffer[j * (j + 1) / 2 + lane] * u[j * S + s];
          for (int s = 0; s < S; ++s) found(p)[s * n + lane] = part[0][s] + part[1][s];
        }
        __syncwarp();
        double* last = buffer;
        buffer = other, other = last;
      }
      wait_for_copies<0>();
    });
  }

  const Program& program_;
  NearlyDiagonal inverse_;
  Packs factors_, coupling_, right_, found_;
};

}  // namespace jaxscp

// The elimination of the nodes' variables, on a GPU: a warp for each node.
//
// Of a node's Hessian A = L L' only M = L'^-1 is kept, as M M' is its inverse: what ties it to the links, B, is sparse,
// so that products with B take fewer numbers from memory than such with B M.
#pragma once

#include "chain_by_warps.h"
#include "elimination_by_warp.h"

namespace jaxscp {

class Nodes {
 public:
  Nodes(const Program& program, Arena& arena)
      : program_(program), factors_(arena.take(nodes * kTriangle)), ties_(arena.take(nodes * 2 * m * n)),
        right_(arena.take(program.packs * n * kSides)), found_(arena.take(right_.size)) {}

  // Begins with another program: what ties nodes to links, node by node, and where among it an entry is.
  JAXSCP_CALLED void read() {
    const Matrix &after = program_.after, &before = program_.before;
    share(2 * m * n, [&](int k) {
      const int i = k / n, j = k % n, e = i < m ? after.number(i, j) : before.number(i - m, j);
      place()[k] = e < 0 ? -1 : i < m ? e : after.entries + e;
    });
    share_among_teams(nodes, [&](int p) {
      double* tie = &ties_[p * 2 * m * n];
      in_team(after.entries, [&](int e) { tie[e] = after.at(p)[e]; });
      in_team(before.entries, [&](int e) { tie[after.entries + e] = before.at(p)[e]; });
    });
  }

  // Eliminates them, add(p, Triangle) having added up the lower triangle of each Hessian, and factors what remains in
  // the links, which have own(p, i) times own(p, j) themselves, and diagonal(p, i) on the diagonal.
  template <typename Add, typename Own, typename Diagonal>
  JAXSCP_CALLED void factor(Chain& chain, Add add, Own own, Diagonal diagonal) {
    share_among_teams(nodes + 1, [&](int p) {
      double *tile = tile_of_warp(), *of_link = passed();
      auto compliance = [&](int i, int j) { return of_link[i] * of_link[j] + (i == j ? of_link[m + i] : 0.0); };
      auto begin_link = [&] { in_team(m, [&](int i) { of_link[i] = own(p, i), of_link[m + i] = diagonal(p, i); }); };
      if (p == nodes) {  // a link, but no node
        begin_link();
        in_team(m * m, [&](int e) { chain.own(p)[e] = compliance(e % m, e / m); });
        return;
      }
      in_team(n * n, [&](int e) { tile[e] = 0.0; });
      add(p, Triangle{tile}, passed());
      invert_factor<n>(tile);
      Products<n, n + 2 * m> products(tile);
      const double* tie = &ties_[p * 2 * m * n];
      products.find([&](int i, int j) {
        const int e = place()[i * n + j];
        return e < 0 ? 0.0 : tie[e];
      });
      double* factor = &factors_[p * kTriangle];
      for (int j = 0; j < n; ++j)
        if (int i = lane_of_warp(); i <= j) factor[j * (j + 1) / 2 + i] = tile[j * n + i];
      begin_link();
      products.each_of_gram([&](int i, int j, double v) {
        if (i < m) chain.own(p)[j * m + i] = v + compliance(i, j);
        else if (j >= m) chain.from_before(p + 1)[(j - m) * m + i - m] = v;
        else chain.above(p, j, i - m) = v;
      });
      __syncwarp();
    });
    chain.factor();
  }

  // Right sides of the nodes, side by side: row j of side s at j S + s.
  Entries right(int p) const { return right_.of(p, n * kSides); }

  // Solves for the nodes and for the links, whose own right sides are lacks(p, i, s).
  template <int S, typename Lacks>
  void solve(Chain& chain, Lacks lacks) {
    const Program& g = program_;
    times_inverses<S>(right_);
    chain.template solve<S>([&](int p, int i, double (&total)[S]) {
      for (int s = 0; s < S; ++s) total[s] = -lacks(p, i, s);
      auto add = [&](const Matrix& matrix, int p) {
        Entries a = matrix.at(p), v = found(p);
        matrix.each_of_row(i, [&](int e, int j) {
          for (int s = 0; s < S; ++s) total[s] += a[e] * v[s * n + j];
        });
      };
      if (p < nodes) add(g.after, p);
      if (p > 0) add(g.before, p - 1);
    });
    share(g.packs, Parts{n}, [&](int p, int j) {
      if (p >= nodes) return;
      double left[S];
      for (int s = 0; s < S; ++s) left[s] = right(p)[j * S + s];
      auto take = [&](const Matrix& matrix, int l) {
        Entries a = matrix.at(p);
        matrix.each_of_column(j, [&](int e, int i) {
          for (int s = 0; s < S; ++s) left[s] -= a[e] * chain.solution(l, i, s);
        });
      };
      take(g.after, p);
      take(g.before, p + 1);
      for (int s = 0; s < S; ++s) right(p)[j * S + s] = left[s];
    });
    times_inverses<S>(right_);
  }

  // Row j of side s.
  template <int S>
  Pack solution(int p, int j, int s) const {
    return found(p)[s * n + j];
  }

 private:
  static constexpr int n = ProgramLayout::n, m = ProgramLayout::m, nodes = ProgramLayout::nodes;

  // Entries (i, j) of a matrix by columns.
  struct Triangle {
    double* first;
    double& operator()(int i, int j) const { return first[j * n + i]; }
  };

  Entries found(int p) const { return found_.of(p, n * kSides); }
  static short* place() {
    __shared__ short of_entry[2 * m * n];
    return of_entry;
  }

  // ``found_`` = A^-1 v at all nodes; factors are fetched one ahead of their use.
  template <int S>
  JAXSCP_CALLED void times_inverses(Packs from) {
    static_assert(2 * n * kSides <= kPassed);
    share_among_teams(kWarps, [&](int w) {
      const int lane = lane_of_warp();
      auto room = [&](int p) { return tile_of_warp() + p / kWarps % 2 * kTriangle; };
      auto begin = [&](int p) { fetch(room(p), &factors_[p * kTriangle], p < nodes ? kTriangle : 0); };
      begin(w);
#pragma unroll 1
      for (int p = w; p < nodes; p += kWarps) {
        double *v = passed(), *u = passed() + n * S;
        begin(p + kWarps);
        in_team(n * S, [&](int k) { v[k] = from.of(p, n * kSides)[k]; });
        wait_for_fetched<1>();
        times_transposed<S, n>(room(p), v, u);
        if (lane < n) {
          double part[2][S] = {};  // in turn: neither waits for the one before
#pragma unroll
          for (int j = 0; j < n; ++j)
            if (j >= lane)
              for (int s = 0; s < S; ++s) part[j % 2][s] += room(p)[j * (j + 1) / 2 + lane] * u[j * S + s];
          for (int s = 0; s < S; ++s) found(p)[s * n + lane] = part[0][s] + part[1][s];
        }
        __syncwarp();
      }
      wait_for_fetched<0>();
    });
  }

  const Program& program_;
  Packs factors_, ties_, right_, found_;
};

}  // namespace jaxscp

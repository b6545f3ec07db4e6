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
      : program_(program), factors_(arena.take(ProgramLayout::nodes * kTriangle)),
        right_(arena.take(program.packs * n * kSides)), left_(arena.take(right_.size)), found_(arena.take(right_.size)) {}

  // Eliminates them, add(p, Triangle) having added up the lower triangle of each Hessian, and factors what remains in
  // the links, which have compliance(p, i, j) themselves.
  template <typename Add, typename Compliance>
  JAXSCP_CALLED void factor(Chain& chain, Add add, Compliance compliance) {
    share_among_teams(nodes + 1, [&](int p) {
      double* tile = tile_of_warp();
      if (p == nodes) {  // a link, but no node
        in_team(m * m, [&](int e) { chain.own(p)[e] = compliance(p, e % m, e / m); });
        return;
      }
      in_team(n * n, [&](int e) { tile[e] = 0.0; });
      add(p, Triangle{tile}, passed());
      invert_factor<n>(tile);
      Products<n, n + 2 * m> products(tile);
      products.find([&](int i, int j) {
        return i < m ? program_.after.entry(p, i, j) : program_.before.entry(p, i - m, j);
      });
      double* factor = &factors_[p * kTriangle];
      for (int j = 0; j < n; ++j)
        if (int i = lane_of_warp(); i <= j) factor[j * (j + 1) / 2 + i] = tile[j * n + i];
      products.each_of_gram([&](int i, int j, double v) {
        if (i < m) chain.own(p)[j * m + i] = v + compliance(p, i, j);
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
    chain.template solve<S>([&](int p, int i, int s) {
      Pack total = -lacks(p, i, s);
      if (p < nodes) total += g.after.times(p, i, found(p) + s * n);
      if (p > 0) total += g.before.times(p - 1, i, found(p - 1) + s * n);
      return total;
    });
    share(g.packs, Parts{n * S}, [&](int p, int k) {
      if (p >= nodes) return;
      const int j = k / S, s = k % S;
      Pack taken = g.after.add_transposed(p, j, 0.0, [&](int i) { return chain.solution(p, i, s); });
      taken = g.before.add_transposed(p, j, taken, [&](int i) { return chain.solution(p + 1, i, s); });
      left_.of(p, n * kSides)[k] = right(p)[k] - taken;
    });
    times_inverses<S>(left_);
  }

  // Row j of side s.
  template <int S>
  Pack solution(int p, int j, int s) const {
    return found(p)[s * n + j];
  }

 private:
  static constexpr int n = ProgramLayout::n, m = ProgramLayout::m, nodes = ProgramLayout::nodes;
  static constexpr int kTriangle = even(n * (n + 1) / 2);

  // Entries (i, j) of a matrix by columns.
  struct Triangle {
    double* first;
    double& operator()(int i, int j) const { return first[j * n + i]; }
  };

  Entries found(int p) const { return found_.of(p, n * kSides); }

  // ``found_`` = A^-1 v at all nodes; factors are fetched one ahead of their use.
  template <int S>
  JAXSCP_CALLED void times_inverses(Packs from) {
    static_assert(2 * n * kSides <= kPassed && 2 * kTriangle <= kTileSize);
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
        double sums[S] = {};
        if (lane < n) {
#pragma unroll
          for (int j = 0; j < n; ++j)
            if (j >= lane)
              for (int s = 0; s < S; ++s) sums[s] += room(p)[j * (j + 1) / 2 + lane] * u[j * S + s];
          for (int s = 0; s < S; ++s) found(p)[s * n + lane] = sums[s];
        }
        __syncwarp();
      }
      wait_for_fetched<0>();
    });
  }

  const Program& program_;
  Packs factors_, right_, left_, found_;
};

}  // namespace jaxscp

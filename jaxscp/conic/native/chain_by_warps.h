// Schur complement in the link multipliers on a GPU: block tridiagonal, eliminated from both ends to the middle by one
// warp per end.
//
// Cyclic reduction would use more warps, but twice the arithmetic, and each of its rounds waits for memory and for all
// threads. Here the next block is copied during the elimination, and other programs use the other warps' time.
#pragma once

#include "elimination_by_warp.h"
#include "program.h"

namespace jaxscp {

// Largest number of right-hand sides that are solved together.
constexpr int kMaxRhs = 2;

class Chain {
 public:
  Chain(const Program& program, Arena& arena)
      : program_(program), blocks_(arena.take(kLinks * kPerLink)), inverse_(arena.take(kLinks * kBlockSize)),
        step_(arena.take(kLinks * kBlockSize)), far_(arena.take(kSolutions - kChainVectors)) {}

  // The matrix in tiles. Link l has two lower triangles: its own compliance with the contribution of the node after it,
  // and the contribution of the node before it.
  double* own(int l) const { return &blocks_[l * kPerLink]; }
  double* from_before(int l) const { return own(l) + kLower; }
  // Off-diagonal block to the link that is eliminated next, with that link's rows.
  double* neighbour(int l) const { return from_before(l) + kLower; }
  // Whether link l + 1 is eliminated after link l.
  static bool goes_on(int l) { return l < kMiddle; }

  JAXSCP_CALLED void factor() {
    parallel_for_teams(2, [&](int end) {
      double *tile = warp_tile(), *here = prefetched(end);
      auto begin = [&](int t) { copy_async(here, own(link(end, t)), t < count(end) ? kPerLink : 0); };
      begin(0);
      double update[kLower / kTile][2] = {};  // update of this link by the previous one
#pragma unroll 1
      for (int t = 0; t < count(end); ++t) {
        const int l = link(end, t);
        const double* next = here + 2 * kLower;
        wait_for_copies<0>();
        assemble(tile, [&](int at, int e) {
          const int k = at + 2 * lane_of_warp() + e;
          return here[k] + (l > 0 ? here[kLower + k] : 0.0) - update[at / kTile][e];
        });
        double *inverse = &inverse_[l * kBlockSize], *step = &step_[l * kBlockSize];
        invert_factor<m>(tile);
        const Products<m> products(tile);
        typename Products<m>::Row k[kAcross];
#pragma unroll
        for (int s = 0; s < kAcross; ++s) {
          k[s] = products.find([&](int i, int j) { return next[square_tile(s, j / 8) + i * 8 + j % 8]; });
#pragma unroll
          for (int t = 0; t <= s; ++t)
            gram(k[s], k[t], [&](const double (&sums)[2]) {
              for (int e = 0; e < 2; ++e) update[lower_tile(s, t) / kTile][e] = sums[e];
            });
        }
        __syncwarp();
        begin(t + 1);
#pragma unroll
        for (int s = 0; s < kAcross; ++s)
          products.each_of_solved(k[s], [&](int i, int j, double v) {
            if (8 * s + i < m) step[j * m + 8 * s + i] = v;
          });
        products.each_of_inverse([&](int i, int j, double v) { inverse[j * m + i] = v; });
        __syncwarp();
      }
      each_lower_tile([&](int tile, int, int) {
        const double(&sums)[2] = update[tile / kTile];
        put_pair(here + tile + 2 * lane_of_warp(), sums[0], sums[1]);
      });
    });
    parallel_for_teams(1, [&](int) {
      double *tile = warp_tile(), *inverse = &inverse_[kMiddle * kBlockSize];
      assemble(tile, [&](int at, int e) {
        const int k = at + 2 * lane_of_warp() + e;
        double v = own(kMiddle)[k] + (kMiddle > 0 ? from_before(kMiddle)[k] : 0.0);
        for (int end = 0; end < 2; ++end) v -= prefetched(end)[k];
        return v;
      });
      invert_factor<m>(tile);
      Products<m>(tile).each_of_inverse([&](int i, int j, double v) { inverse[j * m + i] = v; });
    });
  }

  // Solves for S right-hand sides; right(l, i, rhs) writes row i of each to ``rhs``. See ``solution``.
  template <int S, typename Right>
  void solve(Right right) {
    parallel_for(program_.packs, Parts{m}, [&](int l, int i) {
      if (l >= kLinks) return;
      double rhs[S];
      right(l, i, rhs);
      for (int s = 0; s < S; ++s) vector(l)[i * kMaxRhs + s] = rhs[s];
    });
    substitute<S, false>();
    parallel_for_teams(kLinks, [&](int l) {
      in_team(m * S, [&](int k) {
        const int at = k / S * kMaxRhs + k % S;
        double v = vector(l)[at];
        if (l == kMiddle)
          for (int end = 0; end < 2; ++end)
            if (count(end) > 0) v += middle_update(end)[at];
        warp_scratch()[k] = v;
      });
      double sums[S] = {};
      multiply<S>(&inverse_[l * kBlockSize], 1, m, warp_scratch(), sums);
      if (lane_of_warp() < m)
        for (int s = 0; s < S; ++s) vector(l)[lane_of_warp() * kMaxRhs + s] = sums[s];
      __syncwarp();
    });
    substitute<S, true>();
  }

  // Row i of solution s.
  Pack solution(int l, int i, int s) const { return l < kLinks ? vector(l)[i * kMaxRhs + s] : 0.0; }

 private:
  static constexpr int m = ProgramLayout::m, kLinks = ProgramLayout::nodes + 1, kMiddle = kLinks / 2;
  static constexpr int kTurns = 3;  // independent sums hide the latency of additions

  // Number of blocks that are eliminated from an end (0 or 1), and the t-th of them.
  static int count(int end) { return end == 0 ? kMiddle : kLinks - 1 - kMiddle; }
  static int link(int end, int t) { return end == 0 ? t : kLinks - 1 - t; }

  // Right-hand sides of a link, later its solutions.
  double* vector(int l) const { return (kVectorsShared ? chain_vectors() : far_.data) + l * m * kMaxRhs; }
  double* middle_update(int end) const { return vector(kLinks + end); }
  // By a team, stores the lower triangle of a block by columns; a lane's two numbers of a tile are value(tile, e), e <
  // 2.
  template <typename Value>
  static void assemble(double* columns, Value value) {
    each_lower_tile([&](int tile, int i, int j) {
#pragma unroll
      for (int e = 0; e < 2; ++e)
        if (i < m && j + e <= i) columns[(j + e) * m + i] = value(tile, e);
    });
    __syncwarp();
  }

  // Product of a matrix and S adjacent vectors, one lane per row; ``down`` and ``along`` are the strides of rows and
  // columns.
  template <int S>
  static void multiply(const double* matrix, int down, int along, const double* v, double (&sums)[S]) {
    if (lane_of_warp() >= m) return;
    const double* row = matrix + lane_of_warp() * down;
    double part[kTurns][S] = {};
#pragma unroll
    for (int k = 0; k < m; ++k)
      for (int s = 0; s < S; ++s) part[k % kTurns][s] += row[k * along] * v[k * S + s];
    for (int s = 0; s < S; ++s) sums[s] = (part[0][s] + part[1][s]) + part[2][s];
  }

  // Forward substitution from both ends to the middle, v_next -= T v, or backward substitution, v -= T' v_next.
  template <int S, bool kBack>
  JAXSCP_CALLED void substitute() {
    parallel_for_teams(2, [&](int end) {
      const int lane = lane_of_warp(), many = count(end);
      auto at = [&](int i) { return link(end, kBack ? many - 1 - i : i); };
      auto buffer = [&](int i) { return prefetched(end) + i % kBuffers * kBlockSize; };
      auto begin = [&](int i) { copy_async(buffer(i), &step_[at(i) * kBlockSize], i < many ? kBlockSize : 0); };
      auto next = [&](int i) { return kBack ? vector(at(i)) : i + 1 < many ? vector(at(i + 1)) : middle_update(end); };
      auto read = [&](const double* from, bool there, double (&to)[S]) {
        for (int s = 0; s < S; ++s) to[s] = there && lane < m ? from[lane * kMaxRhs + s] : 0.0;
      };
      auto read_next = [&](int i, double (&to)[S]) { read(next(i), kBack ? i < many : i + 1 < many, to); };

      for (int i = 0; i + 1 < kBuffers; ++i) begin(i);
      double v[S], theirs[S];
      read(kBack ? vector(kMiddle) : vector(at(0)), true, v);
      read_next(0, theirs);
#pragma unroll 1
      for (int i = 0; i < many; ++i) {
        double* mine = warp_scratch() + i % 2 * m * S;
        if (lane < m)
          for (int s = 0; s < S; ++s) mine[lane * S + s] = v[s];
        wait_for_copies<kBuffers - 2>();
        begin(i + kBuffers - 1);
        double later[S], sums[S] = {};
        read_next(i + 1, later);
        multiply<S>(buffer(i), kBack ? m : 1, kBack ? 1 : m, mine, sums);
        for (int s = 0; s < S; ++s) {
          v[s] = theirs[s] - sums[s], theirs[s] = later[s];
          if (lane < m) next(i)[lane * kMaxRhs + s] = v[s];
        }
      }
      wait_for_copies<0>();
    });
  }

  const Program& program_;
  Packs blocks_, inverse_, step_, far_;  // far_: vectors that do not fit in shared memory
};

}  // namespace jaxscp

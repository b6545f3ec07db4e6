// Elimination as in ``elimination.h``, by the lanes of a warp together.
//
//     [ A  B' ]
//     [ B  0  ]       A = L L',  M = L'^-1,  K = B M
//
// M instead of L turns solutions into products: A^-1 = M M'. Lane i holds row i of A in registers during elimination;
// the products run on tensor cores.
#pragma once

#include "layout.h"
#include "shared_memory.h"
#include "tensor_cores.h"

namespace jaxscp {

// Replaces A, whose lower triangle is given by columns, by the upper triangular M.
//
// Two columns are eliminated at once. Their pivot block [a b; b c] needs two independent roots: of a and of the
// determinant. An eliminated row is no longer needed; from then on its lane holds a row of the identity, as if the
// identity were below A.
template <int kSize>
JAXSCP_CALLED void invert_factor(double* tile) {
  // With few rows, one lane holds a row's even columns and another its odd columns.
  constexpr int kHalves = 2 * kSize <= kWarp ? 2 : 1, kOther = kWarp / 2, kSlots = (kSize + kHalves - 1) / kHalves;
  constexpr int kAtOnce = 4;  // reads that overlap
  static_assert(kSize <= kWarp && 4 * kSize <= kWarpScratch, "a lane for each row");
  struct alignas(16) Both {
    double column, next;
  };
  const int half = kHalves == 2 ? lane_of_warp() / kOther : 0, i = lane_of_warp() - half * kOther;
  const bool there = i < kSize;
  double row[kSlots];  // from the next column on
#pragma unroll
  for (int s = 0; s < kSlots; ++s) {
    const int j = s * kHalves + half;
    row[s] = there && j < kSize ? tile[j * kSize + i] : 0.0;
  }
  Both* eliminated = reinterpret_cast<Both*>(warp_scratch());  // zero from kSize on
  for (int k = lane_of_warp(); k < 2 * kSize; k += kWarp) eliminated[k] = {0.0, 0.0};
  __syncwarp();
#pragma unroll
  for (int j = 0; j + 1 < kSize; j += 2) {
    const double mine = kHalves == 2 ? __shfl_sync(kAllLanes, row[0], i) : row[0];
    const double mine_next = kHalves == 2 ? __shfl_sync(kAllLanes, row[0], i + kOther) : row[1 % kSlots];
    const double a = __shfl_sync(kAllLanes, mine, j), b = __shfl_sync(kAllLanes, mine, j + 1);
    const double c = __shfl_sync(kAllLanes, mine_next, j + 1);
    const double over = inverse_root(a), over_next = a * over * inverse_root(a * c - b * b), between = b * over;
    const bool turn = i == j, turn_next = i == j + 1, spent = turn || turn_next;
    const double first = turn ? over : turn_next ? 0.0 : mine * over;
    const double second = (turn_next ? 1.0 : (turn ? 0.0 : mine_next) - first * between) * over_next;
    if (there && half == 0) {
      eliminated[i] = {first, second};
      tile[j * kSize + i] = i <= j ? first : 0.0;
    }
    if (there && half == kHalves - 1) tile[(j + 1) * kSize + i] = i <= j + 1 ? second : 0.0;
    __syncwarp();
#pragma unroll
    for (int begin = 2 / kHalves; begin < kSlots; begin += kAtOnce) {
      Both with[kAtOnce];
#pragma unroll
      for (int k = 0; k < kAtOnce; ++k)
        if (j + (begin + k) * kHalves < kSize) with[k] = eliminated[j + (begin + k) * kHalves + half];
#pragma unroll
      for (int k = 0; k < kAtOnce; ++k)
        if (const int s = begin + k; j + s * kHalves < kSize)
          row[s - 2 / kHalves] = (spent ? 0.0 : row[s]) - first * with[k].column - second * with[k].next;
    }
    __syncwarp();
  }
  if (constexpr int j = kSize - 1; kSize % 2 == 1) {
    const double over = inverse_root(__shfl_sync(kAllLanes, row[0], j));
    if (there && half == 0) tile[j * kSize + i] = (i == j ? 1.0 : row[0]) * over;
  }
  __syncwarp();
}

// Tile of K K' from two ``Row``s of K: put receives this lane's two sums.
template <typename Row, typename Put>
inline void gram(const Row& a, const Row& b, Put put) {
  double sums[2] = {};
  __syncwarp();
#pragma unroll
  for (int k = 0; k < Row::kFactors; ++k) add_products(sums, a.factor(k), b.factor(k));
  put(sums);
}

// Products with M, which is in a tile. A ``Row`` is eight rows of K = B M, in the registers of the tensor cores' sums.
// It is a factor of the next product, with the columns in another order.
template <int kSize>
class Products {
 public:
  static constexpr int kTiles = (kSize + 7) / 8;
  struct Row {
    static constexpr int kFactors = 2 * kTiles;
    double tiles[kTiles][2] = {};
    double factor(int k) const { return tiles[k / 2][k % 2]; }
  };

  explicit Products(const double* tile) : tile_(tile) {}

  // Eight rows of K, from the entries b(i, j), i < 8, of B.
  template <typename Below>
  Row find(Below below) const {
    Row found;
    double b[kSteps];
#pragma unroll
    for (int k = 0; k < kSteps; ++k) b[k] = 4 * k + column_ < kSize ? below(row_, 4 * k + column_) : 0.0;
    __syncwarp();
#pragma unroll
    for (int k = 0; k < kSteps; ++k)
#pragma unroll
      for (int u = k / 2; u < kTiles; ++u) add_products(found.tiles[u], b[k], m(4 * k + column_, 8 * u + row_));
    return found;
  }

  // Calls put(i, j, value) for entries i < 8 of B A^-1 = K M'.
  template <typename Put>
  void each_of_solved(const Row& of_k, Put put) const {
#pragma unroll
    for (int t = 0; t < kTiles; ++t) {
      double sums[2] = {};
      __syncwarp();
#pragma unroll
      for (int u = t; u < kTiles; ++u)
#pragma unroll
        for (int e = 0; e < 2; ++e) add_products(sums, of_k.tiles[u][e], m(8 * t + row_, 8 * u + 2 * column_ + e));
#pragma unroll
      for (int e = 0; e < 2; ++e)
        if (const int j = 8 * t + 2 * column_ + e; j < kSize) put(row_, j, sums[e]);
    }
  }

  // Calls put(i, j, value) for entries of A^-1 = M M'.
  template <typename Put>
  void each_of_inverse(Put put) const {
#pragma unroll
    for (int s = 0; s < kTiles; ++s)
#pragma unroll
      for (int t = 0; t <= s; ++t) {
        double sums[2] = {};
        __syncwarp();
#pragma unroll
        for (int k = 2 * s; k < kSteps; ++k)
          add_products(sums, m(8 * s + row_, 4 * k + column_), m(8 * t + row_, 4 * k + column_));
#pragma unroll
        for (int e = 0; e < 2; ++e)
          if (const int i = 8 * s + row_, j = 8 * t + 2 * column_ + e; i < kSize && j <= i)
            put(i, j, sums[e]), put(j, i, sums[e]);
      }
  }

 private:
  static constexpr int kSteps = (kSize + 3) / 4;

  double m(int i, int j) const { return i < kSize && j < kSize ? tile_[j * kSize + i] : 0.0; }

  const double* tile_;
  int row_ = lane_of_warp() / 4, column_ = lane_of_warp() % 4;
};

// out = M' v for S adjacent vectors; M is upper triangular, stored by the columns of its triangle. Four lanes share a
// column.
template <int S, int kSize>
inline void times_transposed(const double* triangle, const double* v, double* out) {
  const int lane = lane_of_warp(), quarter = lane % 4;
#pragma unroll
  for (int round = 0; round < (kSize + 7) / 8; ++round) {
    const int j = 8 * round + lane / 4;
    double sums[S] = {};
#pragma unroll
    for (int k = 0; k < 2 * round + 2; ++k)
      if (int i = 4 * k + quarter; i <= j && j < kSize)
        for (int s = 0; s < S; ++s) sums[s] += triangle[j * (j + 1) / 2 + i] * v[i * S + s];
    for (int s = 0; s < S; ++s) {
      for (int distance = 1; distance < 4; distance *= 2) sums[s] += __shfl_xor_sync(kAllLanes, sums[s], distance);
      if (quarter == 0 && j < kSize) out[j * S + s] = sums[s];
    }
  }
  __syncwarp();
}

}  // namespace jaxscp

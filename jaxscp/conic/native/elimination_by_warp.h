// What ``elimination.h`` does, by the lanes of a warp together.
//
// A panel is held by columns. Lane i has row i in its registers while the columns are eliminated one after another. The
// leading rows end as M = L'^-1 in place of L, so that solutions are products, and so are rows that have no lane.
#pragma once

#include "layout.h"
#include "threads.h"

namespace jaxscp {

constexpr unsigned kEvery = 0xffffffff;  // lane of the warp

// Numbers that the lanes of a warp pass to each other.
constexpr int kPassed = 128;
inline double* passed() {
  __shared__ double numbers[kThreads / kWarp][kPassed];
  return numbers[warp_of_block()];
}

template <int kSize, int kRows>
inline double& entry(PanelShape<kSize, kRows>, double* panel, int i, int j) {
  return panel[j * kRows + i];
}

// K = B M for the rows from the 32nd on: to hold two rows at once would take more registers than a lane has.
template <int kSize, int kRows>
JAXSCP_CALLED void eliminate_the_rest(double* panel) {
#pragma unroll 1
  for (int i = kWarp + lane_of_warp(); i < kRows; i += kWarp) {
    double row[kSize];
#pragma unroll
    for (int j = 0; j < kSize; ++j) row[j] = panel[j * kRows + i];
#pragma unroll
    for (int j = kSize - 1; j >= 0; --j) {
      double sums[2] = {};
#pragma unroll
      for (int k = 0; k <= j; ++k) sums[k % 2] += row[k] * panel[j * kRows + k];
      panel[j * kRows + i] = sums[0] + sums[1];
    }
  }
  __syncwarp();
}

template <int kSize, int kRows>
JAXSCP_CALLED void eliminate(PanelShape<kSize, kRows>, double* panel) {
  static_assert(kSize <= kWarp && 4 * kSize <= kPassed, "a lane for each leading row");
  const int lane = lane_of_warp();
  double row[kSize];  // from the column on that is next
#pragma unroll
  for (int j = 0; j < kSize; ++j) row[j] = lane < kRows ? panel[j * kRows + lane] : 0.0;
  for (int i = lane; i < 4 * kSize; i += kWarp) passed()[i] = 0.0;
  __syncwarp();
#pragma unroll 1
  for (int j = 0; j < kSize; ++j) {
    double scale = rsqrt(__shfl_sync(kEvery, row[0], j));
    double* column = passed() + j % 2 * 2 * kSize;  // zero from kSize on
    // what lane j has of A is spent: from here on it has a row of the identity, as if that had been below
    bool spent = lane == j;
    double first = (spent ? 1.0 : row[0]) * scale;
    if (lane < kSize) column[lane] = first;
    if (lane < kRows) panel[j * kRows + lane] = lane >= kSize || lane <= j ? first : 0.0;
    __syncwarp();
#pragma unroll
    for (int l = 1; l < kSize; ++l) row[l - 1] = (spent ? 0.0 : row[l]) - first * column[j + l];
  }
  __syncwarp();
  if constexpr (kRows > kWarp) eliminate_the_rest<kSize, kRows>(panel);
}

// 8 x 8 sums of products of 8 x 4 and 4 x 8 numbers, which tensor cores add to; a lane has two neighbours of a row.
#if defined(JAXSCP_EMULATED_GPU)
void add_products(double (&sums)[2], double a, double b);
#else
inline void add_products(double (&sums)[2], double a, double b) {
  asm volatile("mma.sync.aligned.m8n8k4.row.col.f64.f64.f64.f64 {%0, %1}, {%2}, {%3}, {%0, %1};"
      : "+d"(sums[0]), "+d"(sums[1])
      : "d"(a), "d"(b));
}
#endif

template <int kSize, int kRows>
JAXSCP_CALLED void grams(PanelShape<kSize, kRows>, const double* panel, double* out) {
  constexpr int kBelow = kRows - kSize, kHalf = kBelow / 2;
  constexpr int kTiles = (kBelow + 7) / 8, kSteps = (kSize + 3) / 4;
  const int lane = lane_of_warp(), row = lane / 4, column = lane % 4;
  double sums[kTiles * (kTiles + 1) / 2][2] = {};
  __syncwarp();  // tensor cores take a whole warp
#pragma unroll
  for (int k = 0; k < kSteps; ++k) {
    double part[kTiles];
#pragma unroll
    for (int t = 0; t < kTiles; ++t) {
      int i = 8 * t + row, j = 4 * k + column;
      part[t] = i < kBelow && j < kSize ? panel[j * kRows + kSize + i] : 0.0;
    }
#pragma unroll
    for (int s = 0, at = 0; s < kTiles; ++s)
#pragma unroll
      for (int t = 0; t <= s; ++t, ++at) add_products(sums[at], part[s], part[t]);
  }
  // entry (i, j) of the whole lower triangle: of a a', of b b', or of b a', which is wanted the other way round
#pragma unroll
  for (int s = 0, at = 0; s < kTiles; ++s)
#pragma unroll
    for (int t = 0; t <= s; ++t, ++at)
#pragma unroll
      for (int e = 0; e < 2; ++e) {
        int i = 8 * s + row, j = 8 * t + 2 * column + e;
        if (i >= kBelow || j > i) continue;
        if (i < kHalf) out[i * kHalf + j] = sums[at][e];
        else if (j >= kHalf) out[kHalf * kHalf + (i - kHalf) * kHalf + j - kHalf] = sums[at][e];
        else out[2 * kHalf * kHalf + j * kHalf + i - kHalf] = sums[at][e];
      }
  __syncwarp();
}

// out = M' v for the panel's rows from ``first`` to ``end``: four lanes a column. ``v`` begins at row ``first``.
template <int S, int kSize, int kRows>
JAXSCP_CALLED void times_transposed(const double* panel, int first, int end, const double* v, double* out) {
  const int lane = lane_of_warp(), quarter = lane % 4;
#pragma unroll 1
  for (int j0 = 0; j0 < kSize; j0 += 8) {
    int j = j0 + lane / 4;
    double sums[S] = {};
    if (j < kSize)
#pragma unroll 4
      for (int i = first + quarter; i < end; i += 4)
        for (int s = 0; s < S; ++s) sums[s] += panel[j * kRows + i] * v[(i - first) * S + s];
    for (int s = 0; s < S; ++s) {
      sums[s] += __shfl_xor_sync(kEvery, sums[s], 1);
      sums[s] += __shfl_xor_sync(kEvery, sums[s], 2);
      if (j < kSize && quarter == 0) out[j * S + s] = sums[s];
    }
  }
  __syncwarp();
}

// out = M v for the panel's rows from ``first`` to ``end``: a lane a row.
template <int S, int kSize, int kRows>
JAXSCP_CALLED void times(const double* panel, int first, int end, const double* v, double* out) {
#pragma unroll 1
  for (int i = first + lane_of_warp(); i < end; i += kWarp) {
    double sums[S] = {};
#pragma unroll
    for (int j = 0; j < kSize; ++j)
      for (int s = 0; s < S; ++s) sums[s] += panel[j * kRows + i] * v[j * S + s];
    for (int s = 0; s < S; ++s) out[(i - first) * S + s] = sums[s];
  }
  __syncwarp();
}

template <int S, int kSize, int kRows>
JAXSCP_CALLED void descend(PanelShape<kSize, kRows>, const double* panel, const double* right, double* out) {
  double* solved = passed();
  times_transposed<S, kSize, kRows>(panel, 0, kSize, right, solved);
  in_team(kSize * S, [&](int i) { out[i] = solved[i]; });
  times<S, kSize, kRows>(panel, kSize, kRows, solved, out + kSize * S);
}

template <int S, int kSize, int kRows>
JAXSCP_CALLED void ascend(PanelShape<kSize, kRows>, const double* panel, double* v) {
  double* left = passed();
  times_transposed<S, kSize, kRows>(panel, kSize, kRows, v + kSize * S, left);
  in_team(kSize * S, [&](int i) { left[i] = v[i] - left[i]; });
  times<S, kSize, kRows>(panel, 0, kSize, left, v);
}

}  // namespace jaxscp

// The kernel that sums J' W J and J' v over the weighted rows of one location (``system.py``), by a warp on tensor
// cores. The macros are the sizes of all constraints, and the kernel's parameters.
//
// Each lane loads what it multiplies, one number of a tile; nothing is shared.

#include "tensor_cores.h"

constexpr int kPoints[] = {JAXSCP_POINTS}, kRows[] = {JAXSCP_ROWS}, kRankOne[] = {JAXSCP_RANK_ONE};
constexpr int kInputs = JAXSCP_INPUTS, kVectors = JAXSCP_VECTORS;
constexpr int kTiles = (kInputs + 7) / 8;

// Lower tiles of J' W J and all tiles of J' v.
struct Sums {
  double matrix[kTiles][kTiles][2] = {}, products[kTiles][2] = {};
};

// Adds left' right; both are tiles of the same four rows.
inline void add(Sums& sums, const double (&left)[kTiles], const double (&right)[kTiles]) {
#pragma unroll
  for (int s = 0; s < kTiles; ++s)
#pragma unroll
    for (int t = 0; t <= s; ++t) jaxscp::add_products(sums.matrix[s][t], left[s], right[t]);
}

// The lane's numbers of a row: one of each tile.
inline void read_row(double (&to)[kTiles], bool there, const double* row, int column) {
#pragma unroll
  for (int t = 0; t < kTiles; ++t) to[t] = there && 8 * t + column < kInputs ? row[8 * t + column] : 0.0;
}

template <int kPart>
inline void add_diagonal(Sums& sums, int row_of_four, int column, const double* jacobian, const double* weight,
                         const double* vectors) {
  constexpr int kAll = kPoints[kPart] * kRows[kPart];
#pragma unroll 2
  for (int first = 0; first < kAll; first += 4) {
    const int row = first + row_of_four;
    const bool there = row < kAll;
    double plain[kTiles], weighted[kTiles];
    read_row(plain, there, jacobian + row * kInputs, column);
    const double of_row = there ? weight[row] : 0.0;
#pragma unroll
    for (int t = 0; t < kTiles; ++t) weighted[t] = of_row * plain[t];
    add(sums, weighted, plain);
    if constexpr (kVectors > 0) {
      const double vector = there && column < kVectors ? vectors[row * kVectors + column] : 0.0;
#pragma unroll
      for (int t = 0; t < kTiles; ++t) jaxscp::add_products(sums.products[t], plain[t], vector);
    }
  }
}

// A lane has a point's row: the sum over the point's rows.
template <int kPart>
inline void add_rank_one(Sums& sums, int point_of_four, int column, const double* jacobian, const double* rank_one) {
  for (int first = 0; first < kPoints[kPart]; first += 4) {
    const int point = first + point_of_four;
    double row[kTiles], sum[kTiles] = {};
    for (int r = point * kRows[kPart]; point < kPoints[kPart] && r < (point + 1) * kRows[kPart]; ++r) {
      read_row(row, true, jacobian + r * kInputs, column);
      const double of_row = rank_one[r];
#pragma unroll
      for (int t = 0; t < kTiles; ++t) sum[t] = fma(of_row, row[t], sum[t]);
    }
    add(sums, sum, sum);
  }
}

// Adds all constraints from ``kPart`` on, from the addresses of their arrays.
template <int kPart>
inline void add_parts(Sums&, long long) {}

template <int kPart, typename... Others>
inline void add_parts(Sums& sums, long long location, const double* jacobian, const double* weight,
                      const double* vectors, const double* rank_one, Others... others) {
  constexpr int kAll = kPoints[kPart] * kRows[kPart];
  const int column = threadIdx.x % 32 / 4, of_four = threadIdx.x % 4;
  jacobian += location * kAll * kInputs, weight += location * kAll, vectors += location * kAll * kVectors;
  add_diagonal<kPart>(sums, of_four, column, jacobian, weight, vectors);
  if constexpr (kRankOne[kPart] != 0)
    add_rank_one<kPart>(sums, of_four, column, jacobian, rank_one + location * kAll);
  add_parts<kPart + 1>(sums, location, others...);
}

extern "C" __global__ void __launch_bounds__(JAXSCP_THREADS)
    jaxscp_kernel(JAXSCP_PARAMETERS, double* __restrict__ to_matrix, double* __restrict__ to_products, long long count,
                  long long) {
  const long long location = blockIdx.x * (JAXSCP_THREADS / 32LL) + threadIdx.x / 32;
  if (location >= count) return;
  Sums sums;
  add_parts<0>(sums, location, JAXSCP_ARGUMENTS);
  const int row = threadIdx.x % 32 / 4, column = threadIdx.x % 4 * 2;
  to_matrix += location * kInputs * kInputs, to_products += location * kVectors * kInputs;
#pragma unroll
  for (int s = 0; s < kTiles; ++s) {
    const int i = 8 * s + row;
#pragma unroll
    for (int e = 0; e < 2; ++e) {
#pragma unroll
      for (int t = 0; t <= s; ++t)
        if (const int j = 8 * t + column + e; i < kInputs && j <= i)
          to_matrix[i * kInputs + j] = to_matrix[j * kInputs + i] = sums.matrix[s][t][e];
      if (i < kInputs && column + e < kVectors) to_products[(column + e) * kInputs + i] = sums.products[s][e];
    }
  }
}

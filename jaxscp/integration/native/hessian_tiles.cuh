// Lower tiles of the symmetric Hessian of an interval, in registers, spread over the warps of a block.
#pragma once

#include "tensor_cores.h"

struct HessianTiles {
  static constexpr int kTiles = (kInputs + 7) / 8, kPairs = kTiles * (kTiles + 1) / 2, kWarps = kThreads / 32,
                       kOwn = (kPairs + kWarps - 1) / kWarps;  // tiles of a warp
  double sums[kOwn][2] = {};

  // Adds the products of left(row)[i] and right[row][j] over all rows, by all threads of the block. The caller waits
  // for the block before and after. Columns beyond the last input may hold anything.
  template <int kRows, typename Left>
  void add(Left left, const double (*right)[kRow]) {
    const int lane = threadIdx.x % 32;
#pragma unroll
    for (int first = 0; first < kRows; first += 4) {
      const int row = first + lane % 4;
      const bool there = first + 4 <= kRows || row < kRows;
      const double *of_left = left(there ? row : 0), *of_right = right[there ? row : 0];
      for_own(sums, [&](double(&sum)[2], int s, int t) {
        const double a = of_left[8 * s + lane / 4], b = of_right[8 * t + lane / 4];
        jaxscp::add_products(sum, there ? a : 0.0, there ? b : 0.0);
      });
    }
  }

  // Writes the lower triangle.
  void write_lower(double (*to)[kRow]) const {
    const int lane = threadIdx.x % 32;
    for_own(sums, [&](const double(&sum)[2], int s, int t) {
#pragma unroll
      for (int e = 0; e < 2; ++e)
        if (const int i = 8 * s + lane / 4, j = 8 * t + lane % 4 * 2 + e; i < kInputs && j <= i) to[i][j] = sum[e];
    });
  }

 private:
  // Acts on the warp's tiles (s, t), t <= s, and their sums.
  template <typename Sums, typename Act>
  static void for_own(Sums& sums, Act act) {
#pragma unroll
    for (int k = 0; k < kOwn; ++k) {
      const int pair = k * kWarps + (kWarps > 1 ? threadIdx.x / 32 : 0);
      if (pair < kPairs) act(sums[k], tile_row(pair), pair - tile_row(pair) * (tile_row(pair) + 1) / 2);
    }
  }

  static constexpr int tile_row(int pair) {
    int s = 0;
    while ((s + 1) * (s + 2) / 2 <= pair) ++s;
    return s;
  }
};

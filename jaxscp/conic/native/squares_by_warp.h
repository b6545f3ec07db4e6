// The squares of ``squares.h`` on a GPU: a product of dense rows on the tensor cores of a warp.
#pragma once

#include "elimination_by_warp.h"
#include "squares.h"

namespace jaxscp {

// Adds the sum of weight(i) a_i a_i' over ``count`` rows of kSize entries value(i, j).
template <int kSize, typename Weight, typename Value, typename Triangle>
inline void add_squares_of_rows(int count, Weight weight, Value value, Triangle to) {
  constexpr int kTiles = (kSize + 7) / 8, kRows = 4;  // rows of a product
  const int lane = lane_of_warp();
  double sums[kTiles * (kTiles + 1) / 2][2] = {};
#pragma unroll 2
  for (int first = 0; first < count; first += kRows) {
    const int i = first + lane % kRows;
    const double by = i < count ? weight(i) : 0.0;
    double v[kTiles];
#pragma unroll
    for (int s = 0; s < kTiles; ++s) {
      const int j = 8 * s + lane / kRows;
      v[s] = i < count && j < kSize ? value(i, j) : 0.0;
    }
    __syncwarp();
#pragma unroll
    for (int s = 0; s < kTiles; ++s)
#pragma unroll
      for (int t = 0; t <= s; ++t) add_products(sums[s * (s + 1) / 2 + t], v[s], by * v[t]);
  }
#pragma unroll
  for (int s = 0; s < kTiles; ++s)
#pragma unroll
    for (int t = 0; t <= s; ++t)
#pragma unroll
      for (int e = 0; e < 2; ++e)
        if (const int i = 8 * s + lane / 4, j = 8 * t + lane % 4 * 2 + e; i < kSize && j <= i)
          to(i, j) += sums[s * (s + 1) / 2 + t][e];
  __syncwarp();
}

// Adds all squares, one row more for each cone's rank-one term; ``weight`` is a buffer.
template <typename Triangle>
void add_squares(const Program& g, const Scaling& s, int p, Entries weight, Pack*, Triangle to) {
  constexpr int r = ProgramLayout::r, u = ProgramLayout::u, kCones = ProgramLayout::user_cones;
  find_weights(g, s, p, weight);
  const Entries a = g.rows.at(p), b = g.user.at(p), w = g.of_cones(s.w, p);
  auto of_user = [&](int i, int j) {
    const int e = g.user.number(i, j);
    return e < 0 ? 0.0 : b[e];
  };
  auto value = [&](int i, int j) {
    if (i < r) {
      const int e = g.rows.number(i, j);
      return e < 0 ? 0.0 : a[e];
    }
    if (i < r + u) return of_user(i - r, j);
    auto [first, d, _] = g.cone_at(i - (r + u));
    double along = w[first] * of_user(first - r, j);
    for (int k = 1; k < d; ++k) along -= w[first + k] * of_user(first - r + k, j);
    return along;
  };
  auto weight_of = [&](int i) { return i < r + u ? weight[i] : -2.0 * weight[g.cone_at(i - (r + u)).offset]; };
  add_squares_of_rows<ProgramLayout::n>(r + u + kCones, weight_of, value, to);
}

}  // namespace jaxscp

// The squares of ``squares.h`` on a CPU, one sparse row after another.
#pragma once

#include "squares.h"

namespace jaxscp {

// Adds the sum of weight[i] a_i a_i' over the rows a_i of a matrix.
template <typename Triangle>
void add_squares_of_rows(const Matrix& matrix, int p, Entries weight, Triangle to) {
  const Entries a = matrix.at(p);
  for (int j = 0; j < matrix.columns; ++j)
    matrix.each_of_column(j, [&](int e, int i) {
      const Pack v = weight[i] * a[e];
      matrix.each_of_row(i, [&](int f, int other) {
        if (other <= j) to(j, other) += v * a[f];
      });
    });
}

// Adds all squares; ``weight`` and ``along`` are buffers.
template <typename Triangle>
void add_squares(const Program& g, const Scaling& s, int p, Entries weight, Pack* along, Triangle to) {
  find_weights(g, s, p, weight);
  add_squares_of_rows(g.rows, p, weight, to);
  add_squares_of_rows(g.user, p, weight + g.r, to);
  const Entries a = g.user.at(p), w = g.of_cones(s.w, p);
  for (int c = 0; c < g.user_cones; ++c) {
    const int first = g.cone_at(c).offset, d = g.cone_at(c).dimension;
    for (int j = 0; j < g.n; ++j) {
      along[j] = all(0.0);
      g.user.each_of_column(j, [&](int e, int row) {
        const int i = g.r + row - first;
        if (i >= 0 && i < d) along[j] += (i == 0 ? w[first] : -w[first + i]) * a[e];
      });
    }
    add_square(g.n, -2.0 * weight[first], along, to);
  }
}

}  // namespace jaxscp

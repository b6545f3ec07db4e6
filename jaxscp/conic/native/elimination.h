// Cholesky factorisation of the leading block of a symmetric matrix, extended to the rows below the block:
//
//     [ A  B' ]   [ L  0 ] [ 1   0   ] [ L' K' ]        K = B L'^-1
//     [ B  0  ] = [ K  1 ] [ 0 -K K' ] [ 0  1  ]
//
// A is eliminated; K K' updates the remaining block.
#pragma once

#include <algorithm>

#include "layout.h"

namespace jaxscp {

struct PanelShape {
  int size, rows;
};

// A panel is [A; B] by rows. Its first ``size`` rows hold the lower triangle of A, later L with 1 / L_jj on the
// diagonal.

constexpr int kTile = 4;  // 4 x 4 sums fill the registers

namespace tile {

// sums[i][j] = sum over k < count of a[i][k] b[j][k]
template <int R, int C>
inline void products(const Pack* a, int a_stride, const Pack* b, int b_stride, int count, Pack (&sums)[R][C]) {
  for (int i = 0; i < R; ++i)
    for (int j = 0; j < C; ++j) sums[i][j] = all(0.0);
  for (int k = 0; k < count; ++k)
    for (int i = 0; i < R; ++i)
      for (int j = 0; j < C; ++j) sums[i][j] += a[i * a_stride + k] * b[j * b_stride + k];
}

// Columns j .. j + C - 1 of rows i .. i + R - 1, below the diagonal tile, which is already factored.
template <int R, int C>
inline void below(Pack* panel, int size, int i, int j) {
  Pack sums[R][C];
  products<R, C>(panel + i * size, size, panel + j * size, size, j, sums);
  for (int r = 0; r < R; ++r) {
    Pack* row = panel + (i + r) * size + j;
    for (int c = 0; c < C; ++c) {
      Pack v = row[c] - sums[r][c];
      for (int k = 0; k < c; ++k) v -= row[k] * panel[(j + c) * size + j + k];
      row[c] = v * panel[(j + c) * size + j + c];
    }
  }
}

template <int C>
inline void diagonal(Pack* panel, int size, int j) {
  Pack sums[C][C];
  products<C, C>(panel + j * size, size, panel + j * size, size, j, sums);
  for (int r = 0; r < C; ++r) {
    Pack* row = panel + (j + r) * size + j;
    for (int c = 0; c <= r; ++c) {
      Pack v = row[c] - sums[r][c];
      for (int k = 0; k < c; ++k) v -= row[k] * panel[(j + c) * size + j + k];
      row[c] = c == r ? 1.0 / root(v) : v * panel[(j + c) * size + j + c];
    }
  }
}

template <int C>
inline void columns(Pack* panel, int size, int rows, int j) {
  diagonal<C>(panel, size, j);
  int i = j + C;
  for (; i + kTile <= rows; i += kTile) below<kTile, C>(panel, size, i, j);
  switch (rows - i) {
    case 3: below<3, C>(panel, size, i, j); break;
    case 2: below<2, C>(panel, size, i, j); break;
    case 1: below<1, C>(panel, size, i, j); break;
  }
}

// Tile (i, j) of a product A B', with ``stride`` packs per row.
template <int R, int C>
inline void gram(const Pack* a, int i, const Pack* b, int j, int size, Pack* out, int stride) {
  Pack sums[R][C];
  products<R, C>(a + i * size, size, b + j * size, size, size, sums);
  for (int r = 0; r < R; ++r)
    for (int c = 0; c < C; ++c) out[(i + r) * stride + j + c] = sums[r][c];
}

template <int R>
inline void gram_rows(const Pack* a, int i, const Pack* b, int columns, int size, Pack* out, int stride) {
  int j = 0;
  for (; j + kTile <= columns; j += kTile) gram<R, kTile>(a, i, b, j, size, out, stride);
  switch (columns - j) {
    case 3: gram<R, 3>(a, i, b, j, size, out, stride); break;
    case 2: gram<R, 2>(a, i, b, j, size, out, stride); break;
    case 1: gram<R, 1>(a, i, b, j, size, out, stride); break;
  }
}

}  // namespace tile

inline void eliminate(PanelShape shape, Pack* panel) {
  auto [size, rows] = shape;
  int j = 0;
  for (; j + kTile <= size; j += kTile) tile::columns<kTile>(panel, size, rows, j);
  switch (size - j) {
    case 3: tile::columns<3>(panel, size, rows, j); break;
    case 2: tile::columns<2>(panel, size, rows, j); break;
    case 1: tile::columns<1>(panel, size, rows, j); break;
  }
}

// out = A B' for ``count`` rows of ``size`` numbers; of A A' at least the lower triangle.
inline void gram(const Pack* a, const Pack* b, int count, int size, Pack* out) {
  int i = 0;
  auto columns = [&](int end) { return a == b ? std::min(end, count) : count; };
  for (; i + kTile <= count; i += kTile) tile::gram_rows<kTile>(a, i, b, columns(i + kTile), size, out, count);
  switch (count - i) {
    case 3: tile::gram_rows<3>(a, i, b, count, size, out, count); break;
    case 2: tile::gram_rows<2>(a, i, b, count, size, out, count); break;
    case 1: tile::gram_rows<1>(a, i, b, count, size, out, count); break;
  }
}

// out = (a a', b b', a b') for the upper half a and the lower half b of the rows below; the first two at least in their
// lower triangles.
inline void grams(PanelShape shape, const Pack* panel, Pack* out) {
  int size = shape.size, half = (shape.rows - size) / 2;
  const Pack *a = panel + size * size, *b = a + half * size;
  gram(a, a, half, size, out);
  gram(b, b, half, size, out + half * half);
  gram(a, b, half, size, out + 2 * half * half);
}

// Forward substitution for S adjacent right-hand sides: out = L^-1 right in the rows of A, K L^-1 right below.
template <int S>
inline void descend(PanelShape shape, const Pack* panel, const Pack* right, Pack* out) {
  auto [size, rows] = shape;
  for (int i = 0; i < rows; i += kTile) {
    int count = std::min(kTile, rows - i), before = std::min(i, size);
    const Pack* row = panel + i * size;
    Pack sums[kTile][S] = {};
    if (count == kTile) {
      for (int k = 0; k < before; ++k)
        for (int r = 0; r < kTile; ++r)
          for (int s = 0; s < S; ++s) sums[r][s] += row[r * size + k] * out[k * S + s];
    } else {
      for (int r = 0; r < count; ++r)
        for (int k = 0; k < before; ++k)
          for (int s = 0; s < S; ++s) sums[r][s] += row[r * size + k] * out[k * S + s];
    }
    for (int r = 0; r < count; ++r) {
      int end = std::min(i + r, size);
      for (int s = 0; s < S; ++s) {
        Pack v = sums[r][s];
        for (int k = before; k < end; ++k) v += row[r * size + k] * out[k * S + s];
        out[(i + r) * S + s] = i + r < size ? (right[(i + r) * S + s] - v) * row[r * size + i + r] : v;
      }
    }
  }
}

// Backward substitution in place: the rows of A become L'^-1 (v - K' v_below).
template <int S>
inline void ascend(PanelShape shape, const Pack* panel, Pack* v) {
  auto [size, rows] = shape;
  for (int end = size; end > 0;) {
    int j = (end - 1) / kTile * kTile, count = end - j;
    Pack sums[kTile][S] = {};
    if (count == kTile) {
      for (int i = end; i < rows; ++i)
        for (int c = 0; c < kTile; ++c)
          for (int s = 0; s < S; ++s) sums[c][s] += panel[i * size + j + c] * v[i * S + s];
    } else {
      for (int i = end; i < rows; ++i)
        for (int c = 0; c < count; ++c)
          for (int s = 0; s < S; ++s) sums[c][s] += panel[i * size + j + c] * v[i * S + s];
    }
    for (int c = count - 1; c >= 0; --c)
      for (int s = 0; s < S; ++s) {
        Pack left = v[(j + c) * S + s] - sums[c][s];
        for (int i = c + 1; i < count; ++i) left -= panel[(j + i) * size + j + c] * v[(j + i) * S + s];
        v[(j + c) * S + s] = left * panel[(j + c) * size + j + c];
      }
    end = j;
  }
}

}  // namespace jaxscp

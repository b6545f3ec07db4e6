// Cholesky's method on the leading block of a symmetric matrix, carried on into the rows below it:
//
//     [ A  B' ]   [ L  0 ] [ 1   0   ] [ L' K' ]        K = B L'^-1
//     [ B  0  ] = [ K  1 ] [ 0 -K K' ] [ 0  1  ]
//
// A is eliminated and K K' is what the rest gets. Nodes, and links in cyclic reduction, are eliminated by this alone.
#pragma once

#include "pack.h"

namespace jaxscp {

// A panel is [A; B] by rows: the first ``size`` rows hold A's lower triangle, then L with 1 / L_jj on its diagonal.

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

// Columns j .. j + C - 1 of rows i .. i + R - 1, below the diagonal's tile, which is done.
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
  for (; i < rows; ++i) below<1, C>(panel, size, i, j);
}

}  // namespace tile

inline void eliminate(Pack* panel, int size, int rows) {
  int j = 0;
  for (; j + kTile <= size; j += kTile) tile::columns<kTile>(panel, size, rows, j);
  switch (size - j) {
    case 3: tile::columns<3>(panel, size, rows, j); break;
    case 2: tile::columns<2>(panel, size, rows, j); break;
    case 1: tile::columns<1>(panel, size, rows, j); break;
  }
}

// Calls put(i, j, (K K')_ij) for rows i of the first block and j of the second, counted from their own first rows;
// for i >= j only where the two are one.
template <typename Put>
inline void gram(const Pack* a, int a_rows, const Pack* b, int b_rows, int size, Put put) {
  bool lower = a == b;
  auto part = [&]<int R, int C>(int i, int j) {
    Pack sums[R][C];
    tile::products<R, C>(a + i * size, size, b + j * size, size, size, sums);
    for (int r = 0; r < R; ++r)
      for (int c = 0; c < C; ++c)
        if (!lower || i + r >= j + c) put(i + r, j + c, sums[r][c]);
  };
  for (int i = 0; i < a_rows;) {
    bool tall = i + kTile <= a_rows;
    int end = lower ? std::min(b_rows, i + (tall ? kTile : 1)) : b_rows;
    for (int j = 0; j < end;) {
      bool wide = j + kTile <= b_rows;
      if (tall && wide) part.template operator()<kTile, kTile>(i, j);
      else if (tall) part.template operator()<kTile, 1>(i, j);
      else if (wide) part.template operator()<1, kTile>(i, j);
      else part.template operator()<1, 1>(i, j);
      j += wide ? kTile : 1;
    }
    i += tall ? kTile : 1;
  }
}

// out = L^-1 right for the rows of A, and K L^-1 right for those below.
inline void descend(const Pack* panel, int size, int rows, const Pack* right, Pack* out) {
  int i = 0;
  for (; i + kTile <= size; i += kTile) {
    Pack v[kTile];
    for (int r = 0; r < kTile; ++r) v[r] = right[i + r];
    for (int k = 0; k < i; ++k)
      for (int r = 0; r < kTile; ++r) v[r] -= panel[(i + r) * size + k] * out[k];
    for (int r = 0; r < kTile; ++r) {
      for (int k = 0; k < r; ++k) v[r] -= panel[(i + r) * size + i + k] * out[i + k];
      out[i + r] = v[r] * panel[(i + r) * size + i + r];
    }
  }
  for (; i < size; ++i) out[i] = (right[i] - dot(panel + i * size, out, i)) * panel[i * size + i];
  for (; i + kTile <= rows; i += kTile) {
    Pack v[kTile] = {all(0.0), all(0.0), all(0.0), all(0.0)};
    for (int k = 0; k < size; ++k)
      for (int r = 0; r < kTile; ++r) v[r] += panel[(i + r) * size + k] * out[k];
    for (int r = 0; r < kTile; ++r) out[i + r] = v[r];
  }
  for (; i < rows; ++i) out[i] = dot(panel + i * size, out, size);
}

// In place: the first rows become L'^-1 (v - K' v_below).
inline void ascend(const Pack* panel, int size, int rows, Pack* v) {
  int edge = size - size % kTile;
  for (int j = size - 1; j >= edge; --j) {
    Pack left = v[j];
    for (int i = j + 1; i < rows; ++i) left -= panel[i * size + j] * v[i];
    v[j] = left * panel[j * size + j];
  }
  for (int j = edge - kTile; j >= 0; j -= kTile) {
    Pack left[kTile];
    for (int c = 0; c < kTile; ++c) left[c] = v[j + c];
    for (int i = j + kTile; i < rows; ++i)
      for (int c = 0; c < kTile; ++c) left[c] -= panel[i * size + j + c] * v[i];
    for (int c = kTile - 1; c >= 0; --c) {
      for (int i = c + 1; i < kTile; ++i) left[c] -= panel[(j + i) * size + j + c] * v[j + i];
      v[j + c] = left[c] * panel[(j + c) * size + j + c];
    }
  }
}

}  // namespace jaxscp

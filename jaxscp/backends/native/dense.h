// Products of matrices of a few dozen rows. A row begins at a multiple of a pack and is padded with zeros to whole
// packs.
#pragma once

#include <cmath>
#include <cstring>
#include <limits>

#include "pack.h"

namespace jaxscp {

inline Pack load(const double* from) {
  Pack v;
  std::memcpy(&v, from, sizeof v);
  return v;
}
inline void store(Pack v, double* to) { std::memcpy(to, &v, sizeof v); }

struct Matrix {
  double* at = nullptr;
  int packs = 0;  // packs of a row

  int stride() const { return packs * kWidth; }
  double* operator[](int row) const { return at + row * stride(); }
};

constexpr int kRows = 4, kPacks = 3;  // block of sums that fits in the registers, with its operands

namespace rows {

template <int R, int P, typename Coefficient>
inline void accumulate(int count, Coefficient a, const Matrix& b, const Matrix& to, int row, int column) {
  Pack sums[R][P];
  for (int r = 0; r < R; ++r)
    for (int p = 0; p < P; ++p) sums[r][p] = load(to[row + r] + column + p * kWidth);
  for (int k = 0; k < count; ++k)
    for (int r = 0; r < R; ++r) {
      const Pack left = all(a(row + r, k));
      for (int p = 0; p < P; ++p) sums[r][p] += left * load(b[k] + column + p * kWidth);
    }
  for (int r = 0; r < R; ++r)
    for (int p = 0; p < P; ++p) store(sums[r][p], to[row + r] + column + p * kWidth);
}

template <int P, typename Coefficient>
inline void accumulate_all(int rows, int count, Coefficient a, const Matrix& b, const Matrix& to, int column) {
  int row = 0;
  for (; row + kRows <= rows; row += kRows) accumulate<kRows, P>(count, a, b, to, row, column);
  for (; row < rows; ++row) accumulate<1, P>(count, a, b, to, row, column);
}

}  // namespace rows

// to[i] += sum over k < count of a(i, k) b[k], for i < rows
template <typename Coefficient>
inline void accumulate(int rows, int count, Coefficient a, const Matrix& b, const Matrix& to) {
  int p = 0;
  for (; p + kPacks <= to.packs; p += kPacks) rows::accumulate_all<kPacks>(rows, count, a, b, to, p * kWidth);
  for (; p < to.packs; ++p) rows::accumulate_all<1>(rows, count, a, b, to, p * kWidth);
}

namespace rows {

// In two sums: each addition waits for the one before in the same sum.
template <int P>
inline void add(double factor, int count, const double* a, const Matrix& b, double* to, int column) {
  Pack even[P], odd[P] = {};
  for (int p = 0; p < P; ++p) even[p] = load(to + column + p * kWidth);
  int k = 0;
  for (; k + 2 <= count; k += 2)
    for (int p = 0; p < P; ++p) {
      even[p] += all(factor * a[k]) * load(b[k] + column + p * kWidth);
      odd[p] += all(factor * a[k + 1]) * load(b[k + 1] + column + p * kWidth);
    }
  if (k < count)
    for (int p = 0; p < P; ++p) even[p] += all(factor * a[k]) * load(b[k] + column + p * kWidth);
  for (int p = 0; p < P; ++p) store(even[p] + odd[p], to + column + p * kWidth);
}

}  // namespace rows

// to += factor (sum over k < count of a[k] b[k])
inline void add_rows(double factor, int count, const double* a, const Matrix& b, double* to) {
  int p = 0;
  for (; p + kPacks <= b.packs; p += kPacks) rows::add<kPacks>(factor, count, a, b, to, p * kWidth);
  for (; p < b.packs; ++p) rows::add<1>(factor, count, a, b, to, p * kWidth);
}

// out[i] = a[i] . x for i < rows. Overwrites out up to the end of the last pack.
inline void products(int rows, const Matrix& a, const double* x, double* out) {
  for (int row = 0; row < rows; row += kWidth) {
    Pack sums[kWidth] = {};
    for (int r = 0; r < kWidth && row + r < rows; ++r)
      for (int p = 0; p < a.packs; ++p) sums[r] += load(a[row + r] + p * kWidth) * load(x + p * kWidth);
    transpose(sums);
    for (int half = kWidth / 2; half > 0; half /= 2)
      for (int r = 0; r < half; ++r) sums[r] += sums[r + half];
    store(sums[0], out + row);
  }
}

// Cholesky factor of the leading block, in its lower triangle; NaN if the block is not positive definite.
inline void cholesky(int size, const Matrix& a) {
  for (int j = 0; j < size; ++j)
    for (int i = j; i < size; ++i) {
      double v = a[i][j];
      for (int k = 0; k < j; ++k) v -= a[i][k] * a[j][k];
      if (i > j)
        a[i][j] = v / a[j][j];
      else
        a[j][j] = v > 0.0 ? std::sqrt(v) : std::numeric_limits<double>::quiet_NaN();
    }
}

// x = (L L')^-1 x
inline void solve_cholesky(int size, const Matrix& lower, double* x) {
  for (int i = 0; i < size; ++i) {
    for (int k = 0; k < i; ++k) x[i] -= lower[i][k] * x[k];
    x[i] /= lower[i][i];
  }
  for (int i = size - 1; i >= 0; --i) {
    x[i] /= lower[i][i];
    for (int k = 0; k < i; ++k) x[k] -= lower[i][k] * x[i];
  }
}

}  // namespace jaxscp

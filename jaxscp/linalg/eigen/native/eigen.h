// Eigenvalues and vectors of symmetric matrices, one in each place of a Pack: Householder's reduction to tridiagonal
// form, and the QR iteration with Wilkinson's shift (Golub and Van Loan, "Matrix Computations", sections 8.3 and 5.1).
//
// All of them go through the same steps. Where a matrix has nothing to do in one of them, its rotation is the identity.
#pragma once

#include <algorithm>

#include "memory.h"
#include "pack.h"

namespace jaxscp {

using Memory = MemoryOf<Pack>;

constexpr double kNegligible = 1.1e-16;  // of a matrix's size, beside its diagonal
constexpr int kMaxRounds = 40;           // for one eigenvalue, which takes two or three

inline bool any(Mask mask) {
  long long found = 0;
  for (int lane = 0; lane < kWidth; ++lane) found |= mask[lane];
  return found != 0;
}

class Eigen {
 public:
  Eigen(int size, Memory& memory)
      : n_(size), matrix_(memory.take(size * size)), vectors_(memory.take(size * size)), values_(memory.take(size)),
        beside_(memory.take(size)), weights_(memory.take(size)), row_(memory.take(size)) {}

  // The matrix, of which the lower triangle is read.
  Pack& entry(int i, int j) { return matrix_[i * n_ + j]; }

  void run() {
    scale();
    reduce();
    turn_back();
    iterate();
    for (int i = 0; i < n_; ++i) values_[i] *= size_;
  }

  const Pack& value(int k) const { return values_[k]; }
  const Pack* vector(int k) const { return vectors_ + k * n_; }

 private:
  // To entries of at most one, so that no square of one is out of range.
  void scale() {
    Pack largest = all(0.0);
    for (int i = 0; i < n_; ++i)
      for (int j = 0; j <= i; ++j) largest = larger(magnitude(entry(i, j)), largest);
    size_ = where(largest > 0.0, largest, all(1.0));
    const Pack unit = 1.0 / size_;
    for (int i = 0; i < n_; ++i)
      for (int j = 0; j <= i; ++j) entry(i, j) *= unit, entry(j, i) = entry(i, j);
  }

  // Reflections I - beta v v' leave the diagonal and what is beside it. Each v stays in the row whose end it clears.
  void reduce() {
    for (int k = 0; k + 1 < n_; ++k) {
      Pack* v = matrix_ + k * n_;
      Pack square = all(0.0);
      for (int j = k + 1; j < n_; ++j) square += v[j] * v[j];
      const Pack first = v[k + 1], norm = root(square), to = where(first > 0.0, -norm, norm);
      const Mask some = norm > 0.0;
      values_[k] = v[k], beside_[k] = to;
      v[k + 1] = first - to;
      const Pack beta = weights_[k] = where(some, 1.0 / where(some, square - first * to, all(1.0)), all(0.0));
      reflect(k, v, beta);
    }
    values_[n_ - 1] = entry(n_ - 1, n_ - 1);
  }

  // From both sides: A - v w' - w v', where w = beta A v - (beta/2 v' beta A v) v.
  void reflect(int k, const Pack* v, Pack beta) {
    Pack* w = row_;
    Pack along = all(0.0);
    for (int i = k + 1; i < n_; ++i) {
      Pack sum = all(0.0);
      for (int j = k + 1; j < n_; ++j) sum += entry(i, j) * v[j];
      w[i] = beta * sum, along += w[i] * v[i];
    }
    const Pack half = 0.5 * beta * along;
    for (int i = k + 1; i < n_; ++i) w[i] -= half * v[i];
    for (int i = k + 1; i < n_; ++i)
      for (int j = k + 1; j < n_; ++j) entry(i, j) -= v[i] * w[j] + w[i] * v[j];
  }

  // The product of the reflections, whose columns are rows here.
  void turn_back() {
    for (int i = 0; i < n_ * n_; ++i) vectors_[i] = all(i / n_ == i % n_ ? 1.0 : 0.0);
    for (int k = n_ - 2; k >= 0; --k) {
      const Pack* v = matrix_ + k * n_;
      for (int i = k + 1; i < n_; ++i) {
        Pack *row = vectors_ + i * n_, sum = all(0.0);
        for (int j = k + 1; j < n_; ++j) sum += row[j] * v[j];
        sum *= weights_[k];
        for (int j = k + 1; j < n_; ++j) row[j] -= sum * v[j];
      }
    }
  }

  // Eigenvalues come off at the end of the diagonal, one after another.
  void iterate() {
    Pack largest = all(0.0);
    for (int i = 0; i < n_; ++i) largest = larger(magnitude(values_[i]), largest);
    for (int i = 0; i + 1 < n_; ++i) largest = larger(magnitude(beside_[i]), largest);
    const Pack negligible = kNegligible * largest;
    for (int end = n_ - 1; end > 0; --end)
      // what is not a number is not larger than anything, and so is left alone
      for (int round = 0; round < kMaxRounds && any(magnitude(beside_[end - 1]) > negligible); ++round)
        chase(end, negligible);
  }

  // One round for the block that ends at ``end``, which begins behind the last entry beside the diagonal that is
  // negligible: another place for each matrix.
  void chase(int end, Pack negligible) {
    int first = end;
    for (Mask on = magnitude(beside_[end - 1]) > negligible; any(on);) {
      row_[--first] = truth(on);
      if (first == 0) break;
      on &= magnitude(beside_[first - 1]) > negligible;
    }
    const Pack shift = wilkinson(end);
    Pack x = all(0.0), z = all(0.0), before = all(0.0);
    for (int k = first; k < end; ++k) {
      const Mask on = row_[k] > 0.0, begins = on & (before == 0.0);
      x = where(begins, values_[k] - shift, x), z = where(begins, beside_[k], z);
      const Pack length = root(x * x + z * z);
      const Mask turns = on & (length > 0.0);
      const Pack unit = 1.0 / where(turns, length, all(1.0));
      const Pack c = where(turns, x * unit, all(1.0)), s = where(turns, z * unit, all(0.0));
      if (k > first) beside_[k - 1] = where(on & (before > 0.0), length, beside_[k - 1]);
      const Pack a = values_[k], b = values_[k + 1], e = beside_[k], twice = 2.0 * c * s * e;
      values_[k] = c * c * a + twice + s * s * b;
      values_[k + 1] = s * s * a - twice + c * c * b;
      beside_[k] = c * s * (b - a) + (c * c - s * s) * e;
      if (k + 1 < end) x = beside_[k], z = s * beside_[k + 1], beside_[k + 1] = c * beside_[k + 1];
      rotate(vectors_ + k * n_, vectors_ + (k + 1) * n_, c, s);
      before = row_[k];
    }
    for (int k = first; k < end; ++k)
      beside_[k] = where(magnitude(beside_[k]) <= negligible, all(0.0), beside_[k]);
  }

  // The eigenvalue of the last two rows that is nearer to the last entry.
  Pack wilkinson(int end) const {
    const Pack e = beside_[end - 1], half = 0.5 * (values_[end - 1] - values_[end]);
    const Pack length = root(half * half + e * e), far = where(half < 0.0, half - length, half + length);
    return values_[end] - where(far == 0.0, all(0.0), e * e / where(far == 0.0, all(1.0), far));
  }

  void rotate(Pack* a, Pack* b, Pack c, Pack s) const {
    for (int i = 0; i < n_; ++i) {
      const Pack u = a[i], v = b[i];
      a[i] = c * u + s * v, b[i] = c * v - s * u;
    }
  }

  static Pack truth(Mask mask) { return where(mask, all(1.0), all(0.0)); }

  int n_;
  Pack *matrix_, *vectors_;          // row by row
  Pack *values_, *beside_;           // the diagonal, and the entries beside it
  Pack *weights_, *row_;             // of the reflections; room for one row
  Pack size_;
};

}  // namespace jaxscp

// Eigenvalues and vectors of symmetric matrices, one in each lane of a Pack: Householder's reduction to tridiagonal
// form, and the QR iteration with Wilkinson's shift (Golub and Van Loan, "Matrix Computations", sections 8.3 and 5.1).
//
// All matrices take the same steps. Where a matrix needs no rotation, its rotation is the identity.
#pragma once

#include <algorithm>

#include "pack.h"
#include "workspace.h"

namespace jaxscp {

using Workspace = WorkspaceOf<Pack>;

constexpr double kNegligible = 1.1e-16;  // off-diagonal entry, relative to the largest entry
constexpr int kMaxRounds = 40;           // for one eigenvalue, which usually takes two or three

inline bool any(Mask mask) {
  long long found = 0;
  for (int lane = 0; lane < kWidth; ++lane) found |= mask[lane];
  return found != 0;
}

class Eigen {
 public:
  Eigen(int size, Workspace& workspace)
      : n_(size), matrix_(workspace.take(size * size)), vectors_(workspace.take(size * size)),
        values_(workspace.take(size)), off_diagonal_(workspace.take(size)), weights_(workspace.take(size)), row_(workspace.take(size)) {}

  // Entry of the matrix, whose lower triangle is read.
  Pack& entry(int i, int j) { return matrix_[i * n_ + j]; }

  void run() {
    scale();
    reduce();
    accumulate_reflections();
    iterate();
    for (int i = 0; i < n_; ++i) values_[i] *= size_;
  }

  const Pack& value(int k) const { return values_[k]; }
  const Pack* vector(int k) const { return vectors_ + k * n_; }

 private:
  // Scales entries to at most one, so that their squares cannot overflow.
  void scale() {
    Pack largest = all(0.0);
    for (int i = 0; i < n_; ++i)
      for (int j = 0; j <= i; ++j) largest = larger(magnitude(entry(i, j)), largest);
    size_ = where(largest > 0.0, largest, all(1.0));
    const Pack unit = 1.0 / size_;
    for (int i = 0; i < n_; ++i)
      for (int j = 0; j <= i; ++j) entry(i, j) *= unit, entry(j, i) = entry(i, j);
  }

  // Reflections I - beta v v' reduce the matrix to tridiagonal form. Each v is stored in the row that it clears.
  void reduce() {
    for (int k = 0; k + 1 < n_; ++k) {
      Pack* v = matrix_ + k * n_;
      Pack square = all(0.0);
      for (int j = k + 1; j < n_; ++j) square += v[j] * v[j];
      const Pack first = v[k + 1], norm = root(square), to = where(first > 0.0, -norm, norm);
      const Mask nonzero = norm > 0.0;
      values_[k] = v[k], off_diagonal_[k] = to;
      v[k + 1] = first - to;
      const Pack beta = weights_[k] = where(nonzero, 1.0 / where(nonzero, square - first * to, all(1.0)), all(0.0));
      reflect(k, v, beta);
    }
    values_[n_ - 1] = entry(n_ - 1, n_ - 1);
  }

  // Reflects from both sides: A - v w' - w v', where w = beta A v - (beta/2 v' beta A v) v.
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

  // Product of the reflections; its columns are stored as rows.
  void accumulate_reflections() {
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

  // QR iteration: eigenvalues converge at the end of the diagonal, one after another.
  void iterate() {
    Pack largest = all(0.0);
    for (int i = 0; i < n_; ++i) largest = larger(magnitude(values_[i]), largest);
    for (int i = 0; i + 1 < n_; ++i) largest = larger(magnitude(off_diagonal_[i]), largest);
    const Pack negligible = kNegligible * largest;
    for (int end = n_ - 1; end > 0; --end)
      // NaN compares false, so that no step is taken for it
      for (int round = 0; round < kMaxRounds && any(magnitude(off_diagonal_[end - 1]) > negligible); ++round)
        qr_step(end, negligible);
  }

  // One QR step for the block that ends at ``end``. The block begins after the last negligible off-diagonal entry, whose
  // index differs between matrices.
  void qr_step(int end, Pack negligible) {
    int first = end;
    for (Mask active = magnitude(off_diagonal_[end - 1]) > negligible; any(active);) {
      row_[--first] = truth(active);
      if (first == 0) break;
      active &= magnitude(off_diagonal_[first - 1]) > negligible;
    }
    const Pack shift = wilkinson(end);
    Pack x = all(0.0), z = all(0.0), before = all(0.0);
    for (int k = first; k < end; ++k) {
      const Mask active = row_[k] > 0.0, begins = active & (before == 0.0);
      x = where(begins, values_[k] - shift, x), z = where(begins, off_diagonal_[k], z);
      const Pack length = root(x * x + z * z);
      const Mask rotates = active & (length > 0.0);
      const Pack unit = 1.0 / where(rotates, length, all(1.0));
      const Pack c = where(rotates, x * unit, all(1.0)), s = where(rotates, z * unit, all(0.0));
      if (k > first) off_diagonal_[k - 1] = where(active & (before > 0.0), length, off_diagonal_[k - 1]);
      const Pack a = values_[k], b = values_[k + 1], e = off_diagonal_[k], twice = 2.0 * c * s * e;
      values_[k] = c * c * a + twice + s * s * b;
      values_[k + 1] = s * s * a - twice + c * c * b;
      off_diagonal_[k] = c * s * (b - a) + (c * c - s * s) * e;
      if (k + 1 < end)
        x = off_diagonal_[k], z = s * off_diagonal_[k + 1], off_diagonal_[k + 1] = c * off_diagonal_[k + 1];
      rotate(vectors_ + k * n_, vectors_ + (k + 1) * n_, c, s);
      before = row_[k];
    }
    for (int k = first; k < end; ++k)
      off_diagonal_[k] = where(magnitude(off_diagonal_[k]) <= negligible, all(0.0), off_diagonal_[k]);
  }

  // Eigenvalue of the last two rows' block that is nearer to the last diagonal entry.
  Pack wilkinson(int end) const {
    const Pack e = off_diagonal_[end - 1], half = 0.5 * (values_[end - 1] - values_[end]);
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
  Pack *matrix_, *vectors_;       // row by row
  Pack *values_, *off_diagonal_;  // diagonal, and off-diagonal entries
  Pack *weights_, *row_;          // weights of the reflections; one row
  Pack size_;
};

}  // namespace jaxscp

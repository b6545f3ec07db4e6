// The Schur complement in the link multipliers: block tridiagonal, factored by cyclic reduction.
//
// Every second block is eliminated at once, which leaves a chain of half the length (``block_tridiagonal.py`` says it
// in JAX). Entry (i, j) of all blocks lies in a row, so that neighbours are a shift apart.
#pragma once

#include <algorithm>

#include "elimination.h"

namespace jaxscp {

// Rows of ``places`` numbers, with room behind them for whole packs shifted by one.
class Rows {
 public:
  Rows() = default;
  Rows(int rows, int places)
      : stride_(2 * kWidth * ((places + 2 * kWidth - 1) / (2 * kWidth)) + kWidth), data_(rows * stride_) {}
  double* operator[](int row) { return data_.data() + static_cast<size_t>(row) * stride_; }
  int packs() const { return stride_ / kWidth - 1; }
  void fill(int row, double v) { std::fill_n((*this)[row], stride_, v); }

 private:
  int stride_ = 0;
  std::vector<double> data_;
};

class Chain {
 public:
  Chain(int blocks, int size) : size_(size), right_(size) {
    for (int count = blocks;; count -= count / 2) {
      levels_.push_back({count, Rows(size * size, count), Rows(size * size, count), Rows(size, count), {}, {}});
      Level& level = levels_.back();
      int packs = packs_for(std::max(count / 2, 1)), rows = count > 1 ? 3 * size : size;
      level.panel.resize(static_cast<size_t>(packs) * rows * size);
      level.reduced.resize(static_cast<size_t>(packs) * rows);
      if (count == 1) break;
    }
  }

  // Blocks of the matrix: lower triangles of those on the diagonal, and S_{l,l+1}. Zero after ``clear``.
  double* diagonal(int i, int j) { return levels_[0].diagonal[i * size_ + j]; }
  double* above(int i, int j) { return levels_[0].above[i * size_ + j]; }
  // The right side, then the solution. Zero after ``clear_vector``.
  double* vector(int i) { return levels_[0].vector[i]; }

  void clear() { clear(levels_[0]); }
  void clear_vector() {
    for (int i = 0; i < size_; ++i) levels_[0].vector.fill(i, 0.0);
  }

  void factor() {
    for (size_t n = 0; n + 1 < levels_.size(); ++n) reduce(levels_[n], levels_[n + 1]);
    Level& last = levels_.back();
    for (int i = 0; i < size_; ++i)
      for (int j = 0; j <= i; ++j) last.panel[i * size_ + j] = all(last.diagonal[i * size_ + j][0]);
    eliminate(last.panel.data(), size_, size_);
  }

  void solve() {
    for (size_t n = 0; n + 1 < levels_.size(); ++n) descend_to(levels_[n], levels_[n + 1]);
    Level& last = levels_.back();
    Pack* v = last.reduced.data();
    for (int i = 0; i < size_; ++i) right_[i] = all(last.vector[i][0]);
    descend(last.panel.data(), size_, size_, right_.data(), v);
    ascend(last.panel.data(), size_, size_, v);
    for (int i = 0; i < size_; ++i) last.vector[i][0] = v[i][0];
    for (size_t n = levels_.size() - 1; n-- > 0;) ascend_from(levels_[n], levels_[n + 1]);
  }

 private:
  struct Level {
    int count;
    Rows diagonal, above, vector;
    Packs panel;    // of the odd blocks: D, and what ties it to the even blocks left and right of it
    Packs reduced;  // right side of the odd blocks, eliminated
  };

  // Blocks beyond the last are unit blocks tied to nothing, so that they need no case of their own.
  void clear(Level& level) {
    for (int e = 0; e < size_ * size_; ++e) {
      bool unit = e % (size_ + 1) == 0;
      level.diagonal.fill(e, 0.0);
      if (unit) std::fill_n(level.diagonal[e] + level.count, level.diagonal.packs() * kWidth - level.count, 1.0);
      level.above.fill(e, 0.0);
    }
  }

  void reduce(Level& from, Level& to) {
    clear(to);
    int m = size_, even_packs = packs_for(to.count), odd_packs = packs_for(from.count / 2);
    for (int i = 0; i < m; ++i)
      for (int j = 0; j <= i; ++j)
        for (int p = 0; p < even_packs; ++p) {
          const double* d = from.diagonal[i * m + j] + 2 * p * kWidth;
          store(to.diagonal[i * m + j] + p * kWidth, evens(load(d), load(d + kWidth)));
        }
    for (int p = 0; p < odd_packs; ++p) {
      Pack* panel = from.panel.data() + static_cast<size_t>(p) * 3 * m * m;
      Pack *left = panel + m * m, *right = left + m * m;
      for (int i = 0; i < m; ++i)
        for (int j = 0; j < m; ++j) {
          const double* d = from.diagonal[i * m + j] + 2 * p * kWidth;
          const double* a = from.above[i * m + j] + 2 * p * kWidth;
          Pack first = load(a), second = load(a + kWidth);
          if (j <= i) panel[i * m + j] = odds(load(d), load(d + kWidth));
          left[i * m + j] = evens(first, second);   // S_{o-1,o}
          right[j * m + i] = odds(first, second);   // S_{o,o+1}'
        }
      eliminate(panel, m, 3 * m);
      auto subtract = [](double* at, Pack v) { store(at, load(at) - v); };
      int here = p * kWidth;
      gram(left, m, left, m, m, [&](int i, int j, Pack v) { subtract(to.diagonal[i * m + j] + here, v); });
      gram(right, m, right, m, m, [&](int i, int j, Pack v) { subtract(to.diagonal[i * m + j] + here + 1, v); });
      gram(left, m, right, m, m, [&](int i, int j, Pack v) { store(to.above[i * m + j] + here, -v); });
    }
  }

  void descend_to(Level& from, Level& to) {
    int m = size_, even_packs = packs_for(to.count), odd_packs = packs_for(from.count / 2);
    for (int i = 0; i < m; ++i) {
      to.vector.fill(i, 0.0);
      for (int p = 0; p < even_packs; ++p) {
        const double* v = from.vector[i] + 2 * p * kWidth;
        store(to.vector[i] + p * kWidth, evens(load(v), load(v + kWidth)));
      }
    }
    for (int p = 0; p < odd_packs; ++p) {
      for (int i = 0; i < m; ++i) {
        const double* v = from.vector[i] + 2 * p * kWidth;
        right_[i] = odds(load(v), load(v + kWidth));
      }
      Pack* out = from.reduced.data() + static_cast<size_t>(p) * 3 * m;
      descend(from.panel.data() + static_cast<size_t>(p) * 3 * m * m, m, 3 * m, right_.data(), out);
      for (int i = 0; i < m; ++i) {
        double* even = to.vector[i] + p * kWidth;
        store(even, load(even) - out[m + i]);
        store(even + 1, load(even + 1) - out[2 * m + i]);
      }
    }
  }

  void ascend_from(Level& level, Level& even) {
    int m = size_, odd_packs = packs_for(level.count / 2);
    for (int p = 0; p < odd_packs; ++p) {
      Pack* v = level.reduced.data() + static_cast<size_t>(p) * 3 * m;
      for (int i = 0; i < m; ++i) {
        const double* x = even.vector[i] + p * kWidth;
        v[m + i] = load(x);
        v[2 * m + i] = load(x + 1);
      }
      ascend(level.panel.data() + static_cast<size_t>(p) * 3 * m * m, m, 3 * m, v);
      for (int i = 0; i < m; ++i)
        for (int lane = 0; lane < kWidth; ++lane) {
          double* at = level.vector[i] + 2 * (p * kWidth + lane);
          at[0] = v[m + i][lane];
          at[1] = v[i][lane];
        }
    }
    // an even block behind the last odd one
    if (level.count % 2 == 1)
      for (int i = 0; i < m; ++i) level.vector[i][level.count - 1] = even.vector[i][even.count - 1];
  }

  int size_;
  Packs right_;
  std::vector<Level> levels_;
};

}  // namespace jaxscp

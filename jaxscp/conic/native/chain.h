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
  void clear() { std::fill(data_.begin(), data_.end(), 0.0); }
  // All places of a row from ``begin`` on, but for the room behind them.
  void fill(int row, int begin, double v) { std::fill_n((*this)[row] + begin, stride_ - kWidth - begin, v); }

 private:
  int stride_ = 0;
  std::vector<double> data_;
};

// Sides of a system that are solved together, at most.
constexpr int kSides = 2;

class Chain {
 public:
  Chain(int blocks, int size) : size_(size), gram_(size * size), right_(size * kSides) {
    for (int count = blocks;; count -= count / 2) {
      int packs = packs_for(std::max(count / 2, 1)), rows = count > 1 ? 3 * size : size;
      levels_.push_back({count, Rows(size * kSides, count), Packs(static_cast<size_t>(packs) * rows * size),
                         Packs(static_cast<size_t>(packs) * rows * kSides)});
      if (count == 1) break;
    }
    for (auto& blocks_of : blocks_) blocks_of = {Rows(size * size, blocks), Rows(size * size, blocks)};
  }

  // Blocks of the matrix: lower triangles of those on the diagonal, and S_{l,l+1}. Zero after ``clear``.
  double* diagonal(int i, int j) { return blocks_[0].diagonal[i * size_ + j]; }
  double* above(int i, int j) { return blocks_[0].above[i * size_ + j]; }
  // The right sides, then the solutions. Zero after ``clear_vector``.
  double* vector(int i, int side) { return levels_[0].vector[i * kSides + side]; }

  void clear() { clear(blocks_[0], levels_[0].count); }
  void clear_vector() { levels_[0].vector.clear(); }

  void factor() {
    int n = 0, last = static_cast<int>(levels_.size()) - 1;
    for (; n < last; ++n) reduce(blocks_[n % 2], levels_[n], blocks_[(n + 1) % 2], levels_[n + 1].count);
    for (int i = 0; i < size_; ++i)
      for (int j = 0; j <= i; ++j) levels_[n].panel[i * size_ + j] = all(blocks_[n % 2].diagonal[i * size_ + j][0]);
    eliminate(levels_[n].panel.data(), size_, size_);
  }

  template <int S>
  void solve() {
    int last = static_cast<int>(levels_.size()) - 1;
    for (int n = 0; n < last; ++n) descend_to<S>(levels_[n], levels_[n + 1]);
    Level& one = levels_[last];
    Pack* v = one.reduced.data();
    for (int i = 0; i < size_; ++i)
      for (int s = 0; s < S; ++s) right_[i * S + s] = all(one.vector[i * kSides + s][0]);
    descend<S>(one.panel.data(), size_, size_, right_.data(), v);
    ascend<S>(one.panel.data(), size_, size_, v);
    for (int i = 0; i < size_; ++i)
      for (int s = 0; s < S; ++s) one.vector[i * kSides + s][0] = v[i * S + s][0];
    for (int n = last - 1; n >= 0; --n) ascend_from<S>(levels_[n], levels_[n + 1]);
  }

 private:
  struct Blocks {
    Rows diagonal, above;
  };
  struct Level {
    int count;
    Rows vector;
    Packs panel;    // of the odd blocks: D, and what ties it to the even blocks left and right of it
    Packs reduced;  // right sides of the odd blocks, eliminated
  };

  // Blocks beyond the last are unit blocks tied to nothing, so that they need no case of their own.
  void clear(Blocks& blocks, int count) {
    blocks.diagonal.clear();
    blocks.above.clear();
    for (int i = 0; i < size_; ++i) blocks.diagonal.fill(i * size_ + i, count, 1.0);
  }

  void reduce(Blocks& from, Level& level, Blocks& to, int even_count) {
    int m = size_, even_packs = packs_for(even_count), odd_packs = packs_for(level.count / 2);
    clear(to, even_count);
    for (int i = 0; i < m; ++i)
      for (int j = 0; j <= i; ++j)
        for (int p = 0; p < even_packs; ++p) {
          const double* d = from.diagonal[i * m + j] + 2 * p * kWidth;
          store(to.diagonal[i * m + j] + p * kWidth, evens(load(d), load(d + kWidth)));
        }
    for (int p = 0; p < odd_packs; ++p) {
      Pack* panel = level.panel.data() + static_cast<size_t>(p) * 3 * m * m;
      Pack *left = panel + m * m, *right = left + m * m;
      for (int i = 0; i < m; ++i)
        for (int j = 0; j < m; ++j) {
          const double* d = from.diagonal[i * m + j] + 2 * p * kWidth;
          const double* a = from.above[i * m + j] + 2 * p * kWidth;
          Pack first = load(a), second = load(a + kWidth);
          if (j <= i) panel[i * m + j] = odds(load(d), load(d + kWidth));
          left[i * m + j] = evens(first, second);  // S_{o-1,o}
          right[j * m + i] = odds(first, second);  // S_{o,o+1}'
        }
      eliminate(panel, m, 3 * m);
      int here = p * kWidth;
      auto subtract = [&](const Pack* side, int shift) {
        gram(side, side, m, m, gram_.data());
        for (int i = 0; i < m; ++i)
          for (int j = 0; j <= i; ++j) {
            double* at = to.diagonal[i * m + j] + here + shift;
            store(at, load(at) - gram_[i * m + j]);
          }
      };
      subtract(left, 0);
      subtract(right, 1);
      gram(left, right, m, m, gram_.data());
      for (int e = 0; e < m * m; ++e) store(to.above[e] + here, -gram_[e]);
    }
  }

  template <int S>
  void descend_to(Level& from, Level& to) {
    int m = size_, even_packs = packs_for(to.count), odd_packs = packs_for(from.count / 2);
    to.vector.clear();
    for (int i = 0; i < m; ++i)
      for (int s = 0; s < S; ++s)
        for (int p = 0; p < even_packs; ++p) {
          const double* v = from.vector[i * kSides + s] + 2 * p * kWidth;
          store(to.vector[i * kSides + s] + p * kWidth, evens(load(v), load(v + kWidth)));
        }
    for (int p = 0; p < odd_packs; ++p) {
      for (int i = 0; i < m; ++i)
        for (int s = 0; s < S; ++s) {
          const double* v = from.vector[i * kSides + s] + 2 * p * kWidth;
          right_[i * S + s] = odds(load(v), load(v + kWidth));
        }
      Pack* out = from.reduced.data() + static_cast<size_t>(p) * 3 * m * kSides;
      descend<S>(from.panel.data() + static_cast<size_t>(p) * 3 * m * m, m, 3 * m, right_.data(), out);
      for (int i = 0; i < m; ++i)
        for (int s = 0; s < S; ++s) {
          double* even = to.vector[i * kSides + s] + p * kWidth;
          store(even, load(even) - out[(m + i) * S + s]);
          store(even + 1, load(even + 1) - out[(2 * m + i) * S + s]);
        }
    }
  }

  template <int S>
  void ascend_from(Level& level, Level& even) {
    int m = size_, odd_packs = packs_for(level.count / 2);
    for (int p = 0; p < odd_packs; ++p) {
      Pack* v = level.reduced.data() + static_cast<size_t>(p) * 3 * m * kSides;
      for (int i = 0; i < m; ++i)
        for (int s = 0; s < S; ++s) {
          const double* x = even.vector[i * kSides + s] + p * kWidth;
          v[(m + i) * S + s] = load(x);
          v[(2 * m + i) * S + s] = load(x + 1);
        }
      ascend<S>(level.panel.data() + static_cast<size_t>(p) * 3 * m * m, m, 3 * m, v);
      for (int i = 0; i < m; ++i)
        for (int s = 0; s < S; ++s) {
          double* at = level.vector[i * kSides + s] + 2 * p * kWidth;
          Pack x = v[(m + i) * S + s], y = v[i * S + s];
          store(at, first_of_pairs(x, y));
          store(at + kWidth, last_of_pairs(x, y));
        }
    }
    // an even block behind the last odd one
    if (level.count % 2 == 1)
      for (int i = 0; i < m * kSides; ++i) level.vector[i][level.count - 1] = even.vector[i][even.count - 1];
  }

  int size_;
  Packs gram_, right_;
  std::vector<Level> levels_;
  Blocks blocks_[2];  // of a level, and of the one it is reduced to
};

}  // namespace jaxscp

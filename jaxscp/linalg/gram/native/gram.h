// Sums over the weighted rows of one location (``system.py``): J' W J and J' v.
#pragma once

#include <algorithm>
#include <vector>

#include "dense.h"
#include "workspace.h"

namespace jaxscp {

using Workspace = WorkspaceOf<Pack>;

// Arrays of one constraint, row after row; ``rank_one`` is null if the weight matrix is diagonal.
struct WeightedRows {
  int points, rows;
  const double *jacobian, *weight, *vectors, *rank_one;

  int all_rows() const { return points * rows; }
  int stacked() const { return points * rows + (rank_one ? points : 0); }
};

class Gram {
 public:
  Gram(const std::vector<WeightedRows>& parts, int inputs, int vectors, Workspace& workspace)
      : parts_(parts), inputs_(inputs), vector_count_(vectors) {
    for (const WeightedRows& part : parts) stacked_ += part.stacked(), rows_ += part.all_rows();
    const int packs = packs_for(inputs);
    auto take = [&](int count) { return Matrix{reinterpret_cast<double*>(workspace.take(count * packs)), packs}; };
    jacobian_ = take(stacked_), weighted_ = take(stacked_), matrix_ = take(inputs), products_ = take(vectors);
    vectors_ = reinterpret_cast<double*>(workspace.take(packs_for(vectors * rows_)));
  }

  // J' W J and J' v of one location, as XLA stores them.
  void run(double* matrix, double* products) {
    stack();
    std::fill_n(matrix_.at, inputs_ * matrix_.stride(), 0.0);
    accumulate(inputs_, stacked_, [&](int i, int k) { return weighted_[k][i]; }, jacobian_, matrix_);
    for (int i = 0; i < inputs_; ++i) std::copy_n(matrix_[i], inputs_, matrix + i * inputs_);
    std::fill_n(products_.at, vector_count_ * products_.stride(), 0.0);
    for (int s = 0; s < vector_count_; ++s) {
      add_rows(1.0, rows_, vectors_ + s * rows_, jacobian_, products_[s]);
      std::copy_n(products_[s], inputs_, products + s * inputs_);
    }
  }

 private:
  // Stacks all rows, then the rank-one row of each point; each padded with zeros, once plain and once weighted.
  void stack() {
    int row = 0;
    for (const WeightedRows& part : parts_)
      for (int r = 0; r < part.all_rows(); ++r, ++row) {
        const int left = (part.all_rows() - r) * inputs_;
        read(part.jacobian + r * inputs_, left >= jacobian_.stride(), jacobian_[row]);
        for (int p = 0; p < jacobian_.packs; ++p)
          store(part.weight[r] * load(jacobian_[row] + p * kWidth), weighted_[row] + p * kWidth);
        for (int s = 0; s < vector_count_; ++s) vectors_[s * rows_ + row] = part.vectors[r * vector_count_ + s];
      }
    int first = 0;
    for (const WeightedRows& part : parts_) {
      for (int p = 0; part.rank_one && p < part.points; ++p, ++row) {
        const Matrix of_point{jacobian_[first + p * part.rows], jacobian_.packs};
        std::fill_n(jacobian_[row], jacobian_.stride(), 0.0);
        add_rows(1.0, part.rows, part.rank_one + p * part.rows, of_point, jacobian_[row]);
        std::copy_n(jacobian_[row], jacobian_.stride(), weighted_[row]);
      }
      first += part.all_rows();
    }
  }

  // Copies a row. If enough numbers follow, whole packs are loaded and masked, which is faster.
  void read(const double* from, bool followed, double* to) const {
    if (followed) {
      for (int p = 0; p < jacobian_.packs; ++p)
        store(where(within(p, inputs_), load(from + p * kWidth), all(0.0)), to + p * kWidth);
    } else {
      std::copy_n(from, inputs_, to);
      std::fill(to + inputs_, to + jacobian_.stride(), 0.0);
    }
  }

  const std::vector<WeightedRows>& parts_;
  int inputs_, vector_count_, stacked_ = 0, rows_ = 0;
  Matrix jacobian_, weighted_, matrix_, products_;
  double* vectors_;  // by vector, then by row
};

}  // namespace jaxscp

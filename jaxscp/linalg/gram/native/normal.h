// Sums over the weighted rows of one place (``rows.py``): J' W J and J' v.
#pragma once

#include <algorithm>
#include <vector>

#include "dense.h"
#include "memory.h"

namespace jaxscp {

using Memory = MemoryOf<Pack>;

// A constraint's arrays, row after row; ``along`` is null where its rows are weighed one by one.
struct Part {
  int points, rows;
  const double *jacobian, *weight, *sides, *along;

  int all_rows() const { return points * rows; }
  int stacked() const { return points * rows + (along ? points : 0); }
};

class Normal {
 public:
  Normal(const std::vector<Part>& parts, int inputs, int sides, Memory& memory)
      : parts_(parts), inputs_(inputs), sides_(sides) {
    for (const Part& part : parts) stacked_ += part.stacked(), rows_ += part.all_rows();
    const int packs = packs_for(inputs);
    auto take = [&](int count) { return Matrix{reinterpret_cast<double*>(memory.take(count * packs)), packs}; };
    jacobian_ = take(stacked_), weighted_ = take(stacked_), matrix_ = take(inputs), pulled_ = take(sides);
    side_ = reinterpret_cast<double*>(memory.take(packs_for(sides * rows_)));
  }

  // matrix and sides as XLA wants them, of one place.
  void run(double* matrix, double* sides) {
    stack();
    std::fill_n(matrix_.at, inputs_ * matrix_.stride(), 0.0);
    accumulate(inputs_, stacked_, [&](int i, int k) { return weighted_[k][i]; }, jacobian_, matrix_);
    for (int i = 0; i < inputs_; ++i) std::copy_n(matrix_[i], inputs_, matrix + i * inputs_);
    std::fill_n(pulled_.at, sides_ * pulled_.stride(), 0.0);
    for (int s = 0; s < sides_; ++s) {
      add_rows(1.0, rows_, side_ + s * rows_, jacobian_, pulled_[s]);
      std::copy_n(pulled_[s], inputs_, sides + s * inputs_);
    }
  }

 private:
  // All rows, then those that couple the rows of a point; each with zeros behind, as it is and weighted.
  void stack() {
    int row = 0;
    for (const Part& part : parts_)
      for (int r = 0; r < part.all_rows(); ++r, ++row) {
        const int left = (part.all_rows() - r) * inputs_;
        read(part.jacobian + r * inputs_, left >= jacobian_.stride(), jacobian_[row]);
        for (int p = 0; p < jacobian_.packs; ++p)
          store(part.weight[r] * load(jacobian_[row] + p * kWidth), weighted_[row] + p * kWidth);
        for (int s = 0; s < sides_; ++s) side_[s * rows_ + row] = part.sides[r * sides_ + s];
      }
    int first = 0;
    for (const Part& part : parts_) {
      for (int p = 0; part.along && p < part.points; ++p, ++row) {
        const Matrix of_point{jacobian_[first + p * part.rows], jacobian_.packs};
        std::fill_n(jacobian_[row], jacobian_.stride(), 0.0);
        add_rows(1.0, part.rows, part.along + p * part.rows, of_point, jacobian_[row]);
        std::copy_n(jacobian_[row], jacobian_.stride(), weighted_[row]);
      }
      first += part.all_rows();
    }
  }

  // With what follows it, if there is as much, which is quicker than by its length.
  void read(const double* from, bool followed, double* to) const {
    if (followed) {
      for (int p = 0; p < jacobian_.packs; ++p)
        store(where(within(p, inputs_), load(from + p * kWidth), all(0.0)), to + p * kWidth);
    } else {
      std::copy_n(from, inputs_, to);
      std::fill(to + inputs_, to + jacobian_.stride(), 0.0);
    }
  }

  const std::vector<Part>& parts_;
  int inputs_, sides_, stacked_ = 0, rows_ = 0;
  Matrix jacobian_, weighted_, matrix_, pulled_;
  double* side_;  // by side, of all rows
};

}  // namespace jaxscp

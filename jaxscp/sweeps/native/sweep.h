// One pass through the intervals of a pack: the path, its tangents, and the curvature of the priced slopes.
//
// An interval's inputs are w = (state x, first controls, last controls); controls are linear between. The path is the
// state with the running cost after it, its tangents dX/dw, row by row. ``entry`` of a slope's derivatives come from a
// tape (``tape.h``), by coordinates; all the rest is the linear algebra of a Runge-Kutta method.
#pragma once

#include <cstring>
#include <vector>

#include "tape.h"

namespace jaxscp {

struct Coordinates {
  int row, column;
};

template <typename T>
struct Several {
  const T* data = nullptr;
  int count = 0;
  const T* begin() const { return data; }
  const T* end() const { return data + count; }
  const T& operator[](int i) const { return data[i]; }
};

// What is the same for all intervals.
struct Sweep {
  int states, controls, steps, every;  // states without the cost; controls of one end, with the dilation
  bool priced;
  Several<double> shares, weights, table;  // the Runge-Kutta method: of a stage; (stages, stages) row by row
  Several<Operation> operations;
  int once, places, parameters;
  Several<double> constants;
  Several<int> outputs;  // places of the slopes, then of the Jacobian's entries, then of the Hessian's
  Several<Coordinates> jacobian, hessian;  // of the slopes in (state, controls); lower triangle of their price
  Several<int> first;  // by row of the path: the first input that it depends on

  int extended() const { return states + 1; }
  int inputs() const { return states + 2 * controls; }
  int stages() const { return shares.count; }
  int kept() const { return steps / every; }
};

// The arrays of one pack of intervals.
class SweepPack {
 public:
  explicit SweepPack(const Sweep& s)
      : s_(s), rows_(s.extended()), columns_(s.inputs()), w_(columns_), places_(s.places), path_(rows_),
        slopes_(s.stages() * rows_), tangent_(rows_ * columns_), moved_((s.states + s.controls) * columns_),
        pushed_(s.stages() * rows_ * columns_), turned_((s.states + s.controls) * columns_),
        curvature_(columns_ * columns_) {}

  std::vector<Pack>& w() { return w_; }
  Pack& parameter(int i) { return places_[arguments() + i]; }
  const std::vector<Pack>& path() const { return path_; }
  const std::vector<Pack>& tangent() const { return tangent_; }
  const std::vector<Pack>& curvature() const { return curvature_; }

  // price(step, stage, row) of a slope; keep(i) when another point of the path is due.
  template <typename Price, typename Keep>
  void run(Price price, Keep keep) {
    begin();
    for (int step = 0; step < s_.steps; ++step) {
      for (int stage = 0; stage < s_.stages(); ++stage) {
        if (s_.priced)
          for (int r = 0; r < rows_; ++r) places_[s_.states + s_.controls + r] = price(step, stage, r);
        one_stage(step, stage);
      }
      advance(s_.weights.data, path_.data(), tangent_.data(), path_.data(), tangent_.data(), s_.stages(), rows_);
      if ((step + 1) % s_.every == 0) keep((step + 1) / s_.every - 1);
    }
    for (int i = 0; i < columns_; ++i)
      for (int j = 0; j < i; ++j) curvature_[i * columns_ + j] = curvature_[j * columns_ + i];
  }

 private:
  int arguments() const { return s_.states + s_.controls + (s_.priced ? rows_ : 0); }

  void begin() {
    for (int i = 0; i < s_.constants.count; ++i) parameter(s_.parameters + i) = all(s_.constants[i]);
    play(s_.operations.begin(), s_.operations.begin() + s_.once, places_.data());
    std::fill(tangent_.begin(), tangent_.end(), all(0.0));
    std::fill(moved_.begin(), moved_.end(), all(0.0));
    std::fill(pushed_.begin(), pushed_.end(), all(0.0));
    std::fill(curvature_.begin(), curvature_.end(), all(0.0));
    for (int r = 0; r < s_.states; ++r) path_[r] = w_[r], tangent_[r * columns_ + r] = all(1.0);
    path_[s_.states] = all(0.0);
  }

  void one_stage(int step, int stage) {
    const double share = (step + s_.shares[stage]) / s_.steps;
    const int n = s_.states, m = s_.controls;
    advance(s_.table.data + stage * s_.stages(), path_.data(), tangent_.data(), places_.data(), moved_.data(), stage, n);
    for (int k = 0; k < m; ++k) {
      places_[n + k] = w_[n + k] + share * (w_[n + m + k] - w_[n + k]);
      moved_[(n + k) * columns_ + n + k] = all(1.0 - share);
      moved_[(n + k) * columns_ + n + m + k] = all(share);
    }
    play(s_.operations.begin() + s_.once, s_.operations.end(), places_.data());
    push(stage, share);
    if (s_.priced) bend(share);
  }

  // to = from + step (weights . slopes), the state and its tangents, for the first ``rows``; of ``count`` slopes.
  void advance(const double* weights, const Pack* state, const Pack* tangent, Pack* to, Pack* tangent_to, int count,
               int rows) {
    double scaled[16];
    int used[16], number = 0;
    for (int i = 0; i < count; ++i)
      if (weights[i] != 0.0) used[number] = i, scaled[number++] = weights[i] / s_.steps;
    for (int r = 0; r < rows; ++r) {
      Pack sum = state[r];
      for (int i = 0; i < number; ++i) sum += scaled[i] * slopes_[used[i] * rows_ + r];
      to[r] = sum;
      for (int c = s_.first[r]; c < columns_; ++c) {
        Pack sum = tangent[r * columns_ + c];
        for (int i = 0; i < number; ++i) sum += scaled[i] * pushed_[(used[i] * rows_ + r) * columns_ + c];
        tangent_to[r * columns_ + c] = sum;
      }
    }
  }

  // The stage's slopes and their tangents.
  void push(int stage, double share) {
    const int n = s_.states, m = s_.controls;
    Pack* pushed = pushed_.data() + stage * rows_ * columns_;
    for (int r = 0; r < rows_; ++r) {
      slopes_[stage * rows_ + r] = places_[s_.outputs[r]];
      std::fill(pushed + r * columns_ + s_.first[r], pushed + (r + 1) * columns_, all(0.0));
    }
    for (int i = 0; i < s_.jacobian.count; ++i) {
      const auto [r, k] = s_.jacobian[i];
      const Pack entry = places_[s_.outputs[rows_ + i]];
      Pack* row = pushed + r * columns_;
      if (k < n) {
        const Pack* from = moved_.data() + k * columns_;
        for (int c = s_.first[k]; c < columns_; ++c) row[c] += entry * from[c];
      } else {
        row[k] += (1.0 - share) * entry;
        row[k + m] += share * entry;
      }
    }
  }

  // curvature += moved' Hessian moved, upper triangle.
  void bend(double share) {
    const int n = s_.states, m = s_.controls, all_rows = n + m;
    const int* outputs = s_.outputs.data + rows_ + s_.jacobian.count;
    std::fill(turned_.begin(), turned_.end(), all(0.0));
    for (int i = 0; i < s_.hessian.count; ++i) {
      const auto [r, k] = s_.hessian[i];
      const Pack entry = places_[outputs[i]];
      add_row(r, k, entry, share);
      if (r != k) add_row(k, r, entry, share);
    }
    for (int r = 0; r < all_rows; ++r) {
      const Pack* turned = turned_.data() + r * columns_;
      const Pack* moved = moved_.data() + r * columns_;
      if (r >= n) {
        for (int c = r; c < columns_; ++c) curvature_[r * columns_ + c] += (1.0 - share) * turned[c];
        for (int c = r + m; c < columns_; ++c) curvature_[(r + m) * columns_ + c] += share * turned[c];
        continue;
      }
      for (int i = s_.first[r]; i < columns_; ++i)
        for (int c = i; c < columns_; ++c) curvature_[i * columns_ + c] += moved[i] * turned[c];
    }
  }

  void add_row(int r, int k, Pack entry, double share) {
    const int n = s_.states, m = s_.controls;
    Pack* row = turned_.data() + r * columns_;
    if (k >= n) {
      row[k] += (1.0 - share) * entry;
      row[k + m] += share * entry;
      return;
    }
    const Pack* from = moved_.data() + k * columns_;
    for (int c = s_.first[k]; c < columns_; ++c) row[c] += entry * from[c];
  }

  const Sweep& s_;
  int rows_, columns_;
  std::vector<Pack> w_, places_, path_, slopes_, tangent_, moved_, pushed_, turned_, curvature_;
};

}  // namespace jaxscp

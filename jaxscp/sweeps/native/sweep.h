// One pass through sixteen intervals: the path, its tangents, and the curvature of the priced slopes.
//
// An interval's inputs are w = (state x, first controls, last controls); controls are linear between. The path is the
// state with the running cost after it, its tangents dX/dw, row by row. The entries of a slope's derivatives come from
// a tape (``tape.h``), by coordinates; all the rest is the linear algebra of a Runge-Kutta method. A row is kept from its
// first entry that may not be zero.
#pragma once

#include <utility>
#include <vector>

#include "tape.h"

namespace jaxscp {

constexpr int kMaxStages = 16;

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

// The arrays of sixteen intervals, in memory that serves again.
class SweepPack {
 public:
  SweepPack(const Sweep& s, std::vector<Wide>& memory)
      : s_(s), rows_(s.extended()), columns_(s.inputs()), arguments_(s.states + s.controls) {
    std::pair<Wide**, int> arrays[] = {
        {&w_, columns_}, {&places_, s.places}, {&path_, rows_}, {&slopes_, s.stages() * rows_},
        {&tangent_, rows_ * columns_}, {&moved_, s.states * columns_}, {&pushed_, s.stages() * rows_ * columns_},
        {&turned_, arguments_ * columns_}, {&curvature_, columns_ * columns_}};
    size_t total = 0;
    for (auto [to, count] : arrays) total += count;
    if (memory.size() < total) memory.resize(total);
    Wide* at = memory.data();
    for (auto [to, count] : arrays) *to = at, at += count;
  }

  Wide& w(int i) { return w_[i]; }
  Wide& parameter(int i) { return places_[arguments_ + (s_.priced ? rows_ : 0) + i]; }
  const Wide* path() const { return path_; }
  const Wide* tangent() const { return tangent_; }
  const Wide* curvature() const { return curvature_; }

  // price(step, stage, row) of a slope; keep(i) when another point of the path is due.
  template <typename Price, typename Keep>
  void run(Price price, Keep keep) {
    begin();
    for (int step = 0; step < s_.steps; ++step) {
      for (int stage = 0; stage < s_.stages(); ++stage) {
        if (s_.priced)
          for (int r = 0; r < rows_; ++r) places_[arguments_ + r] = price(step, stage, r);
        one_stage(step, stage);
      }
      advance(s_.weights.data, path_, tangent_, path_, tangent_, s_.stages(), rows_);
      if ((step + 1) % s_.every == 0) keep((step + 1) / s_.every - 1);
    }
    for (int i = 0; i < columns_; ++i)
      for (int j = 0; j < i; ++j) curvature_[i * columns_ + j] = curvature_[j * columns_ + i];
  }

 private:
  void begin() {
    for (int i = 0; i < s_.constants.count; ++i) parameter(s_.parameters + i) = wide(s_.constants[i]);
    play(s_.operations.begin(), s_.operations.begin() + s_.once, places_);
    std::fill_n(tangent_, rows_ * columns_, wide(0.0));
    std::fill_n(curvature_, columns_ * columns_, wide(0.0));
    for (int r = 0; r < s_.states; ++r) path_[r] = w_[r], tangent_[r * columns_ + r] = wide(1.0);
    path_[s_.states] = wide(0.0);
  }

  void one_stage(int step, int stage) {
    const double share = (step + s_.shares[stage]) / s_.steps;
    const int n = s_.states, m = s_.controls;
    advance(s_.table.data + stage * s_.stages(), path_, tangent_, places_, moved_, stage, n);
    for (int k = 0; k < m; ++k) places_[n + k] = w_[n + k] + share * (w_[n + m + k] - w_[n + k]);
    play(s_.operations.begin() + s_.once, s_.operations.end(), places_);
    push(stage, share);
    if (s_.priced) bend(share);
  }

  // to = from + step (weights . slopes), the state and its tangents, for the first ``rows``; of ``count`` slopes.
  void advance(const double* weights, const Wide* state, const Wide* tangent, Wide* to, Wide* tangent_to, int count,
               int rows) {
    double scaled[kMaxStages];
    int used[kMaxStages], number = 0;
    for (int i = 0; i < count; ++i)
      if (weights[i] != 0.0) used[number] = i, scaled[number++] = weights[i] / s_.steps;
    for (int r = 0; r < rows; ++r) {
      Wide sum = state[r];
      for (int i = 0; i < number; ++i) sum += scaled[i] * slopes_[used[i] * rows_ + r];
      to[r] = sum;
      for (int c = s_.first[r]; c < columns_; ++c) {
        Wide sum = tangent[r * columns_ + c];
        for (int i = 0; i < number; ++i) sum += scaled[i] * pushed_[(used[i] * rows_ + r) * columns_ + c];
        tangent_to[r * columns_ + c] = sum;
      }
    }
  }

  // The stage's slopes and their tangents.
  void push(int stage, double share) {
    Wide* pushed = pushed_ + stage * rows_ * columns_;
    for (int r = 0; r < rows_; ++r) {
      slopes_[stage * rows_ + r] = places_[s_.outputs[r]];
      std::fill(pushed + r * columns_ + s_.first[r], pushed + (r + 1) * columns_, wide(0.0));
    }
    for (int i = 0; i < s_.jacobian.count; ++i) {
      const auto [r, k] = s_.jacobian[i];
      add_row(pushed + r * columns_, places_[s_.outputs[rows_ + i]], k, share);
    }
  }

  // curvature += moved' Hessian moved, upper triangle.
  void bend(double share) {
    const int n = s_.states, m = s_.controls;
    const int* outputs = s_.outputs.data + rows_ + s_.jacobian.count;
    std::fill_n(turned_, arguments_ * columns_, wide(0.0));
    for (int i = 0; i < s_.hessian.count; ++i) {
      const auto [r, k] = s_.hessian[i];
      const Wide entry = places_[outputs[i]];
      add_row(turned_ + r * columns_, entry, k, share);
      if (r != k) add_row(turned_ + k * columns_, entry, r, share);
    }
    for (int r = 0; r < n; ++r) {
      const Wide *moved = moved_ + r * columns_, *turned = turned_ + r * columns_;
      for (int i = s_.first[r]; i < columns_; ++i)
        for (int c = i; c < columns_; ++c) curvature_[i * columns_ + c] += moved[i] * turned[c];
    }
    for (int r = n; r < arguments_; ++r) {
      const Wide* turned = turned_ + r * columns_;
      for (int c = r; c < columns_; ++c) curvature_[r * columns_ + c] += (1.0 - share) * turned[c];
      for (int c = r + m; c < columns_; ++c) curvature_[(r + m) * columns_ + c] += share * turned[c];
    }
  }

  // row += entry times the tangent of a stage's k-th argument: a state's, or a control's, which is a share of two inputs.
  void add_row(Wide* row, const Wide& entry, int k, double share) {
    if (k >= s_.states) {
      row[k] += (1.0 - share) * entry;
      row[k + s_.controls] += share * entry;
      return;
    }
    const Wide* from = moved_ + k * columns_;
    for (int c = s_.first[k]; c < columns_; ++c) row[c] += entry * from[c];
  }

  const Sweep& s_;
  int rows_, columns_, arguments_;
  Wide *w_, *places_, *path_, *slopes_, *tangent_, *moved_, *pushed_, *turned_, *curvature_;
};

}  // namespace jaxscp

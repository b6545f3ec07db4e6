// Factorisation and solution of the problem in ``system.py``, in the steps of ``in_jax.py``.
#pragma once

#include <algorithm>
#include <numeric>

#include "dense.h"
#include "workspace.h"

namespace jaxscp {

using Workspace = WorkspaceOf<Pack>;

struct Sizes {
  int intervals, states, inputs, stage, initial, final;

  int controls() const { return inputs - stage; }
  int nodes() const { return intervals + 1; }
};

// Arrays from XLA, row after row, with the names of ``system.py``.
struct ProblemArrays {
  const double *hessian, *last, *flow, *initial, *final;
};
template <typename Number>
struct FactorArrays {
  Number *value, *lower, *gain, *first;
};
template <typename Number>
struct KKTArrays {
  Number *nodes, *flow, *initial, *final;
};

inline Matrix blank(int rows, int columns, Workspace& workspace) {
  const int packs = packs_for(columns);
  return {reinterpret_cast<double*>(workspace.take(static_cast<size_t>(rows) * packs)), packs};
}

inline Matrix zeros(int rows, int columns, Workspace& workspace) {
  const Matrix to = blank(rows, columns, workspace);
  std::fill_n(to.at, rows * to.stride(), 0.0);
  return to;
}

// Copies rows, padded with zeros. All but the last few are loaded in whole packs and masked, which is faster.
inline void read(const double* from, int rows, int columns, const Matrix& to) {
  for (int i = 0; i < rows - kWidth; ++i)
    for (int p = 0; p < to.packs; ++p)
      store(where(within(p, columns), load(from + i * columns + p * kWidth), all(0.0)), to[i] + p * kWidth);
  for (int i = std::max(0, rows - kWidth); i < rows; ++i) {
    std::copy_n(from + i * columns, columns, to[i]);
    std::fill(to[i] + columns, to[i] + to.stride(), 0.0);
  }
}

inline Matrix copied(const double* from, int rows, int columns, Workspace& workspace) {
  const Matrix to = blank(rows, columns, workspace);
  read(from, rows, columns, to);
  return to;
}

inline void write(const Matrix& from, int rows, int columns, double* to) {
  for (int i = 0; i < rows; ++i) std::copy_n(from[i], columns, to + i * columns);
}

// value += penalty c' c, for conditions c on states.
inline void add_penalty(double penalty, const double* c, int end_conditions, int states, const Matrix& value) {
  for (int k = 0; k < end_conditions; ++k)
    for (int i = 0; i < states; ++i)
      for (int j = 0; j < states; ++j) value[i][j] += penalty * c[k * states + i] * c[k * states + j];
}

// Factorisation, from the last node to the first. With controls U at an interval's end, the Hessian in w = (X, U) is
// H + T' P T = [V + K' L L' K, ...; ..., L L'], where T w is the next node and V the Hessian of the cost to go.
class Elimination {
 public:
  Elimination(const Sizes& sizes, double penalty, Workspace& workspace)
      : s_(sizes), penalty_(penalty), value_(blank(s_.stage, s_.stage, workspace)),
        flow_(blank(s_.states, s_.inputs, workspace)), propagated_(blank(s_.stage, s_.inputs, workspace)),
        stage_hessian_(blank(s_.inputs, s_.inputs, workspace)), lower_(blank(s_.controls(), s_.controls(), workspace)),
        cross_(blank(s_.controls(), s_.stage, workspace)) {}

  void run(const ProblemArrays& problem, const FactorArrays<double>& to) {
    const int v = s_.stage, c = s_.controls();
    read(problem.last, v, v, value_);
    add_penalty(penalty_, problem.final, s_.final, s_.states, value_);
    for (int i = s_.intervals - 1; i >= 0; --i) {
      write(value_, v, v, to.value + i * v * v);
      add_cost_to_go(problem.hessian + i * s_.inputs * s_.inputs, problem.flow + i * s_.states * s_.inputs);
      minimise();
      write(lower_, c, c, to.lower + i * c * c);
      write(cross_, c, v, to.gain + i * c * v);
    }
    add_penalty(penalty_, problem.initial, s_.initial, s_.states, value_);
    cholesky(v, value_);
    for (int i = 0; i < v; ++i) std::fill(value_[i] + i + 1, value_[i] + v, 0.0);
    write(value_, v, v, to.first);
  }

 private:
  // stage_hessian = H + T' P T, where T w = (A w, U).
  void add_cost_to_go(const double* hessian, const double* flow) {
    const int n = s_.states, v = s_.stage, c = s_.controls();
    read(flow, n, s_.inputs, flow_);
    std::fill_n(propagated_.at, v * propagated_.stride(), 0.0);
    accumulate(v, n, [&](int i, int k) { return value_[i][k]; }, flow_, propagated_);
    for (int i = 0; i < v; ++i)
      for (int j = 0; j < c; ++j) propagated_[i][v + j] += value_[i][n + j];
    read(hessian, s_.inputs, s_.inputs, stage_hessian_);
    accumulate(s_.inputs, n, [&](int i, int k) { return flow_[k][i]; }, propagated_, stage_hessian_);
    for (int j = 0; j < c; ++j)
      for (int i = 0; i < s_.inputs; ++i) stage_hessian_[v + j][i] += propagated_[n + j][i];
  }

  // Minimises over the controls: leaves the Hessian of the cost to go, and the gain.
  void minimise() {
    const int v = s_.stage, c = s_.controls();
    for (int i = 0; i < c; ++i) std::copy_n(stage_hessian_[v + i] + v, c, lower_[i]);
    cholesky(c, lower_);
    for (int i = 0; i < c; ++i) std::fill(lower_[i] + i + 1, lower_[i] + c, 0.0);
    for (int i = 0; i < c; ++i) {  // cross = L^-1 (the rows of the controls)
      std::copy_n(stage_hessian_[v + i], v, cross_[i]);
      for (int k = 0; k < i; ++k) subtract(lower_[i][k], cross_[k], cross_[i]);
      divide(lower_[i][i], cross_[i]);
    }
    accumulate(v, c, [&](int i, int k) { return -cross_[k][i]; }, cross_, stage_hessian_);
    for (int i = 0; i < v; ++i)
      for (int j = 0; j <= i; ++j) value_[i][j] = value_[j][i] = 0.5 * (stage_hessian_[i][j] + stage_hessian_[j][i]);
    for (int i = c - 1; i >= 0; --i) {  // gain = L'^-1 cross
      for (int k = i + 1; k < c; ++k) subtract(lower_[k][i], cross_[k], cross_[i]);
      divide(lower_[i][i], cross_[i]);
    }
  }

  void subtract(double factor, const double* row, double* from) const {
    for (int j = 0; j < s_.stage; ++j) from[j] -= factor * row[j];
  }
  void divide(double by, double* row) const {
    for (int j = 0; j < s_.stage; ++j) row[j] /= by;
  }

  const Sizes s_;
  const double penalty_;
  Matrix value_, flow_, propagated_, stage_hessian_, lower_, cross_;
};

// A right-hand side, or a solution.
struct KKTVector {
  Matrix nodes, flow, ends;  // ends: one row of conditions at the start, one at the end

  KKTVector(const Sizes& s, Workspace& workspace)
      : nodes(zeros(s.nodes(), s.stage, workspace)), flow(zeros(s.intervals, s.states, workspace)),
        ends(zeros(2, std::max(s.initial, s.final), workspace)) {}

  void read_from(const Sizes& s, const KKTArrays<const double>& from) const {
    read(from.nodes, s.nodes(), s.stage, nodes);
    read(from.flow, s.intervals, s.states, flow);
    std::copy_n(from.initial, s.initial, ends[0]);
    std::copy_n(from.final, s.final, ends[1]);
  }
  void write_to(const Sizes& s, const KKTArrays<double>& to) const {
    write(nodes, s.nodes(), s.stage, to.nodes);
    write(flow, s.intervals, s.states, to.flow);
    std::copy_n(ends[0], s.initial, to.initial);
    std::copy_n(ends[1], s.final, to.final);
  }

  // Runs act(own, other's) for every number.
  template <typename Act>
  void for_all(const Sizes& s, const KKTVector& other, Act act) const {
    auto each = [&](double* a, const double* b, int count) {
      for (int k = 0; k < count; ++k) act(a[k], b[k]);
    };
    each(nodes.at, other.nodes.at, s.nodes() * nodes.stride());
    each(flow.at, other.flow.at, s.intervals * flow.stride());
    each(ends.at, other.ends.at, 2 * ends.stride());
  }
};

// Solution for one right-hand side.
class Solution {
 public:
  Solution(const Sizes& sizes, double penalty, const ProblemArrays& problem, const FactorArrays<const double>& factor,
           Workspace& workspace)
      : s_(sizes), penalty_(penalty), hessian_(copied(problem.hessian, s_.intervals * s_.inputs, s_.inputs, workspace)),
        last_(copied(problem.last, s_.stage, s_.stage, workspace)),
        flow_(copied(problem.flow, s_.intervals * s_.states, s_.inputs, workspace)),
        initial_(copied(problem.initial, s_.initial, s_.states, workspace)),
        final_(copied(problem.final, s_.final, s_.states, workspace)),
        value_(copied(factor.value, s_.intervals * s_.stage, s_.stage, workspace)),
        lower_(copied(factor.lower, s_.intervals * s_.controls(), s_.controls(), workspace)),
        gain_(copied(factor.gain, s_.intervals * s_.controls(), s_.stage, workspace)),
        first_(copied(factor.first, s_.stage, s_.stage, workspace)), gradients_(blank(s_.nodes(), s_.stage, workspace)),
        feedforward_(blank(s_.intervals, s_.controls(), workspace)), w_(zeros(1, s_.inputs, workspace).at),
        linear_(blank(1, s_.inputs, workspace).at), gradient_(blank(1, s_.stage, workspace).at),
        product_(blank(1, std::max({s_.stage, s_.initial, s_.final}), workspace).at), rhs_(s_, workspace),
        residual_(s_, workspace), step_(s_, workspace), solution_(s_, workspace) {}

  void run(const KKTArrays<const double>& rhs, int refinements, const KKTArrays<double>& to) const {
    rhs_.read_from(s_, rhs);
    solve_once(rhs_, solution_);
    for (int i = 0; i < refinements; ++i) {
      find_residual();
      solve_once(residual_, step_);
      solution_.for_all(s_, step_, [](double& x, double dx) { x += dx; });
    }
    solution_.write_to(s_, to);
  }

 private:
  static Matrix of(const Matrix& all, int rows, int i) { return {all[i * rows], all.packs}; }
  Matrix hessian(int i) const { return of(hessian_, s_.inputs, i); }
  Matrix flow(int i) const { return of(flow_, s_.states, i); }
  Matrix value(int i) const { return of(value_, s_.stage, i); }
  Matrix lower(int i) const { return of(lower_, s_.controls(), i); }
  Matrix gain(int i) const { return of(gain_, s_.controls(), i); }

  // Solves the system whose end conditions are penalties, without refinement.
  void solve_once(const KKTVector& rhs, const KKTVector& x) const {
    backward(rhs);
    forward(rhs, x);
  }

  // Gradients of the cost to go, from the last node to the first, and the controls' feedforward terms.
  void backward(const KKTVector& rhs) const {
    const int n = s_.states, v = s_.stage, c = s_.controls(), last = s_.intervals;
    for (int j = 0; j < v; ++j) gradients_[last][j] = -rhs.nodes[last][j];
    add_rows(-penalty_, s_.final, rhs.ends[1], final_, gradients_[last]);
    for (int i = last - 1; i >= 0; --i) {
      std::copy_n(gradients_[i + 1], v, gradient_);  // the flow's equation: x = A w - rhs.flow
      add_rows(-1.0, n, rhs.flow[i], value(i), gradient_);
      std::fill_n(linear_, s_.inputs, 0.0);
      add_rows(1.0, n, gradient_, flow(i), linear_);
      for (int j = 0; j < c; ++j) linear_[v + j] += gradient_[n + j];
      for (int j = 0; j < v; ++j) gradients_[i][j] = linear_[j] - rhs.nodes[i][j];
      add_rows(-1.0, c, linear_ + v, gain(i), gradients_[i]);
      std::copy_n(linear_ + v, c, feedforward_[i]);
      solve_cholesky(c, lower(i), feedforward_[i]);
    }
    add_rows(-penalty_, s_.initial, rhs.ends[0], initial_, gradients_[0]);
  }

  // Nodes from the first to the last, and multipliers of the flow.
  void forward(const KKTVector& rhs, const KKTVector& x) const {
    const int n = s_.states, v = s_.stage, c = s_.controls(), last = s_.intervals;
    for (int j = 0; j < v; ++j) x.nodes[0][j] = -gradients_[0][j];
    solve_cholesky(v, first_, x.nodes[0]);
    for (int i = 0; i < last; ++i) {
      double* next = x.nodes[i + 1];
      products(c, gain(i), x.nodes[i], product_);
      for (int j = 0; j < c; ++j) next[n + j] = -product_[j] - feedforward_[i][j];
      inputs(x.nodes, i);
      products(n, flow(i), w_, product_);
      for (int j = 0; j < n; ++j) next[j] = product_[j] - rhs.flow[i][j];
      std::copy_n(gradients_[i + 1], v, gradient_);
      add_rows(1.0, v, next, value(i), gradient_);
      std::copy_n(gradient_, n, x.flow[i]);
    }
    end_conditions(initial_, s_.initial, x.nodes[0], product_);
    for (int k = 0; k < s_.initial; ++k) x.ends[0][k] = penalty_ * (product_[k] - rhs.ends[0][k]);
    end_conditions(final_, s_.final, x.nodes[last], product_);
    for (int k = 0; k < s_.final; ++k) x.ends[1][k] = penalty_ * (product_[k] - rhs.ends[1][k]);
  }

  // residual = rhs - matrix * solution
  void find_residual() const {
    const int n = s_.states, v = s_.stage, c = s_.controls(), last = s_.intervals;
    const KKTVector& x = solution_;
    residual_.for_all(s_, rhs_, [](double& a, double b) { a = b; });
    for (int i = 0; i < last; ++i) {
      inputs(x.nodes, i);
      std::fill_n(linear_, s_.inputs, 0.0);
      add_rows(1.0, s_.inputs, w_, hessian(i), linear_);
      add_rows(1.0, n, x.flow[i], flow(i), linear_);
      for (int j = 0; j < v; ++j) residual_.nodes[i][j] -= linear_[j];
      for (int j = 0; j < c; ++j) residual_.nodes[i + 1][n + j] -= linear_[v + j];
      products(n, flow(i), w_, product_);
      for (int j = 0; j < n; ++j) {
        residual_.nodes[i + 1][j] += x.flow[i][j];
        residual_.flow[i][j] -= product_[j] - x.nodes[i + 1][j];
      }
    }
    add_rows(-1.0, v, x.nodes[last], last_, residual_.nodes[last]);
    add_rows(-1.0, s_.initial, x.ends[0], initial_, residual_.nodes[0]);
    add_rows(-1.0, s_.final, x.ends[1], final_, residual_.nodes[last]);
    end_conditions(initial_, s_.initial, x.nodes[0], product_);
    for (int k = 0; k < s_.initial; ++k) residual_.ends[0][k] -= product_[k];
    end_conditions(final_, s_.final, x.nodes[last], product_);
    for (int k = 0; k < s_.final; ++k) residual_.ends[1][k] -= product_[k];
  }

  // w = (X, U) of an interval.
  void inputs(const Matrix& nodes, int i) const {
    std::copy_n(nodes[i], s_.stage, w_);
    std::copy_n(nodes[i + 1] + s_.states, s_.controls(), w_ + s_.stage);
  }

  void end_conditions(const Matrix& c, int count, const double* state, double* out) const {
    for (int k = 0; k < count; ++k) out[k] = std::inner_product(c[k], c[k] + s_.states, state, 0.0);
  }

  const Sizes s_;
  const double penalty_;
  const Matrix hessian_, last_, flow_, initial_, final_, value_, lower_, gain_, first_, gradients_, feedforward_;
  double *const w_, *const linear_, *const gradient_, *const product_;
  const KKTVector rhs_, residual_, step_, solution_;
};

}  // namespace jaxscp

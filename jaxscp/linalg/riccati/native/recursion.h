// The chain of ``system.py`` factored, and solved for, in the steps of ``in_jax.py``.
#pragma once

#include <algorithm>
#include <numeric>

#include "dense.h"
#include "memory.h"

namespace jaxscp {

using Memory = MemoryOf<Pack>;

struct Sizes {
  int intervals, states, inputs, stage, initial, final;

  int controls() const { return inputs - stage; }
  int nodes() const { return intervals + 1; }
};

// Arrays as XLA passes them, row after row; the names are those of ``system.py``.
struct ChainArrays {
  const double *hessian, *last, *flow, *initial, *final;
};
template <typename Number>
struct FactorArrays {
  Number *value, *lower, *gain, *first;
};
template <typename Number>
struct SideArrays {
  Number *nodes, *flow, *initial, *final;
};

inline Matrix blank(int rows, int columns, Memory& memory) {
  const int packs = packs_for(columns);
  return {reinterpret_cast<double*>(memory.take(static_cast<size_t>(rows) * packs)), packs};
}

inline Matrix zeros(int rows, int columns, Memory& memory) {
  const Matrix to = blank(rows, columns, memory);
  std::fill_n(to.at, rows * to.stride(), 0.0);
  return to;
}

// With zeros behind each row. A row but the last is loaded with what follows it, which is quicker than by its length.
inline void read(const double* from, int rows, int columns, const Matrix& to) {
  for (int i = 0; i < rows - kWidth; ++i)
    for (int p = 0; p < to.packs; ++p)
      store(where(within(p, columns), load(from + i * columns + p * kWidth), all(0.0)), to[i] + p * kWidth);
  for (int i = std::max(0, rows - kWidth); i < rows; ++i) {
    std::copy_n(from + i * columns, columns, to[i]);
    std::fill(to[i] + columns, to[i] + to.stride(), 0.0);
  }
}

inline Matrix copied(const double* from, int rows, int columns, Memory& memory) {
  const Matrix to = blank(rows, columns, memory);
  read(from, rows, columns, to);
  return to;
}

inline void write(const Matrix& from, int rows, int columns, double* to) {
  for (int i = 0; i < rows; ++i) std::copy_n(from[i], columns, to + i * columns);
}

// value += penalty c' c, for conditions c on states.
inline void add_penalty(double penalty, const double* c, int conditions, int states, const Matrix& value) {
  for (int k = 0; k < conditions; ++k)
    for (int i = 0; i < states; ++i)
      for (int j = 0; j < states; ++j) value[i][j] += penalty * c[k * states + i] * c[k * states + j];
}

// Eliminates the chain from its end. With controls U at an interval's end, its matrix in w = (X, U) is
// whole = H + onward' P onward = [before + K' L L' K, ...; ..., L L'].
class Elimination {
 public:
  Elimination(const Sizes& sizes, double penalty, Memory& memory)
      : s_(sizes), penalty_(penalty), value_(blank(s_.stage, s_.stage, memory)),
        flow_(blank(s_.states, s_.inputs, memory)), ahead_(blank(s_.stage, s_.inputs, memory)),
        whole_(blank(s_.inputs, s_.inputs, memory)), lower_(blank(s_.controls(), s_.controls(), memory)),
        cross_(blank(s_.controls(), s_.stage, memory)) {}

  void run(const ChainArrays& chain, const FactorArrays<double>& to) {
    const int v = s_.stage, c = s_.controls();
    read(chain.last, v, v, value_);
    add_penalty(penalty_, chain.final, s_.final, s_.states, value_);
    for (int i = s_.intervals - 1; i >= 0; --i) {
      write(value_, v, v, to.value + i * v * v);
      pull_back(chain.hessian + i * s_.inputs * s_.inputs, chain.flow + i * s_.states * s_.inputs);
      minimise();
      write(lower_, c, c, to.lower + i * c * c);
      write(cross_, c, v, to.gain + i * c * v);
    }
    add_penalty(penalty_, chain.initial, s_.initial, s_.states, value_);
    cholesky(v, value_);
    for (int i = 0; i < v; ++i) std::fill(value_[i] + i + 1, value_[i] + v, 0.0);
    write(value_, v, v, to.first);
  }

 private:
  // whole = H + onward' P onward, where onward w = (A w, U).
  void pull_back(const double* hessian, const double* flow) {
    const int n = s_.states, v = s_.stage, c = s_.controls();
    read(flow, n, s_.inputs, flow_);
    std::fill_n(ahead_.at, v * ahead_.stride(), 0.0);
    accumulate(v, n, [&](int i, int k) { return value_[i][k]; }, flow_, ahead_);
    for (int i = 0; i < v; ++i)
      for (int j = 0; j < c; ++j) ahead_[i][v + j] += value_[i][n + j];
    read(hessian, s_.inputs, s_.inputs, whole_);
    accumulate(s_.inputs, n, [&](int i, int k) { return flow_[k][i]; }, ahead_, whole_);
    for (int j = 0; j < c; ++j)
      for (int i = 0; i < s_.inputs; ++i) whole_[v + j][i] += ahead_[n + j][i];
  }

  // Minimise over the controls: what is left is the curvature before, and what they follow.
  void minimise() {
    const int v = s_.stage, c = s_.controls();
    for (int i = 0; i < c; ++i) std::copy_n(whole_[v + i] + v, c, lower_[i]);
    cholesky(c, lower_);
    for (int i = 0; i < c; ++i) std::fill(lower_[i] + i + 1, lower_[i] + c, 0.0);
    for (int i = 0; i < c; ++i) {  // cross = L^-1 (the rows of the controls)
      std::copy_n(whole_[v + i], v, cross_[i]);
      for (int k = 0; k < i; ++k) subtract(lower_[i][k], cross_[k], cross_[i]);
      divide(lower_[i][i], cross_[i]);
    }
    accumulate(v, c, [&](int i, int k) { return -cross_[k][i]; }, cross_, whole_);
    for (int i = 0; i < v; ++i)
      for (int j = 0; j <= i; ++j) value_[i][j] = value_[j][i] = 0.5 * (whole_[i][j] + whole_[j][i]);
    for (int i = c - 1; i >= 0; --i) {  // gain = L'^-1 cross
      for (int k = i + 1; k < c; ++k) subtract(lower_[k][i], cross_[k], cross_[i]);
      divide(lower_[i][i], cross_[i]);
    }
  }

  void subtract(double times, const double* row, double* from) const {
    for (int j = 0; j < s_.stage; ++j) from[j] -= times * row[j];
  }
  void divide(double by, double* row) const {
    for (int j = 0; j < s_.stage; ++j) row[j] /= by;
  }

  const Sizes s_;
  const double penalty_;
  Matrix value_, flow_, ahead_, whole_, lower_, cross_;
};

// A right-hand side, or an unknown.
struct Side {
  Matrix nodes, flow, ends;  // ends: a row of conditions at the start, and one of those at the end

  Side(const Sizes& s, Memory& memory)
      : nodes(zeros(s.nodes(), s.stage, memory)), flow(zeros(s.intervals, s.states, memory)),
        ends(zeros(2, std::max(s.initial, s.final), memory)) {}

  void read_from(const Sizes& s, const SideArrays<const double>& from) const {
    read(from.nodes, s.nodes(), s.stage, nodes);
    read(from.flow, s.intervals, s.states, flow);
    std::copy_n(from.initial, s.initial, ends[0]);
    std::copy_n(from.final, s.final, ends[1]);
  }
  void write_to(const Sizes& s, const SideArrays<double>& to) const {
    write(nodes, s.nodes(), s.stage, to.nodes);
    write(flow, s.intervals, s.states, to.flow);
    std::copy_n(ends[0], s.initial, to.initial);
    std::copy_n(ends[1], s.final, to.final);
  }

  // act(mine, other's) for every number.
  template <typename Act>
  void for_all(const Sizes& s, const Side& other, Act act) const {
    auto each = [&](double* a, const double* b, int count) {
      for (int k = 0; k < count; ++k) act(a[k], b[k]);
    };
    each(nodes.at, other.nodes.at, s.nodes() * nodes.stride());
    each(flow.at, other.flow.at, s.intervals * flow.stride());
    each(ends.at, other.ends.at, 2 * ends.stride());
  }
};

// Solves for a right-hand side; all matrices are symmetric that may be.
class Solution {
 public:
  Solution(const Sizes& sizes, double penalty, const ChainArrays& chain, const FactorArrays<const double>& factor,
           Memory& memory)
      : s_(sizes), penalty_(penalty), hessian_(copied(chain.hessian, s_.intervals * s_.inputs, s_.inputs, memory)),
        last_(copied(chain.last, s_.stage, s_.stage, memory)),
        flow_(copied(chain.flow, s_.intervals * s_.states, s_.inputs, memory)),
        initial_(copied(chain.initial, s_.initial, s_.states, memory)),
        final_(copied(chain.final, s_.final, s_.states, memory)),
        value_(copied(factor.value, s_.intervals * s_.stage, s_.stage, memory)),
        lower_(copied(factor.lower, s_.intervals * s_.controls(), s_.controls(), memory)),
        gain_(copied(factor.gain, s_.intervals * s_.controls(), s_.stage, memory)),
        first_(copied(factor.first, s_.stage, s_.stage, memory)), slopes_(blank(s_.nodes(), s_.stage, memory)),
        held_(blank(s_.intervals, s_.controls(), memory)), w_(zeros(1, s_.inputs, memory).at),
        linear_(blank(1, s_.inputs, memory).at), moved_(blank(1, s_.stage, memory).at),
        product_(blank(1, std::max({s_.stage, s_.initial, s_.final}), memory).at), right_(s_, memory), rest_(s_, memory), step_(s_, memory),
        found_(s_, memory) {}

  void run(const SideArrays<const double>& right, int refinements, const SideArrays<double>& to) const {
    right_.read_from(s_, right);
    solve_once(right_, found_);
    for (int i = 0; i < refinements; ++i) {
      find_rest();
      solve_once(rest_, step_);
      found_.for_all(s_, step_, [](double& x, double dx) { x += dx; });
    }
    found_.write_to(s_, to);
  }

 private:
  static Matrix of(const Matrix& all, int rows, int i) { return {all[i * rows], all.packs}; }
  Matrix hessian(int i) const { return of(hessian_, s_.inputs, i); }
  Matrix flow(int i) const { return of(flow_, s_.states, i); }
  Matrix value(int i) const { return of(value_, s_.stage, i); }
  Matrix lower(int i) const { return of(lower_, s_.controls(), i); }
  Matrix gain(int i) const { return of(gain_, s_.controls(), i); }

  // But for the penalties of the ends and for rounding.
  void solve_once(const Side& right, const Side& x) const {
    descend(right);
    ascend(right, x);
  }

  // Slopes of the cost to go, from the end to the start, and the controls that go with a node of zeros.
  void descend(const Side& right) const {
    const int n = s_.states, v = s_.stage, c = s_.controls(), last = s_.intervals;
    for (int j = 0; j < v; ++j) slopes_[last][j] = -right.nodes[last][j];
    add_rows(-penalty_, s_.final, right.ends[1], final_, slopes_[last]);
    for (int i = last - 1; i >= 0; --i) {
      std::copy_n(slopes_[i + 1], v, moved_);  // the flow's equation: x = A w - lack
      add_rows(-1.0, n, right.flow[i], value(i), moved_);
      std::fill_n(linear_, s_.inputs, 0.0);
      add_rows(1.0, n, moved_, flow(i), linear_);
      for (int j = 0; j < c; ++j) linear_[v + j] += moved_[n + j];
      for (int j = 0; j < v; ++j) slopes_[i][j] = linear_[j] - right.nodes[i][j];
      add_rows(-1.0, c, linear_ + v, gain(i), slopes_[i]);
      std::copy_n(linear_ + v, c, held_[i]);
      solve_cholesky(c, lower(i), held_[i]);
    }
    add_rows(-penalty_, s_.initial, right.ends[0], initial_, slopes_[0]);
  }

  // Nodes from the start to the end, and prices of the flow between them.
  void ascend(const Side& right, const Side& x) const {
    const int n = s_.states, v = s_.stage, c = s_.controls(), last = s_.intervals;
    for (int j = 0; j < v; ++j) x.nodes[0][j] = -slopes_[0][j];
    solve_cholesky(v, first_, x.nodes[0]);
    for (int i = 0; i < last; ++i) {
      double* after = x.nodes[i + 1];
      products(c, gain(i), x.nodes[i], product_);
      for (int j = 0; j < c; ++j) after[n + j] = -product_[j] - held_[i][j];
      inputs(x.nodes, i);
      products(n, flow(i), w_, product_);
      for (int j = 0; j < n; ++j) after[j] = product_[j] - right.flow[i][j];
      std::copy_n(slopes_[i + 1], v, moved_);
      add_rows(1.0, v, after, value(i), moved_);
      std::copy_n(moved_, n, x.flow[i]);
    }
    conditions(initial_, s_.initial, x.nodes[0], product_);
    for (int k = 0; k < s_.initial; ++k) x.ends[0][k] = penalty_ * (product_[k] - right.ends[0][k]);
    conditions(final_, s_.final, x.nodes[last], product_);
    for (int k = 0; k < s_.final; ++k) x.ends[1][k] = penalty_ * (product_[k] - right.ends[1][k]);
  }

  // rest = right - the system's matrix times what was found
  void find_rest() const {
    const int n = s_.states, v = s_.stage, c = s_.controls(), last = s_.intervals;
    const Side& x = found_;
    rest_.for_all(s_, right_, [](double& a, double b) { a = b; });
    for (int i = 0; i < last; ++i) {
      inputs(x.nodes, i);
      std::fill_n(linear_, s_.inputs, 0.0);
      add_rows(1.0, s_.inputs, w_, hessian(i), linear_);
      add_rows(1.0, n, x.flow[i], flow(i), linear_);
      for (int j = 0; j < v; ++j) rest_.nodes[i][j] -= linear_[j];
      for (int j = 0; j < c; ++j) rest_.nodes[i + 1][n + j] -= linear_[v + j];
      products(n, flow(i), w_, product_);
      for (int j = 0; j < n; ++j) {
        rest_.nodes[i + 1][j] += x.flow[i][j];
        rest_.flow[i][j] -= product_[j] - x.nodes[i + 1][j];
      }
    }
    add_rows(-1.0, v, x.nodes[last], last_, rest_.nodes[last]);
    add_rows(-1.0, s_.initial, x.ends[0], initial_, rest_.nodes[0]);
    add_rows(-1.0, s_.final, x.ends[1], final_, rest_.nodes[last]);
    conditions(initial_, s_.initial, x.nodes[0], product_);
    for (int k = 0; k < s_.initial; ++k) rest_.ends[0][k] -= product_[k];
    conditions(final_, s_.final, x.nodes[last], product_);
    for (int k = 0; k < s_.final; ++k) rest_.ends[1][k] -= product_[k];
  }

  // w = (X, U) of an interval
  void inputs(const Matrix& nodes, int i) const {
    std::copy_n(nodes[i], s_.stage, w_);
    std::copy_n(nodes[i + 1] + s_.states, s_.controls(), w_ + s_.stage);
  }

  void conditions(const Matrix& c, int count, const double* state, double* out) const {
    for (int k = 0; k < count; ++k) out[k] = std::inner_product(c[k], c[k] + s_.states, state, 0.0);
  }

  const Sizes s_;
  const double penalty_;
  const Matrix hessian_, last_, flow_, initial_, final_, value_, lower_, gain_, first_, slopes_, held_;
  double *const w_, *const linear_, *const moved_, *const product_;
  const Side right_, rest_, step_, found_;
};

}  // namespace jaxscp

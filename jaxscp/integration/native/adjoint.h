// Adjoints of the values at the points and of the slopes, from the multipliers of the outputs.
//
// An adjoint is the gradient of the outputs' weighted sum in a perturbation. Those of slopes come from the Runge-Kutta
// method in reverse.
#pragma once

#include "forward.h"

namespace jaxscp {

class Adjoint {
 public:
  Adjoint(const IntervalProblem& p, const Forward& forward, Workspace& workspace)
      : p_(p), forward_(forward), multipliers_(workspace.take(p.outputs())),
        values_(workspace.take(p.points() * p.point.values)),
        slopes_(workspace.take(p.steps * p.stages() * p.extended())), state_(workspace.take(p.states)),
        stage_adjoints_(workspace.take(p.stages() * p.states)) {}

  Wide* multipliers() { return multipliers_; }  // multipliers of the outputs, to be written before run()

  void run() {
    std::fill_n(values_, p_.points() * p_.point.values, wide(0.0));
    int group = 0;
    p_.for_groups([&](int g, auto value, auto output) {
      const auto& entries = p_.groups[g].subtract_margin.jacobian;
      const Wide* entry = forward_.group_entries(group++);
      for (int i = 0; i < entries.count; ++i)
        values_[value(entries[i].column)] += entry[i] * multipliers_[output(entries[i].row)];
    });
    std::copy_n(multipliers_, p_.states, state_);
    add_point(p_.points() - 1);
    for (int step = p_.steps - 1; step >= 0; --step) {
      reverse_step(step);
      if (step % p_.steps_per_subinterval == 0) add_point(step / p_.steps_per_subinterval);
    }
  }

  const Wide* multipliers() const { return multipliers_; }
  const Wide* values(int point) const { return values_ + point * p_.point.values; }
  const Wide* slopes(int slope) const { return slopes_ + slope * p_.extended(); }

 private:
  // Adds the adjoint of the state from the rows at a point.
  void add_point(int point) {
    add_transpose_product(p_.point.jacobian, forward_.point_entries(point), values(point), state_);
  }

  void reverse_step(int step) {
    const int n = p_.states;
    for (int stage = p_.stages() - 1; stage >= 0; --stage) {
      const int slope = step * p_.stages() + stage;
      Wide* adjoint = slopes_ + slope * p_.extended();
      for (int r = 0; r < n; ++r) {
        Wide sum = p_.b[stage] * state_[r];
        for (int later = stage + 1; later < p_.stages(); ++later) {
          const double weight = p_.a[later * p_.stages() + stage];
          if (weight != 0.0) sum += weight * stage_adjoints_[later * n + r];
        }
        adjoint[r] = 1.0 / p_.steps * sum;
      }
      adjoint[n] = p_.b[stage] / p_.steps * multipliers_[n];
      std::fill_n(stage_adjoints_ + stage * n, n, wide(0.0));
      add_transpose_product(p_.rate.jacobian, forward_.rate_entries(slope), adjoint, stage_adjoints_ + stage * n);
    }
    for (int i = 0; i < p_.stages() * n; ++i) state_[i % n] += stage_adjoints_[i];
  }

  // to += J' multipliers, in the states among the arguments.
  void add_transpose_product(const Span<Coordinates>& jacobian, const Wide* entry, const Wide* multipliers,
                             Wide* to) const {
    for (int i = 0; i < jacobian.count; ++i)
      if (jacobian[i].column < p_.states) to[jacobian[i].column] += entry[i] * multipliers[jacobian[i].row];
  }

  const IntervalProblem& p_;
  const Forward& forward_;
  Wide *multipliers_, *values_, *slopes_, *state_, *stage_adjoints_;
};

}  // namespace jaxscp

// From the prices of the outcomes to those of all that they are made of: values at the points, and slopes.
//
// The price of a slope is how the priced sum changes where something is added to it: the Runge-Kutta method backwards.
#pragma once

#include "walk.h"

namespace jaxscp {

class Prices {
 public:
  Prices(const Sweep& s, const Walk& walk, Memory& memory)
      : s_(s), walk_(walk), outcomes_(memory.take(s.outcomes())), values_(memory.take(s.points() * s.point.values)),
        slopes_(memory.take(s.steps * s.stages() * s.extended())), state_(memory.take(s.states)),
        pulled_(memory.take(s.stages() * s.states)) {}

  Wide* outcomes() { return outcomes_; }  // goes in

  void run() {
    std::fill_n(values_, s_.points() * s_.point.values, wide(0.0));
    int group = 0;
    s_.for_groups([&](int b, auto value, auto outcome) {
      const auto& entries = s_.blocks[b].less_margin.jacobian;
      const Wide* entry = walk_.group_entries(group++);
      for (int i = 0; i < entries.count; ++i)
        values_[value(entries[i].column)] += entry[i] * outcomes_[outcome(entries[i].row)];
    });
    std::copy_n(outcomes_, s_.states, state_);
    look(s_.points() - 1);
    for (int step = s_.steps - 1; step >= 0; --step) {
      back(step);
      if (step % s_.every == 0) look(step / s_.every);
    }
  }

  const Wide* outcomes() const { return outcomes_; }
  const Wide* values(int point) const { return values_ + point * s_.point.values; }
  const Wide* slopes(int slope) const { return slopes_ + slope * s_.extended(); }

 private:
  // The state at a point is priced for what is watched there.
  void look(int point) {
    pull(s_.point.jacobian, walk_.point_entries(point), values(point), state_);
  }

  void back(int step) {
    const int n = s_.states;
    for (int stage = s_.stages() - 1; stage >= 0; --stage) {
      const int slope = step * s_.stages() + stage;
      Wide* price = slopes_ + slope * s_.extended();
      for (int r = 0; r < n; ++r) {
        Wide sum = s_.weights[stage] * state_[r];
        for (int later = stage + 1; later < s_.stages(); ++later) {
          const double weight = s_.table[later * s_.stages() + stage];
          if (weight != 0.0) sum += weight * pulled_[later * n + r];
        }
        price[r] = 1.0 / s_.steps * sum;
      }
      price[n] = s_.weights[stage] / s_.steps * outcomes_[n];
      std::fill_n(pulled_ + stage * n, n, wide(0.0));
      pull(s_.rate.jacobian, walk_.rate_entries(slope), price, pulled_ + stage * n);
    }
    for (int i = 0; i < s_.stages() * n; ++i) state_[i % n] += pulled_[i];
  }

  // to += Jacobian' prices, of the states among the arguments.
  void pull(const Several<Coordinates>& jacobian, const Wide* entry, const Wide* prices, Wide* to) const {
    for (int i = 0; i < jacobian.count; ++i)
      if (jacobian[i].column < s_.states) to[jacobian[i].column] += entry[i] * prices[jacobian[i].row];
  }

  const Sweep& s_;
  const Walk& walk_;
  Wide *outcomes_, *values_, *slopes_, *state_, *pulled_;
};

}  // namespace jaxscp

// Path and outputs of intervals; arguments and Jacobians of all functions are stored for the derivatives.
#pragma once

#include "interval_problem.h"

namespace jaxscp {

class Forward {
 public:
  Forward(const IntervalProblem& p, Workspace& workspace)
      : p_(p), tapes_(p, &Function::first, workspace), w_(workspace.take(p.inputs())), data_(workspace.take(p.data())),
        state_(workspace.take(p.extended())), slopes_(workspace.take(p.stages() * p.extended())),
        rate_arguments_(workspace.take(p.steps * p.stages() * p.arguments())),
        rate_entries_(workspace.take(p.steps * p.stages() * p.rate.jacobian.count)),
        point_arguments_(workspace.take(p.points() * p.arguments())),
        point_entries_(workspace.take(p.points() * p.point.jacobian.count)),
        ends_entries_(workspace.take(p.ends.jacobian.count)), values_(workspace.take(p.points() * p.point.values)),
        outputs_(workspace.take(p.outputs())) {
    p.for_groups([&](int g, auto, auto) {
      group_entries_.push_back(workspace.take(p.groups[g].subtract_margin.jacobian.count));
    });
  }

  // Inputs.
  Wide* w() { return w_; }
  Wide* data() { return data_; }
  Tapes& tapes() { return tapes_; }

  void run() {
    begin();
    evaluate_point(0);
    for (int step = 0; step < p_.steps; ++step) {
      for (int stage = 0; stage < p_.stages(); ++stage) evaluate_stage(step, stage);
      for (int r = 0; r < p_.extended(); ++r) state_[r] += increment(p_.b.data, p_.stages(), r);
      if ((step + 1) % p_.steps_per_subinterval == 0) evaluate_point((step + 1) / p_.steps_per_subinterval);
    }
    std::copy_n(state_, p_.extended(), outputs_);
    subtract_margins();
    std::copy_n(w_, p_.inputs(), tapes_.ends.inputs());
    tapes_.ends.evaluate();
    for (int r = 0; r < p_.ends.values; ++r) outputs_[p_.ends_begin() + r] = tapes_.ends.output(r);
    record(tapes_.ends, p_.ends, ends_entries_);
  }

  // Results: outputs; arguments and Jacobian entries by slope, by point, by group and for the functions of w.
  const Wide* outputs() const { return outputs_; }
  const Wide* w() const { return w_; }
  const Wide* data() const { return data_; }
  const Wide* rate_arguments(int slope) const { return rate_arguments_ + slope * p_.arguments(); }
  const Wide* rate_entries(int slope) const { return rate_entries_ + slope * p_.rate.jacobian.count; }
  const Wide* point_arguments(int point) const { return point_arguments_ + point * p_.arguments(); }
  const Wide* point_entries(int point) const { return point_entries_ + point * p_.point.jacobian.count; }
  const Wide* group_entries(int group) const { return group_entries_[group]; }
  const Wide* ends_entries() const { return ends_entries_; }
  const Wide& value(int i) const { return values_[i]; }  // of a row at a point, before its margin is subtracted

 private:
  void begin() {
    tapes_.begin(data_);
    std::copy_n(w_, p_.states, state_);
    state_[p_.states] = wide(0.0);
  }

  void controls(double fraction, Wide* to) const {
    for (int k = p_.states; k < p_.arguments(); ++k) to[k] = w_[k] + fraction * (w_[k + p_.controls] - w_[k]);
  }

  // h sum_i weights_i k_i, of one row.
  Wide increment(const double* weights, int count, int row) const {
    Wide sum = wide(0.0);
    for (int i = 0; i < count; ++i)
      if (weights[i] != 0.0) sum += weights[i] / p_.steps * slopes_[i * p_.extended() + row];
    return sum;
  }

  void evaluate_stage(int step, int stage) {
    Wide* to = tapes_.rate.inputs();
    for (int r = 0; r < p_.states; ++r)
      to[r] = state_[r] + increment(p_.a.data + stage * p_.stages(), stage, r);
    controls(p_.fraction(step, stage), to);
    tapes_.rate.evaluate();
    for (int r = 0; r < p_.extended(); ++r) slopes_[stage * p_.extended() + r] = tapes_.rate.output(r);
    const int slope = step * p_.stages() + stage;
    if (p_.order > 0) std::copy_n(to, p_.arguments(), rate_arguments_ + slope * p_.arguments());
    record(tapes_.rate, p_.rate, rate_entries_ + slope * p_.rate.jacobian.count);
  }

  // Rows at a point.
  void evaluate_point(int point) {
    Wide* to = tapes_.point.inputs();
    std::copy_n(state_, p_.states, to);
    controls(p_.fraction(point), to);
    tapes_.point.evaluate();
    for (int r = 0; r < p_.point.values; ++r) values_[point * p_.point.values + r] = tapes_.point.output(r);
    if (p_.order > 0) std::copy_n(to, p_.arguments(), point_arguments_ + point * p_.arguments());
    record(tapes_.point, p_.point, point_entries_ + point * p_.point.jacobian.count);
  }

  void subtract_margins() {
    int group = 0;
    p_.for_groups([&](int g, auto value, auto output) {
      const Function& f = p_.groups[g].subtract_margin;
      TapeEvaluator& margin = tapes_.margins[g];
      for (int e = 0; e < f.arguments; ++e) margin.inputs()[e] = values_[value(e)];
      margin.evaluate();
      for (int e = 0; e < f.values; ++e) outputs_[output(e)] = margin.output(e);
      record(margin, f, group_entries_[group++]);
    });
  }

  void record(const TapeEvaluator& tape, const Function& f, Wide* to) const {
    for (int i = 0; i < f.jacobian.count; ++i) to[i] = tape.output(f.values + i);
  }

  const IntervalProblem& p_;
  Tapes tapes_;
  Wide *w_, *data_, *state_, *slopes_, *rate_arguments_, *rate_entries_, *point_arguments_, *point_entries_,
      *ends_entries_, *values_, *outputs_;
  std::vector<Wide*> group_entries_;
};

}  // namespace jaxscp

// The first part of a pass: the path and the outcomes, with what the derivatives are made of.
#pragma once

#include "sweep.h"

namespace jaxscp {

class Walk {
 public:
  Walk(const Sweep& s, Memory& memory)
      : s_(s), tapes_(s, &Function::first, memory), w_(memory.take(s.inputs())), data_(memory.take(s.data())),
        state_(memory.take(s.extended())), slopes_(memory.take(s.stages() * s.extended())),
        rate_arguments_(memory.take(s.steps * s.stages() * s.arguments())),
        rate_entries_(memory.take(s.steps * s.stages() * s.rate.jacobian.count)),
        point_arguments_(memory.take(s.points() * s.arguments())),
        point_entries_(memory.take(s.points() * s.point.jacobian.count)),
        ends_entries_(memory.take(s.ends.jacobian.count)), values_(memory.take(s.points() * s.point.values)),
        outcomes_(memory.take(s.outcomes())) {
    s.for_groups([&](int b, auto, auto) {
      group_entries_.push_back(memory.take(s.blocks[b].less_margin.jacobian.count));
    });
  }

  // What goes in.
  Wide* w() { return w_; }
  Wide* data() { return data_; }
  Tapes& tapes() { return tapes_; }

  void run() {
    begin();
    look(0);
    for (int step = 0; step < s_.steps; ++step) {
      for (int stage = 0; stage < s_.stages(); ++stage) slope(step, stage);
      for (int r = 0; r < s_.extended(); ++r) state_[r] += moved(s_.weights.data, s_.stages(), r);
      if ((step + 1) % s_.every == 0) look((step + 1) / s_.every);
    }
    std::copy_n(state_, s_.extended(), outcomes_);
    keep_margins();
    std::copy_n(w_, s_.inputs(), tapes_.ends.inputs());
    tapes_.ends.play();
    for (int r = 0; r < s_.ends.values; ++r) outcomes_[s_.of_ends() + r] = tapes_.ends.output(r);
    record(tapes_.ends, s_.ends, ends_entries_);
  }

  // What is found: outcomes; and by slope, point, group and for the ends, arguments and entries of Jacobians.
  const Wide* outcomes() const { return outcomes_; }
  const Wide* w() const { return w_; }
  const Wide* data() const { return data_; }
  const Wide* rate_arguments(int slope) const { return rate_arguments_ + slope * s_.arguments(); }
  const Wide* rate_entries(int slope) const { return rate_entries_ + slope * s_.rate.jacobian.count; }
  const Wide* point_arguments(int point) const { return point_arguments_ + point * s_.arguments(); }
  const Wide* point_entries(int point) const { return point_entries_ + point * s_.point.jacobian.count; }
  const Wide* group_entries(int group) const { return group_entries_[group]; }
  const Wide* ends_entries() const { return ends_entries_; }
  const Wide& value(int i) const { return values_[i]; }  // of a point's row, before its margin

 private:
  void begin() {
    tapes_.begin(data_);
    std::copy_n(w_, s_.states, state_);
    state_[s_.states] = wide(0.0);
  }

  void controls(double share, Wide* to) const {
    for (int k = s_.states; k < s_.arguments(); ++k) to[k] = w_[k] + share * (w_[k + s_.controls] - w_[k]);
  }

  // How far so many slopes of these weights lead.
  Wide moved(const double* weights, int count, int row) const {
    Wide sum = wide(0.0);
    for (int i = 0; i < count; ++i)
      if (weights[i] != 0.0) sum += weights[i] / s_.steps * slopes_[i * s_.extended() + row];
    return sum;
  }

  void slope(int step, int stage) {
    Wide* to = tapes_.rate.inputs();
    for (int r = 0; r < s_.states; ++r)
      to[r] = state_[r] + moved(s_.table.data + stage * s_.stages(), stage, r);
    controls(s_.share(step, stage), to);
    tapes_.rate.play();
    for (int r = 0; r < s_.extended(); ++r) slopes_[stage * s_.extended() + r] = tapes_.rate.output(r);
    const int slope = step * s_.stages() + stage;
    if (s_.order > 0) std::copy_n(to, s_.arguments(), rate_arguments_ + slope * s_.arguments());
    record(tapes_.rate, s_.rate, rate_entries_ + slope * s_.rate.jacobian.count);
  }

  // What is watched, at a point.
  void look(int point) {
    Wide* to = tapes_.point.inputs();
    std::copy_n(state_, s_.states, to);
    controls(s_.share(point), to);
    tapes_.point.play();
    for (int r = 0; r < s_.point.values; ++r) values_[point * s_.point.values + r] = tapes_.point.output(r);
    if (s_.order > 0) std::copy_n(to, s_.arguments(), point_arguments_ + point * s_.arguments());
    record(tapes_.point, s_.point, point_entries_ + point * s_.point.jacobian.count);
  }

  void keep_margins() {
    int group = 0;
    s_.for_groups([&](int b, auto value, auto outcome) {
      const Function& f = s_.blocks[b].less_margin;
      Player& margin = tapes_.margins[b];
      for (int e = 0; e < f.arguments; ++e) margin.inputs()[e] = values_[value(e)];
      margin.play();
      for (int e = 0; e < f.values; ++e) outcomes_[outcome(e)] = margin.output(e);
      record(margin, f, group_entries_[group++]);
    });
  }

  void record(const Player& tape, const Function& f, Wide* to) const {
    for (int i = 0; i < f.jacobian.count; ++i) to[i] = tape.output(f.values + i);
  }

  const Sweep& s_;
  Tapes tapes_;
  Wide *w_, *data_, *state_, *slopes_, *rate_arguments_, *rate_entries_, *point_arguments_, *point_entries_,
      *ends_entries_, *values_, *outcomes_;
  std::vector<Wide*> group_entries_;
};

}  // namespace jaxscp

// Reader of an IntervalProblem from two arrays, integers and reals, which ``in_cpp.py`` writes in the same order.
#pragma once

#include "interval_problem.h"

namespace jaxscp {

class Reader {
 public:
  Reader(const int* integers, const double* reals) : integers_(integers), reals_(reals) {}

  int number() { return *integers_++; }

  template <typename T>
  Span<T> span() {
    constexpr int each = sizeof(T) / sizeof(int);
    const int count = number();
    const T* from = reinterpret_cast<const T*>(integers_);
    integers_ += count * each;
    return {from, count};
  }

  Span<double> real_span() {
    const int count = number();
    const double* from = reals_;
    reals_ += count;
    return {from, count};
  }

  Tape tape() {
    Tape t;
    t.operations = span<Operation>();
    t.hoisted_count = number(), t.slots = number(), t.parameters = number();
    t.constants = real_span();
    t.outputs = span<int>();
    return t;
  }

  Function function() {
    Function f;
    f.arguments = number(), f.values = number(), f.data = number();
    f.first = tape(), f.second = tape();
    f.jacobian = span<Coordinates>(), f.hessian = span<Coordinates>();
    return f;
  }

 private:
  const int* integers_;
  const double* reals_;
};

inline IntervalProblem read_problem(const int* integers, const double* reals) {
  Reader read(integers, reals);
  IntervalProblem p;
  p.order = read.number();
  p.states = read.number(), p.controls = read.number();
  p.steps = read.number(), p.steps_per_subinterval = read.number();
  p.c = read.real_span(), p.b = read.real_span(), p.a = read.real_span();
  p.first = read.span<int>();
  p.rate = read.function(), p.point = read.function(), p.ends = read.function();
  p.groups.resize(read.number());
  for (OutputGroup& group : p.groups) {
    group.rows = read.number(), group.group_size = read.number();
    group.subtract_margin = read.function();
  }
  return p;
}

}  // namespace jaxscp

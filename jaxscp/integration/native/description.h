// Reads what a pass is told from two lists of numbers, whole and real, which ``compiled.py`` writes in this order.
#pragma once

#include "sweep.h"

namespace jaxscp {

class Reader {
 public:
  Reader(const int* whole, const double* real) : whole_(whole), real_(real) {}

  int number() { return *whole_++; }

  template <typename T>
  Several<T> several() {
    constexpr int each = sizeof(T) / sizeof(int);
    const int count = number();
    const T* from = reinterpret_cast<const T*>(whole_);
    whole_ += count * each;
    return {from, count};
  }

  Several<double> reals() {
    const int count = number();
    const double* from = real_;
    real_ += count;
    return {from, count};
  }

  Tape tape() {
    Tape t;
    t.operations = several<Operation>();
    t.once = number(), t.places = number(), t.parameters = number();
    t.constants = reals();
    t.outputs = several<int>();
    return t;
  }

  Function function() {
    Function f;
    f.arguments = number(), f.values = number(), f.data = number();
    f.first = tape(), f.second = tape();
    f.jacobian = several<Coordinates>(), f.hessian = several<Coordinates>();
    return f;
  }

 private:
  const int* whole_;
  const double* real_;
};

inline Sweep described(const int* whole, const double* real) {
  Reader read(whole, real);
  Sweep s;
  s.order = read.number();
  s.states = read.number(), s.controls = read.number(), s.steps = read.number(), s.every = read.number();
  s.shares = read.reals(), s.weights = read.reals(), s.table = read.reals();
  s.first = read.several<int>();
  s.rate = read.function(), s.point = read.function(), s.ends = read.function();
  s.blocks.resize(read.number());
  for (Block& block : s.blocks) {
    block.rows = read.number(), block.together = read.number();
    block.less_margin = read.function();
  }
  return s;
}

}  // namespace jaxscp

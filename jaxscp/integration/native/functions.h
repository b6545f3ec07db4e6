// Functions and entries of their derivatives as tapes (``functions.py``), with the numbers of two packs of intervals.
#pragma once

#include "memory.h"
#include "tape.h"

namespace jaxscp {

template <typename T>
struct Several {
  const T* data = nullptr;
  int count = 0;
  const T* begin() const { return data; }
  const T* end() const { return data + count; }
  const T& operator[](int i) const { return data[i]; }
};

struct Coordinates {
  int row, column;
};

// Places: what goes in, then parameters, then constants, then what is made.
struct Tape {
  Several<Operation> operations;
  int once = 0, places = 0, parameters = 0;
  Several<double> constants;
  Several<int> outputs;
};

// What goes in: arguments, then a price of every value, then data, which have no derivatives.
struct Function {
  int arguments = 0, values = 0, data = 0;
  Tape first, second;              // the values, then entries of their Jacobian; entries of the priced sum's Hessian
  Several<Coordinates> jacobian, hessian;  // where these are; of the latter the lower triangle

  // Places.
  int prices() const { return arguments; }
  int given() const { return arguments + values; }
  int inputs() const { return arguments + values + data; }
};

using Memory = MemoryOf<Wide>;

class Player {
 public:
  Player(const Tape& tape, int inputs, Memory& memory)
      : tape_(tape), inputs_(inputs), places_(memory.take(tape.places)) {}

  Wide* inputs() { return places_; }
  Wide* parameters() { return places_ + inputs_; }
  int parameter_count() const { return tape_.parameters; }

  // When data and parameters are there.
  void begin() {
    for (int i = 0; i < tape_.constants.count; ++i) places_[inputs_ + tape_.parameters + i] = wide(tape_.constants[i]);
    jaxscp::play(tape_.operations.begin(), tape_.operations.begin() + tape_.once, places_);
  }
  void play() { jaxscp::play(tape_.operations.begin() + tape_.once, tape_.operations.end(), places_); }
  const Wide& output(int i) const { return places_[tape_.outputs[i]]; }

 private:
  const Tape& tape_;
  int inputs_;
  Wide* places_;
};

}  // namespace jaxscp

// Functions and their derivatives as tapes (``functions.py``), and the numbers of two packs of intervals.
#pragma once

#include "tape.h"
#include "workspace.h"

namespace jaxscp {

template <typename T>
struct Span {
  const T* data = nullptr;
  int count = 0;
  const T* begin() const { return data; }
  const T* end() const { return data + count; }
  const T& operator[](int i) const { return data[i]; }
};

struct Coordinates {
  int row, column;
};

// Slots hold inputs, then parameters, then constants, then results.
struct Tape {
  Span<Operation> operations;
  int hoisted_count = 0, slots = 0, parameters = 0;
  Span<double> constants;
  Span<int> outputs;
};

// Inputs: arguments, then a multiplier of every value, then data, which have no derivatives.
struct Function {
  int arguments = 0, values = 0, data = 0;
  Tape first, second;                   // values, then Jacobian; Hessian of the weighted sum
  Span<Coordinates> jacobian, hessian;  // positions of their entries; of the Hessian, the lower triangle

  // Slots.
  int multipliers_begin() const { return arguments; }
  int data_begin() const { return arguments + values; }
  int inputs() const { return arguments + values + data; }
};

using Workspace = WorkspaceOf<Wide>;

class TapeEvaluator {
 public:
  TapeEvaluator(const Tape& tape, int inputs, Workspace& workspace)
      : tape_(tape), inputs_(inputs), slots_(workspace.take(tape.slots)) {}

  Wide* inputs() { return slots_; }
  Wide* parameters() { return slots_ + inputs_; }
  int parameter_count() const { return tape_.parameters; }

  // Evaluates hoisted operations; data and parameters must have been written.
  void begin() {
    for (int i = 0; i < tape_.constants.count; ++i) slots_[inputs_ + tape_.parameters + i] = wide(tape_.constants[i]);
    jaxscp::evaluate(tape_.operations.begin(), tape_.operations.begin() + tape_.hoisted_count, slots_);
  }
  void evaluate() { jaxscp::evaluate(tape_.operations.begin() + tape_.hoisted_count, tape_.operations.end(), slots_); }
  const Wide& output(int i) const { return slots_[tape_.outputs[i]]; }

 private:
  const Tape& tape_;
  int inputs_;
  Wide* slots_;
};

}  // namespace jaxscp

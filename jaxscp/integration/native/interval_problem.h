// Description of the integration, the same for all intervals.
//
// An interval's inputs are w = (state x, first controls, last controls); controls are linear between. Its outputs are
// the state at the end and the running cost; rows at its points, less a margin, which depends on the values at all
// points; and functions of w. The functions of a problem are tapes (``functions.h``).
#pragma once

#include <vector>

#include "functions.h"

namespace jaxscp {

constexpr int kMaxStages = 16;

// Rows of a point: ``group_size`` of them share a margin.
struct OutputGroup {
  int rows = 0, group_size = 1;
  Function subtract_margin;  // of (points, group_size) values; its data are the margin mask
};

struct IntervalProblem {
  int order;                   // highest derivative
  int states, controls;        // states without the cost; controls at one end
  int steps, steps_per_subinterval;
  Span<double> c, b, a;        // Butcher tableau; a row by row
  Span<int> first;             // by row of the path: the first input that the row depends on
  Function rate, point, ends;  // rate and point of (state, controls), ends of w
  std::vector<OutputGroup> groups;

  int extended() const { return states + 1; }
  int inputs() const { return states + 2 * controls; }
  int arguments() const { return states + controls; }
  int stages() const { return c.count; }
  int points() const { return steps / steps_per_subinterval + 1; }
  int points_begin() const { return extended(); }  // first row of the points, and of the functions of w
  int ends_begin() const { return extended() + points() * point.values; }
  int outputs() const { return ends_begin() + ends.values; }
  int data() const { return point.data + ends.data + points(); }
  double fraction(int step, int stage) const { return (step + c[stage]) / steps; }
  double fraction(int point) const { return static_cast<double>(point) / (points() - 1); }

  // act(group, value, output) for each set of rows that share a margin: value(e) is the index of its e-th row among the
  // rows of all points, output(e) among the outputs.
  template <typename Act>
  void for_groups(Act act) const {
    int first = 0;
    for (size_t g = 0; g < groups.size(); ++g) {
      const int rows = groups[g].rows, group_size = groups[g].group_size;
      for (int row = 0; row < rows; row += group_size) {
        auto value = [&](int e) { return e / group_size * point.values + first + row + e % group_size; };
        const int begin = points_begin() + points() * first + row;
        auto output = [&](int e) { return begin + e / group_size * rows + e % group_size; };
        act(static_cast<int>(g), value, output);
      }
      first += rows;
    }
  }
};

// Tapes of all functions, of one order.
class Tapes {
 public:
  TapeEvaluator rate, point, ends;
  std::vector<TapeEvaluator> margins;

  Tapes(const IntervalProblem& p, Tape Function::*order, Workspace& workspace)
      : rate(p.rate.*order, p.rate.inputs(), workspace), point(p.point.*order, p.point.inputs(), workspace),
        ends(p.ends.*order, p.ends.inputs(), workspace), p_(p) {
    for (const OutputGroup& group : p.groups)
      margins.emplace_back(group.subtract_margin.*order, group.subtract_margin.inputs(), workspace);
  }

  template <typename Act>
  void for_all(Act act) {
    act(rate), act(point), act(ends);
    for (TapeEvaluator& margin : margins) act(margin);
  }

  // Evaluates hoisted operations. Parameters must have been written; data are those of points, ends and margin mask.
  void begin(const Wide* data) {
    std::copy_n(data, p_.point.data, point.inputs() + p_.point.data_begin());
    std::copy_n(data + p_.point.data, p_.ends.data, ends.inputs() + p_.ends.data_begin());
    const Wide* mask = data + p_.point.data + p_.ends.data;
    for (size_t g = 0; g < margins.size(); ++g)
      std::copy_n(mask, p_.points(), margins[g].inputs() + p_.groups[g].subtract_margin.data_begin());
    for_all([](TapeEvaluator& tape) { tape.begin(); });
  }

 private:
  const IntervalProblem& p_;
};

}  // namespace jaxscp

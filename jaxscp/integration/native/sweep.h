// What a pass through intervals is told, the same for all of them.
//
// An interval's inputs are w = (state x, first controls, last controls); controls are linear between. Its outcomes are
// its end and the running cost; rows of what is watched at its points, less a margin that the values at all points
// decide; and rows of w alone. All that is particular to a problem comes from tapes (``functions.h``).
#pragma once

#include <vector>

#include "functions.h"

namespace jaxscp {

constexpr int kMaxStages = 16;

// Rows of a point: ``together`` of them have a margin in common.
struct Block {
  int rows = 0, together = 1;
  Function less_margin;  // of (points, together) values; its data say where the margin is kept
};

struct Sweep {
  int order;                               // of the derivatives
  int states, controls, steps, every;      // states without the cost; controls of one end; steps between two points
  Several<double> shares, weights, table;  // the Runge-Kutta method: of a stage; (stages, stages) row by row
  Several<int> first;                      // by row of the path: the first input that it depends on
  Function rate, point, ends;              // of (state, controls), and of w
  std::vector<Block> blocks;

  int extended() const { return states + 1; }
  int inputs() const { return states + 2 * controls; }
  int arguments() const { return states + controls; }
  int stages() const { return shares.count; }
  int points() const { return steps / every + 1; }
  int of_points() const { return extended(); }  // where outcomes of the points begin, and those of w alone
  int of_ends() const { return extended() + points() * point.values; }
  int outcomes() const { return of_ends() + ends.values; }
  int data() const { return point.data + ends.data + points(); }
  double share(int step, int stage) const { return (step + shares[stage]) / steps; }
  double share(int point) const { return static_cast<double>(point) / (points() - 1); }

  // act(which block, value, outcome) for all rows that have a margin in common: value(e) is the place of the e-th among
  // the rows of all points, and outcome(e) among the outcomes.
  template <typename Act>
  void for_groups(Act act) const {
    int before = 0;
    for (size_t b = 0; b < blocks.size(); ++b) {
      const int rows = blocks[b].rows, together = blocks[b].together;
      for (int row = 0; row < rows; row += together) {
        auto value = [&](int e) { return e / together * point.values + before + row + e % together; };
        const int begin = of_points() + points() * before + row;
        auto outcome = [&](int e) { return begin + e / together * rows + e % together; };
        act(static_cast<int>(b), value, outcome);
      }
      before += rows;
    }
  }
};

// The tapes of one order, of all functions.
class Tapes {
 public:
  Player rate, point, ends;
  std::vector<Player> margins;

  Tapes(const Sweep& s, Tape Function::*order, Memory& memory)
      : rate(s.rate.*order, s.rate.inputs(), memory), point(s.point.*order, s.point.inputs(), memory),
        ends(s.ends.*order, s.ends.inputs(), memory), s_(s) {
    for (const Block& block : s.blocks)
      margins.emplace_back(block.less_margin.*order, block.less_margin.inputs(), memory);
  }

  template <typename Act>
  void for_all(Act act) {
    act(rate), act(point), act(ends);
    for (Player& margin : margins) act(margin);
  }

  // When parameters are there; data are those of the points, of the ends, and where margins are kept.
  void begin(const Wide* data) {
    std::copy_n(data, s_.point.data, point.inputs() + s_.point.given());
    std::copy_n(data + s_.point.data, s_.ends.data, ends.inputs() + s_.ends.given());
    const Wide* keep = data + s_.point.data + s_.ends.data;
    for (size_t b = 0; b < margins.size(); ++b)
      std::copy_n(keep, s_.points(), margins[b].inputs() + s_.blocks[b].less_margin.given());
    for_all([](Player& tape) { tape.begin(); });
  }

 private:
  const Sweep& s_;
};

}  // namespace jaxscp

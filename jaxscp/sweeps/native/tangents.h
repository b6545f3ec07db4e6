// The path's tangents and the outcomes' Jacobian, row by row; and the curvature of the priced sum, which is the sum of
// S' H S over all functions that the outcomes are made of: S are the tangents of its arguments, H its Hessian.
//
// A row is kept from its first entry that may not be zero.
#pragma once

#include "prices.h"

namespace jaxscp {

// Sum of S' H S, by entries of H. What concerns a control is a row of its own, twice that of the two inputs whose share
// it is; what concerns states alone is summed in the upper triangle.
class Curvature {
 public:
  Curvature(const Sweep& s, Memory& memory)
      : s_(s), size_(s.inputs()), upper_(memory.take(size_ * size_)), of_controls_(memory.take(2 * s.controls * size_)),
        turned_(memory.take(most_rows(s) * size_)), any_(s.arguments()) {}

  void begin() {
    std::fill_n(upper_, size_ * size_, wide(0.0));
    std::fill_n(of_controls_, 2 * s_.controls * size_, wide(0.0));
  }

  // Of (state, controls) at a share of the interval, ``tangent`` being the states' rows.
  void add(const Several<Coordinates>& hessian, const Player& entries, const Wide* tangent, double share) {
    const int n = s_.states;
    std::fill(any_.begin(), any_.end(), false);
    auto row = [&](int r) {
      Wide* to = turned_ + r * size_;
      if (!any_[r]) std::fill_n(to, size_, wide(0.0)), any_[r] = true;
      return to;
    };
    for (int i = 0; i < hessian.count; ++i) {
      const auto [r, k] = hessian[i];  // r >= k, so that r is the control if there is one
      const Wide& entry = entries.output(i);
      if (r < n) {
        axpy(row(r), entry, tangent + k * size_, s_.first[k]);
        if (r != k) axpy(row(k), entry, tangent + r * size_, s_.first[r]);
      } else if (k < n) {
        axpy(row(r), entry, tangent + k * size_, s_.first[k]);
      } else {
        const Wide half = r == k ? 0.5 * entry : entry;
        row(r)[k] += (1.0 - share) * half;
        row(r)[k + s_.controls] += share * half;
      }
    }
    for (int r = 0; r < n; ++r)
      if (any_[r]) outer(tangent + r * size_, turned_ + r * size_, s_.first[r]);
    for (int r = n; r < s_.arguments(); ++r) {
      if (!any_[r]) continue;
      axpy(of_controls_ + (r - n) * size_, wide(1.0 - share), turned_ + r * size_, 0);
      axpy(of_controls_ + (r - n + s_.controls) * size_, wide(share), turned_ + r * size_, 0);
    }
  }

  // Of arguments that have a row each.
  template <typename Row>
  void add(const Several<Coordinates>& hessian, const Player& entries, int arguments, Row tangent) {
    std::fill_n(turned_, arguments * size_, wide(0.0));
    for (int i = 0; i < hessian.count; ++i) {
      const auto [r, k] = hessian[i];
      axpy(turned_ + r * size_, entries.output(i), tangent(k), 0);
      if (r != k) axpy(turned_ + k * size_, entries.output(i), tangent(r), 0);
    }
    for (int r = 0; r < arguments; ++r) outer(tangent(r), turned_ + r * size_, 0);
  }

  // Of the inputs themselves.
  void add(const Several<Coordinates>& hessian, const Player& entries) {
    for (int i = 0; i < hessian.count; ++i) upper_[hessian[i].column * size_ + hessian[i].row] += entries.output(i);
  }

  const Wide* whole() {
    const int n = s_.states;
    for (int i = n; i < size_; ++i)
      for (int c = 0; c < size_; ++c) upper_[std::min(i, c) * size_ + std::max(i, c)] += of_control(i, c);
    for (int i = n; i < size_; ++i) upper_[i * size_ + i] += of_control(i, i);
    for (int i = 0; i < size_; ++i)
      for (int j = 0; j < i; ++j) upper_[i * size_ + j] = upper_[j * size_ + i];
    return upper_;
  }

  void axpy(Wide* to, const Wide& factor, const Wide* row, int first) const {
    for (int c = first; c < size_; ++c) to[c] += factor * row[c];
  }

 private:
  static int most_rows(const Sweep& s) {
    int rows = s.arguments();
    for (const Block& block : s.blocks) rows = std::max(rows, block.less_margin.arguments);
    return rows;
  }

  const Wide& of_control(int i, int c) const { return of_controls_[(i - s_.states) * size_ + c]; }

  void outer(const Wide* a, const Wide* b, int first) {
    for (int i = first; i < size_; ++i)
      for (int c = i; c < size_; ++c) upper_[i * size_ + c] += a[i] * b[c];
  }

  const Sweep& s_;
  int size_;
  Wide *upper_, *of_controls_, *turned_;
  std::vector<char> any_;  // whether there is such a row of ``turned_``
};

class Tangents {
 public:
  Tangents(const Sweep& s, const Walk& walk, const Prices& prices, Memory& memory)
      : s_(s), walk_(walk), prices_(prices), size_(s.inputs()), rate_(s.rate.second, s.rate.inputs(), memory),
        point_(s.point.second, s.point.inputs(), memory), ends_(s.ends.second, s.ends.inputs(), memory),
        path_(memory.take(s.extended() * size_)), moved_(memory.take(s.states * size_)),
        pushed_(memory.take(s.stages() * s.extended() * size_)), values_(memory.take(s.points() * s.point.values * size_)),
        outcomes_(memory.take(s.outcomes() * size_)), curvature_(s, memory) {
    for (const Block& block : s.blocks)
      margins_.emplace_back(block.less_margin.second, block.less_margin.inputs(), memory);
  }

  template <typename Act>
  void for_tapes(Act act) {
    act(rate_), act(point_), act(ends_);
    for (auto& margin : margins_) act(margin);
  }

  void run() {
    begin();
    look(0);
    for (int step = 0; step < s_.steps; ++step) {
      for (int stage = 0; stage < s_.stages(); ++stage) slope(step, stage);
      advance(s_.weights.data, s_.stages(), s_.extended(), path_);
      if ((step + 1) % s_.every == 0) look((step + 1) / s_.every);
    }
    std::copy_n(path_, s_.extended() * size_, outcomes_);
    keep_margins();
    ends();
  }

  const Wide* outcomes() const { return outcomes_; }
  const Wide* curvature() { return curvature_.whole(); }

 private:
  bool curved() const { return s_.order == 2; }

  void begin() {
    std::fill_n(path_, s_.extended() * size_, wide(0.0));
    for (int r = 0; r < s_.states; ++r) path_[r * size_ + r] = wide(1.0);
    std::fill_n(outcomes_, s_.outcomes() * size_, wide(0.0));
    if (!curved()) return;
    curvature_.begin();
    const Wide* at = walk_.data();
    std::copy_n(at, s_.point.data, point_.inputs() + s_.point.given());
    std::copy_n(at += s_.point.data, s_.ends.data, ends_.inputs() + s_.ends.given());
    at += s_.ends.data;
    for (size_t b = 0; b < margins_.size(); ++b)
      std::copy_n(at, s_.points(), margins_[b].inputs() + s_.blocks[b].less_margin.given());
    for_tapes([](Player& tape) { tape.begin(); });
  }

  void slope(int step, int stage) {
    const int slope = step * s_.stages() + stage;
    const double share = s_.share(step, stage);
    advance(s_.table.data + stage * s_.stages(), stage, s_.states, moved_);
    Wide* pushed = pushed_ + stage * s_.extended() * size_;
    for (int r = 0; r < s_.extended(); ++r)
      std::fill(pushed + r * size_ + s_.first[r], pushed + (r + 1) * size_, wide(0.0));
    push(s_.rate.jacobian, walk_.rate_entries(slope), moved_, share, pushed);
    if (!curved()) return;
    std::copy_n(walk_.rate_arguments(slope), s_.arguments(), rate_.inputs());
    std::copy_n(prices_.slopes(slope), s_.extended(), rate_.inputs() + s_.rate.prices());
    rate_.play();
    curvature_.add(s_.rate.hessian, rate_, moved_, share);
  }

  // to = path + so many slopes of these weights, for the first ``rows``.
  void advance(const double* weights, int count, int rows, Wide* to) const {
    double scaled[kMaxStages];
    const Wide* from[kMaxStages];
    int number = 0;
    for (int i = 0; i < count; ++i)
      if (weights[i] != 0.0) from[number] = pushed_ + i * s_.extended() * size_, scaled[number++] = weights[i] / s_.steps;
    for (int r = 0; r < rows; ++r)
      for (int c = r * size_ + s_.first[r]; c < (r + 1) * size_; ++c) {
        Wide sum = path_[c];
        for (int i = 0; i < number; ++i) sum += scaled[i] * from[i][c];
        to[c] = sum;
      }
  }

  void look(int point) {
    Wide* to = values_ + point * s_.point.values * size_;
    const double share = s_.share(point);
    std::fill_n(to, s_.point.values * size_, wide(0.0));
    push(s_.point.jacobian, walk_.point_entries(point), path_, share, to);
    if (!curved()) return;
    std::copy_n(walk_.point_arguments(point), s_.arguments(), point_.inputs());
    std::copy_n(prices_.values(point), s_.point.values, point_.inputs() + s_.point.prices());
    point_.play();
    curvature_.add(s_.point.hessian, point_, path_, share);
  }

  // to += Jacobian tangents, of arguments (state, controls): a control is a share of two inputs.
  void push(const Several<Coordinates>& jacobian, const Wide* entry, const Wide* tangent, double share, Wide* to) const {
    for (int i = 0; i < jacobian.count; ++i) {
      const auto [r, k] = jacobian[i];
      Wide* row = to + r * size_;
      if (k < s_.states) {
        curvature_.axpy(row, entry[i], tangent + k * size_, s_.first[k]);
      } else {
        row[k] += (1.0 - share) * entry[i];
        row[k + s_.controls] += share * entry[i];
      }
    }
  }

  void keep_margins() {
    int group = 0;
    s_.for_groups([&](int b, auto value, auto outcome) {
      const Function& f = s_.blocks[b].less_margin;
      const Wide* entry = walk_.group_entries(group++);
      auto tangent = [&](int e) { return values_ + value(e) * size_; };
      for (int i = 0; i < f.jacobian.count; ++i)
        curvature_.axpy(outcomes_ + outcome(f.jacobian[i].row) * size_, entry[i], tangent(f.jacobian[i].column), 0);
      if (!curved()) return;
      Wide* to = margins_[b].inputs();
      for (int e = 0; e < f.arguments; ++e) to[e] = walk_.value(value(e));
      for (int e = 0; e < f.values; ++e) to[f.prices() + e] = prices_.outcomes()[outcome(e)];
      margins_[b].play();
      curvature_.add(f.hessian, margins_[b], f.arguments, tangent);
    });
  }

  void ends() {
    const Function& f = s_.ends;
    for (int i = 0; i < f.jacobian.count; ++i)
      outcomes_[(s_.of_ends() + f.jacobian[i].row) * size_ + f.jacobian[i].column] = walk_.ends_entries()[i];
    if (!curved()) return;
    std::copy_n(walk_.w(), size_, ends_.inputs());
    std::copy_n(prices_.outcomes() + s_.of_ends(), f.values, ends_.inputs() + f.prices());
    ends_.play();
    curvature_.add(f.hessian, ends_);
  }

  const Sweep& s_;
  const Walk& walk_;
  const Prices& prices_;
  int size_;
  Player rate_, point_, ends_;
  std::vector<Player> margins_;
  Wide *path_, *moved_, *pushed_, *values_, *outcomes_;
  Curvature curvature_;
};

}  // namespace jaxscp

// The path's tangents and the outcomes' Jacobian, row by row; and the curvature of the priced sum, which is the sum of
// S' H S over all functions that the outcomes are made of: S are the tangents of its arguments, H its Hessian.
//
// A row is kept from its first entry that may not be zero.
#pragma once

#include "prices.h"

namespace jaxscp {

// act(column, how many from there on), of a row from ``first``: four at once, as many as registers hold sums of.
template <typename Act>
inline void for_columns(int first, int size, Act act) {
  int c = first;
  for (; c + 4 <= size; c += 4) act(c, std::integral_constant<int, 4>());
  for (; c < size; ++c) act(c, std::integral_constant<int, 1>());
}

// A number times a row, which is zero before its first column.
struct Term {
  const Wide *factor, *row;
  int first = 0;
};

// to (+)= sum of the terms, from column ``first`` on.
template <bool kAdd>
inline void combine(const Term* terms, int count, int first, int size, Wide* to) {
  for_columns(first, size, [&](int c, auto some) {
    Wide sum[some];
    for (int q = 0; q < some; ++q) sum[q] = kAdd ? to[c + q] : wide(0.0);
    for (int t = 0; t < count; ++t) {
      const Wide factor = *terms[t].factor;
      for (int q = 0; q < some; ++q) sum[q] += factor * terms[t].row[c + q];
    }
    for (int q = 0; q < some; ++q) to[c + q] = sum[q];
  });
}

// Sum of S' H S, by entries of H. What concerns a control is in rows of the two inputs whose share it is; what concerns
// states alone is summed in the upper triangle.
class Curvature {
 public:
  Curvature(const Sweep& s, Memory& memory)
      : s_(s), size_(s.inputs()), upper_(memory.take(size_ * size_)), of_controls_(memory.take(2 * s.controls * size_)),
        turned_(memory.take(most_rows(s) * size_)), terms_(most_rows(s)) {}

  void begin() {
    std::fill_n(upper_, size_ * size_, wide(0.0));
    std::fill_n(of_controls_, 2 * s_.controls * size_, wide(0.0));
  }

  // Of (state, controls) at a share of the interval, ``tangent`` being the states' rows.
  void add(const Several<Coordinates>& hessian, const Player& entries, const Wide* tangent, double share) {
    const int n = s_.states;
    for (auto& terms : terms_) terms.clear();
    auto row = [&](int r) { return Term{nullptr, tangent + r * size_, s_.first[r]}; };
    auto note = [&](int r, int k, int i) { terms_[r].push_back({&entries.output(i), row(k).row, row(k).first}); };
    for (int i = 0; i < hessian.count; ++i) {
      const auto [r, k] = hessian[i];  // r >= k, so that r is the control if there is one
      if (k < n) note(r, k, i);
      if (r < n && r != k) note(k, r, i);
    }
    turn(s_.arguments());
    for (int i = 0; i < hessian.count; ++i) {
      const auto [r, k] = hessian[i];
      if (k < n) continue;
      const Wide half = r == k ? 0.5 * entries.output(i) : entries.output(i);
      turned_[r * size_ + k] += (1.0 - share) * half;
      turned_[r * size_ + k + s_.controls] += share * half;
    }
    outer(n, row);
    for (int r = n; r < s_.arguments(); ++r) {
      const Wide* turned = turned_ + r * size_;
      Wide *first = of_controls_ + (r - n) * size_, *last = first + s_.controls * size_;
      for (int c = 0; c < size_; ++c) first[c] += (1.0 - share) * turned[c], last[c] += share * turned[c];
    }
  }

  // Of arguments that have a row each.
  template <typename Row>
  void add(const Several<Coordinates>& hessian, const Player& entries, int arguments, Row tangent) {
    for (auto& terms : terms_) terms.clear();
    for (int i = 0; i < hessian.count; ++i) {
      const auto [r, k] = hessian[i];
      terms_[r].push_back({&entries.output(i), tangent(k)});
      if (r != k) terms_[k].push_back({&entries.output(i), tangent(r)});
    }
    turn(arguments);
    outer(arguments, [&](int r) { return Term{nullptr, tangent(r)}; });
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

 private:
  static int most_rows(const Sweep& s) {
    int rows = s.arguments();
    for (const Block& block : s.blocks) rows = std::max(rows, block.less_margin.arguments);
    return rows;
  }

  const Wide& of_control(int i, int c) const { return of_controls_[(i - s_.states) * size_ + c]; }

  // H S, for the first rows of H.
  void turn(int rows) {
    for (int r = 0; r < rows; ++r) {
      int first = size_;
      for (const Term& term : terms_[r]) first = std::min(first, term.first);
      std::fill_n(turned_ + r * size_, first, wide(0.0));
      combine<false>(terms_[r].data(), static_cast<int>(terms_[r].size()), first, size_, turned_ + r * size_);
    }
  }

  // upper += S' (H S), of the first rows of H; row(r) of S.
  template <typename Row>
  void outer(int rows, Row row) {
    for (int i = 0; i < size_; ++i) {
      of_row_.clear();
      for (int r = 0; r < rows; ++r)
        if (!terms_[r].empty() && i >= row(r).first) of_row_.push_back({row(r).row + i, turned_ + r * size_});
      if (!of_row_.empty())
        combine<true>(of_row_.data(), static_cast<int>(of_row_.size()), i, size_, upper_ + i * size_);
    }
  }

  const Sweep& s_;
  int size_;
  Wide *upper_, *of_controls_, *turned_;
  std::vector<std::vector<Term>> terms_;  // by row of H
  std::vector<Term> of_row_;
};

class Tangents {
 public:
  Tangents(const Sweep& s, const Walk& walk, const Prices& prices, Memory& memory)
      : s_(s), walk_(walk), prices_(prices), size_(s.inputs()), tapes_(s, &Function::second, memory),
        path_(memory.take(s.extended() * size_)), moved_(memory.take(s.states * size_)),
        pushed_(memory.take(s.stages() * s.extended() * size_)),
        values_(memory.take(s.points() * s.point.values * size_)),
        outcomes_(memory.take(s.outcomes() * size_)), curvature_(s, memory) {}

  Tapes& tapes() { return tapes_; }

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
    for (int r = 0; r < s_.extended(); ++r) std::fill_n(path_ + r * size_, size_, wide(0.0));
    for (int r = 0; r < s_.states; ++r) std::fill_n(moved_ + r * size_, s_.first[r], wide(0.0));
    for (int r = 0; r < s_.states; ++r) path_[r * size_ + r] = wide(1.0);
    std::fill_n(outcomes_ + s_.of_ends() * size_, s_.ends.values * size_, wide(0.0));
    if (!curved()) return;
    curvature_.begin();
    tapes_.begin(walk_.data());
  }

  void slope(int step, int stage) {
    const int slope = step * s_.stages() + stage;
    const double share = s_.share(step, stage);
    advance(s_.table.data + stage * s_.stages(), stage, s_.states, moved_);
    Wide* pushed = pushed_ + stage * s_.extended() * size_;
    auto first = [&](int r) { return s_.first[r]; };
    push(s_.rate.jacobian, walk_.rate_entries(slope), moved_, share, s_.extended(), first, pushed);
    if (!curved()) return;
    std::copy_n(walk_.rate_arguments(slope), s_.arguments(), tapes_.rate.inputs());
    std::copy_n(prices_.slopes(slope), s_.extended(), tapes_.rate.inputs() + s_.rate.prices());
    tapes_.rate.play();
    curvature_.add(s_.rate.hessian, tapes_.rate, moved_, share);
  }

  // to = path + so many slopes of these weights, for the first ``rows``.
  void advance(const double* weights, int count, int rows, Wide* to) const {
    double scaled[kMaxStages];
    const Wide* from[kMaxStages];
    int number = 0;
    for (int i = 0; i < count; ++i)
      if (weights[i] != 0.0) {
        from[number] = pushed_ + i * s_.extended() * size_;
        scaled[number++] = weights[i] / s_.steps;
      }
    for (int r = 0; r < rows; ++r)
      for_columns(s_.first[r], size_, [&](int column, auto some) {
        const int c = r * size_ + column;
        Wide sum[some];
        for (int q = 0; q < some; ++q) sum[q] = path_[c + q];
        for (int i = 0; i < number; ++i)
          for (int q = 0; q < some; ++q) sum[q] += scaled[i] * from[i][c + q];
        for (int q = 0; q < some; ++q) to[c + q] = sum[q];
      });
  }

  void look(int point) {
    Wide* to = values_ + point * s_.point.values * size_;
    const double share = s_.share(point);
    push(s_.point.jacobian, walk_.point_entries(point), path_, share, s_.point.values, [](int) { return 0; }, to);
    if (!curved()) return;
    std::copy_n(walk_.point_arguments(point), s_.arguments(), tapes_.point.inputs());
    std::copy_n(prices_.values(point), s_.point.values, tapes_.point.inputs() + s_.point.prices());
    tapes_.point.play();
    curvature_.add(s_.point.hessian, tapes_.point, path_, share);
  }

  // to = Jacobian tangents, row by row from its first column; of arguments (state, controls), of which a control is a
  // share of two inputs.
  template <typename First>
  void push(const Several<Coordinates>& jacobian, const Wide* entry, const Wide* tangent, double share, int rows,
            First first, Wide* to) {
    int i = 0;
    for (int r = 0; r < rows; ++r) {
      Wide* row = to + r * size_;
      terms_.clear();
      for (; i < jacobian.count && jacobian[i].row == r && jacobian[i].column < s_.states; ++i)
        terms_.push_back({entry + i, tangent + jacobian[i].column * size_});
      combine<false>(terms_.data(), static_cast<int>(terms_.size()), first(r), size_, row);
      for (; i < jacobian.count && jacobian[i].row == r; ++i) {
        row[jacobian[i].column] += (1.0 - share) * entry[i];
        row[jacobian[i].column + s_.controls] += share * entry[i];
      }
    }
  }

  void keep_margins() {
    int group = 0;
    s_.for_groups([&](int b, auto value, auto outcome) {
      const Function& f = s_.blocks[b].less_margin;
      const Wide* entry = walk_.group_entries(group++);
      auto tangent = [&](int e) { return values_ + value(e) * size_; };
      for (int i = 0, e = 0; e < f.values; ++e) {
        terms_.clear();
        for (; i < f.jacobian.count && f.jacobian[i].row == e; ++i)
          terms_.push_back({entry + i, tangent(f.jacobian[i].column)});
        combine<false>(terms_.data(), static_cast<int>(terms_.size()), 0, size_, outcomes_ + outcome(e) * size_);
      }
      if (!curved()) return;
      Player& margin = tapes_.margins[b];
      Wide* to = margin.inputs();
      for (int e = 0; e < f.arguments; ++e) to[e] = walk_.value(value(e));
      for (int e = 0; e < f.values; ++e) to[f.prices() + e] = prices_.outcomes()[outcome(e)];
      margin.play();
      curvature_.add(f.hessian, margin, f.arguments, tangent);
    });
  }

  void ends() {
    const Function& f = s_.ends;
    for (int i = 0; i < f.jacobian.count; ++i)
      outcomes_[(s_.of_ends() + f.jacobian[i].row) * size_ + f.jacobian[i].column] = walk_.ends_entries()[i];
    if (!curved()) return;
    std::copy_n(walk_.w(), size_, tapes_.ends.inputs());
    std::copy_n(prices_.outcomes() + s_.of_ends(), f.values, tapes_.ends.inputs() + f.prices());
    tapes_.ends.play();
    curvature_.add(f.hessian, tapes_.ends);
  }

  const Sweep& s_;
  const Walk& walk_;
  const Prices& prices_;
  int size_;
  Tapes tapes_;
  Wide *path_, *moved_, *pushed_, *values_, *outcomes_;
  std::vector<Term> terms_;
  Curvature curvature_;
};

}  // namespace jaxscp

// Tangents of the path and Jacobian of the outputs, row by row; and the Hessian of the outputs' weighted sum: the sum
// of S' H S over all functions, with S the tangents of a function's arguments and H the Hessian of its weighted sum.
//
// A row is stored from its first entry that may differ from zero.
#pragma once

#include "adjoint.h"

namespace jaxscp {

// act(column, count) over the columns of a row from ``first``: four at once, as registers hold four sums.
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

// Sum of S' H S, by entries of H. Terms of a control are stored in rows of the two inputs that interpolate the control;
// terms of states alone are summed in the upper triangle.
class HessianSum {
 public:
  HessianSum(const IntervalProblem& p, Workspace& workspace)
      : p_(p), size_(p.inputs()), upper_(workspace.take(size_ * size_)),
        of_controls_(workspace.take(2 * p.controls * size_)), product_(workspace.take(most_rows(p) * size_)),
        terms_(most_rows(p)) {}

  void begin() {
    std::fill_n(upper_, size_ * size_, wide(0.0));
    std::fill_n(of_controls_, 2 * p_.controls * size_, wide(0.0));
  }

  // Adds a function of (state, controls) at a fraction of the interval; ``tangent`` holds the states' rows.
  void add(const Span<Coordinates>& hessian, const TapeEvaluator& entries, const Wide* tangent, double fraction) {
    const int n = p_.states;
    for (auto& terms : terms_) terms.clear();
    auto row = [&](int r) { return Term{nullptr, tangent + r * size_, p_.first[r]}; };
    auto note = [&](int r, int k, int i) { terms_[r].push_back({&entries.output(i), row(k).row, row(k).first}); };
    for (int i = 0; i < hessian.count; ++i) {
      const auto [r, k] = hessian[i];  // r >= k, so that r is the control if there is one
      if (k < n) note(r, k, i);
      if (r < n && r != k) note(k, r, i);
    }
    multiply(p_.arguments());
    for (int i = 0; i < hessian.count; ++i) {
      const auto [r, k] = hessian[i];
      if (k < n) continue;
      const Wide half = r == k ? 0.5 * entries.output(i) : entries.output(i);
      product_[r * size_ + k] += (1.0 - fraction) * half;
      product_[r * size_ + k + p_.controls] += fraction * half;
    }
    outer(n, row);
    for (int r = n; r < p_.arguments(); ++r) {
      const Wide* product = product_ + r * size_;
      Wide *first = of_controls_ + (r - n) * size_, *last = first + p_.controls * size_;
      for (int c = 0; c < size_; ++c) first[c] += (1.0 - fraction) * product[c], last[c] += fraction * product[c];
    }
  }

  // Adds a function of arguments that have a row each.
  template <typename Row>
  void add(const Span<Coordinates>& hessian, const TapeEvaluator& entries, int arguments, Row tangent) {
    for (auto& terms : terms_) terms.clear();
    for (int i = 0; i < hessian.count; ++i) {
      const auto [r, k] = hessian[i];
      terms_[r].push_back({&entries.output(i), tangent(k)});
      if (r != k) terms_[k].push_back({&entries.output(i), tangent(r)});
    }
    multiply(arguments);
    outer(arguments, [&](int r) { return Term{nullptr, tangent(r)}; });
  }

  // Adds a function of the inputs.
  void add(const Span<Coordinates>& hessian, const TapeEvaluator& entries) {
    for (int i = 0; i < hessian.count; ++i) upper_[hessian[i].column * size_ + hessian[i].row] += entries.output(i);
  }

  // The full matrix.
  const Wide* assembled() {
    const int n = p_.states;
    for (int i = n; i < size_; ++i)
      for (int c = 0; c < size_; ++c) upper_[std::min(i, c) * size_ + std::max(i, c)] += of_control(i, c);
    for (int i = n; i < size_; ++i) upper_[i * size_ + i] += of_control(i, i);
    for (int i = 0; i < size_; ++i)
      for (int j = 0; j < i; ++j) upper_[i * size_ + j] = upper_[j * size_ + i];
    return upper_;
  }

 private:
  static int most_rows(const IntervalProblem& p) {
    int rows = p.arguments();
    for (const OutputGroup& group : p.groups) rows = std::max(rows, group.subtract_margin.arguments);
    return rows;
  }

  const Wide& of_control(int i, int c) const { return of_controls_[(i - p_.states) * size_ + c]; }

  // product = H S, for the first rows of H.
  void multiply(int rows) {
    for (int r = 0; r < rows; ++r) {
      int first = size_;
      for (const Term& term : terms_[r]) first = std::min(first, term.first);
      std::fill_n(product_ + r * size_, first, wide(0.0));
      combine<false>(terms_[r].data(), static_cast<int>(terms_[r].size()), first, size_, product_ + r * size_);
    }
  }

  // upper += S' (H S), for the first rows of H; row(r) is a row of S.
  template <typename Row>
  void outer(int rows, Row row) {
    for (int i = 0; i < size_; ++i) {
      of_row_.clear();
      for (int r = 0; r < rows; ++r)
        if (!terms_[r].empty() && i >= row(r).first) of_row_.push_back({row(r).row + i, product_ + r * size_});
      if (!of_row_.empty())
        combine<true>(of_row_.data(), static_cast<int>(of_row_.size()), i, size_, upper_ + i * size_);
    }
  }

  const IntervalProblem& p_;
  int size_;
  Wide *upper_, *of_controls_, *product_;
  std::vector<std::vector<Term>> terms_;  // by row of H
  std::vector<Term> of_row_;
};

class Tangents {
 public:
  Tangents(const IntervalProblem& p, const Forward& forward, const Adjoint& adjoint, Workspace& workspace)
      : p_(p), forward_(forward), adjoint_(adjoint), size_(p.inputs()), tapes_(p, &Function::second, workspace),
        path_(workspace.take(p.extended() * size_)), stage_tangent_(workspace.take(p.states * size_)),
        slope_tangents_(workspace.take(p.stages() * p.extended() * size_)),
        values_(workspace.take(p.points() * p.point.values * size_)),
        outputs_(workspace.take(p.outputs() * size_)), hessian_(p, workspace) {}

  Tapes& tapes() { return tapes_; }

  void run() {
    begin();
    evaluate_point(0);
    for (int step = 0; step < p_.steps; ++step) {
      for (int stage = 0; stage < p_.stages(); ++stage) evaluate_stage(step, stage);
      advance(p_.b.data, p_.stages(), p_.extended(), path_);
      if ((step + 1) % p_.steps_per_subinterval == 0) evaluate_point((step + 1) / p_.steps_per_subinterval);
    }
    std::copy_n(path_, p_.extended() * size_, outputs_);
    subtract_margins();
    ends();
  }

  const Wide* outputs() const { return outputs_; }
  const Wide* hessian() { return hessian_.assembled(); }

 private:
  bool second_order() const { return p_.order == 2; }

  void begin() {
    for (int r = 0; r < p_.extended(); ++r) std::fill_n(path_ + r * size_, size_, wide(0.0));
    for (int r = 0; r < p_.states; ++r) std::fill_n(stage_tangent_ + r * size_, p_.first[r], wide(0.0));
    for (int r = 0; r < p_.states; ++r) path_[r * size_ + r] = wide(1.0);
    std::fill_n(outputs_ + p_.ends_begin() * size_, p_.ends.values * size_, wide(0.0));
    if (!second_order()) return;
    hessian_.begin();
    tapes_.begin(forward_.data());
  }

  void evaluate_stage(int step, int stage) {
    const int slope = step * p_.stages() + stage;
    const double fraction = p_.fraction(step, stage);
    advance(p_.a.data + stage * p_.stages(), stage, p_.states, stage_tangent_);
    Wide* slope_tangent = slope_tangents_ + stage * p_.extended() * size_;
    auto first = [&](int r) { return p_.first[r]; };
    jacobian_product(p_.rate.jacobian, forward_.rate_entries(slope), stage_tangent_, fraction, p_.extended(), first,
                     slope_tangent);
    if (!second_order()) return;
    std::copy_n(forward_.rate_arguments(slope), p_.arguments(), tapes_.rate.inputs());
    std::copy_n(adjoint_.slopes(slope), p_.extended(), tapes_.rate.inputs() + p_.rate.multipliers_begin());
    tapes_.rate.evaluate();
    hessian_.add(p_.rate.hessian, tapes_.rate, stage_tangent_, fraction);
  }

  // to = path + h sum_i weights_i slope_tangents_i, for the first ``rows``.
  void advance(const double* weights, int count, int rows, Wide* to) const {
    double scaled[kMaxStages];
    const Wide* from[kMaxStages];
    int number = 0;
    for (int i = 0; i < count; ++i)
      if (weights[i] != 0.0) {
        from[number] = slope_tangents_ + i * p_.extended() * size_;
        scaled[number++] = weights[i] / p_.steps;
      }
    for (int r = 0; r < rows; ++r)
      for_columns(p_.first[r], size_, [&](int column, auto some) {
        const int c = r * size_ + column;
        Wide sum[some];
        for (int q = 0; q < some; ++q) sum[q] = path_[c + q];
        for (int i = 0; i < number; ++i)
          for (int q = 0; q < some; ++q) sum[q] += scaled[i] * from[i][c + q];
        for (int q = 0; q < some; ++q) to[c + q] = sum[q];
      });
  }

  void evaluate_point(int point) {
    Wide* to = values_ + point * p_.point.values * size_;
    const double fraction = p_.fraction(point);
    auto first = [](int) { return 0; };
    jacobian_product(p_.point.jacobian, forward_.point_entries(point), path_, fraction, p_.point.values, first, to);
    if (!second_order()) return;
    std::copy_n(forward_.point_arguments(point), p_.arguments(), tapes_.point.inputs());
    std::copy_n(adjoint_.values(point), p_.point.values, tapes_.point.inputs() + p_.point.multipliers_begin());
    tapes_.point.evaluate();
    hessian_.add(p_.point.hessian, tapes_.point, path_, fraction);
  }

  // to = J S, row by row from its first column; of arguments (state, controls), where two inputs interpolate a control.
  template <typename First>
  void jacobian_product(const Span<Coordinates>& jacobian, const Wide* entry, const Wide* tangent, double fraction,
                        int rows, First first, Wide* to) {
    int i = 0;
    for (int r = 0; r < rows; ++r) {
      Wide* row = to + r * size_;
      terms_.clear();
      for (; i < jacobian.count && jacobian[i].row == r && jacobian[i].column < p_.states; ++i)
        terms_.push_back({entry + i, tangent + jacobian[i].column * size_});
      combine<false>(terms_.data(), static_cast<int>(terms_.size()), first(r), size_, row);
      for (; i < jacobian.count && jacobian[i].row == r; ++i) {
        row[jacobian[i].column] += (1.0 - fraction) * entry[i];
        row[jacobian[i].column + p_.controls] += fraction * entry[i];
      }
    }
  }

  void subtract_margins() {
    int group = 0;
    p_.for_groups([&](int g, auto value, auto output) {
      const Function& f = p_.groups[g].subtract_margin;
      const Wide* entry = forward_.group_entries(group++);
      auto tangent = [&](int e) { return values_ + value(e) * size_; };
      for (int i = 0, e = 0; e < f.values; ++e) {
        terms_.clear();
        for (; i < f.jacobian.count && f.jacobian[i].row == e; ++i)
          terms_.push_back({entry + i, tangent(f.jacobian[i].column)});
        combine<false>(terms_.data(), static_cast<int>(terms_.size()), 0, size_, outputs_ + output(e) * size_);
      }
      if (!second_order()) return;
      TapeEvaluator& margin = tapes_.margins[g];
      Wide* to = margin.inputs();
      for (int e = 0; e < f.arguments; ++e) to[e] = forward_.value(value(e));
      for (int e = 0; e < f.values; ++e) to[f.multipliers_begin() + e] = adjoint_.multipliers()[output(e)];
      margin.evaluate();
      hessian_.add(f.hessian, margin, f.arguments, tangent);
    });
  }

  void ends() {
    const Function& f = p_.ends;
    for (int i = 0; i < f.jacobian.count; ++i)
      outputs_[(p_.ends_begin() + f.jacobian[i].row) * size_ + f.jacobian[i].column] = forward_.ends_entries()[i];
    if (!second_order()) return;
    std::copy_n(forward_.w(), size_, tapes_.ends.inputs());
    std::copy_n(adjoint_.multipliers() + p_.ends_begin(), f.values, tapes_.ends.inputs() + f.multipliers_begin());
    tapes_.ends.evaluate();
    hessian_.add(f.hessian, tapes_.ends);
  }

  const IntervalProblem& p_;
  const Forward& forward_;
  const Adjoint& adjoint_;
  int size_;
  Tapes tapes_;
  Wide *path_, *stage_tangent_, *slope_tangents_, *values_, *outputs_;
  std::vector<Term> terms_;
  HessianSum hessian_;
};

}  // namespace jaxscp

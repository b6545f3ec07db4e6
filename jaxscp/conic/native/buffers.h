// XLA's buffers as a batch of programs, on every device.
#pragma once

#include <algorithm>

#include "batch.h"
#include "call.h"

namespace jaxscp {

// A batch, and the sizes of its programs.
struct SizedBatch {
  Sizes sizes;
  Batch batch;
};

// Batch from the arguments, results and attributes of ``native/__init__.py``, in the same order.
inline SizedBatch sized_batch(const Call& call) {
  SizedBatch s{};
  Batch& b = s.batch;
  auto number = [&](const char* name) { return call.number<double>(name); };
  auto integer = [&](const char* name) { return static_cast<int>(call.number<int64_t>(name)); };
  b.settings = {number("proof_tolerance"), number("loose_tolerance"),
                number("regularisation"), number("refine_below"), integer("max_iterations"), integer("refinements"),
                integer("equilibration")};
  s.sizes.has_norm = integer("has_norm") != 0;

  // Strides of the batch's elements, and lengths of the last two axes.
  auto read = [&](const Array& array, auto& to, int* first, int* second) {
    using Number = std::remove_const_t<std::remove_pointer_t<decltype(to.data)>>;
    to = {array.numbers<Number>(), array.size() / std::max<long long>(b.size, 1)};
    if (first) *first = array.from_last(2);
    if (second) *second = array.from_last(1);
  };
  auto argument = [&](int64_t i, Input& to, int* first = nullptr, int* second = nullptr) {
    read(call.argument(i), to, first, second);
  };
  constexpr int64_t kTolerance = 9;  // has one number per batch element
  b.size = call.argument(kTolerance).size();
  int64_t next = 0;
  argument(next++, b.hessian);
  argument(next++, b.gradient, &s.sizes.nodes, &s.sizes.variables);
  argument(next++, b.before);
  argument(next++, b.after);
  argument(next++, b.link_offset);
  argument(next++, b.soft, nullptr, &s.sizes.link_rows);
  argument(next++, b.penalty_weight);
  argument(next++, b.row_matrix);
  argument(next++, b.row_offset, nullptr, &s.sizes.rows);
  argument(next++, b.tolerance);
  const bool has_warm_start = integer("has_warm_start") != 0;
  s.sizes.groups = static_cast<int>(call.arguments() - next - (s.sizes.has_norm ? 3 : 0) - (has_warm_start ? 3 : 0)) /
                   (has_warm_start ? 3 : 2);
  if (s.sizes.groups > kMaxGroups) throw invalid("too many groups of cones");
  int cones = 2, rows = 0;
  for (int c = 0; c < s.sizes.groups; ++c) {
    argument(next++, b.cone_matrix[c]);
    argument(next++, b.cone_offset[c], &s.sizes.cones[c].count, &s.sizes.cones[c].dimension);
    cones += s.sizes.cones[c].count;
    rows += s.sizes.cones[c].count * s.sizes.cones[c].dimension;
  }
  if (std::max({rows, s.sizes.rows, s.sizes.variables, s.sizes.link_rows}) > kMaxLines)
    throw invalid("too many rows at a node");
  if (cones > kMaxCones) throw invalid("too many cones at a node");
  if (s.sizes.has_norm)
    for (Input* to : {&b.norm_weight, &b.norm_scale, &b.norm_centre}) argument(next++, *to);
  if (has_warm_start) {
    for (Input* to : {&b.warm_z, &b.warm_links, &b.warm_rows}) argument(next++, *to);
    for (int c = 0; c < s.sizes.groups; ++c) argument(next++, b.warm_cones[c]);
  }

  int64_t out = 0;
  auto result = [&](auto& to, int* second = nullptr) { read(call.result(out++), to, nullptr, second); };
  for (Output* to : {&b.z, &b.xi, &b.zeta, &b.y_zero, &b.y_orthant}) result(*to);
  result(b.y_second, &b.width);
  for (Output* to : {&b.s_orthant, &b.s_second, &b.tau, &b.kappa, &b.error, &b.infeasibility, &b.unboundedness})
    result(*to);
  result(b.iterations);
  for (auto* to : {&b.stalled, &b.broken}) result(*to);
  for (Output* to : {&b.scales_of_columns, &b.scales_of_links, &b.scales_of_rows}) result(*to);
  for (int c = 0; c < s.sizes.groups; ++c) result(b.scales_of_cones[c]);
  result(b.scale_of_cost);
  return s;
}

}  // namespace jaxscp

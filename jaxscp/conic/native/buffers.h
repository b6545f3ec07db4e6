// XLA's buffers as a batch of programs, on every device.
#pragma once

#include <algorithm>

#include "batch.h"
#include "xla/ffi/api/ffi.h"

namespace jaxscp {

namespace ffi = xla::ffi;

// A batch, and the sizes of its programs.
struct SizedBatch {
  Sizes sizes;
  Batch batch;
};

// Batch from the arguments, results and attributes of ``native/__init__.py``, in the same order.
inline ffi::ErrorOr<SizedBatch> sized_batch(ffi::RemainingArgs args, ffi::RemainingRets rets, ffi::Dictionary attrs) {
  SizedBatch s{};
  Batch& b = s.batch;
  ffi::Error error = ffi::Error::Success();
  auto number = [&](const char* name) {
    auto v = attrs.get<double>(name);
    if (!v.has_value()) error = v.error();
    return v.has_value() ? *v : 0.0;
  };
  auto integer = [&](const char* name) {
    auto v = attrs.get<int64_t>(name);
    if (!v.has_value()) error = v.error();
    return v.has_value() ? static_cast<int>(*v) : 0;
  };
  b.settings = {number("proof_tolerance"), number("loose_tolerance"),
                number("regularisation"), number("refine_below"), integer("max_iterations"), integer("refinements"),
                integer("equilibration")};
  s.sizes.has_norm = integer("has_norm") != 0;

  // length of the k-th axis from the end; k = 1 is the last axis
  auto axis = [](const auto& v, size_t k) { return static_cast<int>(v.dimensions()[v.dimensions().size() - k]); };
  auto stride = [&](size_t numbers) { return static_cast<long long>(numbers) / std::max<long long>(b.size, 1); };
  auto argument = [&](size_t i, Input& to, int* first = nullptr, int* second = nullptr) {
    auto v = args.get<ffi::Buffer<ffi::F64>>(i);
    if (!v.has_value()) return void(error = v.error());
    to = {v->typed_data(), stride(v->element_count())};
    if (first) *first = axis(*v, 2);
    if (second) *second = axis(*v, 1);
  };
  constexpr size_t kTolerance = 9;  // has one number per batch element
  if (auto v = args.get<ffi::Buffer<ffi::F64>>(kTolerance); v.has_value()) b.size = v->element_count();
  size_t next = 0;
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
  s.sizes.groups = static_cast<int>(args.size() - next - (s.sizes.has_norm ? 3 : 0) - (has_warm_start ? 3 : 0)) /
                   (has_warm_start ? 3 : 2);
  if (s.sizes.groups > kMaxGroups) return ffi::Unexpected(ffi::Error::InvalidArgument("too many groups of cones"));
  int cones = 2, rows = 0;
  for (int c = 0; c < s.sizes.groups; ++c) {
    argument(next++, b.cone_matrix[c]);
    argument(next++, b.cone_offset[c], &s.sizes.cones[c].count, &s.sizes.cones[c].dimension);
    cones += s.sizes.cones[c].count;
    rows += s.sizes.cones[c].count * s.sizes.cones[c].dimension;
  }
  if (std::max({rows, s.sizes.rows, s.sizes.variables, s.sizes.link_rows}) > kMaxLines)
    return ffi::Unexpected(ffi::Error::InvalidArgument("too many rows at a node"));
  if (cones > kMaxCones) return ffi::Unexpected(ffi::Error::InvalidArgument("too many cones at a node"));
  if (s.sizes.has_norm)
    for (Input* to : {&b.norm_weight, &b.norm_scale, &b.norm_centre}) argument(next++, *to);
  if (has_warm_start) {
    for (Input* to : {&b.warm_z, &b.warm_links, &b.warm_rows}) argument(next++, *to);
    for (int c = 0; c < s.sizes.groups; ++c) argument(next++, b.warm_cones[c]);
  }

  auto result = [&](size_t i, auto tag, auto& to, int* first = nullptr, int* second = nullptr) {
    auto v = rets.get<ffi::Buffer<decltype(tag)::value>>(i);
    if (!v.has_value()) return void(error = v.error());
    using Number = std::remove_pointer_t<decltype(to.data)>;
    to = {reinterpret_cast<Number*>((*v)->untyped_data()), stride((*v)->element_count())};
    if (first) *first = axis(**v, 2);
    if (second) *second = axis(**v, 1);
  };
  std::integral_constant<ffi::DataType, ffi::F64> real;
  size_t out = 0;
  for (Output* to : {&b.z, &b.xi, &b.zeta, &b.y_zero, &b.y_orthant}) result(out++, real, *to);
  result(out++, real, b.y_second, nullptr, &b.width);
  for (Output* to : {&b.s_orthant, &b.s_second, &b.tau, &b.kappa, &b.error, &b.infeasibility, &b.unboundedness})
    result(out++, real, *to);
  result(out++, std::integral_constant<ffi::DataType, ffi::S64>(), b.iterations);
  for (auto* to : {&b.stalled, &b.broken}) result(out++, std::integral_constant<ffi::DataType, ffi::PRED>(), *to);
  for (Output* to : {&b.scales_of_columns, &b.scales_of_links, &b.scales_of_rows}) result(out++, real, *to);
  for (int c = 0; c < s.sizes.groups; ++c) result(out++, real, b.scales_of_cones[c]);
  result(out++, real, b.scale_of_cost);
  if (error.failure()) return ffi::Unexpected(error);
  return s;
}

}  // namespace jaxscp

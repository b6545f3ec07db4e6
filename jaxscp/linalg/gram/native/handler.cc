// XLA FFI handler on a CPU: J' W J and J' v of a batch of locations, in chunks on XLA's threads.

#include "gram.h"
#include "parallel_for.h"

namespace jaxscp {
namespace {

constexpr int64_t kMinOperations = 500'000;  // of a chunk: for fewer, a thread costs more than it saves

Workspace& workspace_of_thread() {
  thread_local Workspace workspace;
  workspace.reset();
  return workspace;
}

ffi::Error gram(ffi::ThreadPool pool, ffi::Span<const int32_t> rank_one, ffi::RemainingArgs args,
                ffi::Result<ffi::Buffer<ffi::F64>> matrix, ffi::Result<ffi::Buffer<ffi::F64>> products) {
  const auto shape_of_products = products->dimensions();
  const int inputs = static_cast<int>(shape_of_products[shape_of_products.size() - 1]);
  const int count = static_cast<int>(shape_of_products[shape_of_products.size() - 2]);
  const int64_t locations = static_cast<int64_t>(matrix->element_count()) / (inputs * inputs);
  std::vector<WeightedRows> parts;
  size_t at = 0;
  for (const int32_t has_rank_one : rank_one) {
    if (at + 3 + has_rank_one > args.size()) return ffi::Error::InvalidArgument("a constraint lacks an array");
    auto next = [&] { return static_cast<const double*>(args.get<ffi::AnyBuffer>(at++)->untyped_data()); };
    const auto shape = args.get<ffi::AnyBuffer>(at)->dimensions();
    auto size = [&](int from_last) { return static_cast<int>(shape[shape.size() - from_last]); };
    WeightedRows part{.points = size(3), .rows = size(2),
                      .jacobian = next(), .weight = next(), .vectors = next(), .rank_one = {}};
    if (has_rank_one) part.rank_one = next();
    parts.push_back(part);
  }
  int64_t operations = 1;  // of a location
  for (const WeightedRows& part : parts) operations += static_cast<int64_t>(part.stacked()) * inputs * inputs;
  const int64_t chunk = (kMinOperations + operations - 1) / operations;
  parallel_for(pool, (locations + chunk - 1) / chunk, [&](int64_t index) {
    std::vector<WeightedRows> at_location = parts;
    Gram sums(at_location, inputs, count, workspace_of_thread());
    for (int64_t location = index * chunk; location < std::min(locations, (index + 1) * chunk); ++location) {
      for (size_t k = 0; k < parts.size(); ++k) {
        const int64_t rows = location * parts[k].all_rows();
        at_location[k].jacobian = parts[k].jacobian + rows * inputs, at_location[k].weight = parts[k].weight + rows;
        at_location[k].vectors = parts[k].vectors + rows * count;
        if (parts[k].rank_one) at_location[k].rank_one = parts[k].rank_one + rows;
      }
      sums.run(matrix->typed_data() + location * inputs * inputs, products->typed_data() + location * count * inputs);
    }
  });
  return ffi::Error::Success();
}

}  // namespace
}  // namespace jaxscp

XLA_FFI_DEFINE_HANDLER_SYMBOL(jaxscp_gram, jaxscp::gram,
                              xla::ffi::Ffi::Bind()
                                  .Ctx<xla::ffi::ThreadPool>()
                                  .Attr<xla::ffi::Span<const int32_t>>("rank_one")
                                  .RemainingArgs()
                                  .Ret<xla::ffi::Buffer<xla::ffi::F64>>()
                                  .Ret<xla::ffi::Buffer<xla::ffi::F64>>());

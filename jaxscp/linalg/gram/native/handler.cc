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

void gram(Call& call) {
  call.expect(call.arguments(), 2);
  const Array matrix = call.result(0), products = call.result(1);
  const int inputs = products.from_last(1), count = products.from_last(2);
  const int64_t locations = matrix.size() / (inputs * inputs);
  double *const to_matrix = matrix.numbers<double>(), *const to_products = products.numbers<double>();
  std::vector<WeightedRows> parts;
  int64_t at = 0;
  for (const int32_t has_rank_one : call.numbers<int32_t>("rank_one")) {
    const Array jacobian = call.argument(at);
    auto next = [&] { return call.argument(at++).numbers<double>(); };
    WeightedRows part{.points = jacobian.from_last(3), .rows = jacobian.from_last(2),
                      .jacobian = next(), .weight = next(), .vectors = next(), .rank_one = {}};
    if (has_rank_one) part.rank_one = next();
    parts.push_back(part);
  }
  int64_t operations = 1;  // of a location
  for (const WeightedRows& part : parts) operations += static_cast<int64_t>(part.stacked()) * inputs * inputs;
  const int64_t chunk = (kMinOperations + operations - 1) / operations;
  parallel_for(call, (locations + chunk - 1) / chunk, [&](int64_t index) {
    std::vector<WeightedRows> at_location = parts;
    Gram sums(at_location, inputs, count, workspace_of_thread());
    for (int64_t location = index * chunk; location < std::min(locations, (index + 1) * chunk); ++location) {
      for (size_t k = 0; k < parts.size(); ++k) {
        const int64_t rows = location * parts[k].all_rows();
        at_location[k].jacobian = parts[k].jacobian + rows * inputs, at_location[k].weight = parts[k].weight + rows;
        at_location[k].vectors = parts[k].vectors + rows * count;
        if (parts[k].rank_one) at_location[k].rank_one = parts[k].rank_one + rows;
      }
      sums.run(to_matrix + location * inputs * inputs, to_products + location * count * inputs);
    }
  });
}

}  // namespace
}  // namespace jaxscp

JAXSCP_HANDLER(jaxscp_gram, jaxscp::gram);

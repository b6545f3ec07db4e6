// XLA FFI handlers on a CPU: factor or solve a batch of problems on XLA's threads.

#include "parallel_for.h"
#include "recursion.h"

namespace jaxscp {
namespace {

// Arguments or results of a call, whose leading axes are the batch.
template <typename Number>
class Arrays {
 public:
  void add(const Array& array, int64_t batch) { each_.push_back({array.numbers<double>(), array.size() / batch}); }
  Number* operator()(int which, int64_t element) const { return each_[which].at + element * each_[which].size; }

 private:
  struct Each {
    Number* at;
    int64_t size;  // of one element
  };
  std::vector<Each> each_;
};

// Sizes of a batch of problems, from hessian, last, flow, initial and final, and the arrays of the call.
struct Problems {
  Sizes sizes;
  int64_t batch;
  Arrays<const double> in;
  Arrays<double> out;

  explicit Problems(const Call& call) {
    auto of = [&](int which, int from_last) { return call.argument(which).from_last(from_last); };
    sizes = {of(2, 3), of(2, 2), of(2, 1), of(1, 1), of(3, 2), of(4, 2)};
    batch = call.argument(1).size() / (static_cast<int64_t>(sizes.stage) * sizes.stage);
    for (int64_t i = 0; i < call.arguments(); ++i) in.add(call.argument(i), batch);
    for (int64_t i = 0; i < call.results(); ++i) out.add(call.result(i), batch);
  }
};

ProblemArrays problem_of(const Arrays<const double>& in, int64_t element) {
  return {in(0, element), in(1, element), in(2, element), in(3, element), in(4, element)};
}

Workspace& workspace_of_thread() {
  thread_local Workspace workspace;
  workspace.reset();
  return workspace;
}

void factor(Call& call) {
  call.expect(5, 4);
  const Problems all(call);
  const auto penalty = call.number<double>("penalty");
  parallel_for(call, all.batch, [&](int64_t element) {
    const auto& out = all.out;
    Elimination(all.sizes, penalty, workspace_of_thread())
        .run(problem_of(all.in, element), {out(0, element), out(1, element), out(2, element), out(3, element)});
  });
}

void solve(Call& call) {
  call.expect(13, 4);
  const Problems all(call);
  const auto penalty = call.number<double>("penalty");
  const auto refinements = static_cast<int>(call.number<int64_t>("refinements"));
  parallel_for(call, all.batch, [&](int64_t element) {
    const auto &in = all.in;
    const auto &out = all.out;
    const FactorArrays<const double> factor{in(5, element), in(6, element), in(7, element), in(8, element)};
    Solution(all.sizes, penalty, problem_of(in, element), factor, workspace_of_thread())
        .run({in(9, element), in(10, element), in(11, element), in(12, element)}, refinements,
             {out(0, element), out(1, element), out(2, element), out(3, element)});
  });
}

}  // namespace
}  // namespace jaxscp

JAXSCP_HANDLER(jaxscp_riccati_factor, jaxscp::factor);
JAXSCP_HANDLER(jaxscp_riccati_solve, jaxscp::solve);

// XLA FFI handlers on a CPU: factor or solve a batch of problems on XLA's threads.

#include "parallel_for.h"
#include "recursion.h"

namespace jaxscp {
namespace {

// Arguments or results of a call, whose leading axes are the batch.
template <typename Number>
class Arrays {
 public:
  template <typename Buffers>
  explicit Arrays(const Buffers& buffers, int64_t batch) {
    for (const ffi::AnyBuffer& buffer : buffers)
      each_.push_back({static_cast<Number*>(buffer.untyped_data()), buffer.element_count() / batch});
  }
  Number* operator()(int which, int64_t element) const { return each_[which].at + element * each_[which].size; }

 private:
  struct Each {
    Number* at;
    int64_t size;  // of one element
  };
  std::vector<Each> each_;
};

std::vector<ffi::AnyBuffer> arguments_of(ffi::RemainingArgs args) {
  std::vector<ffi::AnyBuffer> all;
  for (size_t i = 0; i < args.size(); ++i) all.push_back(*args.get<ffi::AnyBuffer>(i));
  return all;
}
std::vector<ffi::AnyBuffer> results_of(ffi::RemainingRets rets) {
  std::vector<ffi::AnyBuffer> all;
  for (size_t i = 0; i < rets.size(); ++i) all.push_back(**rets.get<ffi::AnyBuffer>(i));
  return all;
}

struct Shape {
  Sizes sizes;
  int64_t batch;
};

// Sizes, from hessian, last, flow, initial and final.
Shape shape(const std::vector<ffi::AnyBuffer>& problem) {
  auto of = [&](int which, int from_last) {
    const auto dimensions = problem[which].dimensions();
    return static_cast<int>(dimensions[dimensions.size() - from_last]);
  };
  const Sizes s{of(2, 3), of(2, 2), of(2, 1), of(1, 1), of(3, 2), of(4, 2)};
  return {s, static_cast<int64_t>(problem[1].element_count()) / (s.stage * s.stage)};
}

ProblemArrays problem_of(const Arrays<const double>& in, int64_t element) {
  return {in(0, element), in(1, element), in(2, element), in(3, element), in(4, element)};
}

Workspace& workspace_of_thread() {
  thread_local Workspace workspace;
  workspace.reset();
  return workspace;
}

ffi::Error factor(ffi::ThreadPool pool, double penalty, ffi::RemainingArgs args, ffi::RemainingRets rets) {
  if (args.size() != 5 || rets.size() != 4) return ffi::Error::InvalidArgument("the problem lacks an array");
  const auto arguments = arguments_of(args);
  const auto [sizes, batch] = shape(arguments);
  const Arrays<const double> in(arguments, batch);
  const Arrays<double> out(results_of(rets), batch);
  parallel_for(pool, batch, [&, sizes = sizes](int64_t element) {
    Elimination(sizes, penalty, workspace_of_thread())
        .run(problem_of(in, element), {out(0, element), out(1, element), out(2, element), out(3, element)});
  });
  return ffi::Error::Success();
}

ffi::Error solve(ffi::ThreadPool pool, double penalty, int64_t refinements, ffi::RemainingArgs args,
                 ffi::RemainingRets rets) {
  if (args.size() != 13 || rets.size() != 4) return ffi::Error::InvalidArgument("the system lacks an array");
  const auto arguments = arguments_of(args);
  const auto [sizes, batch] = shape(arguments);
  const Arrays<const double> in(arguments, batch);
  const Arrays<double> out(results_of(rets), batch);
  parallel_for(pool, batch, [&, sizes = sizes](int64_t element) {
    const FactorArrays<const double> factor{in(5, element), in(6, element), in(7, element), in(8, element)};
    Solution(sizes, penalty, problem_of(in, element), factor, workspace_of_thread())
        .run({in(9, element), in(10, element), in(11, element), in(12, element)}, static_cast<int>(refinements),
             {out(0, element), out(1, element), out(2, element), out(3, element)});
  });
  return ffi::Error::Success();
}

}  // namespace
}  // namespace jaxscp

XLA_FFI_DEFINE_HANDLER_SYMBOL(jaxscp_riccati_factor, jaxscp::factor,
                              xla::ffi::Ffi::Bind()
                                  .Ctx<xla::ffi::ThreadPool>()
                                  .Attr<double>("penalty")
                                  .RemainingArgs()
                                  .RemainingRets());
XLA_FFI_DEFINE_HANDLER_SYMBOL(jaxscp_riccati_solve, jaxscp::solve,
                              xla::ffi::Ffi::Bind()
                                  .Ctx<xla::ffi::ThreadPool>()
                                  .Attr<double>("penalty")
                                  .Attr<int64_t>("refinements")
                                  .RemainingArgs()
                                  .RemainingRets());

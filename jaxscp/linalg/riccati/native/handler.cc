// What XLA calls on a CPU: factors or solves a batch of chains, shared among its threads.

#include "recursion.h"
#include "spread.h"

namespace jaxscp {
namespace {

// The arguments or results of a call, whose leading axes are lanes.
template <typename Number>
class Arrays {
 public:
  template <typename Buffers>
  explicit Arrays(const Buffers& buffers, int64_t lanes) {
    for (const ffi::AnyBuffer& buffer : buffers)
      each_.push_back({static_cast<Number*>(buffer.untyped_data()), buffer.element_count() / lanes});
  }
  Number* operator()(int which, int64_t lane) const { return each_[which].at + lane * each_[which].size; }

 private:
  struct Each {
    Number* at;
    int64_t size;  // of a lane
  };
  std::vector<Each> each_;
};

std::vector<ffi::AnyBuffer> given(ffi::RemainingArgs args) {
  std::vector<ffi::AnyBuffer> all;
  for (size_t i = 0; i < args.size(); ++i) all.push_back(*args.get<ffi::AnyBuffer>(i));
  return all;
}
std::vector<ffi::AnyBuffer> asked(ffi::RemainingRets rets) {
  std::vector<ffi::AnyBuffer> all;
  for (size_t i = 0; i < rets.size(); ++i) all.push_back(**rets.get<ffi::AnyBuffer>(i));
  return all;
}

struct Shape {
  Sizes sizes;
  int64_t lanes;
};

// From hessian, last, flow, initial and final.
Shape shape(const std::vector<ffi::AnyBuffer>& chain) {
  auto of = [&](int which, int from_last) {
    const auto dimensions = chain[which].dimensions();
    return static_cast<int>(dimensions[dimensions.size() - from_last]);
  };
  const Sizes s{of(2, 3), of(2, 2), of(2, 1), of(1, 1), of(3, 2), of(4, 2)};
  return {s, static_cast<int64_t>(chain[1].element_count()) / (s.stage * s.stage)};
}

ChainArrays chain_of(const Arrays<const double>& in, int64_t lane) {
  return {in(0, lane), in(1, lane), in(2, lane), in(3, lane), in(4, lane)};
}

Memory& memory_of_thread() {
  thread_local Memory memory;
  memory.again();
  return memory;
}

ffi::Error factor(ffi::ThreadPool pool, double penalty, ffi::RemainingArgs args, ffi::RemainingRets rets) {
  if (args.size() != 5 || rets.size() != 4) return ffi::Error::InvalidArgument("the chain lacks an array");
  const auto arguments = given(args);
  const auto [sizes, lanes] = shape(arguments);
  const Arrays<const double> in(arguments, lanes);
  const Arrays<double> out(asked(rets), lanes);
  spread(pool, lanes, [&, sizes = sizes](int64_t lane) {
    Elimination(sizes, penalty, memory_of_thread())
        .run(chain_of(in, lane), {out(0, lane), out(1, lane), out(2, lane), out(3, lane)});
  });
  return ffi::Error::Success();
}

ffi::Error solve(ffi::ThreadPool pool, double penalty, int64_t refinements, ffi::RemainingArgs args,
                 ffi::RemainingRets rets) {
  if (args.size() != 13 || rets.size() != 4) return ffi::Error::InvalidArgument("the system lacks an array");
  const auto arguments = given(args);
  const auto [sizes, lanes] = shape(arguments);
  const Arrays<const double> in(arguments, lanes);
  const Arrays<double> out(asked(rets), lanes);
  spread(pool, lanes, [&, sizes = sizes](int64_t lane) {
    const FactorArrays<const double> factor{in(5, lane), in(6, lane), in(7, lane), in(8, lane)};
    Solution(sizes, penalty, chain_of(in, lane), factor, memory_of_thread())
        .run({in(9, lane), in(10, lane), in(11, lane), in(12, lane)}, static_cast<int>(refinements),
             {out(0, lane), out(1, lane), out(2, lane), out(3, lane)});
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

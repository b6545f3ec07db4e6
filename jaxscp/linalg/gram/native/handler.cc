// What XLA calls on a CPU: its threads share the places, so many at a time that there is something to do.

#include "normal.h"
#include "spread.h"

namespace jaxscp {
namespace {

constexpr int64_t kEnough = 500'000;  // products: for fewer, another thread is not worth calling

Memory& memory_of_thread() {
  thread_local Memory memory;
  memory.again();
  return memory;
}

ffi::Error normal(ffi::ThreadPool pool, ffi::Span<const int32_t> coupled, ffi::RemainingArgs args,
                  ffi::Result<ffi::Buffer<ffi::F64>> matrix, ffi::Result<ffi::Buffer<ffi::F64>> sides) {
  const auto of_sides = sides->dimensions();
  const int inputs = static_cast<int>(of_sides[of_sides.size() - 1]);
  const int count = static_cast<int>(of_sides[of_sides.size() - 2]);
  const int64_t places = static_cast<int64_t>(matrix->element_count()) / (inputs * inputs);
  std::vector<Part> parts;
  size_t at = 0;
  for (const int32_t couples : coupled) {
    if (at + 3 + couples > args.size()) return ffi::Error::InvalidArgument("a constraint lacks an array");
    auto next = [&] { return static_cast<const double*>(args.get<ffi::AnyBuffer>(at++)->untyped_data()); };
    const auto shape = args.get<ffi::AnyBuffer>(at)->dimensions();
    auto size = [&](int from_last) { return static_cast<int>(shape[shape.size() - from_last]); };
    Part part{.points = size(3), .rows = size(2), .jacobian = next(), .weight = next(), .sides = next(), .along = {}};
    if (couples) part.along = next();
    parts.push_back(part);
  }
  int64_t products = 1;  // of a place
  for (const Part& part : parts) products += static_cast<int64_t>(part.stacked()) * inputs * inputs;
  const int64_t together = (kEnough + products - 1) / products;
  spread(pool, (places + together - 1) / together, [&](int64_t some) {
    std::vector<Part> here = parts;
    Normal sums(here, inputs, count, memory_of_thread());
    for (int64_t place = some * together; place < std::min(places, (some + 1) * together); ++place) {
      for (size_t k = 0; k < parts.size(); ++k) {
        const int64_t rows = place * parts[k].all_rows();
        here[k].jacobian = parts[k].jacobian + rows * inputs, here[k].weight = parts[k].weight + rows;
        here[k].sides = parts[k].sides + rows * count;
        if (parts[k].along) here[k].along = parts[k].along + rows;
      }
      sums.run(matrix->typed_data() + place * inputs * inputs, sides->typed_data() + place * count * inputs);
    }
  });
  return ffi::Error::Success();
}

}  // namespace
}  // namespace jaxscp

XLA_FFI_DEFINE_HANDLER_SYMBOL(jaxscp_normal, jaxscp::normal,
                              xla::ffi::Ffi::Bind()
                                  .Ctx<xla::ffi::ThreadPool>()
                                  .Attr<xla::ffi::Span<const int32_t>>("coupled")
                                  .RemainingArgs()
                                  .Ret<xla::ffi::Buffer<xla::ffi::F64>>()
                                  .Ret<xla::ffi::Buffer<xla::ffi::F64>>());

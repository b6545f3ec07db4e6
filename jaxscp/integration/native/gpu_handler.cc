// What XLA calls on an NVIDIA GPU: launches a kernel that was written from a tape, which the call carries with it. Its
// arguments are what a flight has several of, intervals say, what is known of the flight, and two results.

#include <algorithm>
#include <cstdint>

#include "driver.h"

namespace jaxscp {
namespace {

struct Loaded {
  CUfunction kernel = nullptr;
};

// ``groups`` threads work on one of the several; ``threads`` are a block.
ffi::Error sweep(CUstream stream, ffi::Buffer<ffi::F64> w, ffi::Buffer<ffi::F64> known,
                 ffi::ResultBuffer<ffi::F64> first, ffi::ResultBuffer<ffi::F64> second,
                 ffi::Span<const uint8_t> image, std::string_view name, int64_t groups, int64_t threads) {
  const auto shape = w.dimensions();
  if (shape.size() < 2) return ffi::Error::InvalidArgument("a kernel made of a tape lacks an axis");
  long long of_one = shape[shape.size() - 2];  // flight
  long long count = static_cast<long long>(w.element_count()) / std::max<long long>(shape.back(), 1);
  const Driver& cuda = Driver::get();
  if (!cuda.found) return ffi::Error::Internal("the CUDA driver was not found, or is too old");

  Failure failure{"a kernel made of a tape"};
  const Current current(cuda, stream, failure);
  if (failure.code != 0) return failure.error();
  static Kept<Loaded> kept;
  const Loaded loaded = kept.get({current.context(), std::string(name)}, failure, [&] {
    Loaded found;
    CUmodule module = nullptr;
    failure(cuda.cuModuleLoadData(&module, image.begin()), "loading it") &&
        failure(cuda.cuModuleGetFunction(&found.kernel, module, "jaxscp_kernel"), "finding it");
    return found;
  });
  const long long blocks = (count * groups + threads - 1) / threads;
  if (blocks > INT32_MAX) return ffi::Error::InvalidArgument("a kernel has more to do than a GPU can be given");
  if (failure.code == 0 && blocks > 0) {
    const double *from = w.typed_data(), *by = known.typed_data();
    double *to = first->typed_data(), *also_to = second->typed_data();
    void* arguments[] = {&from, &by, &to, &also_to, &count, &of_one};
    failure(cuda.cuLaunchKernel(loaded.kernel, static_cast<unsigned>(blocks), 1, 1, static_cast<unsigned>(threads), 1,
                                1, 0, stream, arguments, nullptr),
            "launching it");
  }
  return failure.error();
}

}  // namespace
}  // namespace jaxscp

XLA_FFI_DEFINE_HANDLER_SYMBOL(jaxscp_sweep_on_gpu, jaxscp::sweep,
                              xla::ffi::Ffi::Bind()
                                  .Ctx<xla::ffi::PlatformStream<CUstream>>()
                                  .Arg<xla::ffi::Buffer<xla::ffi::F64>>()
                                  .Arg<xla::ffi::Buffer<xla::ffi::F64>>()
                                  .Ret<xla::ffi::Buffer<xla::ffi::F64>>()
                                  .Ret<xla::ffi::Buffer<xla::ffi::F64>>()
                                  .Attr<xla::ffi::Span<const uint8_t>>("image")
                                  .Attr<std::string_view>("name")
                                  .Attr<int64_t>("groups")
                                  .Attr<int64_t>("threads"));

// XLA FFI handler on an NVIDIA GPU: launches a kernel that was written from a tape; its cubin is an attribute. The
// arguments are a batch of inputs, hoisted constants shared by the batch, and two results.

#include <algorithm>
#include <cstdint>

#include "driver.h"

namespace jaxscp {
namespace {

struct LoadedKernel {
  CUfunction function = nullptr;
};

// ``group_size`` threads work on one element of the batch; a block has ``threads`` threads.
ffi::Error integrate(CUstream stream, ffi::Buffer<ffi::F64> w, ffi::Buffer<ffi::F64> hoisted,
                     ffi::ResultBuffer<ffi::F64> first, ffi::ResultBuffer<ffi::F64> second,
                     ffi::Span<const uint8_t> cubin, std::string_view name, int64_t group_size, int64_t threads) {
  const auto shape = w.dimensions();
  if (shape.size() < 2) return ffi::Error::InvalidArgument("a kernel made of a tape lacks an axis");
  long long batch = shape[shape.size() - 2];
  long long count = static_cast<long long>(w.element_count()) / std::max<long long>(shape.back(), 1);
  const Driver& cuda = Driver::get();
  if (!cuda.found) return ffi::Error::Internal("the CUDA driver was not found, or is too old");

  Failure failure{"a kernel made of a tape"};
  const Current current(cuda, stream, failure);
  if (failure.code != 0) return failure.error();
  static KernelCache<LoadedKernel> cache;
  const LoadedKernel kernel = cache.get({current.context(), std::string(name)}, failure, [&] {
    LoadedKernel found;
    CUmodule module = nullptr;
    failure(cuda.cuModuleLoadData(&module, cubin.begin()), "loading it") &&
        failure(cuda.cuModuleGetFunction(&found.function, module, "jaxscp_kernel"), "finding it");
    return found;
  });
  const long long blocks = (count * group_size + threads - 1) / threads;
  if (blocks > INT32_MAX) return ffi::Error::InvalidArgument("a kernel has more blocks than a GPU can launch");
  if (failure.code == 0 && blocks > 0) {
    const double *inputs = w.typed_data(), *constants = hoisted.typed_data();
    double *to_first = first->typed_data(), *to_second = second->typed_data();
    void* arguments[] = {&inputs, &constants, &to_first, &to_second, &count, &batch};
    failure(cuda.cuLaunchKernel(kernel.function, static_cast<unsigned>(blocks), 1, 1, static_cast<unsigned>(threads), 1,
                                1, 0, stream, arguments, nullptr),
            "launching it");
  }
  return failure.error();
}

}  // namespace
}  // namespace jaxscp

XLA_FFI_DEFINE_HANDLER_SYMBOL(jaxscp_integrate_on_gpu, jaxscp::integrate,
                              xla::ffi::Ffi::Bind()
                                  .Ctx<xla::ffi::PlatformStream<CUstream>>()
                                  .Arg<xla::ffi::Buffer<xla::ffi::F64>>()
                                  .Arg<xla::ffi::Buffer<xla::ffi::F64>>()
                                  .Ret<xla::ffi::Buffer<xla::ffi::F64>>()
                                  .Ret<xla::ffi::Buffer<xla::ffi::F64>>()
                                  .Attr<xla::ffi::Span<const uint8_t>>("cubin")
                                  .Attr<std::string_view>("name")
                                  .Attr<int64_t>("group_size")
                                  .Attr<int64_t>("threads"));

// Launch of a kernel whose cubin is an attribute of an XLA FFI call, for the ``gpu_handler.cc`` of a library.
//
// The kernel is named ``jaxscp_kernel``. Its parameters are the addresses of all arguments, then of all results, then
// the number of elements of the batch, and the number of elements along the batch's last axis.
#pragma once

#include <algorithm>
#include <cstdint>
#include <vector>

#include "driver.h"

namespace jaxscp {

struct LoadedKernel {
  CUfunction function = nullptr;
};

inline LoadedKernel load_kernel(const Driver& cuda, ffi::Span<const uint8_t> cubin, int64_t shared, Failure& failure) {
  constexpr int kSharedMost = 8;  // CU_FUNC_ATTRIBUTE_MAX_DYNAMIC_SHARED_SIZE_BYTES
  LoadedKernel found;
  CUmodule module = nullptr;
  failure(cuda.cuModuleLoadData(&module, cubin.begin()), "loading it") &&
      failure(cuda.cuModuleGetFunction(&found.function, module, "jaxscp_kernel"), "finding it") &&
      failure(cuda.cuFuncSetAttribute(found.function, kSharedMost, static_cast<int>(shared)), "sharing memory");
  return found;
}

// ``axes``: axes of one element in the first argument. ``group_size`` threads work on an element; a block has
// ``threads`` threads and ``shared`` bytes of shared memory.
inline ffi::Error launch(CUstream stream, ffi::RemainingArgs args, ffi::RemainingRets rets,
                         ffi::Span<const uint8_t> cubin, std::string_view name, int64_t axes, int64_t group_size,
                         int64_t threads, int64_t shared) {
  std::vector<void*> addresses;
  for (size_t i = 0; i < args.size(); ++i) addresses.push_back(args.get<ffi::AnyBuffer>(i)->untyped_data());
  for (size_t i = 0; i < rets.size(); ++i) addresses.push_back((*rets.get<ffi::AnyBuffer>(i))->untyped_data());
  const auto shape = args.get<ffi::AnyBuffer>(0)->dimensions();
  const int64_t batch_axes = static_cast<int64_t>(shape.size()) - axes;
  if (batch_axes < 0) return ffi::Error::InvalidArgument("a kernel's first argument lacks an axis");
  long long count = 1, last = batch_axes > 0 ? shape[batch_axes - 1] : 1;
  for (int64_t i = 0; i < batch_axes; ++i) count *= shape[i];
  const Driver& cuda = Driver::get();
  if (!cuda.found) return ffi::Error::Internal("the CUDA driver was not found, or is too old");

  Failure failure{"a kernel compiled at run time"};
  const Current current(cuda, stream, failure);
  if (failure.code != 0) return failure.error();
  static KernelCache<LoadedKernel> cache;
  const LoadedKernel kernel = cache.get({current.context(), std::string(name)}, failure,
                                        [&] { return load_kernel(cuda, cubin, shared, failure); });
  const long long blocks = (count * group_size + threads - 1) / threads;
  if (blocks > INT32_MAX) return ffi::Error::InvalidArgument("a kernel has more blocks than a GPU can launch");
  if (failure.code == 0 && blocks > 0) {
    std::vector<void*> parameters;
    for (void*& address : addresses) parameters.push_back(&address);
    parameters.push_back(&count), parameters.push_back(&last);
    failure(cuda.cuLaunchKernel(kernel.function, static_cast<unsigned>(blocks), 1, 1, static_cast<unsigned>(threads), 1,
                                1, static_cast<unsigned>(shared), stream, parameters.data(), nullptr),
            "launching it");
  }
  return failure.error();
}

// The FFI binding of ``launch``.
inline auto launch_binding() {
  return ffi::Ffi::Bind()
      .Ctx<ffi::PlatformStream<CUstream>>()
      .RemainingArgs()
      .RemainingRets()
      .Attr<ffi::Span<const uint8_t>>("cubin")
      .Attr<std::string_view>("name")
      .Attr<int64_t>("axes")
      .Attr<int64_t>("group_size")
      .Attr<int64_t>("threads")
      .Attr<int64_t>("shared");
}

}  // namespace jaxscp

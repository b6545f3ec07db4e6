// XLA FFI handler on a CPU in place of a GPU's: runs a kernel written from a tape. In place of a cubin, the call carries
// the path of a library that was compiled with ``threads_on_a_cpu.h`` or ``warps_on_a_cpu.h``.

#include <dlfcn.h>

#include <string>

#include "xla/ffi/api/ffi.h"

namespace ffi = xla::ffi;

using Run = void(const double*, const double*, double*, double*, long long, long long, long long, long long);

static ffi::Error run_kernel(ffi::Buffer<ffi::F64> w, ffi::Buffer<ffi::F64> hoisted,
                             ffi::ResultBuffer<ffi::F64> first, ffi::ResultBuffer<ffi::F64> second,
                             ffi::Span<const uint8_t> cubin, std::string_view, int64_t group_size, int64_t threads) {
  void* library = dlopen(std::string(cubin.begin(), cubin.end()).c_str(), RTLD_NOW);
  auto* run = reinterpret_cast<Run*>(library ? dlsym(library, "run") : nullptr);
  if (run == nullptr) return ffi::Error::Internal(dlerror());
  const auto shape = w.dimensions();
  const long long batch = shape[shape.size() - 2], count = w.element_count() / shape.back();
  run(w.typed_data(), hoisted.typed_data(), first->typed_data(), second->typed_data(), count, batch, group_size,
      threads);
  return ffi::Error::Success();
}

XLA_FFI_DEFINE_HANDLER_SYMBOL(jaxscp_integrate_on_gpu, run_kernel,
                              ffi::Ffi::Bind()
                                  .Arg<ffi::Buffer<ffi::F64>>()
                                  .Arg<ffi::Buffer<ffi::F64>>()
                                  .Ret<ffi::Buffer<ffi::F64>>()
                                  .Ret<ffi::Buffer<ffi::F64>>()
                                  .Attr<ffi::Span<const uint8_t>>("cubin")
                                  .Attr<std::string_view>("name")
                                  .Attr<int64_t>("group_size")
                                  .Attr<int64_t>("threads"));

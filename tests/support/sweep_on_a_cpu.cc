// What XLA calls on a CPU in place of a GPU: the kernel of the pass through intervals, which the call names as the file
// of a library made with ``threads_on_a_cpu.h``.

#include <dlfcn.h>

#include <string>

#include "xla/ffi/api/ffi.h"

namespace ffi = xla::ffi;

using Run = void(const double*, const double*, double*, double*, long long, long long, long long, long long);

static ffi::Error sweep(ffi::Buffer<ffi::F64> w, ffi::Buffer<ffi::F64> known, ffi::ResultBuffer<ffi::F64> outcomes,
                        ffi::ResultBuffer<ffi::F64> jacobian, ffi::Span<const uint8_t> image, std::string_view,
                        int64_t groups, int64_t threads) {
  void* library = dlopen(std::string(image.begin(), image.end()).c_str(), RTLD_NOW);
  auto* run = reinterpret_cast<Run*>(library ? dlsym(library, "run") : nullptr);
  if (run == nullptr) return ffi::Error::Internal(dlerror());
  const auto shape = w.dimensions();
  const long long intervals = shape[shape.size() - 2], count = w.element_count() / shape.back();
  run(w.typed_data(), known.typed_data(), outcomes->typed_data(), jacobian->typed_data(), count, intervals, groups,
      threads);
  return ffi::Error::Success();
}

XLA_FFI_DEFINE_HANDLER_SYMBOL(jaxscp_sweep_on_gpu, sweep,
                              ffi::Ffi::Bind()
                                  .Arg<ffi::Buffer<ffi::F64>>()
                                  .Arg<ffi::Buffer<ffi::F64>>()
                                  .Ret<ffi::Buffer<ffi::F64>>()
                                  .Ret<ffi::Buffer<ffi::F64>>()
                                  .Attr<ffi::Span<const uint8_t>>("image")
                                  .Attr<std::string_view>("name")
                                  .Attr<int64_t>("groups")
                                  .Attr<int64_t>("threads"));

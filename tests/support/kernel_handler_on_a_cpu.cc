// XLA FFI handler on a CPU in place of a GPU's: runs a kernel. In place of a cubin, the call carries the path of a
// library that was compiled with ``threads_on_a_cpu.h`` or ``warps_on_a_cpu.h``.

#include <dlfcn.h>

#include <string>
#include <vector>

#include "xla/ffi/api/ffi.h"

namespace ffi = xla::ffi;

using Run = void(void** parameters, long long blocks, long long threads);

static ffi::Error run_kernel(ffi::RemainingArgs args, ffi::RemainingRets rets, ffi::Span<const uint8_t> cubin,
                             std::string_view, int64_t axes, int64_t group_size, int64_t threads, int64_t) {
  void* library = dlopen(std::string(cubin.begin(), cubin.end()).c_str(), RTLD_NOW);
  auto* run = reinterpret_cast<Run*>(library ? dlsym(library, "run") : nullptr);
  if (run == nullptr) return ffi::Error::Internal(dlerror());
  std::vector<void*> addresses, parameters;
  for (size_t i = 0; i < args.size(); ++i) addresses.push_back(args.get<ffi::AnyBuffer>(i)->untyped_data());
  for (size_t i = 0; i < rets.size(); ++i) addresses.push_back((*rets.get<ffi::AnyBuffer>(i))->untyped_data());
  const auto shape = args.get<ffi::AnyBuffer>(0)->dimensions();
  const int64_t batch_axes = shape.size() - axes;
  long long count = 1, last = batch_axes > 0 ? shape[batch_axes - 1] : 1;
  for (int64_t i = 0; i < batch_axes; ++i) count *= shape[i];
  for (void*& address : addresses) parameters.push_back(&address);
  parameters.push_back(&count), parameters.push_back(&last);
  run(parameters.data(), (count * group_size + threads - 1) / threads, threads);
  return ffi::Error::Success();
}

XLA_FFI_DEFINE_HANDLER_SYMBOL(jaxscp_run_kernel, run_kernel,
                              ffi::Ffi::Bind()
                                  .RemainingArgs()
                                  .RemainingRets()
                                  .Attr<ffi::Span<const uint8_t>>("cubin")
                                  .Attr<std::string_view>("name")
                                  .Attr<int64_t>("axes")
                                  .Attr<int64_t>("group_size")
                                  .Attr<int64_t>("threads")
                                  .Attr<int64_t>("shared"));

// Launch of a kernel whose cubin is an attribute of an XLA FFI call, for the ``gpu_handler.cc`` of a library.
//
// The kernel is named ``jaxscp_kernel``. Its parameters are the addresses of all arguments, then of all results, then
// the number of elements of the batch, and the number of elements along the batch's last axis.
#pragma once

#include <cstdint>
#include <vector>

#include "driver.h"

namespace jaxscp {

struct LoadedKernel {
  CUfunction function = nullptr;
};

inline LoadedKernel load_kernel(const Driver& cuda, const void* cubin, int64_t shared, Failure& failure) {
  constexpr int kSharedMost = 8;  // CU_FUNC_ATTRIBUTE_MAX_DYNAMIC_SHARED_SIZE_BYTES
  LoadedKernel found;
  CUmodule module = nullptr;
  failure(cuda.cuModuleLoadData(&module, cubin), "loading it") &&
      failure(cuda.cuModuleGetFunction(&found.function, module, "jaxscp_kernel"), "finding it") &&
      failure(cuda.cuFuncSetAttribute(found.function, kSharedMost, static_cast<int>(shared)), "sharing memory");
  return found;
}

// Parameters of a kernel and its number of blocks. Attributes of the call: ``axes`` of one element in the first
// argument. ``group_size`` threads work on an element; a block has ``threads`` threads.
struct Work {
  std::vector<void*> addresses;
  long long count = 1, last = 1, blocks = 0;

  explicit Work(const Call& call) {
    for (int64_t i = 0; i < call.arguments(); ++i) addresses.push_back(call.argument(i).address());
    for (int64_t i = 0; i < call.results(); ++i) addresses.push_back(call.result(i).address());
    const Array first = call.argument(0);
    const int64_t batch_axes = first.rank() - call.number<int64_t>("axes");
    if (batch_axes < 0) throw invalid("a kernel's first argument lacks an axis");
    for (int64_t axis = 0; axis < batch_axes; ++axis) count *= last = first.length(axis);
    const auto threads = call.number<int64_t>("threads");
    blocks = (count * call.number<int64_t>("group_size") + threads - 1) / threads;
    if (blocks > INT32_MAX) throw invalid("a kernel has more blocks than a GPU can launch");
  }
  // Addresses of all parameters, for as long as this lives.
  std::vector<void*> parameters() {
    std::vector<void*> all;
    for (void*& address : addresses) all.push_back(&address);
    all.push_back(&count), all.push_back(&last);
    return all;
  }
};

// A block has ``shared`` bytes of shared memory, an attribute of the call.
inline void launch(Call& call) {
  Work work(call);
  const auto threads = call.number<int64_t>("threads"), shared = call.number<int64_t>("shared");
  const Driver& cuda = Driver::get();
  const auto stream = static_cast<CUstream>(call.stream());
  Failure failure{"a kernel compiled at run time"};
  const Current current(cuda, stream, failure);
  failure.raise();
  static KernelCache<LoadedKernel> cache;
  const LoadedKernel kernel = cache.get({current.context(), std::string(call.text("name"))}, failure, [&] {
    return load_kernel(cuda, call.numbers<uint8_t>("cubin").data(), shared, failure);
  });
  if (failure.code == 0 && work.blocks > 0)
    failure(cuda.cuLaunchKernel(kernel.function, static_cast<unsigned>(work.blocks), 1, 1,
                                static_cast<unsigned>(threads), 1, 1, static_cast<unsigned>(shared), stream,
                                work.parameters().data(), nullptr),
            "launching it");
  failure.raise();
}

}  // namespace jaxscp

// What XLA calls on an NVIDIA GPU: launches the kernel that ``gpu.py`` compiled, which the call carries with it.

#include "buffers.h"
#include "driver.h"

namespace jaxscp {
namespace {

constexpr int kMultiprocessors = 16;  // CU_DEVICE_ATTRIBUTE_MULTIPROCESSOR_COUNT
constexpr int kSharedMost = 8;        // CU_FUNC_ATTRIBUTE_MAX_DYNAMIC_SHARED_SIZE_BYTES
constexpr int kOutOfMemory = 2;       // CUDA_ERROR_OUT_OF_MEMORY

// A kernel in a GPU's memory.
struct Loaded {
  CUfunction solve = nullptr;
  long long room = 0;  // numbers that a program and its solver take
  long long version = 0, batch = 0;  // as ``jaxscp_room`` says
  long long shared = 0, shared_alone = 0;  // bytes of a block; none of one alone where a multiprocessor has not so many
  int multiprocessors = 0;
  long long grid = 1ll << 30;  // at most: that there was memory for before
};

Loaded load(const Driver& cuda, ffi::Span<const uint8_t> image, CUstream stream, void* scratch, Failure& failure) {
  Loaded loaded;
  CUmodule module = nullptr;
  CUfunction room = nullptr;
  int device = 0;
  auto number = reinterpret_cast<unsigned long long>(scratch);
  void* arguments[] = {&scratch};
  long long said[5] = {};
  failure(cuda.cuModuleLoadData(&module, image.begin()), "loading it") &&
      failure(cuda.cuModuleGetFunction(&loaded.solve, module, "jaxscp_solve"), "finding it") &&
      failure(cuda.cuModuleGetFunction(&room, module, "jaxscp_room"), "finding it") &&
      failure(cuda.cuCtxGetDevice(&device), "finding the device") &&
      failure(cuda.cuDeviceGetAttribute(&loaded.multiprocessors, kMultiprocessors, device), "asking the device") &&
      failure(cuda.cuLaunchKernel(room, 1, 1, 1, 1, 1, 1, 0, stream, arguments, nullptr), "launching it") &&
      failure(cuda.cuMemcpyDtoHAsync_v2(said, number, sizeof(said), stream), "asking for its room") &&
      failure(cuda.cuStreamSynchronize(stream), "asking for its room");
  loaded.room = said[0], loaded.version = said[1], loaded.batch = said[2];
  loaded.shared = said[3], loaded.shared_alone = said[4];
  if (failure.code != 0 || loaded.version != kVersion) return loaded;
  auto share = [&](long long bytes) {
    return cuda.cuFuncSetAttribute(loaded.solve, kSharedMost, static_cast<int>(bytes));
  };
  if (share(loaded.shared_alone) != 0) loaded.shared_alone = 0, failure(share(loaded.shared), "sharing memory");
  return loaded;
}

// ``blocks``: how many a multiprocessor is to hold at once, of ``threads`` each; ``alone``: threads of one that has a
// multiprocessor to itself, as there are so few.
ffi::Error solve(CUstream stream, ffi::ScratchAllocator scratch, ffi::RemainingArgs args, ffi::RemainingRets rets,
                 ffi::Dictionary attrs) {
  auto found = shaped(args, rets, attrs);
  if (!found.has_value()) return found.error();
  auto image = attrs.get<ffi::Span<const uint8_t>>("cubin");
  auto name = attrs.get<std::string_view>("name");
  auto blocks = attrs.get<int64_t>("blocks"), threads = attrs.get<int64_t>("threads");
  auto alone = attrs.get<int64_t>("alone");
  if (!image.has_value() || !name.has_value() || !blocks.has_value() || !threads.has_value() || !alone.has_value())
    return ffi::Error::InvalidArgument("the interior point's kernel is not part of the call");
  const Driver& cuda = Driver::get();
  if (!cuda.found) return ffi::Error::Internal("the CUDA driver was not found, or is too old");

  Failure failure{"the interior point's kernel"};
  const Current current(cuda, stream, failure);
  if (failure.code != 0) return failure.error();
  constexpr size_t kCounter = 256;   // bytes, so that what follows is aligned
  constexpr size_t kAlignment = 16;  // XLA promises no more, and gives 256
  static KernelCache<Loaded> kept;
  const auto key = std::make_pair(current.context(), std::string(*name));
  const Loaded loaded = kept.get(key, failure, [&] {
    auto number = scratch.Allocate(kCounter, kAlignment);
    if (number) return load(cuda, *image, stream, *number, failure);
    failure(kOutOfMemory, "finding memory for it");
    return Loaded();
  });
  if (failure.code == 0 && (loaded.version != kVersion || loaded.batch != sizeof(Batch)))
    return ffi::Error::Internal(
        "the interior point's kernel is of another version of jaxscp: install that again, or export the planner again");
  if (failure.code == 0 && found->batch.lanes > 0) {
    const bool few = found->batch.lanes <= loaded.multiprocessors && loaded.shared_alone > 0;
    const long long together = few ? *alone : *threads, shared = few ? loaded.shared_alone : loaded.shared;
    long long grid = std::min<long long>({found->batch.lanes, *blocks * loaded.multiprocessors, loaded.grid});
    auto find = [&] { return scratch.Allocate(kCounter + grid * loaded.room * sizeof(double), kAlignment); };
    auto memory = find();
    bool enough = memory.has_value();
    for (; !memory && grid > 1; memory = find()) grid /= 2;  // with little memory, fewer programs at once
    // XLA waits for memory for seconds before it says so: not again
    if (!enough) kept.change(key, [&](Loaded& it) { it.grid = grid; });
    if (!memory) {
      failure(kOutOfMemory, "finding memory for it");
    } else {
      void *taken = *memory, *room = static_cast<char*>(taken) + kCounter;
      long long numbers = loaded.room;
      void* arguments[] = {&found->batch, &room, &numbers, &taken};
      failure(cuda.cuMemsetD8Async(reinterpret_cast<unsigned long long>(taken), 0, kCounter, stream), "starting it") &&
          failure(cuda.cuLaunchKernel(loaded.solve, static_cast<unsigned>(grid), 1, 1, static_cast<unsigned>(together),
                                      1, 1, static_cast<unsigned>(shared), stream, arguments, nullptr),
                  "launching it");
    }
  }
  return failure.error();
}

}  // namespace
}  // namespace jaxscp

XLA_FFI_DEFINE_HANDLER_SYMBOL(
    jaxscp_interior_point_on_gpu, jaxscp::solve,
    xla::ffi::Ffi::Bind()
        .Ctx<xla::ffi::PlatformStream<CUstream>>()
        .Ctx<xla::ffi::ScratchAllocator>()
        .RemainingArgs()
        .RemainingRets()
        .Attrs());

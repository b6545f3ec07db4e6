// XLA's handler on an NVIDIA GPU: launches the kernel that ``gpu.py`` compiled, which is an attribute of the call.

#include "buffers.h"
#include "driver.h"

namespace jaxscp {
namespace {

constexpr int kMultiprocessors = 16;  // CU_DEVICE_ATTRIBUTE_MULTIPROCESSOR_COUNT
constexpr int kSharedMost = 8;        // CU_FUNC_ATTRIBUTE_MAX_DYNAMIC_SHARED_SIZE_BYTES
constexpr int kOutOfMemory = 2;       // CUDA_ERROR_OUT_OF_MEMORY

// A kernel loaded on a GPU.
struct Kernel {
  CUfunction solve = nullptr;
  long long workspace = 0;  // numbers of a program and its solver
  long long version = 0, batch = 0;  // as reported by ``jaxscp_workspace``
  long long shared = 0, shared_alone = 0;  // bytes per block; zero if a multiprocessor has too few for a block alone
  int multiprocessors = 0;
  long long grid = 1ll << 30;  // largest grid that memory was available for
};

Kernel load(const Driver& cuda, const void* cubin, CUstream stream, void* scratch, Failure& failure) {
  Kernel kernel;
  CUmodule module = nullptr;
  CUfunction workspace = nullptr;
  int device = 0;
  auto number = reinterpret_cast<unsigned long long>(scratch);
  void* arguments[] = {&scratch};
  long long sizes[5] = {};
  failure(cuda.cuModuleLoadData(&module, cubin), "loading it") &&
      failure(cuda.cuModuleGetFunction(&kernel.solve, module, "jaxscp_solve"), "finding it") &&
      failure(cuda.cuModuleGetFunction(&workspace, module, "jaxscp_workspace"), "finding it") &&
      failure(cuda.cuCtxGetDevice(&device), "finding the device") &&
      failure(cuda.cuDeviceGetAttribute(&kernel.multiprocessors, kMultiprocessors, device), "asking the device") &&
      failure(cuda.cuLaunchKernel(workspace, 1, 1, 1, 1, 1, 1, 0, stream, arguments, nullptr), "launching it") &&
      failure(cuda.cuMemcpyDtoHAsync_v2(sizes, number, sizeof(sizes), stream), "asking for its sizes") &&
      failure(cuda.cuStreamSynchronize(stream), "asking for its sizes");
  kernel.workspace = sizes[0], kernel.version = sizes[1], kernel.batch = sizes[2];
  kernel.shared = sizes[3], kernel.shared_alone = sizes[4];
  if (failure.code != 0 || kernel.version != kVersion) return kernel;
  auto set_shared_memory = [&](long long bytes) {
    return cuda.cuFuncSetAttribute(kernel.solve, kSharedMost, static_cast<int>(bytes));
  };
  if (set_shared_memory(kernel.shared_alone) != 0)
    kernel.shared_alone = 0, failure(set_shared_memory(kernel.shared), "sharing memory");
  return kernel;
}

// Attributes of the call: ``blocks`` per multiprocessor, with ``threads`` threads each. ``alone``: threads of a block
// that is alone on its multiprocessor, in small batches.
void solve(Call& call) {
  SizedBatch found = sized_batch(call);
  const auto blocks = call.number<int64_t>("blocks"), threads = call.number<int64_t>("threads");
  const auto alone = call.number<int64_t>("alone");
  const Driver& cuda = Driver::get();
  const auto stream = static_cast<CUstream>(call.stream());
  Failure failure{"the interior point's kernel"};
  const Current current(cuda, stream, failure);
  failure.raise();
  constexpr size_t kCounter = 256;   // bytes, so that the workspace is aligned
  constexpr size_t kAlignment = 16;  // XLA guarantees 16 and gives 256
  static KernelCache<Kernel> kernels;
  const auto key = std::make_pair(current.context(), std::string(call.text("name")));
  const Kernel kernel = kernels.get(key, failure, [&] {
    void* number = call.allocate(kCounter, kAlignment);
    if (number) return load(cuda, call.numbers<uint8_t>("cubin").data(), stream, number, failure);
    failure(kOutOfMemory, "finding memory for it");
    return Kernel();
  });
  if (failure.code == 0 && (kernel.version != kVersion || kernel.batch != sizeof(Batch)))
    throw internal(
        "the interior point's kernel is of another version of jaxscp: install that again, or export the planner again");
  if (failure.code == 0 && found.batch.size > 0) {
    const bool few = found.batch.size <= kernel.multiprocessors && kernel.shared_alone > 0;
    const long long block = few ? alone : threads, shared = few ? kernel.shared_alone : kernel.shared;
    long long grid = std::min<long long>({found.batch.size, blocks * kernel.multiprocessors, kernel.grid});
    auto find = [&] { return call.allocate(kCounter + grid * kernel.workspace * sizeof(double), kAlignment); };
    void* memory = find();
    const bool enough = memory != nullptr;
    for (; !memory && grid > 1; memory = find()) grid /= 2;  // fewer programs at once if memory is short
    // XLA waits several seconds before it reports a lack of memory; remembered to wait only once.
    if (!enough) kernels.change(key, [&](Kernel& it) { it.grid = grid; });
    if (!memory) {
      failure(kOutOfMemory, "finding memory for it");
    } else {
      void *counter = memory, *workspace = static_cast<char*>(counter) + kCounter;
      long long numbers = kernel.workspace;
      void* arguments[] = {&found.batch, &workspace, &numbers, &counter};
      const auto address = reinterpret_cast<unsigned long long>(counter);
      failure(cuda.cuMemsetD8Async(address, 0, kCounter, stream), "starting it") &&
          failure(cuda.cuLaunchKernel(kernel.solve, static_cast<unsigned>(grid), 1, 1, static_cast<unsigned>(block),
                                      1, 1, static_cast<unsigned>(shared), stream, arguments, nullptr),
                  "launching it");
    }
  }
  failure.raise();
}

}  // namespace
}  // namespace jaxscp

JAXSCP_HANDLER(jaxscp_interior_point_on_gpu, jaxscp::solve);

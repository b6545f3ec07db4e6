// What XLA calls on an NVIDIA GPU: launches the kernel that ``gpu.py`` compiled, which the call carries with it.
//
// The driver is found when it is first needed, so that this compiles and loads on machines without one.

#include <dlfcn.h>

#include <map>
#include <mutex>
#include <string>

#include "buffers.h"

extern "C" {
typedef struct CUctx_st* CUcontext;
typedef struct CUstream_st* CUstream;
typedef struct CUmod_st* CUmodule;
typedef struct CUfunc_st* CUfunction;
}

namespace jaxscp {
namespace {

// The few functions of the driver that are needed, by NVIDIA's names and types.
struct Driver {
  int (*cuStreamGetCtx)(CUstream, CUcontext*);
  int (*cuCtxPushCurrent_v2)(CUcontext);
  int (*cuCtxPopCurrent_v2)(CUcontext*);
  int (*cuCtxGetDevice)(int*);
  int (*cuDeviceGetAttribute)(int*, int, int);
  int (*cuModuleLoadData)(CUmodule*, const void*);
  int (*cuModuleGetFunction)(CUfunction*, CUmodule, const char*);
  int (*cuFuncSetAttribute)(CUfunction, int, int);
  int (*cuLaunchKernel)(CUfunction, unsigned, unsigned, unsigned, unsigned, unsigned, unsigned, unsigned, CUstream,
                        void**, void**);
  int (*cuMemsetD8Async)(unsigned long long, unsigned char, size_t, CUstream);
  int (*cuMemcpyDtoHAsync_v2)(void*, unsigned long long, size_t, CUstream);
  int (*cuStreamSynchronize)(CUstream);
  bool found = true;

  Driver() {
    void* library = dlopen("libcuda.so.1", RTLD_NOW | RTLD_GLOBAL);
    auto find = [&](auto& function, const char* name) {
      void* address = library ? dlsym(library, name) : nullptr;
      found = found && address;
      function = reinterpret_cast<std::remove_reference_t<decltype(function)>>(address);
    };
    find(cuStreamGetCtx, "cuStreamGetCtx"), find(cuCtxPushCurrent_v2, "cuCtxPushCurrent_v2");
    find(cuCtxPopCurrent_v2, "cuCtxPopCurrent_v2"), find(cuCtxGetDevice, "cuCtxGetDevice");
    find(cuDeviceGetAttribute, "cuDeviceGetAttribute"), find(cuModuleLoadData, "cuModuleLoadData");
    find(cuModuleGetFunction, "cuModuleGetFunction"), find(cuFuncSetAttribute, "cuFuncSetAttribute");
    find(cuLaunchKernel, "cuLaunchKernel");
    find(cuMemsetD8Async, "cuMemsetD8Async"), find(cuMemcpyDtoHAsync_v2, "cuMemcpyDtoHAsync_v2");
    find(cuStreamSynchronize, "cuStreamSynchronize");
  }
  static const Driver& get() {
    static Driver driver;
    return driver;
  }
};

constexpr int kMultiprocessors = 16;  // CU_DEVICE_ATTRIBUTE_MULTIPROCESSOR_COUNT
constexpr int kSharedMost = 8;        // CU_FUNC_ATTRIBUTE_MAX_DYNAMIC_SHARED_SIZE_BYTES
constexpr int kOutOfMemory = 2;       // CUDA_ERROR_OUT_OF_MEMORY

// The first failure of the driver, with what was tried.
struct Failure {
  int code = 0;
  const char* what = "";
  bool operator()(int result, const char* tried) {
    if (result != 0 && code == 0) code = result, what = tried;
    return code == 0;
  }
  ffi::Error error() const {
    if (code == 0) return ffi::Error::Success();
    return ffi::Error::Internal(std::string("the interior point's kernel: ") + what + " failed with CUDA error " +
                                std::to_string(code));
  }
};

// A kernel in a GPU's memory.
struct Loaded {
  CUfunction solve = nullptr;
  long long room = 0;  // numbers that a program and its solver take
  long long version = 0, batch = 0, shared = 0;  // as ``jaxscp_room`` says
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
  long long said[4] = {};
  failure(cuda.cuModuleLoadData(&module, image.begin()), "loading it") &&
      failure(cuda.cuModuleGetFunction(&loaded.solve, module, "jaxscp_solve"), "finding it") &&
      failure(cuda.cuModuleGetFunction(&room, module, "jaxscp_room"), "finding it") &&
      failure(cuda.cuCtxGetDevice(&device), "finding the device") &&
      failure(cuda.cuDeviceGetAttribute(&loaded.multiprocessors, kMultiprocessors, device), "asking the device") &&
      failure(cuda.cuLaunchKernel(room, 1, 1, 1, 1, 1, 1, 0, stream, arguments, nullptr), "launching it") &&
      failure(cuda.cuMemcpyDtoHAsync_v2(said, number, sizeof(said), stream), "asking for its room") &&
      failure(cuda.cuStreamSynchronize(stream), "asking for its room");
  loaded.room = said[0], loaded.version = said[1], loaded.batch = said[2], loaded.shared = said[3];
  if (loaded.version == kVersion)
    failure(cuda.cuFuncSetAttribute(loaded.solve, kSharedMost, static_cast<int>(loaded.shared)), "sharing memory");
  return loaded;
}

// ``blocks``: how many a multiprocessor is to hold at once, of ``threads`` each.
ffi::Error solve(CUstream stream, ffi::ScratchAllocator scratch, ffi::RemainingArgs args, ffi::RemainingRets rets,
                 ffi::Dictionary attrs) {
  auto found = shaped(args, rets, attrs);
  if (!found.has_value()) return found.error();
  auto image = attrs.get<ffi::Span<const uint8_t>>("image");
  auto name = attrs.get<std::string_view>("name");
  auto blocks = attrs.get<int64_t>("blocks"), threads = attrs.get<int64_t>("threads");
  if (!image.has_value() || !name.has_value() || !blocks.has_value() || !threads.has_value())
    return ffi::Error::InvalidArgument("the interior point's kernel is not part of the call");
  const Driver& cuda = Driver::get();
  if (!cuda.found) return ffi::Error::Internal("the CUDA driver was not found, or is too old");

  Failure failure;
  CUcontext context = nullptr;
  if (!failure(cuda.cuStreamGetCtx(stream, &context), "finding the device") ||
      !failure(cuda.cuCtxPushCurrent_v2(context), "finding the device"))
    return failure.error();
  constexpr size_t kCounter = 256;   // bytes, so that what follows is aligned
  constexpr size_t kAlignment = 16;  // XLA promises no more, and gives 256
  Loaded loaded;
  static std::mutex lock;
  static std::map<std::pair<CUcontext, std::string>, Loaded> kept;
  auto key = std::make_pair(context, std::string(*name));
  {
    std::lock_guard<std::mutex> hold(lock);
    if (auto at = kept.find(key); at != kept.end()) loaded = at->second;
  }
  // without the lock, for which another GPU may wait: to load it twice does no harm
  if (!loaded.solve) {
    auto number = scratch.Allocate(kCounter, kAlignment);
    if (!number) failure(kOutOfMemory, "finding memory for it");
    else loaded = load(cuda, *image, stream, *number, failure);
    if (failure.code == 0 && (loaded.version != kVersion || loaded.batch != sizeof(Batch))) {
      cuda.cuCtxPopCurrent_v2(&context);
      return ffi::Error::Internal(
          "the interior point's kernel is of another version of jaxscp: install that again, or export the planner again");
    }
    std::lock_guard<std::mutex> hold(lock);
    if (failure.code == 0) kept.emplace(key, loaded);
  }
  if (failure.code == 0 && found->batch.lanes > 0) {
    long long grid = std::min<long long>({found->batch.lanes, *blocks * loaded.multiprocessors, loaded.grid});
    auto find = [&] { return scratch.Allocate(kCounter + grid * loaded.room * sizeof(double), kAlignment); };
    auto memory = find();
    bool enough = memory.has_value();
    for (; !memory && grid > 1; memory = find()) grid /= 2;  // with little memory, fewer programs at once
    if (!enough) {  // XLA waits for memory for seconds before it says so: not again
      std::lock_guard<std::mutex> hold(lock);
      kept[key].grid = grid;
    }
    if (!memory) {
      failure(kOutOfMemory, "finding memory for it");
    } else {
      void *taken = *memory, *room = static_cast<char*>(taken) + kCounter;
      void* arguments[] = {&found->batch, &room, &loaded.room, &taken};
      failure(cuda.cuMemsetD8Async(reinterpret_cast<unsigned long long>(taken), 0, kCounter, stream), "starting it") &&
          failure(cuda.cuLaunchKernel(loaded.solve, static_cast<unsigned>(grid), 1, 1, static_cast<unsigned>(*threads),
                                      1, 1, static_cast<unsigned>(loaded.shared), stream, arguments, nullptr),
                  "launching it");
    }
  }
  cuda.cuCtxPopCurrent_v2(&context);
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

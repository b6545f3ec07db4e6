// NVIDIA's driver, for what launches kernels that a call carries with it.
//
// It is found when it is first needed, so that what includes this compiles and loads on machines without one.
#pragma once

#include <dlfcn.h>

#include <map>
#include <mutex>
#include <string>
#include <type_traits>
#include <utility>

#include "xla/ffi/api/ffi.h"

extern "C" {
typedef struct CUctx_st* CUcontext;
typedef struct CUstream_st* CUstream;
typedef struct CUmod_st* CUmodule;
typedef struct CUfunc_st* CUfunction;
}

namespace jaxscp {

namespace ffi = xla::ffi;

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

// The first failure of the driver, with what was tried, for the sake of a kernel.
struct Failure {
  const char* kernel;
  int code = 0;
  const char* what = "";
  bool operator()(int result, const char* tried) {
    if (result != 0 && code == 0) code = result, what = tried;
    return code == 0;
  }
  ffi::Error error() const {
    if (code == 0) return ffi::Error::Success();
    return ffi::Error::Internal(std::string(kernel) + ": " + what + " failed with CUDA error " + std::to_string(code));
  }
};

// A stream's context, as this thread's own as long as this is there.
class Current {
 public:
  Current(const Driver& cuda, CUstream stream, Failure& failure) : cuda_(cuda) {
    pushed_ = failure(cuda.cuStreamGetCtx(stream, &context_), "finding the device") &&
              failure(cuda.cuCtxPushCurrent_v2(context_), "finding the device");
  }
  ~Current() {
    CUcontext context;
    if (pushed_) cuda_.cuCtxPopCurrent_v2(&context);
  }
  Current(const Current&) = delete;
  CUcontext context() const { return context_; }

 private:
  const Driver& cuda_;
  CUcontext context_ = nullptr;
  bool pushed_;
};

// Kernels in the memories of GPUs, by context and name.
template <typename Loaded>
class Kept {
 public:
  using Key = std::pair<CUcontext, std::string>;

  // Loads it first if need be. That is without the lock, for which another GPU may wait: to load it twice does no harm.
  template <typename Load>
  Loaded get(const Key& key, const Failure& failure, Load load) {
    {
      std::lock_guard<std::mutex> hold(lock_);
      if (auto at = kept_.find(key); at != kept_.end()) return at->second;
    }
    const Loaded loaded = load();
    std::lock_guard<std::mutex> hold(lock_);
    if (failure.code == 0) kept_.emplace(key, loaded);
    return loaded;
  }

  template <typename Change>
  void change(const Key& key, Change change) {
    std::lock_guard<std::mutex> hold(lock_);
    change(kept_[key]);
  }

 private:
  std::mutex lock_;
  std::map<Key, Loaded> kept_;
};

}  // namespace jaxscp

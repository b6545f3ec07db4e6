// NVIDIA's driver, which launches kernels whose cubin is an attribute of an XLA FFI call.
//
// The driver is loaded at first use, so that libraries compile and load on machines without one.
#pragma once

#include <dlfcn.h>

#include <map>
#include <mutex>
#include <string>
#include <type_traits>
#include <utility>

#include "call.h"

extern "C" {
typedef struct CUctx_st* CUcontext;
typedef struct CUstream_st* CUstream;
typedef struct CUmod_st* CUmodule;
typedef struct CUfunc_st* CUfunction;
}

namespace jaxscp {

// Functions of the driver, by NVIDIA's names and types.
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
    if (!driver.found) throw internal("the CUDA driver was not found, or is too old");
    return driver;
  }
};

// First failure of the driver for a kernel, and the action that failed.
struct Failure {
  const char* kernel;
  int code = 0;
  const char* what = "";
  bool operator()(int result, const char* tried) {
    if (result != 0 && code == 0) code = result, what = tried;
    return code == 0;
  }
  void raise() const {
    if (code != 0) throw internal(std::string(kernel) + ": " + what + " failed with CUDA error " + std::to_string(code));
  }
};

// Guard: makes a stream's context current on this thread for the guard's lifetime.
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

// Kernels loaded into GPUs, by context and name.
template <typename Loaded>
class KernelCache {
 public:
  using Key = std::pair<CUcontext, std::string>;

  // The kernel, loaded at first use. Loading holds no lock, for which other GPUs would wait; loading twice is harmless.
  template <typename Load>
  Loaded get(const Key& key, const Failure& failure, Load load) {
    {
      std::lock_guard<std::mutex> guard(lock_);
      if (auto at = kernels_.find(key); at != kernels_.end()) return at->second;
    }
    const Loaded loaded = load();
    std::lock_guard<std::mutex> guard(lock_);
    if (failure.code == 0) kernels_.emplace(key, loaded);
    return loaded;
  }

  template <typename Change>
  void change(const Key& key, Change change) {
    std::lock_guard<std::mutex> guard(lock_);
    change(kernels_[key]);
  }

 private:
  std::mutex lock_;
  std::map<Key, Loaded> kernels_;
};

}  // namespace jaxscp

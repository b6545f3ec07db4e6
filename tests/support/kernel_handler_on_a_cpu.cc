// XLA FFI handler on a CPU in place of a GPU's: runs a kernel. In place of a cubin, the call carries the path of a
// library that was compiled with ``threads_on_a_cpu.h`` or ``warps_on_a_cpu.h``.

#include "launch.h"

static void run_kernel(jaxscp::Call& call) {
  const auto path = call.numbers<uint8_t>("cubin");
  using Run = void(void** parameters, long long blocks, long long threads);
  void* library = dlopen(std::string(path.begin(), path.end()).c_str(), RTLD_NOW);
  auto* run = reinterpret_cast<Run*>(library ? dlsym(library, "run") : nullptr);
  if (run == nullptr) throw jaxscp::internal(dlerror());
  jaxscp::Work work(call);
  run(work.parameters().data(), work.blocks, call.number<int64_t>("threads"));
}

JAXSCP_HANDLER(jaxscp_run_kernel, run_kernel);

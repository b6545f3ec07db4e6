// The interior point's CUDA kernel on a CPU, compiled for the sizes of one program (JAXSCP_SIZES), as the FFI target of
// the C++ for CPUs.

#define JAXSCP_BLOCKS 1
#ifndef JAXSCP_SHARED
#define JAXSCP_SHARED (228 * 1024)
#endif
#define JAXSCP_ALONE JAXSCP_THREADS

#include "call.h"

#include "fibers_on_a_cpu.h"
#include "kernel.cu"

#include "buffers.h"

static void solve(jaxscp::Call& call) {
  const jaxscp::SizedBatch found = jaxscp::sized_batch(call);
  long long sizes[5], &numbers = sizes[0];
  jaxscp_workspace(sizes);
  std::vector<double> workspace(numbers, std::nan(""));
  unsigned long long next = 0;
  emulated::run(JAXSCP_THREADS, [&] { jaxscp_solve(found.batch, workspace.data(), numbers, &next); });
}

JAXSCP_HANDLER(jaxscp_interior_point, solve);

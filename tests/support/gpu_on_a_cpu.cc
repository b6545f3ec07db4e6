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

namespace jaxscp {

// Entry (i, k) of the first factor, and (k, i) of the second, are lane 4 i + k's.
void add_products(double (&sums)[2], double a, double b) {
  int lane = threadIdx.x % 32, row = lane / 4;
  for (int k = 0; k < 4; ++k) {
    double of_row = exchanged(a, 4 * row + k);
    for (int e = 0; e < 2; ++e) sums[e] += of_row * exchanged(b, 4 * (2 * (lane % 4) + e) + k);
  }
}

}  // namespace jaxscp

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

// A GPU's threads on a CPU, for kernels written from tapes in which the lanes of a warp wait for each other.
#pragma once

#include "fibers_on_a_cpu.h"

extern "C" void jaxscp_kernel(const double* w, const double* hoisted, double* first, double* second, long long count,
                              long long batch);

extern "C" void run(const double* w, const double* hoisted, double* first, double* second, long long count,
                    long long batch, long long group_size, long long threads) {
  const long long blocks = (count * group_size + threads - 1) / threads;
  for (long long i = 0; i < blocks; ++i) {
    blockIdx.x = i;
    emulated::run(threads, [&] { jaxscp_kernel(w, hoisted, first, second, count, batch); });
  }
}

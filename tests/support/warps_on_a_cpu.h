// For kernels that are written from tapes and whose lanes wait for each other; else as ``threads_on_a_cpu.h``.
#pragma once

#include "fibers_on_a_cpu.h"

extern "C" void jaxscp_kernel(const double* w, const double* known, double* outcomes, double* jacobian, long long count,
                              long long intervals);

extern "C" void run(const double* w, const double* known, double* outcomes, double* jacobian, long long count,
                    long long intervals, long long groups, long long threads) {
  const long long blocks = (count * groups + threads - 1) / threads;
  for (long long i = 0; i < blocks; ++i) {
    blockIdx.x = i;
    emulated::run(threads, [&] { jaxscp_kernel(w, known, outcomes, jacobian, count, intervals); });
  }
}

// A GPU's threads on a CPU, one after another, for kernels that are written from tapes: none waits for another.
#pragma once

#include "cuda_words.h"

extern "C" void jaxscp_kernel(const double* w, const double* known, double* outcomes, double* jacobian, long long count,
                              long long intervals);

// As many blocks as the handler for GPUs launches.
extern "C" void run(const double* w, const double* known, double* outcomes, double* jacobian, long long count,
                    long long intervals, long long groups, long long threads) {
  const long long blocks = (count * groups + threads - 1) / threads;
  for (long long i = 0; i < blocks * threads; ++i) {
    blockIdx.x = i / threads, threadIdx.x = i % threads;
    jaxscp_kernel(w, known, outcomes, jacobian, count, intervals);
  }
}

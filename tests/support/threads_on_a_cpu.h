// A GPU's threads on a CPU, one after another, for kernels written from tapes in which no thread waits for another.
#pragma once

#include "cuda_words.h"

extern "C" void jaxscp_kernel(const double* w, const double* hoisted, double* first, double* second, long long count,
                              long long batch);

// Runs as many blocks as the handler for GPUs launches.
extern "C" void run(const double* w, const double* hoisted, double* first, double* second, long long count,
                    long long batch, long long group_size, long long threads) {
  const long long blocks = (count * group_size + threads - 1) / threads;
  for (long long i = 0; i < blocks * threads; ++i) {
    blockIdx.x = i / threads, threadIdx.x = i % threads;
    jaxscp_kernel(w, hoisted, first, second, count, batch);
  }
}

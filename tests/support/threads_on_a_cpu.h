// A GPU's threads on a CPU, one after another, for kernels in which no thread waits for another.
#pragma once

#include "cuda_words.h"

namespace emulated {

template <typename Act>
void run_block(long long threads, Act act) {
  for (long long t = 0; t < threads; ++t) threadIdx.x = t, act();
}

}  // namespace emulated

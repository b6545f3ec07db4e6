// A GPU's threads on a CPU, for kernels in which the threads of a block wait for each other.
#pragma once

#include "fibers_on_a_cpu.h"

namespace emulated {

template <typename Act>
void run_block(long long threads, Act act) {
  run(threads, act);
}

}  // namespace emulated

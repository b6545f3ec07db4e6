// A GPU's threads on a CPU: the threads of a block take turns, each until the next barrier. Slow, but shuffles and
// barriers have the meaning that they have on a GPU.
#pragma once

#include <ucontext.h>

#include <cstdio>
#include <cstdlib>
#include <functional>
#include <memory>
#include <vector>

#include "cuda_words.h"

#define __CUDACC__

namespace emulated {

constexpr int kWarpSize = 32;

// Barrier: threads that arrive wait for the others.
struct Barrier {
  int size = 0, arrived = 0, round = 0;
};

std::vector<ucontext_t> fibers;
std::vector<bool> ended;
std::vector<Barrier> warps;
Barrier block;
ucontext_t scheduler;
double passed[64][kWarpSize];
std::function<void()> body;

inline void wait(Barrier& barrier) {
  int me = threadIdx.x, round = barrier.round;
  if (++barrier.arrived == barrier.size) {
    barrier.arrived = 0;
    ++barrier.round;
    return;
  }
  while (barrier.round == round) {
    swapcontext(&fibers[me], &scheduler);
    threadIdx.x = me;
  }
}

inline void enter() {
  int me = threadIdx.x;
  body();
  ended[me] = true;
  swapcontext(&fibers[me], &scheduler);
}

// Runs ``work`` by so many threads of one block.
inline void run(int threads, std::function<void()> work) {
  constexpr size_t kStack = 1 << 18;
  blockDim.x = threads;
  std::vector<std::unique_ptr<char[]>> stacks;
  fibers.assign(threads, {}), ended.assign(threads, false);
  warps.assign(threads / kWarpSize, {kWarpSize}), block = {threads};
  body = std::move(work);
  for (auto& fiber : fibers) {
    stacks.push_back(std::make_unique<char[]>(kStack));
    getcontext(&fiber);
    fiber.uc_stack.ss_sp = stacks.back().get(), fiber.uc_stack.ss_size = kStack, fiber.uc_link = nullptr;
    makecontext(&fiber, enter, 0);
  }
  for (int left = threads; left > 0;) {
    left = 0;
    // each round begins with a different thread, so that no order is relied on
    static int turn = 0;
    turn = (turn * 5 + 3) % threads;
    for (int i = 0; i < threads; ++i) {
      int t = (i + turn) % threads;
      if (ended[t]) continue;
      threadIdx.x = t;
      swapcontext(&scheduler, &fibers[t]);
      left += !ended[t];
    }
  }
}

}  // namespace emulated

inline void __syncthreads() { emulated::wait(emulated::block); }
inline void __syncwarp() { emulated::wait(emulated::warps[threadIdx.x / emulated::kWarpSize]); }
inline double exchanged(double v, int from) {
  double(&slots)[emulated::kWarpSize] = emulated::passed[threadIdx.x / emulated::kWarpSize];
  slots[threadIdx.x % emulated::kWarpSize] = v;
  __syncwarp();
  double found = slots[from];
  __syncwarp();
  return found;
}
namespace jaxscp {

// Entry (i, k) of the first factor, and (k, i) of the second, are lane 4 i + k's.
inline void add_products(double (&sums)[2], double a, double b) {
  int lane = threadIdx.x % 32, row = lane / 4;
  for (int k = 0; k < 4; ++k) {
    double of_row = exchanged(a, 4 * row + k);
    for (int e = 0; e < 2; ++e) sums[e] += of_row * exchanged(b, 4 * (2 * (lane % 4) + e) + k);
  }
}

}  // namespace jaxscp

template <typename T>
inline T __shfl_sync(unsigned, T v, int from) {
  return static_cast<T>(exchanged(static_cast<double>(v), from));
}
inline double __shfl_xor_sync(unsigned, double v, int lane_mask) {
  return exchanged(v, threadIdx.x % emulated::kWarpSize ^ lane_mask);
}
inline bool __any_sync(unsigned, bool v) {
  for (int mask = 1; mask < emulated::kWarpSize; mask *= 2) v |= __shfl_xor_sync(0, v, mask) != 0.0;
  return v;
}
inline unsigned __ballot_sync(unsigned, bool v) {
  unsigned all = 0;
  for (int lane = 0; lane < emulated::kWarpSize; ++lane) all |= (exchanged(v, lane) != 0.0 ? 1u : 0u) << lane;
  return all;
}
inline unsigned long long atomicAdd(unsigned long long* at, unsigned long long by) {
  unsigned long long before = *at;
  *at += by;
  return before;
}

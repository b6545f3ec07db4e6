// Sizes of the kernels' problem, and the loop over threads.
#pragma once

#include "dynamic_memory.cuh"

constexpr int kIntervals = JAXSCP_INTERVALS, kStates = JAXSCP_STATES, kInputs = JAXSCP_INPUTS, kStage = JAXSCP_STAGE;
constexpr int kInitial = JAXSCP_INITIAL, kFinal = JAXSCP_FINAL, kControls = kInputs - kStage;
constexpr int kThreads = JAXSCP_THREADS;
constexpr double kPenalty = JAXSCP_PENALTY;

// act(i) for i < count, each by one thread.
template <typename Act>
inline void by_threads(int count, Act act) {
  for (int i = threadIdx.x; i < count; i += kThreads) act(i);
}

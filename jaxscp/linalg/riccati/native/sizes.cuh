// Sizes of the kernels' problem, the loop over threads, and their shared memory.
#pragma once

constexpr int kIntervals = JAXSCP_INTERVALS, kStates = JAXSCP_STATES, kInputs = JAXSCP_INPUTS, kStage = JAXSCP_STAGE;
constexpr int kInitial = JAXSCP_INITIAL, kFinal = JAXSCP_FINAL, kControls = kInputs - kStage;
constexpr int kThreads = JAXSCP_THREADS;
constexpr double kPenalty = JAXSCP_PENALTY;

// act(i) for i < count, each by one thread.
template <typename Act>
inline void by_threads(int count, Act act) {
  for (int i = threadIdx.x; i < count; i += kThreads) act(i);
}

// A block's shared memory, of so many bytes.
template <int kBytes>
inline double* shared_memory() {
#if defined(JAXSCP_EMULATED_GPU)
  static_assert(kBytes <= sizeof(emulated_memory));
  return emulated_memory;
#else
  extern __shared__ double dynamic_memory[];
  return dynamic_memory;
#endif
}

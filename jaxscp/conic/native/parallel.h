// Parallel loops: the threads of a team on a CPU, or of a block on a GPU, solve one program together.
//
//     parallel_for(count, act)           act(i) for i < count
//     parallel_for(packs, parts, act)    act(p, k) for p < packs and all parts k of a stage
//     parallel_for_teams(count, act)     act(p) for p < count, each by a team: a warp of a GPU, a thread of a CPU
//     in_team(count, act)                act(i) for i < count, within a team
//     fill(packs, count, target, value)  target(p, i) = value(p, i)
//     fold(packs, parts, first, act)     reduction, see ``Totals``
//     once(act)                          act() on one thread
//
// All threads make each call, which ends with a barrier. Only ``parallel_for_nowait`` has none; ``wait`` must follow.
#pragma once

#if defined(__CUDACC__)
#include "parallel_gpu.h"
#else
#include "parallel_cpu.h"
#endif

namespace jaxscp {

// Sums and maxima of one reduction.
template <int kSums, int kLargest>
struct Totals {
  static constexpr int kMany = kSums + kLargest;
  Pack numbers[kMany];

  static Totals none() {
    Totals found;
    for (Pack& v : found.numbers) v = all(0.0);
    return found;
  }
  Pack& operator[](int i) { return numbers[i]; }
  void add(int i, Pack v) { numbers[i] += v; }
  void include_max(int i, Pack v) { numbers[kSums + i] = larger(v, numbers[kSums + i]); }
  void join(const Totals& other) {
    for (int i = 0; i < kMany; ++i)
      numbers[i] = i < kSums ? numbers[i] + other.numbers[i] : larger(other.numbers[i], numbers[i]);
  }
  double sum(int i) const { return get(numbers[i], 0); }
  double largest(int i) const { return get(numbers[kSums + i], 0); }
};

}  // namespace jaxscp

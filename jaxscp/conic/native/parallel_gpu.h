// Parallel loops of a GPU's block, as ``parallel.h`` describes them.
#pragma once

#include "pack.h"
#include "parts.h"

namespace jaxscp {

// A function that is not inlined: with everything inlined, the kernel would outgrow the instruction cache.
#define JAXSCP_CALLED __noinline__

constexpr int kWarp = 32;
// Warps of a block: the largest number, and the number of this launch.
constexpr int kMostWarps = JAXSCP_ALONE / kWarp;
inline int warps() { return static_cast<int>(blockDim.x) / kWarp; }
constexpr unsigned kAllLanes = 0xffffffff;  // mask of a warp

inline void wait() { __syncthreads(); }

inline int lane_of_warp() { return threadIdx.x % kWarp; }
inline int warp_of_block() { return threadIdx.x / kWarp; }
// Same number, by a shuffle: the compiler then knows that all lanes agree, and computes dependent values once per warp.
inline int common_warp() { return __shfl_sync(kAllLanes, warp_of_block(), 0); }

// Condition on which all lanes agree. Told so, the compiler does not expect divergent lanes in the branches, which
// would nearly double the code.
inline bool uniform(bool known) { return __any_sync(kAllLanes, known); }

// Calls act(i) for i < count.
template <typename Act>
inline void parallel_for(int count, Act act) {
#pragma unroll 1
  for (int first = common_warp() * kWarp; first < count; first += warps() * kWarp)
    if (int i = first + lane_of_warp(); i < count) act(i);
  wait();
}

// target(p, i) = value(p, i) for p < packs and i < count. A thread reads several values before it writes any, so that
// the reads overlap.
template <typename Target, typename Value>
inline void fill(int packs, int count, Target target, Value value) {
  constexpr int kAtOnce = 4;
  const int rounds = packs / kWarp, all = rounds * count;
#pragma unroll 1
  for (int first = common_warp(); first < all; first += kAtOnce * warps()) {
    Pack found[kAtOnce];
    auto at = [&](int i) { return i % rounds * kWarp + lane_of_warp(); };
#pragma unroll
    for (int k = 0; k < kAtOnce; ++k)
      if (int i = first + k * warps(); i < all) found[k] = value(at(i), i / rounds);
#pragma unroll
    for (int k = 0; k < kAtOnce; ++k)
      if (int i = first + k * warps(); i < all) target(at(i), i / rounds) = found[k];
  }
  wait();
}

// Lanes of a warp that share a cone: entry e belongs to lane e % kLanesOfCone.
constexpr int kLanesOfCone = 8;
inline int lane_of_cone() { return lane_of_warp() % kLanesOfCone; }

// Calls act(p, k) for p < packs and all parts k. The lanes of a warp have the same k and neighbouring stages; for
// cones, kLanesOfCone lanes have the same stage.
template <typename Act>
inline void parallel_for_nowait(int packs, Parts parts, Act act) {
  const int rounds = (packs + kWarp - 1) / kWarp, rest = parts.single + parts.cones * kLanesOfCone;
#pragma unroll 1
  for (int i = common_warp(); i < rounds * (rest + parts.rest); i += warps()) {
    int k = i / rounds, p = i % rounds * kWarp + lane_of_warp();
    if (k >= rest) {
      k -= parts.cones * (kLanesOfCone - 1);
    } else if (k >= parts.single) {
      const int cone = (k - parts.single) / kLanesOfCone, chunk = (k - parts.single) % kLanesOfCone;
      k = parts.single + cone;
      p = (chunk * packs + p) / kLanesOfCone;
    }
    if (packs % kWarp == 0 || p < packs) act(p, k);
  }
}
template <typename Act>
inline void parallel_for(int packs, Parts parts, Act act) {
  parallel_for_nowait(packs, parts, act);
  wait();
}

// v on one of a cone's lanes, zero on the others.
inline Pack once_per_cone(Pack v) { return lane_of_cone() == 0 ? v : 0.0; }

// Calls act(p) for p < count, each by a team: the lanes of a warp.
template <typename Act>
inline void parallel_for_teams(int count, Act act) {
#pragma unroll 1
  for (int p = common_warp(); p < count; p += warps()) act(p);
  wait();
}

// Within a team, calls act(i) for i < count.
template <typename Act>
inline void in_team(int count, Act act) {
#pragma unroll 1
  for (int i = lane_of_warp(); i < count; i += kWarp) act(i);
  __syncwarp();
}

// Calls act() on one thread. Barriers before and after make its changes safe for the others.
template <typename Act>
inline void once(Act act) {
  wait();
  if (threadIdx.x == 0) act();
  wait();
}

// Prefix sum: begin[0] = 0, and begin[i + 1] becomes the sum of begin[1] .. begin[i + 1].
template <typename Index>
inline void add_up(Index* begin, int count) {
  parallel_for_teams(1, [&](int) {
    if (lane_of_warp() == 0) begin[0] = 0;
    int before = 0;
#pragma unroll 1
    for (int first = 0; first < count; first += kWarp) {
      const int i = first + lane_of_warp();
      int total = i < count ? begin[i + 1] : 0;
      for (int distance = 1; distance < kWarp; distance *= 2) {
        const int other = __shfl_sync(kAllLanes, total, lane_of_warp() >= distance ? lane_of_warp() - distance : 0);
        if (lane_of_warp() >= distance) total += other;
      }
      total += before;
      if (i < count) begin[i + 1] = total;
      before = __shfl_sync(kAllLanes, total, kWarp - 1);
    }
  });
}

// The threads of a block take part from the beginning to the end.
inline bool admit() { return true; }
inline void dismiss() {}

// Shared memory of a reduction, one for all: each would have its own otherwise.
constexpr int kMostFolded = 12;  // numbers of a warp
inline double* fold_memory() {
  __shared__ double memory[kMostFolded * kMostWarps];
  return memory;
}

// Reduction: act(p, k, found) adds to ``found``, which begins as ``first``, for all p < packs and parts k.
template <typename Found, typename Act>
inline Found fold(int packs, Parts parts, Found first, Act act) {
  static_assert(sizeof(Found) <= kMostFolded * sizeof(double));
  Found* of_warps = reinterpret_cast<Found*>(fold_memory());
  Found total = first;
  parallel_for_nowait(packs, parts, [&](int p, int k) { act(p, k, total); });
#pragma unroll 1
  for (int distance = kWarp / 2; distance > 0; distance /= 2) {
    Found other;
    for (int i = 0; i < Found::kMany; ++i) other[i] = __shfl_xor_sync(kAllLanes, total[i], distance);
    total.join(other);
  }
  if (lane_of_warp() == 0) of_warps[warp_of_block()] = total;
  wait();
  total = first;
#pragma unroll 1
  for (int w = 0; w < warps(); ++w) total.join(of_warps[w]);
  wait();
  return total;
}

}  // namespace jaxscp

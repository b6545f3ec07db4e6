// Who does what: the threads of a team on a CPU, or of a block on a GPU, solve a program together. Each call is a phase
// that they share, and all of it is done when it returns; but for ``visit``, after which they are to ``wait``.
#pragma once

#if defined(__CUDACC__)
#include "pack.h"
#else
#include <utility>

#include "team.h"
#endif

namespace jaxscp {

// What is to be done at a place: so much that takes one thread, then so many cones, whose entries lanes of a GPU work
// on together, and then more that takes one.
struct Parts {
  int single, cones = 0, rest = 0;
  int count() const { return single + cones + rest; }
};

#if defined(__CUDACC__)

// A function that is called, not copied to where it is used: a kernel of copies outgrows the instruction cache.
#define JAXSCP_CALLED __noinline__

constexpr int kWarp = 32;
// Warps of a block: at most so many, and how many there are is for who launches it to say.
constexpr int kMostWarps = JAXSCP_ALONE / kWarp;
inline int warps() { return static_cast<int>(blockDim.x) / kWarp; }
constexpr unsigned kAllLanes = 0xffffffff;  // lane of the warp

inline void wait() { __syncthreads(); }

inline int lane_of_warp() { return threadIdx.x % kWarp; }
inline int warp_of_block() { return threadIdx.x / kWarp; }
// The same, for all lanes together: the compiler then knows it to be the same for all, and what depends on it alone is
// found once for the warp.
inline int common_warp() { return __shfl_sync(kAllLanes, warp_of_block(), 0); }

// What all threads know, as a condition on which they go ways apart. Said so to the compiler, or it takes lanes for
// apart in all that is called behind it, which makes nearly twice the code.
inline bool uniform(bool known) { return __any_sync(kAllLanes, known); }

// act(i) for i < count
template <typename Act>
inline void parallel_for(int count, Act act) {
#pragma unroll 1
  for (int first = common_warp() * kWarp; first < count; first += warps() * kWarp)
    if (int i = first + lane_of_warp(); i < count) act(i);
  wait();
}

// place(p, i) = value(p, i) for p < packs and i < count: a thread reads several before it puts any, as none of these has
// to wait for the one before.
template <typename Place, typename Value>
inline void fill(int packs, int count, Place place, Value value) {
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
      if (int i = first + k * warps(); i < all) place(at(i), i / rounds) = found[k];
  }
  wait();
}

// Lanes of a warp that work on a cone together: each on every so-manieth of its entries.
constexpr int kLanesOfCone = 8;
inline int lane_of_cone() { return lane_of_warp() % kLanesOfCone; }

// act(p, k) for p < packs and all parts k. The lanes of a warp have neighbouring places and the same k; or so many of
// them have a cone together, of places as many as lanes or several times so.
template <typename Act>
inline void parallel_for_nowait(int packs, Parts parts, Act act) {
  const int rounds = (packs + kWarp - 1) / kWarp, rest = parts.single + parts.cones * kLanesOfCone;
#pragma unroll 1
  for (int i = common_warp(); i < rounds * (rest + parts.rest); i += warps()) {
    int k = i / rounds, p = i % rounds * kWarp + lane_of_warp();
    if (k >= rest) {
      k -= parts.cones * (kLanesOfCone - 1);
    } else if (k >= parts.single) {
      const int cone = (k - parts.single) / kLanesOfCone, stretch = (k - parts.single) % kLanesOfCone;
      k = parts.single + cone;
      p = (stretch * packs + p) / kLanesOfCone;
    }
    if (packs % kWarp == 0 || p < packs) act(p, k);
  }
}
template <typename Act>
inline void parallel_for(int packs, Parts parts, Act act) {
  parallel_for_nowait(packs, parts, act);
  wait();
}

// What is of a cone and not of each lane.
inline Pack once_per_cone(Pack v) { return lane_of_cone() == 0 ? v : 0.0; }

// act(p) for p < count, each by a team: the lanes of a warp.
template <typename Act>
inline void parallel_for_teams(int count, Act act) {
#pragma unroll 1
  for (int p = common_warp(); p < count; p += warps()) act(p);
  wait();
}

// Within a team, act(i) for i < count.
template <typename Act>
inline void in_team(int count, Act act) {
#pragma unroll 1
  for (int i = lane_of_warp(); i < count; i += kWarp) act(i);
  __syncwarp();
}

// What is to be done once: to change what all threads see, who must have seen it as it was.
template <typename Act>
inline void once(Act act) {
  wait();
  if (threadIdx.x == 0) act();
  wait();
}

// begin[i + 1] becomes the sum of all such up to there, which follow begin[0] = 0.
inline void add_up(int* begin, int count) {
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

// All take part from the beginning to the end.
inline bool admit() { return true; }
inline void dismiss() {}

// What act(p, k, found) joins to ``found``, which begins as ``first``, for all p < packs and parts k.
template <typename Found, typename Act>
inline Found fold(int packs, Parts parts, Found first, Act act) {
  __shared__ Found of_warps[kMostWarps];
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

#else

#define JAXSCP_CALLED

inline bool uniform(bool known) { return known; }

inline void wait() { this_thread.team->wait(this_thread.me); }

// Which of so many are this thread's: a stretch, so that it finds in its cache what it left there.
inline std::pair<int, int> mine(int count) {
  const long long size = this_thread.team->size(), me = this_thread.me;
  return {static_cast<int>(count * me / size), static_cast<int>(count * (me + 1) / size)};
}

template <typename Act>
inline void parallel_for(int count, Act act) {
  auto [begin, end] = mine(count);
  for (int i = begin; i < end; ++i) act(i);
  wait();
}

template <typename Act>
inline void parallel_for_nowait(int packs, Parts parts, Act act) {
  const int count = parts.count();
  auto [begin, end] = mine(packs * count);
  for (int at = begin; at < end;) {
    const int p = at / count, first = p * count, last = std::min(end, first + count);
    for (int k = at - first; k < last - first; ++k) act(p, k);
    at = last;
  }
}
template <typename Act>
inline void parallel_for(int packs, Parts parts, Act act) {
  parallel_for_nowait(packs, parts, act);
  wait();
}

template <typename Place, typename Value>
inline void fill(int packs, int count, Place place, Value value) {
  parallel_for(packs, Parts{count}, [&](int p, int i) { place(p, i) = value(p, i); });
}

// A team of its own is what a thread is here.
template <typename Act>
inline void parallel_for_teams(int count, Act act) {
  parallel_for(count, act);
}

template <typename Act>
inline void in_team(int count, Act act) {
  for (int i = 0; i < count; ++i) act(i);
}

inline Pack once_per_cone(Pack v) { return v; }

template <typename Act>
inline void once(Act act) {
  wait();
  if (this_thread.me == 0) act();
  wait();
}

inline void add_up(int* begin, int count) {
  once([&] {
    begin[0] = 0;
    for (int i = 0; i < count; ++i) begin[i + 1] += begin[i];
  });
}

// At the head of what all do together: lets in who wants to take part, at the same place. False for who does not.
inline bool admit() {
  this_thread.turn = 0;
  if (this_thread.me < 0) return (this_thread.me = this_thread.team->join()) > 0;
  return this_thread.team->admit(this_thread.me);
}

// Behind it: one goes on alone.
inline void dismiss() { this_thread.team->dismiss(); }

// In an order that does not depend on how many threads there are, so that what is found does not.
template <typename Found, typename Act>
inline Found fold(int packs, Parts parts, Found first, Act act) {
  const int count = parts.count();
  static_assert(Found::kMany <= kMaxTotals);
  constexpr int kTurns = Found::kMany > 1 ? 1 : 4;  // of one alone, parts in turn: none waits for the one before
  Pack* of_packs = this_thread.team->parts(this_thread.turn ^= 1);
  auto [begin, end] = mine(packs);
  for (int p = begin; p < end; ++p) {
    Found part[kTurns];
    for (Found& v : part) v = first;
    int k = 0;
    for (; k + kTurns <= count; k += kTurns)
      for (int i = 0; i < kTurns; ++i) act(p, k + i, part[i]);
    for (; k < count; ++k) act(p, k, part[0]);
    for (int i = 1; i < kTurns; ++i) part[0].join(part[i]);
    for (int i = 0; i < Found::kMany; ++i) of_packs[p * kMaxTotals + i] = part[0][i];
  }
  wait();
  Found total = first;
  for (int p = 0; p < packs; ++p) {
    Found part;
    for (int i = 0; i < Found::kMany; ++i) part[i] = of_packs[p * kMaxTotals + i];
    total.join(part);
  }
  Found whole = total;
  for (int lane = 1; lane < kWidth; ++lane) {
    Found part;
    for (int i = 0; i < Found::kMany; ++i) part[i] = all(get(total[i], lane));
    whole.join(part);
  }
  return whole;
}

#endif

// Sums and largest numbers that are found together.
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
  void see(int i, Pack v) { numbers[kSums + i] = larger(v, numbers[kSums + i]); }
  void join(const Totals& other) {
    for (int i = 0; i < kMany; ++i)
      numbers[i] = i < kSums ? numbers[i] + other.numbers[i] : larger(other.numbers[i], numbers[i]);
  }
  double sum(int i) const { return get(numbers[i], 0); }
  double largest(int i) const { return get(numbers[kSums + i], 0); }
};

}  // namespace jaxscp

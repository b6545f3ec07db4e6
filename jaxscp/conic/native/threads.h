// Who does what: the threads of a team on a CPU, or of a block on a GPU, solve a program together. Each call is a phase
// that they share, and all of it is done when it returns.
#pragma once

#if defined(__CUDACC__)
#include "pack.h"
#else
#include <utility>

#include "team.h"
#endif

namespace jaxscp {

#if defined(__CUDACC__)

// A function that is called, not copied to where it is used: a kernel of copies outgrows the instruction cache.
#define JAXSCP_CALLED __noinline__

constexpr int kWarp = 32;
constexpr int kThreads = JAXSCP_THREADS;  // of a block

inline int lane_of_warp() { return threadIdx.x % kWarp; }
inline int warp_of_block() { return threadIdx.x / kWarp; }

// act(i) for i < count
template <typename Act>
inline void share(int count, Act act) {
#pragma unroll 1
  for (int i = threadIdx.x; i < count; i += kThreads) act(i);
  __syncthreads();
}

// act(p, k) for p < packs and k < count. Neighbouring threads have neighbouring places and the same k.
template <typename Act>
inline void share(int packs, int count, Act act) {
#pragma unroll 1
  for (int i = threadIdx.x; i < packs * count; i += kThreads) act(i % packs, i / packs);
  __syncthreads();
}

// The same for what teams keep, place after place: neighbouring threads have neighbouring k.
template <typename Act>
inline void share_kept(int packs, int count, Act act) {
#pragma unroll 1
  for (int i = threadIdx.x; i < packs * count; i += kThreads) act(i / count, i % count);
  __syncthreads();
}

// act(p) for p < count, each by a team: the lanes of a warp.
template <typename Act>
inline void share_among_teams(int count, Act act) {
#pragma unroll 1
  for (int p = warp_of_block(); p < count; p += kThreads / kWarp) act(p);
  __syncthreads();
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
  __syncthreads();
  if (threadIdx.x == 0) act();
  __syncthreads();
}

// All take part from the beginning to the end.
inline bool admit() { return true; }
inline void dismiss() {}

// ``join`` of ``first`` and of value(p, k) for all p < packs and k < count.
template <typename Join, typename Value>
inline double fold(int packs, int count, double first, Join join, Value value) {
  __shared__ double of_warps[kThreads / kWarp];
  double total = first;
#pragma unroll 1
  for (int i = threadIdx.x; i < packs * count; i += kThreads) total = join(value(i % packs, i / packs), total);
#pragma unroll 1
  for (int apart = kWarp / 2; apart > 0; apart /= 2) total = join(__shfl_xor_sync(0xffffffff, total, apart), total);
  if (lane_of_warp() == 0) of_warps[warp_of_block()] = total;
  __syncthreads();
  total = first;
#pragma unroll 1
  for (int w = 0; w < kThreads / kWarp; ++w) total = join(of_warps[w], total);
  __syncthreads();
  return total;
}

#else

#define JAXSCP_CALLED

inline void wait() { seat.team->wait(seat.me); }

// Which of so many are this thread's: a stretch, so that it finds in its cache what it left there.
inline std::pair<int, int> mine(int count) {
  const long long size = seat.team->size(), me = seat.me;
  return {static_cast<int>(count * me / size), static_cast<int>(count * (me + 1) / size)};
}

template <typename Act>
inline void share(int count, Act act) {
  auto [begin, end] = mine(count);
  for (int i = begin; i < end; ++i) act(i);
  wait();
}

template <typename Act>
inline void share(int packs, int count, Act act) {
  auto [begin, end] = mine(packs * count);
  for (int at = begin; at < end;) {
    const int p = at / count, first = p * count, last = std::min(end, first + count);
    for (int k = at - first; k < last - first; ++k) act(p, k);
    at = last;
  }
  wait();
}

template <typename Act>
inline void share_kept(int packs, int count, Act act) {
  share(packs, count, act);
}

// A team of its own is what a thread is here.
template <typename Act>
inline void share_among_teams(int count, Act act) {
  share(count, act);
}

template <typename Act>
inline void in_team(int count, Act act) {
  for (int i = 0; i < count; ++i) act(i);
}

template <typename Act>
inline void once(Act act) {
  wait();
  if (seat.me == 0) act();
  wait();
}

// At the head of what all do together: lets in who wants to take part, at the same place. False for who does not.
inline bool admit() {
  seat.turn = 0;
  if (seat.me < 0) return (seat.me = seat.team->join()) > 0;
  return seat.team->admit(seat.me);
}

// Behind it: one goes on alone.
inline void dismiss() { seat.team->dismiss(); }

// In an order that does not depend on how many threads there are, so that what is found does not.
template <typename Join, typename Value>
inline double fold(int packs, int count, double first, Join join, Value value) {
  Pack* of_packs = seat.team->parts(seat.turn ^= 1);
  auto [begin, end] = mine(packs);
  for (int p = begin; p < end; ++p) {
    Pack part[4] = {all(first), all(first), all(first), all(first)};  // in turn: none waits for the one before
    int k = 0;
    for (; k + 4 <= count; k += 4)
      for (int i = 0; i < 4; ++i) part[i] = join(value(p, k + i), part[i]);
    for (; k < count; ++k) part[0] = join(value(p, k), part[0]);
    of_packs[p] = join(join(part[0], part[1]), join(part[2], part[3]));
  }
  wait();
  Pack total = all(first);
  for (int p = 0; p < packs; ++p) total = join(of_packs[p], total);
  Pack whole = all(get(total, 0));
  for (int lane = 1; lane < kWidth; ++lane) whole = join(all(get(total, lane)), whole);
  return get(whole, 0);
}

#endif

inline Pack plus(Pack a, Pack b) { return a + b; }

template <typename Value>
inline double sum_of(int packs, int count, Value value) {
  return fold(packs, count, 0.0, plus, value);
}
template <typename Value>
inline double largest_of(int packs, int count, Value value) {
  return fold(packs, count, 0.0, larger, value);
}
template <typename Value>
inline double least_of(int packs, int count, double first, Value value) {
  return fold(packs, count, first, smaller, value);
}

}  // namespace jaxscp

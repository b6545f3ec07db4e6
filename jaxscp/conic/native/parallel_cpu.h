// Parallel loops of a team of CPU threads, as ``parallel.h`` describes them.
#pragma once

#include <algorithm>
#include <utility>

#include "parts.h"
#include "team.h"

namespace jaxscp {

#define JAXSCP_CALLED

inline bool uniform(bool known) { return known; }

inline void wait() { this_thread.team->wait(this_thread.rank); }

// This thread's range of ``count`` items: always the same range, which is therefore in its cache.
inline std::pair<int, int> range_of_thread(int count) {
  const long long size = this_thread.team->size(), rank = this_thread.rank;
  return {static_cast<int>(count * rank / size), static_cast<int>(count * (rank + 1) / size)};
}

template <typename Act>
inline void parallel_for(int count, Act act) {
  auto [begin, end] = range_of_thread(count);
  for (int i = begin; i < end; ++i) act(i);
  wait();
}

template <typename Act>
inline void parallel_for_nowait(int packs, Parts parts, Act act) {
  const int count = parts.count();
  auto [begin, end] = range_of_thread(packs * count);
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

template <typename Target, typename Value>
inline void fill(int packs, int count, Target target, Value value) {
  parallel_for(packs, Parts{count}, [&](int p, int i) { target(p, i) = value(p, i); });
}

// On a CPU a team is a single thread.
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
  if (this_thread.rank == 0) act();
  wait();
}

inline void add_up(int* begin, int count) {
  once([&] {
    begin[0] = 0;
    for (int i = 0; i < count; ++i) begin[i + 1] += begin[i];
  });
}

// Start of a phase: lets waiting threads join. False for a thread that leaves.
inline bool admit() {
  this_thread.turn = 0;
  if (this_thread.rank < 0) return (this_thread.rank = this_thread.team->join()) > 0;
  return this_thread.team->admit(this_thread.rank);
}

// End of the last phase: the first thread goes on alone.
inline void dismiss() { this_thread.team->dismiss(); }

// Reduction in an order that does not depend on the number of threads; neither does its result.
template <typename Found, typename Act>
inline Found fold(int packs, Parts parts, Found first, Act act) {
  const int count = parts.count();
  static_assert(Found::kMany <= kMaxTotals);
  constexpr int kTurns = Found::kMany > 1 ? 1 : 4;  // independent sums hide the latency of additions
  Pack* of_packs = this_thread.team->parts(this_thread.turn ^= 1);
  auto [begin, end] = range_of_thread(packs);
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

}  // namespace jaxscp

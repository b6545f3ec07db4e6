// Entries of a vector in one second-order cone, in registers on a GPU.
//
// On a CPU the entries stay in memory. On a GPU, kLanesOfCone lanes share a cone; entry e is in lane e % kLanesOfCone,
// and entries beyond the last are zero. All entries are loaded at once, so that the lanes wait for memory only once.
#pragma once

#include "arena.h"
#include "parallel.h"

namespace jaxscp::soc {

#if defined(__CUDACC__)

constexpr int largest_cone() {
  int largest = 1;
  for (int c = 0; c < kLayout.cone_count; ++c)
    largest = kLayout.cones[c].dimension > largest ? kLayout.cones[c].dimension : largest;
  return largest;
}

struct ConeRegisters {
  static constexpr int kSlots = (largest_cone() + kLanesOfCone - 1) / kLanesOfCone;
  int d;
  Pack slots[kSlots];
  Pack& operator[](int slot) { return slots[slot]; }
  Pack operator[](int slot) const { return slots[slot]; }
};

inline int entry_of(int slot) { return slot * kLanesOfCone + lane_of_cone(); }

// d entries from memory.
inline ConeRegisters load(Entries from, int d) {
  ConeRegisters v{d};
#pragma unroll
  for (int k = 0; k < ConeRegisters::kSlots; ++k) v[k] = entry_of(k) < d ? from[entry_of(k)] : 0.0;
  return v;
}
// Entries that will be computed; on a CPU they are written directly to memory.
inline ConeRegisters output(Entries, int d) { return {d}; }
// Writes the entries to memory.
inline void store(const ConeRegisters& v, Entries to) {
#pragma unroll
  for (int k = 0; k < ConeRegisters::kSlots; ++k)
    if (entry_of(k) < v.d) to[entry_of(k)] = v[k];
}

// v[i] = value(i)
template <typename Value>
inline void each(ConeRegisters& v, Value value) {
#pragma unroll
  for (int k = 0; k < ConeRegisters::kSlots; ++k) v[k] = value(k);
}
// v[i] = value(i, entry), entry being the entry's number.
template <typename Value>
inline void each_entry(ConeRegisters& v, Value value) {
#pragma unroll
  for (int k = 0; k < ConeRegisters::kSlots; ++k) v[k] = entry_of(k) < v.d ? value(k, entry_of(k)) : 0.0;
}

inline Pack sum_over_lanes(Pack part) {
#pragma unroll
  for (int distance = 1; distance < kLanesOfCone; distance *= 2) part += __shfl_xor_sync(kAllLanes, part, distance);
  return part;
}
// Sum of value(i), which must be zero beyond the last entry; ``tail_total`` leaves out the head.
template <typename Value>
inline Pack total(int, Value value) {
  Pack part = 0.0;
#pragma unroll
  for (int k = 0; k < ConeRegisters::kSlots; ++k) part += value(k);
  return sum_over_lanes(part);
}
// This lane's contribution to a'b.
inline Pack part_of_dot(const ConeRegisters& a, const ConeRegisters& b) {
  Pack part = 0.0;
#pragma unroll
  for (int k = 0; k < ConeRegisters::kSlots; ++k) part += a[k] * b[k];
  return part;
}
template <typename Value>
inline Pack tail_total(int d, Value value) {
  return total(d, [&](int k) { return k == 0 && lane_of_cone() == 0 ? 0.0 : value(k); });
}

inline Pack head(const ConeRegisters& v) { return __shfl_sync(kAllLanes, v[0], lane_of_warp() - lane_of_cone()); }
inline void set_head(ConeRegisters& v, Pack value) { v[0] = lane_of_cone() == 0 ? value : v[0]; }

#else

struct ConeRegisters {
  Pack* data;
  int d;
  Pack& operator[](int i) const { return data[i]; }
};

inline ConeRegisters load(Entries from, int d) { return {from, d}; }
inline ConeRegisters output(Entries where, int d) { return {where, d}; }
inline void store(const ConeRegisters&, Entries) {}

template <typename Value>
inline void each(ConeRegisters& v, Value value) {
  for (int i = 0; i < v.d; ++i) v[i] = value(i);
}
template <typename Value>
inline void each_entry(ConeRegisters& v, Value value) {
  for (int i = 0; i < v.d; ++i) v[i] = value(i, i);
}

inline Pack sum(int first, int end, auto value) {
  Pack total[4] = {all(0.0), all(0.0), all(0.0), all(0.0)};  // four independent sums hide the latency of additions
  int i = first;
  for (; i + 4 <= end; i += 4)
    for (int k = 0; k < 4; ++k) total[k] += value(i + k);
  for (; i < end; ++i) total[0] += value(i);
  return (total[0] + total[1]) + (total[2] + total[3]);
}
template <typename Value>
inline Pack total(int d, Value value) {
  return sum(0, d, value);
}
template <typename Value>
inline Pack tail_total(int d, Value value) {
  return sum(1, d, value);
}
inline Pack part_of_dot(const ConeRegisters& a, const ConeRegisters& b) {
  return total(a.d, [&](int i) { return a[i] * b[i]; });
}

inline Pack head(const ConeRegisters& v) { return v[0]; }
inline void set_head(ConeRegisters& v, Pack value) { v[0] = value; }

#endif

}  // namespace jaxscp::soc

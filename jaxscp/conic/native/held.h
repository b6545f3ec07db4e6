// What a cone has of a vector, while it is worked on.
//
// On a CPU it stays where it lies. On a GPU the lanes that share a cone have it in their registers, each every
// so-manieth entry, with zeros beyond the last: all of it comes from memory at once, and the lanes wait but for that.
#pragma once

#include "arena.h"
#include "threads.h"

namespace jaxscp::soc {

#if defined(__CUDACC__)

constexpr int largest_cone() {
  int largest = 1;
  for (int c = 0; c < kLayout.cone_count; ++c)
    largest = kLayout.cones[c].dimension > largest ? kLayout.cones[c].dimension : largest;
  return largest;
}

struct Held {
  static constexpr int kSlots = (largest_cone() + kLanesOfCone - 1) / kLanesOfCone;
  int d;
  Pack slots[kSlots];
  Pack& operator[](int slot) { return slots[slot]; }
  Pack operator[](int slot) const { return slots[slot]; }
};

inline int entry_of(int slot) { return slot * kLanesOfCone + lane_of_cone(); }

// The entries of a vector from here on, so many.
inline Held hold(Entries from, int d) {
  Held v{d};
#pragma unroll
  for (int k = 0; k < Held::kSlots; ++k) v[k] = entry_of(k) < d ? from[entry_of(k)] : 0.0;
  return v;
}
// Room for them.
inline Held room(Entries, int d) { return {d}; }
// Puts them where they belong.
inline void keep(const Held& v, Entries to) {
#pragma unroll
  for (int k = 0; k < Held::kSlots; ++k)
    if (entry_of(k) < v.d) to[entry_of(k)] = v[k];
}

// v[i] = value(i)
template <typename Value>
inline void each(Held& v, Value value) {
#pragma unroll
  for (int k = 0; k < Held::kSlots; ++k) v[k] = value(k);
}
// The same, with the number of the entry: value(i, entry)
template <typename Value>
inline void each_entry(Held& v, Value value) {
#pragma unroll
  for (int k = 0; k < Held::kSlots; ++k) v[k] = entry_of(k) < v.d ? value(k, entry_of(k)) : 0.0;
}

inline Pack of_all_lanes(Pack part) {
#pragma unroll
  for (int apart = 1; apart < kLanesOfCone; apart *= 2) part += __shfl_xor_sync(kEvery, part, apart);
  return part;
}
// The sum of value(i), which is zero beyond the last; and that without the head.
template <typename Value>
inline Pack total(int, Value value) {
  Pack part = 0.0;
#pragma unroll
  for (int k = 0; k < Held::kSlots; ++k) part += value(k);
  return of_all_lanes(part);
}
// What this lane adds to a'b.
inline Pack part_of_dot(const Held& a, const Held& b) {
  Pack part = 0.0;
#pragma unroll
  for (int k = 0; k < Held::kSlots; ++k) part += a[k] * b[k];
  return part;
}
template <typename Value>
inline Pack tail_total(int d, Value value) {
  return total(d, [&](int k) { return k == 0 && lane_of_cone() == 0 ? 0.0 : value(k); });
}

inline Pack head(const Held& v) { return __shfl_sync(kEvery, v[0], lane_of_warp() - lane_of_cone()); }
inline void set_head(Held& v, Pack value) { v[0] = lane_of_cone() == 0 ? value : v[0]; }

#else

struct Held {
  Pack* data;
  int d;
  Pack& operator[](int i) const { return data[i]; }
};

inline Held hold(Entries from, int d) { return {from, d}; }
inline Held room(Entries where, int d) { return {where, d}; }
inline void keep(const Held&, Entries) {}

template <typename Value>
inline void each(Held& v, Value value) {
  for (int i = 0; i < v.d; ++i) v[i] = value(i);
}
template <typename Value>
inline void each_entry(Held& v, Value value) {
  for (int i = 0; i < v.d; ++i) v[i] = value(i, i);
}

inline Pack sum(int first, int end, auto value) {
  Pack total[4] = {all(0.0), all(0.0), all(0.0), all(0.0)};  // four in turn: none waits for the one before
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
inline Pack part_of_dot(const Held& a, const Held& b) {
  return total(a.d, [&](int i) { return a[i] * b[i]; });
}

inline Pack head(const Held& v) { return v[0]; }
inline void set_head(Held& v, Pack value) { v[0] = value; }

#endif

}  // namespace jaxscp::soc

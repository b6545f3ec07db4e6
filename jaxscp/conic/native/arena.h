// Room for arrays: one stretch of memory for a program and its solver, from which each takes what it needs.
#pragma once

#include "layout.h"
#include "parallel.h"

namespace jaxscp {

#if defined(__CUDACC__)
// A number of an array. Said to the compiler, which need not read again after each what is in shared memory: where
// arrays begin, say.
inline double& in_global_memory(double* number) {
#if !defined(JAXSCP_EMULATED_GPU)
  __builtin_assume(__isGlobal(number));
#endif
  return *number;
}
#endif

// The numbers that a vector has at one place. On a GPU those of neighbouring places, which neighbouring threads work
// on, lie side by side.
#if defined(__CUDACC__)
struct Entries {
  double* array;
  unsigned first;
  double& operator[](int i) const { return in_global_memory(array + (first + i * kLayout.packs)); }
  Entries operator+(int i) const { return {array, first + i * kLayout.packs}; }
};
#else
using Entries = Pack*;
#endif

// An array in the arena; copies are of the same numbers.
struct Packs {
  Pack* data = nullptr;
  int size = 0;
#if defined(__CUDACC__)
  Pack& operator[](int i) const { return in_global_memory(data + i); }
#else
  Pack& operator[](int i) const { return data[i]; }
#endif

  // So many of them, from one on.
  Packs part(int first, int count) const { return {data ? data + first : nullptr, count}; }

  // Those at pack p, of ``count`` at every pack.
#if defined(__CUDACC__)
  Entries of(int p, int) const { return {data, static_cast<unsigned>(p)}; }
#else
  Entries of(int p, int count) const { return data + p * count; }
#endif
};

class Arena {
 public:
  // Without memory it only counts.
  explicit Arena(Pack* memory = nullptr) : memory_(memory) {}

  Packs take(int count) {
    Packs taken{memory_ ? memory_ + used_ : nullptr, count};
    used_ += (count + kAligned - 1) / kAligned * kAligned;
    return taken;
  }
  int* take_integers(int count) {
    constexpr int kOfPack = sizeof(Pack) / sizeof(int);
    return reinterpret_cast<int*>(take((count + kOfPack - 1) / kOfPack).data);
  }
  long long used() const { return used_; }

 private:
  static constexpr int kAligned = kStageMultiple / kWidth;

  Pack* memory_;
  long long used_ = 0;
};

// What is read again and again while other numbers pass by. On a GPU shared memory has it, as long as there is room: a
// cache would lose it, and to find an entry would take two turns to memory.
#if defined(__CUDACC__)
class FastIndices {
 public:
  // By one thread: where it is to be.
  int* take(int* global, int count) {
    if (used() + count > kCapacity) return global;
    used() += count;
    return integers() + used() - count;
  }
  // By all.
  static void copy(const int* global, int* fast, int count) {
    parallel_for(fast == global ? 0 : count, [&](int i) { fast[i] = global[i]; });
  }

  FastIndices() {
    once([&] { used() = 0; });
  }

 private:
  static constexpr int kCapacity = 768;
  static int* integers() {
    __shared__ int numbers[kCapacity];
    return numbers;
  }
  static int& used() {
    __shared__ int count;
    return count;
  }
};
#else
struct FastIndices {
  static int* take(int* global, int) { return global; }
  static void copy(const int*, int*, int) {}
};
#endif

}  // namespace jaxscp

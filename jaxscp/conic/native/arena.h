// Arena allocation: the arrays of a program and its solver lie in one block of memory.
#pragma once

#include "indices.h"
#include "parallel.h"

namespace jaxscp {

#if defined(__CUDACC__)
// Number of an array in global memory. Told so, the compiler need not reload shared memory (the arrays' addresses, for
// example) after each write.
inline double& in_global_memory(double* number) {
#if !defined(JAXSCP_EMULATED_GPU)
  __builtin_assume(__isGlobal(number));
#endif
  return *number;
}
#endif

// Numbers of a vector at one stage. On a GPU, numbers of neighbouring stages are adjacent, since neighbouring threads
// process neighbouring stages.
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

// Array in the arena; copies refer to the same numbers.
struct Packs {
  Pack* data = nullptr;
  int size = 0;
#if defined(__CUDACC__)
  Pack& operator[](int i) const { return in_global_memory(data + i); }
#else
  Pack& operator[](int i) const { return data[i]; }
#endif

  // Subarray of ``count`` packs.
  Packs part(int first, int count) const { return {data ? data + first : nullptr, count}; }

  // Entries of stage pack p, with ``count`` entries per pack.
#if defined(__CUDACC__)
  Entries of(int p, int) const { return {data, static_cast<unsigned>(p)}; }
#else
  Entries of(int p, int count) const { return data + p * count; }
#endif
};

class Arena {
 public:
  // Without memory, the arena only adds up the sizes.
  explicit Arena(Pack* memory = nullptr) : memory_(memory) {}

  Packs take(int count) {
    Packs taken{memory_ ? memory_ + used_ : nullptr, count};
    used_ += (count + kAligned - 1) / kAligned * kAligned;
    return taken;
  }
  Index* take_indices(int count) {
    constexpr int kOfPack = sizeof(Pack) / sizeof(Index);
    return reinterpret_cast<Index*>(take((count + kOfPack - 1) / kOfPack).data);
  }
  long long used() const { return used_; }

 private:
  static constexpr int kAligned = kStageMultiple / kWidth;

  Pack* memory_;
  long long used_ = 0;
};

// Indices that are read repeatedly. On a GPU they are copied to shared memory while there is capacity: the cache would
// evict them, and reading an entry would take two accesses to global memory.
#if defined(__CUDACC__)
class FastIndices {
 public:
  // Address of the copy, or of the original if the capacity is used up; called by one thread.
  Index* take(Index* global, int count) {
    if (used() + count > kCapacity) return global;
    used() += count;
    return indices() + used() - count;
  }
  // Copies the indices; called by all threads.
  static void copy(const Index* global, Index* fast, int count) {
    parallel_for(fast == global ? 0 : count, [&](int i) { fast[i] = global[i]; });
  }

  FastIndices() {
    once([&] { used() = 0; });
  }

 private:
  static constexpr int kCapacity = kFastIndices;
  static Index* indices() {
    __shared__ Index numbers[kCapacity];
    return numbers;
  }
  static int& used() {
    __shared__ int count;
    return count;
  }
};
#else
struct FastIndices {
  static Index* take(Index* global, int) { return global; }
  static void copy(const Index*, Index*, int) {}
};
#endif

}  // namespace jaxscp

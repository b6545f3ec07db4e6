// Type of indices of entries in sparse matrices, and how many of them a GPU's block keeps in shared memory.
#pragma once

#include "layout.h"
#if defined(__CUDACC__)
#include "shared_memory.h"
#endif

namespace jaxscp {

#if defined(__CUDACC__)
// Pairs of a row and a column take 16 bits if each takes eight.
template <bool kSmall>
struct IndexType {
  using Type = int;
};
template <>
struct IndexType<true> {
  using Type = unsigned short;
};
constexpr int kMostRows = larger_of(larger_of(kLayout.r, kLayout.u), larger_of(kLayout.n, kLayout.m));
using Index = IndexType<kMostRows <= 256 && kMostRows * kLayout.n < 65535>::Type;  // 65535: no entry
constexpr int kMostIndices = 32 * 1024 / sizeof(Index), kFit = kForIndices / static_cast<int>(sizeof(Index));
constexpr int kFastIndices = kFit < kMostIndices ? kFit : kMostIndices;
#else
using Index = int;
#endif

constexpr int kHalfOfIndex = 4 * sizeof(Index);  // bits
constexpr Index pair_of(int first, int second) { return static_cast<Index>(first << kHalfOfIndex | second); }
constexpr int first_of(Index pair) { return pair >> kHalfOfIndex; }
constexpr int second_of(Index pair) { return pair & ((1 << kHalfOfIndex) - 1); }

}  // namespace jaxscp

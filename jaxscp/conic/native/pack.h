// Eight nodes of the chain at once: a Pack is a number of the mathematics, held for eight places in one register.
//
// Every formula of the interior point is the same at every node. Written for a Pack in place of a number, it reads as
// for one node, and compiles to vector instructions, whatever width the machine has.
#pragma once

#include <cmath>
#include <vector>

namespace jaxscp {

constexpr int kWidth = 8;
typedef double Pack __attribute__((vector_size(kWidth * sizeof(double))));
typedef long long Mask __attribute__((vector_size(kWidth * sizeof(long long))));  // of all ones where it holds
typedef Pack UnalignedPack __attribute__((aligned(sizeof(double))));
using Packs = std::vector<Pack>;

inline Pack all(double v) { return Pack{v, v, v, v, v, v, v, v}; }
inline Pack load(const double* from) { return *reinterpret_cast<const UnalignedPack*>(from); }
inline void store(double* to, Pack v) { *reinterpret_cast<UnalignedPack*>(to) = v; }
inline Pack where(Mask mask, Pack yes, Pack no) { return mask ? yes : no; }
inline Pack larger(Pack a, Pack b) { return a > b ? a : b; }
inline Pack smaller(Pack a, Pack b) { return a < b ? a : b; }
inline Pack magnitude(Pack a) { return a < 0.0 ? -a : a; }

inline Pack root(Pack v) {
  Pack r;
  for (int lane = 0; lane < kWidth; ++lane) r[lane] = std::sqrt(v[lane]);
  return r;
}

// The places one before and one after: of a neighbouring pack at the edge.
inline Pack one_before(Pack before, Pack here) {
  return __builtin_shufflevector(before, here, 7, 8, 9, 10, 11, 12, 13, 14);
}
inline Pack one_after(Pack here, Pack after) {
  return __builtin_shufflevector(here, after, 1, 2, 3, 4, 5, 6, 7, 8);
}

// Places 0, 2, 4 .. and 1, 3, 5 .. of two packs in a row.
inline Pack evens(Pack a, Pack b) { return __builtin_shufflevector(a, b, 0, 2, 4, 6, 8, 10, 12, 14); }
inline Pack odds(Pack a, Pack b) { return __builtin_shufflevector(a, b, 1, 3, 5, 7, 9, 11, 13, 15); }
// Back again: a0 b0 a1 b1 .. in two packs.
inline Pack first_of_pairs(Pack a, Pack b) { return __builtin_shufflevector(a, b, 0, 8, 1, 9, 2, 10, 3, 11); }
inline Pack last_of_pairs(Pack a, Pack b) { return __builtin_shufflevector(a, b, 4, 12, 5, 13, 6, 14, 7, 15); }

inline double sum(Pack v) {
  double total = 0.0;
  for (int lane = 0; lane < kWidth; ++lane) total += v[lane];
  return total;
}
inline double largest(Pack v) {
  double most = v[0];
  for (int lane = 1; lane < kWidth; ++lane) most = v[lane] > most ? v[lane] : most;
  return most;
}
inline double least(Pack v) { return -largest(-v); }

inline Pack dot(const Pack* a, const Pack* b, int size) {
  Pack total[4] = {all(0.0), all(0.0), all(0.0), all(0.0)};  // four sums in turn: none waits for the one before
  int i = 0;
  for (; i + 4 <= size; i += 4)
    for (int k = 0; k < 4; ++k) total[k] += a[i + k] * b[i + k];
  for (; i < size; ++i) total[0] += a[i] * b[i];
  return (total[0] + total[1]) + (total[2] + total[3]);
}

inline int packs_for(int places) { return (places + kWidth - 1) / kWidth; }

}  // namespace jaxscp

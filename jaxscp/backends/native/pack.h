// SIMD register: a Pack holds one number of the mathematics for several locations, such as nodes or intervals.
//
// A formula that is the same at every location is written once, for a Pack in place of a number, and compiles to vector
// instructions. A Pack is as wide as the machine's registers: compilers split comparisons and permutations of wider
// vectors into scalar code. On a GPU, where each thread takes a location (``parallel.h``), a Pack is one number.
#pragma once

#if !defined(__CUDACC__)
#include <cmath>
#include <utility>
#endif

namespace jaxscp {

#if defined(__CUDACC__)
constexpr int kWidth = 1;
#elif defined(__AVX512F__)
constexpr int kWidth = 8;
#elif defined(__AVX__)
constexpr int kWidth = 4;
#else
constexpr int kWidth = 2;
#endif

#if defined(__CUDACC__)

typedef double Pack;
typedef bool Mask;

inline Pack all(double v) { return v; }
// 1 / sqrt(v) and 1 / v to rounding, for v whose inverse is a normal number. A branch for other numbers would double
// the code, and would keep two roots from being computed at once.
#if defined(JAXSCP_EMULATED_GPU)
inline Pack inverse_root(Pack v) { return v > 0.0 ? 1.0 / sqrt(v) : sqrt(-1.0); }
inline Pack inverse(Pack v) { return 1.0 / v; }
#else
inline Pack inverse_root(Pack v) {
  double y;
  asm("rsqrt.approx.ftz.f64 %0, %1;" : "=d"(y) : "d"(v));
  const double error = fma(-v * y, y, 1.0);
  return fma(y * error, __dadd_rn(__dmul_rn(error, 0.375), 0.5), y);
}
inline Pack inverse(Pack v) {
  double y;
  asm("rcp.approx.ftz.f64 %0, %1;" : "=d"(y) : "d"(v));
  const double error = fma(-v, y, 1.0);
  return fma(y, fma(error, error, error), y);
}
#endif
inline Pack root(Pack v) { return v == 0.0 ? 0.0 : v * inverse_root(v); }
inline double get(const Pack& v, int) { return v; }
inline void set(Pack& v, int, double to) { v = to; }
inline Mask within(int pack, int count) { return pack < count; }
inline Pack one_before(Pack before, Pack) { return before; }
inline Pack one_after(Pack, Pack after) { return after; }

#else

typedef double Pack __attribute__((vector_size(kWidth * sizeof(double))));
typedef long long Mask __attribute__((vector_size(kWidth * sizeof(long long))));  // all bits set where true

inline Pack all(double v) { return v - Pack{}; }
inline Pack root(Pack v) {
  Pack r;
  for (int lane = 0; lane < kWidth; ++lane) r[lane] = std::sqrt(v[lane]);
  return r;
}
inline Pack inverse(Pack v) { return 1.0 / v; }
inline Pack inverse_root(Pack v) { return 1.0 / root(v); }
inline double get(const Pack& v, int lane) { return v[lane]; }
inline void set(Pack& v, int lane, double to) { v[lane] = to; }

// function(0, 1, .. kWidth - 1), with constants as arguments.
template <typename Function>
inline auto with_lanes(Function function) {
  return [&]<int... kLane>(std::integer_sequence<int, kLane...>) {
    return function(std::integral_constant<int, kLane>()...);
  }(std::make_integer_sequence<int, kWidth>());
}

// Whether each location of a pack is among the first ``count``.
inline Mask within(int pack, int count) {
  return with_lanes([](auto... lane) { return Mask{lane...}; }) < count - pack * kWidth;
}

// Neighbours one location before and one after; at the edge, from the neighbouring pack.
inline Pack one_before(Pack before, Pack here) {
  return with_lanes([&](auto... lane) { return __builtin_shufflevector(before, here, (lane + kWidth - 1)...); });
}
inline Pack one_after(Pack here, Pack after) {
  return with_lanes([&](auto... lane) { return __builtin_shufflevector(here, after, (lane + 1)...); });
}

// Transpose in place: each round interleaves the rows of the lower half with those of the upper.
inline void transpose(Pack (&v)[kWidth]) {
  const auto interleave = [](auto a, auto b, auto from) {
    return with_lanes([&](auto... lane) {
      return __builtin_shufflevector(a, b, (from + lane / 2 + lane % 2 * kWidth)...);
    });
  };
  for (int round = 1; round < kWidth; round *= 2) {
    Pack interleaved[kWidth];
    for (int i = 0; i < kWidth / 2; ++i) {
      const Pack a = v[i], b = v[i + kWidth / 2];
      interleaved[2 * i] = interleave(a, b, std::integral_constant<int, 0>());
      interleaved[2 * i + 1] = interleave(a, b, std::integral_constant<int, kWidth / 2>());
    }
    for (int i = 0; i < kWidth; ++i) v[i] = interleaved[i];
  }
}

#endif

inline Pack where(Mask mask, Pack yes, Pack no) { return mask ? yes : no; }
inline Pack larger(Pack a, Pack b) { return a > b ? a : b; }
inline Pack smaller(Pack a, Pack b) { return a < b ? a : b; }
inline Pack magnitude(Pack a) { return a < 0.0 ? -a : a; }

inline bool is_finite(double v) { return v - v == 0.0; }

// Packs for so many locations, rounded up to a multiple of ``group_size`` locations.
constexpr int packs_for(int locations, int group_size = kWidth) {
  return (locations + group_size - 1) / group_size * (group_size / kWidth);
}

}  // namespace jaxscp

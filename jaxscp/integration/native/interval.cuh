// Arrays of an interval, and the work of threads; ``interval_source.py`` writes the sizes that come before.
#pragma once

constexpr int kLanes = kThreads / kHalves, kRowsOfHalf = (kInputs + kHalves - 1) / kHalves, kWarp = 32;
static_assert(sizeof(Shared) == kShared * sizeof(double));
constexpr int kExtended = kStates + 1, kArguments = kStates + kControls;
constexpr int kEndsBegin = kExtended + kPoints * Point::kValues;
constexpr double kSize = 1.0 / kSteps;

// The arrays of an interval.
struct Interval {
  const double *w, *hoisted, *point_data, *ends_data, *mask, *multipliers;
  double *outputs, *jacobian, *hessian;
  Shared& m;
};

// Index of the e-th of the values that share a margin, and of its output, by the instance of the group.
template <class Group>
constexpr int value_of(int instance, int e) {
  return e / Group::kSize * Point::kValues + Group::kFirst + instance * Group::kSize + e % Group::kSize;
}
template <class Group>
constexpr int output_of(int instance, int e) {
  return kExtended + kPoints * Group::kFirst + instance * Group::kSize + e / Group::kSize * Group::kRows +
         e % Group::kSize;
}

// act(i) for i < count, each by one thread.
template <typename Act>
inline void by_threads(int count, Act act) {
#pragma unroll 1
  for (int i = threadIdx.x; i < count; i += kThreads) act(i);
}

inline double fraction_of(int step, int stage) { return kSize * (step + kC[stage]); }
inline double fraction_of(int point) { return point * (1.0 / (kPoints - 1)); }

inline void write_controls(const Interval& at, double fraction, double* arguments) {
  by_threads(kControls, [&](int k) {
    const double first = at.w[kStates + k], last = at.w[kStates + kControls + k];
    arguments[kStates + k] = fma(fraction, last - first, first);
  });
}

// Sizes of an interval, and numbers that ``paths.cu`` stores for ``intervals.cu``; ``interval_source.py`` writes what
// comes before.
#pragma once

constexpr int kExtended = kStates + 1, kArguments = kStates + kControls;
constexpr int kEndsBegin = kExtended + kPoints * Point::kValues, kOutputs = kEndsBegin + Ends::kValues;
constexpr double kSize = 1.0 / kSteps;

constexpr int even(int count) { return count + count % 2; }

// Numbers of one interval in an array where those of all intervals alternate, so that neighbouring threads use
// neighbouring numbers.
struct Strided {
  double* first;
  long long stride;
  double& operator[](int k) const { return first[k * stride]; }
  Strided operator+(int k) const { return {first + k * stride, stride}; }
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

// Stride of the numbers of so many intervals: whole blocks of ``paths.cu``.
inline long long stride_of(long long count) { return (count + kPathThreads - 1) / kPathThreads * kPathThreads; }

// Entries of the derivatives of a slope: first ones, then second ones. Those of an interval's slopes follow each other.
constexpr int kSecondAt = even(Rate::kMostEntries);
static_assert(kSecondAt + even(Rate::kMostSecond) == kSlopeEntries && kSlopeEntries % 2 == 0);

inline double fraction_of(int step, int stage) { return kSize * (step + kC[stage]); }
inline double fraction_of(int point) { return point * (1.0 / (kPoints - 1)); }

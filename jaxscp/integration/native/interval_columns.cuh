// Columns of the tangents and of the Hessian, in the steps of ``tangents.h``.
//
// A column, that of one input, belongs to one thread in each half of the block; without a Hessian, the block has one
// half. A thread has the column's tangents in registers, and the half's rows of the Hessian's column. Threads beyond
// the last column repeat it.
#pragma once

#include "interval.cuh"

constexpr int kLanes = kThreads / kHalves, kRowsOfHalf = (kInputs + kHalves - 1) / kHalves;
static_assert(sizeof(Shared) == kShared * sizeof(double));

// The arrays of an interval.
struct Interval {
  const double* hoisted;
  Strided stored;
  double *jacobian, *hessian;
  Shared& m;
};

// Copies stored numbers to ``rows`` rows of shared memory.
template <int kCount, typename Row>
inline void read(Strided stored, int rows, Row row) {
#pragma unroll 1
  for (int i = threadIdx.x; i < rows * kCount; i += kThreads) row(i / kCount)[i % kCount] = stored[i];
}

// Reads the entries of the derivatives at points and ends, and of the margins.
inline void read_entries(const Interval& at) {
  Shared& m = at.m;
  if constexpr (Point::kEntries > 0)
    read<Point::kEntries>(at.stored + kPointEntriesAt, kPoints, [&](int p) { return m.point_entries[p]; });
  read<1>(at.stored + kEndsEntriesAt, Ends::kEntries, [&](int e) { return m.ends_entries + e; });
  read<1>(at.stored + kMarginEntriesAt, kMarginEntries, [&](int e) { return m.margin_entries + e; });
  if constexpr (kOrder > 1) {
    if constexpr (Point::kSecond > 0)
      read<Point::kSecond>(at.stored + kPointSecondAt, kPoints, [&](int p) { return m.point_second[p]; });
    read<1>(at.stored + kEndsSecondAt, Ends::kSecond, [&](int e) { return m.ends_second + e; });
    read<1>(at.stored + kMarginSecondAt, kMarginSecond, [&](int e) { return m.margin_second + e; });
  }
  __syncthreads();
}

// Entries of the derivatives of a step's slopes.
inline void evaluate_slopes(const Interval& at, int step) {
  Shared& m = at.m;
  const int half = threadIdx.x / kLanes, first = step * kStages;
  __syncthreads();
  read<kArguments>(at.stored + (kArgumentsAt + first * kArguments), kStages, [&](int s) { return m.arguments[s]; });
  if constexpr (kOrder > 1)
    read<kExtended>(at.stored + (kSlopeAdjointsAt + first * kExtended), kStages,
                    [&](int s) { return m.slope_adjoints[s]; });
  __syncthreads();
  for (int stage = threadIdx.x % kLanes; stage < kStages; stage += kLanes) {
    if (half == 0) Rate::jacobian(m.arguments[stage], nullptr, at.hoisted, m.entries[stage]);
    if constexpr (kOrder > 1)
      if (half == 1)
        Rate::hessian(m.arguments[stage], m.slope_adjoints[stage], nullptr, at.hoisted, m.second[stage]);
  }
  __syncthreads();
}

// A thread's column: tangents of the path, and the half's rows of the Hessian.
struct Column {
  int input, half;
  double path[kExtended] = {}, hessian[kRowsOfHalf] = {};

  int row(int k) const { return kHalves * k + half; }  // of the k-th entry of ``hessian``

  // Adds to a row of the Hessian, if the half has it.
  void add(int i, double number) {
    if (i % kHalves == half) hessian[i / kHalves] += number;
  }

  // Tangents of the controls at a fraction of the interval, after those of the states.
  void set_controls(double fraction, double (&tangent)[kArguments]) const {
#pragma unroll
    for (int k = 0; k < kControls; ++k)
      tangent[kStates + k] = input == kStates + k               ? 1.0 - fraction
                             : input == kStates + kControls + k ? fraction
                                                                : 0.0;
  }

  // hessian += S' H S, for a function F of states and controls with tangents S.
  template <class F>
  void add_curvature(Shared& m, const double* second, double fraction, const double (&tangent)[kArguments]) {
    double product[kArguments] = {};
    F::hessian_times(second, tangent, product);
    __syncthreads();
#pragma unroll
    for (int r = 0; r < kStates; ++r) m.exchanged[input][r] = tangent[r];
    __syncthreads();
#pragma unroll
    for (int k = 0; k < kRowsOfHalf; ++k)
#pragma unroll
      for (int r = 0; r < kStates; ++r)  // a row of the tangents is zero before its first input
        if (F::curved(r) && kHalves * k + kHalves > first_input(r))
          hessian[k] = fma(m.exchanged[row(k)][r], product[r], hessian[k]);
#pragma unroll
    for (int k = 0; k < kControls; ++k) {
      add(kStates + k, (1.0 - fraction) * product[kStates + k]);
      add(kStates + kControls + k, fraction * product[kStates + k]);
    }
  }

  void evaluate_point(Shared& m, int point) {
    const double fraction = fraction_of(point);
    double tangent[kArguments], found[Point::kMostValues] = {};
#pragma unroll
    for (int r = 0; r < kStates; ++r) tangent[r] = path[r];
    set_controls(fraction, tangent);
    Point::times(m.point_entries[point], tangent, found);
#pragma unroll
    for (int v = 0; v < Point::kValues; ++v) m.value_tangents[point * Point::kValues + v][input] = found[v];
    if constexpr (kOrder > 1 && Point::kSecond > 0)
      add_curvature<Point>(m, m.point_second[point], fraction, tangent);
  }

  // Adds a stage's slope to the tangents at the step's end.
  void evaluate_stage(Shared& m, int step, int stage, double (&end)[kExtended]) {
    double tangent[kArguments], slope[kExtended] = {};
#pragma unroll
    for (int r = 0; r < kStates; ++r) tangent[r] = path[r];
#pragma unroll 1
    for (int j = 0; j < stage; ++j)
#pragma unroll
      for (int r = 0; r < kStates; ++r)
        tangent[r] = fma(kSize * kA[stage][j], m.slope_tangents[j][r][input], tangent[r]);
    set_controls(fraction_of(step, stage), tangent);
    Rate::times(m.entries[stage], tangent, slope);
    if (stage + 1 < kStages)
#pragma unroll
      for (int r = 0; r < kStates; ++r) m.slope_tangents[stage][r][input] = slope[r];
#pragma unroll
    for (int r = 0; r < kExtended; ++r) end[r] = fma(kSize * kB[stage], slope[r], end[r]);
    if constexpr (kOrder > 1) add_curvature<Rate>(m, m.second[stage], fraction_of(step, stage), tangent);
  }

  void integrate(const Interval& at) {
    Shared& m = at.m;
#pragma unroll
    for (int r = 0; r < kStates; ++r) path[r] = input == r ? 1.0 : 0.0;
    evaluate_point(m, 0);
#pragma unroll 1
    for (int step = 0; step < kSteps; ++step) {
      evaluate_slopes(at, step);
      double end[kExtended];
#pragma unroll
      for (int r = 0; r < kExtended; ++r) end[r] = path[r];
#pragma unroll 1
      for (int stage = 0; stage < kStages; ++stage) evaluate_stage(m, step, stage, end);
#pragma unroll
      for (int r = 0; r < kExtended; ++r) path[r] = end[r];
      if ((step + 1) % kStepsPerSubinterval == 0) evaluate_point(m, (step + 1) / kStepsPerSubinterval);
    }
#pragma unroll
    for (int r = 0; r < kExtended; ++r) at.jacobian[r * kInputs + input] = path[r];
  }

  void subtract_margins(const Interval& at) {
    Shared& m = at.m;
    __syncthreads();
    for_groups([&](auto group) {
      using Group = decltype(group);
      using Margin = typename Group::Margin;
#pragma unroll 1
      for (int k = 0; k < Group::kInstances; ++k) {
        double tangent[Margin::kArguments], found[Margin::kValues] = {};
#pragma unroll
        for (int e = 0; e < Margin::kArguments; ++e) tangent[e] = m.value_tangents[value_of<Group>(k, e)][input];
        Margin::times(m.margin_entries + Group::entries_of(k), tangent, found);
#pragma unroll
        for (int e = 0; e < Margin::kValues; ++e) at.jacobian[output_of<Group>(k, e) * kInputs + input] = found[e];
        if constexpr (kOrder > 1) {
          double product[Margin::kArguments] = {};
          Margin::hessian_times(m.margin_second + Group::second_of(k), tangent, product);
#pragma unroll
          for (int e = 0; e < Margin::kArguments; ++e)
#pragma unroll
            for (int i = 0; i < kRowsOfHalf; ++i)
              hessian[i] = fma(m.value_tangents[value_of<Group>(k, e)][row(i)], product[e], hessian[i]);
        }
      }
    });
  }

  void evaluate_ends(const Interval& at) {
    double unit[kInputs], found[Ends::kMostValues] = {};
#pragma unroll
    for (int i = 0; i < kInputs; ++i) unit[i] = input == i ? 1.0 : 0.0;
    Ends::times(at.m.ends_entries, unit, found);
#pragma unroll
    for (int v = 0; v < Ends::kValues; ++v) at.jacobian[(kEndsBegin + v) * kInputs + input] = found[v];
    if constexpr (kOrder > 1) {
      double product[kInputs] = {};
      Ends::hessian_times(at.m.ends_second, unit, product);
#pragma unroll
      for (int i = 0; i < kInputs; ++i) add(i, product[i]);
    }
  }

  // The column's part of the symmetric Hessian.
  void write_hessian(double* to) const {
#pragma unroll
    for (int k = 0; k < kRowsOfHalf; ++k)
      if (const int i = row(k); i <= input) to[i * kInputs + input] = to[input * kInputs + i] = hessian[k];
  }
};

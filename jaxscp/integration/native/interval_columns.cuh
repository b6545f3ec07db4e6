// Columns of the tangents and the Hessian, in the steps of ``tangents.h``.
//
// A column, of one input, belongs to one thread, which has the column's tangents in registers. Threads beyond the last
// column repeat it: they write equal numbers to the same places. The Hessian is a sum of products S' H S, by tensor
// cores: S and H S are exchanged between the columns in shared memory.
#pragma once

#include "hessian_tiles.cuh"
#include "interval.cuh"

static_assert(sizeof(Shared) == kShared * sizeof(double));

// The arrays of an interval.
struct Interval {
  Strided stored;
  const double* of_slopes;
  double *jacobian, *hessian;
  Shared& m;
};

// Copies stored numbers to shared memory.
inline void read(Strided stored, int count, double* to) {
#pragma unroll 1
  for (int i = threadIdx.x; i < count; i += kThreads) to[i] = stored[i];
}

// Entries of the derivatives at the points.
inline void read_point_entries(const Interval& at) {
  Integrating& m = at.m.integrating;
  if constexpr (Point::kEntries > 0)
    for (int p = 0; p < kPoints; ++p)
      read(at.stored + (kPointEntriesAt + p * Point::kEntries), Point::kEntries, m.point_entries[p]);
  if constexpr (kOrder > 1 && Point::kSecond > 0)
    for (int p = 0; p < kPoints; ++p)
      read(at.stored + (kPointSecondAt + p * Point::kSecond), Point::kSecond, m.point_second[p]);
  __syncthreads();
}

// Entries of the derivatives of a step's slopes.
inline void read_slope_entries(const Interval& at, int step) {
  constexpr int kPairs = kStages * kSlopeEntries / 2;
  const auto* from = reinterpret_cast<const double2*>(at.of_slopes + step * kStages * kSlopeEntries);
  auto* to = reinterpret_cast<double2*>(at.m.integrating.slope_entries);
  __syncthreads();
#pragma unroll
  for (int i = 0; i < kPairs; i += kThreads)
    if (const int k = i + threadIdx.x; k < kPairs) to[k] = from[k];
  __syncthreads();
}

// A thread's column: tangents of the path, and what the controls, as arguments, add to the Hessian's column: that needs
// no exchange. The tiles are the thread's share of the whole Hessian.
struct Column {
  int input;
  double path[kExtended] = {}, of_controls[2 * kControls + 1] = {};  // at least one number
  HessianTiles hessian;

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
  void add_curvature(Integrating& m, const double* second, double fraction, const double (&tangent)[kArguments]) {
    double product[kArguments] = {};
    F::hessian_times(second, tangent, product);
    __syncthreads();
#pragma unroll
    for (int r = 0; r < kStates; ++r)
      if (const int row = F::curved_row(r); row >= 0)
        m.tangents[row][input] = tangent[r], m.products[row][input] = product[r];
    __syncthreads();
    hessian.add<F::kCurved>([&](int row) { return m.tangents[row]; }, m.products);
#pragma unroll
    for (int k = 0; k < kControls; ++k) {
      of_controls[k] = fma(1.0 - fraction, product[kStates + k], of_controls[k]);
      of_controls[kControls + k] = fma(fraction, product[kStates + k], of_controls[kControls + k]);
    }
  }

  // Tangents of the values at a point, in the Jacobian's rows for the time being.
  void evaluate_point(const Interval& at, int point) {
    Integrating& m = at.m.integrating;
    const double fraction = fraction_of(point);
    double tangent[kArguments], found[Point::kMostValues] = {};
#pragma unroll
    for (int r = 0; r < kStates; ++r) tangent[r] = path[r];
    set_controls(fraction, tangent);
    Point::times(m.point_entries[point], tangent, found);
#pragma unroll
    for (int v = 0; v < Point::kValues; ++v)
      at.jacobian[(kExtended + point * Point::kValues + v) * kInputs + input] = found[v];
    if constexpr (kOrder > 1 && Point::kSecond > 0)
      add_curvature<Point>(m, m.point_second[point], fraction, tangent);
  }

  // Adds a stage's slope to the tangents at the step's end.
  void evaluate_stage(Integrating& m, int step, int stage, double (&end)[kExtended]) {
    double tangent[kArguments], slope[kExtended] = {};
#pragma unroll
    for (int r = 0; r < kStates; ++r) tangent[r] = path[r];
#pragma unroll 1
    for (int j = 0; j < stage; ++j)
#pragma unroll
      for (int r = 0; r < kStates; ++r)
        if (const int row = needed_row(r); row >= 0)
          tangent[r] = fma(kSize * kA[stage][j], m.slope_tangents[j][row][input], tangent[r]);
    set_controls(fraction_of(step, stage), tangent);
    Rate::times(m.slope_entries[stage], tangent, slope);
    if (stage + 1 < kStages)
#pragma unroll
      for (int r = 0; r < kStates; ++r)
        if (const int row = needed_row(r); row >= 0) m.slope_tangents[stage][row][input] = slope[r];
#pragma unroll
    for (int r = 0; r < kExtended; ++r) end[r] = fma(kSize * kB[stage], slope[r], end[r]);
    if constexpr (kOrder > 1)
      add_curvature<Rate>(m, m.slope_entries[stage] + kSecondAt, fraction_of(step, stage), tangent);
  }

  void integrate(const Interval& at) {
    read_point_entries(at);
#pragma unroll
    for (int r = 0; r < kStates; ++r) path[r] = input == r ? 1.0 : 0.0;
    evaluate_point(at, 0);
#pragma unroll 1
    for (int step = 0; step < kSteps; ++step) {
      read_slope_entries(at, step);
      double end[kExtended];
#pragma unroll
      for (int r = 0; r < kExtended; ++r) end[r] = path[r];
#pragma unroll 1
      for (int stage = 0; stage < kStages; ++stage) evaluate_stage(at.m.integrating, step, stage, end);
#pragma unroll
      for (int r = 0; r < kExtended; ++r) path[r] = end[r];
      if ((step + 1) % kStepsPerSubinterval == 0) evaluate_point(at, (step + 1) / kStepsPerSubinterval);
    }
#pragma unroll
    for (int r = 0; r < kExtended; ++r) at.jacobian[r * kInputs + input] = path[r];
  }

  // Replaces the values' tangents in the Jacobian by the margins', and adds the margins' curvature.
  void subtract_margins(const Interval& at) {
    Margins& m = at.m.margins;
    __syncthreads();
    read(at.stored + kMarginEntriesAt, kMarginEntries, m.entries);
    if constexpr (kOrder > 1) read(at.stored + kMarginSecondAt, kMarginSecond, m.second);
#pragma unroll 1
    for (int v = 0; v < kPoints * Point::kValues; ++v)
      m.tangents[v][input] = at.jacobian[(kExtended + v) * kInputs + input];
    __syncthreads();
    for_groups([&](auto group) {
      using Group = decltype(group);
      using Margin = typename Group::Margin;
#pragma unroll 1
      for (int k = 0; k < Group::kInstances; ++k) {
        double tangent[Margin::kArguments], found[Margin::kValues] = {};
#pragma unroll
        for (int e = 0; e < Margin::kArguments; ++e) tangent[e] = m.tangents[value_of<Group>(k, e)][input];
        Margin::times(m.entries + Group::entries_of(k), tangent, found);
#pragma unroll
        for (int e = 0; e < Margin::kValues; ++e) at.jacobian[output_of<Group>(k, e) * kInputs + input] = found[e];
        if constexpr (kOrder > 1) {
          double product[Margin::kArguments] = {};
          Margin::hessian_times(m.second + Group::second_of(k), tangent, product);
          __syncthreads();
#pragma unroll
          for (int e = 0; e < Margin::kArguments; ++e) m.products[e][input] = product[e];
          __syncthreads();
          hessian.add<Margin::kArguments>([&](int e) { return m.tangents[value_of<Group>(k, e)]; }, m.products);
        }
      }
    });
  }

  // Jacobian of the values at the ends.
  void evaluate_ends(const Interval& at) const {
    double unit[kInputs], found[Ends::kMostValues] = {};
#pragma unroll
    for (int i = 0; i < kInputs; ++i) unit[i] = input == i ? 1.0 : 0.0;
    Ends::times(at.stored + kEndsEntriesAt, unit, found);
#pragma unroll
    for (int v = 0; v < Ends::kValues; ++v) at.jacobian[(kEndsBegin + v) * kInputs + input] = found[v];
  }

  // The symmetric Hessian: what the tiles have, the rows of the controls, and the curvature at the ends.
  void write_hessian(const Interval& at) const {
    double(&sums)[kInputs][kRow] = at.m.sums.hessian;
    double unit[kInputs], column[kInputs] = {};
#pragma unroll
    for (int i = 0; i < kInputs; ++i) unit[i] = input == i ? 1.0 : 0.0;
    Ends::hessian_times(at.stored + kEndsSecondAt, unit, column);
#pragma unroll
    for (int k = 0; k < 2 * kControls; ++k) column[kStates + k] += of_controls[k];
    __syncthreads();
    hessian.write_lower(sums);
    __syncthreads();
    if (threadIdx.x < kInputs)
#pragma unroll
      for (int i = 0; i < kInputs; ++i)
        if (i >= input) sums[i][input] += column[i];
    __syncthreads();
#pragma unroll 1
    for (int e = threadIdx.x; e < kInputs * kInputs; e += kThreads) {
      const int i = e / kInputs, j = e % kInputs;
      at.hessian[e] = i >= j ? sums[i][j] : sums[j][i];
    }
  }
};

// Columns of the tangents and of the Hessian, in the steps of ``tangents.h``.
//
// A column, that of one input, belongs to one thread in each half of the block; without a Hessian, the block has one
// half. A thread has the column's tangents in registers, and the half's rows of the Hessian's column. Threads beyond
// the last column repeat it.
#pragma once

#include "interval.cuh"

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

  void evaluate_stage(Shared& m, int step, int stage) {
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
#pragma unroll
    for (int r = 0; r < kExtended; ++r) m.slope_tangents[stage][r][input] = slope[r];
    if constexpr (kOrder > 1) add_curvature<Rate>(m, m.second[stage], fraction_of(step, stage), tangent);
  }

  void integrate(const Interval& at) {
    Shared& m = at.m;
#pragma unroll
    for (int r = 0; r < kStates; ++r) path[r] = input == r ? 1.0 : 0.0;
    evaluate_point(m, 0);
#pragma unroll 1
    for (int step = 0; step < kSteps; ++step) {
      __syncthreads();
      for (int stage = threadIdx.x % kLanes; stage < kStages; stage += kLanes) {
        const int slope = step * kStages + stage;
        if (half == 0) Rate::jacobian(m.arguments[slope], nullptr, at.hoisted, m.entries[stage]);
        if (kOrder > 1 && half == 1)
          Rate::hessian(m.arguments[slope], m.slope_adjoints[slope], nullptr, at.hoisted, m.second[stage]);
      }
      __syncthreads();
#pragma unroll 1
      for (int stage = 0; stage < kStages; ++stage) evaluate_stage(m, step, stage);
#pragma unroll 1
      for (int j = 0; j < kStages; ++j)
#pragma unroll
        for (int r = 0; r < kExtended; ++r) path[r] = fma(kSize * kB[j], m.slope_tangents[j][r][input], path[r]);
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
        Margin::times(m.margin_entries + Group::kEntriesAt + k * Margin::kEntries, tangent, found);
#pragma unroll
        for (int e = 0; e < Margin::kValues; ++e) at.jacobian[output_of<Group>(k, e) * kInputs + input] = found[e];
        if constexpr (kOrder > 1) {
          double product[Margin::kArguments] = {};
          Margin::hessian_times(m.margin_second + Group::kSecondAt + k * Margin::kSecond, tangent, product);
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

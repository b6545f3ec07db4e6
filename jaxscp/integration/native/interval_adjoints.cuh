// Adjoints of an interval, in the steps of ``adjoint.h``.
#pragma once

#include "interval.cuh"

// Adds the adjoint of the state from the rows at a point.
inline void add_point_adjoint(const Interval& at, int point) {
  Shared& m = at.m;
  __syncthreads();
  if (threadIdx.x < kWarp) {
    double sums[kArguments] = {};
    Point::transposed(m.point_entries[point], m.value_adjoints + point * Point::kValues, sums);
    if (threadIdx.x == 0)
      for (int r = 0; r < kStates; ++r) m.state_adjoint[r] += sums[r];
  }
  __syncthreads();
}

// Adjoints of the values at the points and of the slopes; entries of the Hessians at the points.
inline void find_adjoints(const Interval& at) {
  Shared& m = at.m;
  for_groups([&](auto group) {
    using Group = decltype(group);
    using Margin = typename Group::Margin;
    by_threads(Group::kInstances, [&](int k) {
      double sums[Margin::kArguments] = {}, multipliers[Margin::kValues];
      for (int e = 0; e < Margin::kValues; ++e) multipliers[e] = at.multipliers[output_of<Group>(k, e)];
      Margin::transposed(m.margin_entries + Group::kEntriesAt + k * Margin::kEntries, multipliers, sums);
      for (int e = 0; e < Margin::kArguments; ++e) m.value_adjoints[value_of<Group>(k, e)] = sums[e];
    });
  });
  by_threads(kStates, [&](int r) { m.state_adjoint[r] = at.multipliers[r]; });
  add_point_adjoint(at, kPoints - 1);
  by_threads(kPoints, [&](int p) {
    const double* adjoints = m.value_adjoints + p * Point::kValues;
    Point::hessian(m.point_arguments[p], adjoints, at.point_data, at.hoisted, m.point_second[p]);
  });
#pragma unroll 1
  for (int step = kSteps - 1; step >= 0; --step) {
    by_threads(kStages, [&](int stage) {
      Rate::jacobian(m.arguments[step * kStages + stage], nullptr, at.hoisted, m.entries[stage]);
    });
#pragma unroll 1
    for (int stage = kStages - 1; stage >= 0; --stage) {
      double* adjoints = m.slope_adjoints[step * kStages + stage];
      by_threads(kExtended, [&](int r) {
        double sum = kB[stage] * (r < kStates ? m.state_adjoint[r] : at.multipliers[kStates]);
        if (r < kStates)
          for (int i = stage + 1; i < kStages; ++i) sum = fma(kA[i][stage], m.stage_adjoints[i][r], sum);
        adjoints[r] = kSize * sum;
      });
      __syncthreads();
      if (threadIdx.x < kWarp) {
        double sums[kArguments] = {};
        Rate::transposed(m.entries[stage], adjoints, sums);
        if (threadIdx.x == 0)
          for (int r = 0; r < kStates; ++r) m.stage_adjoints[stage][r] = sums[r];
      }
      __syncthreads();
    }
    by_threads(kStates, [&](int r) {
      for (int i = 0; i < kStages; ++i) m.state_adjoint[r] += m.stage_adjoints[i][r];
    });
    if (step % kStepsPerSubinterval == 0) add_point_adjoint(at, step / kStepsPerSubinterval);
  }
  __syncthreads();
}

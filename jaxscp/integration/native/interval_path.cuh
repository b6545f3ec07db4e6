// Path and outputs of an interval, with the entries of Jacobians and Hessians at its points, in the steps of
// ``forward.h``.
#pragma once

#include "interval.cuh"

inline void note_point(const Interval& at, int point) {
  double* to = at.m.point_arguments[point];
  by_threads(kStates, [&](int r) { to[r] = at.m.state[r]; });
  write_controls(at, fraction_of(point), to);
}

// State at the end; arguments of every slope and point.
inline void integrate(const Interval& at) {
  Shared& m = at.m;
  by_threads(kExtended, [&](int r) { m.state[r] = r < kStates ? at.w[r] : 0.0; });
  note_point(at, 0);
#pragma unroll 1
  for (int step = 0; step < kSteps; ++step) {
#pragma unroll 1
    for (int stage = 0; stage < kStages; ++stage) {
      double* arguments = m.arguments[step * kStages + stage];
      by_threads(kStates, [&](int r) {
        double sum = m.state[r];
        for (int j = 0; j < stage; ++j) sum = fma(kSize * kA[stage][j], m.slopes[j][r], sum);
        arguments[r] = sum;
      });
      write_controls(at, fraction_of(step, stage), arguments);
      __syncthreads();
      if (threadIdx.x < kWarp) {
        double found[kExtended];
        Rate::values(arguments, nullptr, at.hoisted, found);
        if (threadIdx.x == 0)
          for (int r = 0; r < kExtended; ++r) m.slopes[stage][r] = found[r];
      }
      __syncthreads();
    }
    by_threads(kExtended, [&](int r) {
      for (int j = 0; j < kStages; ++j) m.state[r] = fma(kSize * kB[j], m.slopes[j][r], m.state[r]);
    });
    if ((step + 1) % kStepsPerSubinterval == 0) note_point(at, (step + 1) / kStepsPerSubinterval);
  }
  __syncthreads();
}

inline void find_outputs(const Interval& at) {
  Shared& m = at.m;
  by_threads(kExtended, [&](int r) { at.outputs[r] = m.state[r]; });
  by_threads(kPoints, [&](int p) {
    Point::values(m.point_arguments[p], at.point_data, at.hoisted, m.values + p * Point::kValues);
    if constexpr (kOrder > 0) Point::jacobian(m.point_arguments[p], at.point_data, at.hoisted, m.point_entries[p]);
  });
  by_threads(1, [&](int) {
    Ends::values(at.w, at.ends_data, at.hoisted, at.outputs + kEndsBegin);
    if constexpr (kOrder > 0) Ends::jacobian(at.w, at.ends_data, at.hoisted, m.ends_entries);
    if constexpr (kOrder > 1)
      Ends::hessian(at.w, at.multipliers + kEndsBegin, at.ends_data, at.hoisted, m.ends_second);
  });
  __syncthreads();
  for_groups([&](auto group) {
    using Group = decltype(group);
    using Margin = typename Group::Margin;
    by_threads(Group::kInstances, [&](int k) {
      double values[Margin::kArguments], found[Margin::kValues], multipliers[Margin::kValues];
      for (int e = 0; e < Margin::kArguments; ++e) values[e] = m.values[value_of<Group>(k, e)];
      Margin::values(values, at.mask, at.hoisted, found);
      for (int e = 0; e < Margin::kValues; ++e) at.outputs[output_of<Group>(k, e)] = found[e];
      if constexpr (kOrder > 0)
        Margin::jacobian(values, at.mask, at.hoisted, m.margin_entries + Group::kEntriesAt + k * Margin::kEntries);
      if constexpr (kOrder > 1) {
        for (int e = 0; e < Margin::kValues; ++e) multipliers[e] = at.multipliers[output_of<Group>(k, e)];
        double* second = m.margin_second + Group::kSecondAt + k * Margin::kSecond;
        Margin::hessian(values, multipliers, at.mask, at.hoisted, second);
      }
    });
  });
  __syncthreads();
}

// The kernel that integrates an interval by a block of threads, with derivatives up to order kOrder, in the steps of
// ``forward.h``, ``adjoint.h`` and ``tangents.h``. ``interval_source.py`` writes what comes before this text: sizes,
// tableau, the struct of the shared memory, and the functions of the problem with their sparse products.
//
// Each column of the tangents and of the Hessian, that of one input, belongs to two threads, one in each half of the
// block. Both have the column's tangents in registers, and every other row of the Hessian's column. Threads beyond the
// last column repeat it. What does not depend on a column is computed by one thread for each slope, point or row, or
// by the first warp.

constexpr int kHalves = 2, kLanes = kThreads / kHalves, kRowsOfHalf = (kInputs + kHalves - 1) / kHalves, kWarp = 32;
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

// ---- Path ----

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

// ---- Outputs, and entries of their Jacobians and Hessians ----

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

// ---- Adjoints ----

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

// ---- Tangents ----

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

// ``intervals`` intervals share hoisted constants; there is a block for each interval.
extern "C" __global__ void __launch_bounds__(kThreads)
    jaxscp_kernel(const double* __restrict__ w, const double* __restrict__ hoisted, const double* __restrict__ data,
                  const double* __restrict__ multipliers, double* __restrict__ outputs, double* __restrict__ jacobian,
                  double* __restrict__ hessian, long long, long long intervals) {
#if defined(JAXSCP_EMULATED_GPU)
  alignas(16) static double memory[kShared];
#else
  extern __shared__ double2 memory[];
#endif
  constexpr int kOutputs = kEndsBegin + Ends::kValues;
  const long long i = blockIdx.x;
  data += i * (kPointData + kEndsData + kPoints);
  const Interval at{w + i * kInputs, hoisted + i / intervals * kHoisted, data, data + kPointData,
                    data + kPointData + kEndsData, multipliers + i * kOutputs, outputs + i * kOutputs,
                    jacobian + i * kOutputs * kInputs, hessian + i * kInputs * kInputs,
                    *reinterpret_cast<Shared*>(memory)};
  integrate(at);
  find_outputs(at);
  if constexpr (kOrder > 1) find_adjoints(at);
  if constexpr (kOrder > 0) {
    const int lane = threadIdx.x % kLanes;
    Column column{lane < kInputs ? lane : kInputs - 1, static_cast<int>(threadIdx.x) / kLanes};
    column.integrate(at);
    column.subtract_margins(at);
    column.evaluate_ends(at);
    if constexpr (kOrder > 1) column.write_hessian(at.hessian);
  }
}

// Path and outputs of an interval, and adjoints, by one thread in the steps of ``forward.h`` and ``adjoint.h``.
#pragma once

#include "interval.cuh"

static_assert(kPathThreads == 32, "a block is a warp");

// Derivatives of a slope, of the warp's threads; a row's length is odd, so that threads use different banks.
using SlopeRows = double[kPathThreads][kSlopeEntries + 1];
static_assert(sizeof(SlopeRows) == kPathShared * sizeof(double));

// Threads beyond the last interval repeat it, and write no outputs; they store numbers of their own.
struct Path {
  const double *w, *hoisted, *point_data, *ends_data, *mask, *multipliers;
  double* outputs;
  Strided stored;
  double* of_slopes;
  SlopeRows& slopes;
  int rows;  // intervals of the block
  double state[kExtended], state_adjoint[kStates];

  Path(const double* w, const double* hoisted, const double* data, const double* multipliers, double* outputs,
       Strided stored, double* of_slopes, SlopeRows& slopes, int rows)
      : w(w), hoisted(hoisted), point_data(data), ends_data(data + kPointData), mask(data + kPointData + kEndsData),
        multipliers(multipliers), outputs(outputs), stored(stored), of_slopes(of_slopes), slopes(slopes), rows(rows) {}

  // Values at the points, later their adjoints.
  Strided values(int first) const { return stored + (kValuesAt + first); }

  void write(int output, double value) const {
    if (threadIdx.x < rows) outputs[output] = value;
  }

  // Where the thread leaves a slope's derivatives for ``store_slope``.
  double* entries() const { return slopes[threadIdx.x]; }

  // Stores the derivatives of a slope: neighbouring threads write neighbouring numbers of one interval.
  void store_slope(int slope) const {
    double* to = of_slopes + slope * kSlopeEntries;
    __syncwarp();
#pragma unroll 4
    for (int row = 0; row < rows; ++row, to += kSteps * kStages * kSlopeEntries)
#pragma unroll
      for (int begin = 0; begin < kSlopeEntries; begin += kPathThreads)
        if (const int k = begin + threadIdx.x; k < kSlopeEntries) to[k] = slopes[row][k];
    __syncwarp();
  }

  void write_controls(double fraction, double* arguments) const {
    for (int k = 0; k < kControls; ++k) {
      const double first = w[kStates + k], last = w[kStates + kControls + k];
      arguments[kStates + k] = fma(fraction, last - first, first);
    }
  }

  // Values at a point, from the state there.
  void evaluate_point(int point) {
    double arguments[kArguments];
    for (int r = 0; r < kStates; ++r) arguments[r] = state[r];
    write_controls(fraction_of(point), arguments);
    Point::values(arguments, point_data, hoisted, values(point * Point::kValues));
    if constexpr (kOrder > 0)
      Point::jacobian(arguments, point_data, hoisted, stored + (kPointEntriesAt + point * Point::kEntries));
    if constexpr (kOrder > 1)
      for (int k = 0; k < kArguments; ++k) stored[kPointArgumentsAt + point * kArguments + k] = arguments[k];
  }

  // State at the end, and values at the points.
  void integrate() {
    for (int r = 0; r < kExtended; ++r) state[r] = r < kStates ? w[r] : 0.0;
    evaluate_point(0);
#pragma unroll 1
    for (int step = 0; step < kSteps; ++step) {
      double rates[kStages][kExtended];
#pragma unroll 1
      for (int stage = 0; stage < kStages; ++stage) {
        double arguments[kArguments];
        for (int r = 0; r < kStates; ++r) arguments[r] = state[r];
#pragma unroll 1
        for (int j = 0; j < stage; ++j)
          for (int r = 0; r < kStates; ++r) arguments[r] = fma(kSize * kA[stage][j], rates[j][r], arguments[r]);
        write_controls(fraction_of(step, stage), arguments);
        if constexpr (kOrder > 1)
          for (int k = 0; k < kArguments; ++k)
            stored[kArgumentsAt + (step * kStages + stage) * kArguments + k] = arguments[k];
        if constexpr (kOrder == 1) {
          Rate::jacobian(arguments, nullptr, hoisted, entries());
          store_slope(step * kStages + stage);
        }
        Rate::values(arguments, nullptr, hoisted, rates[stage]);
      }
#pragma unroll 1
      for (int j = 0; j < kStages; ++j)
        for (int r = 0; r < kExtended; ++r) state[r] = fma(kSize * kB[j], rates[j][r], state[r]);
      if ((step + 1) % kStepsPerSubinterval == 0) evaluate_point((step + 1) / kStepsPerSubinterval);
    }
  }

  void find_outputs() {
    double at_ends[Ends::kMostValues];
    for (int r = 0; r < kExtended; ++r) write(r, state[r]);
    Ends::values(w, ends_data, hoisted, at_ends);
    for (int v = 0; v < Ends::kValues; ++v) write(kEndsBegin + v, at_ends[v]);
    if constexpr (kOrder > 0) Ends::jacobian(w, ends_data, hoisted, stored + kEndsEntriesAt);
    if constexpr (kOrder > 1) Ends::hessian(w, multipliers + kEndsBegin, ends_data, hoisted, stored + kEndsSecondAt);
    for_groups([&](auto group) {
      using Group = decltype(group);
      using Margin = typename Group::Margin;
#pragma unroll 1
      for (int k = 0; k < Group::kInstances; ++k) {
        double of_margin[Margin::kArguments], found[Margin::kValues], weights[Margin::kValues];
        for (int e = 0; e < Margin::kArguments; ++e) of_margin[e] = values(0)[value_of<Group>(k, e)];
        Margin::values(of_margin, mask, hoisted, found);
        for (int e = 0; e < Margin::kValues; ++e) write(output_of<Group>(k, e), found[e]);
        if constexpr (kOrder > 0)
          Margin::jacobian(of_margin, mask, hoisted, stored + (kMarginEntriesAt + Group::entries_of(k)));
        if constexpr (kOrder > 1) {
          for (int e = 0; e < Margin::kValues; ++e) weights[e] = multipliers[output_of<Group>(k, e)];
          Margin::hessian(of_margin, weights, mask, hoisted, stored + (kMarginSecondAt + Group::second_of(k)));
        }
      }
    });
  }

  // Adjoints of the values at the points, in their place.
  void find_value_adjoints() {
    for_groups([&](auto group) {
      using Group = decltype(group);
      using Margin = typename Group::Margin;
#pragma unroll 1
      for (int k = 0; k < Group::kInstances; ++k) {
        double sums[Margin::kArguments] = {}, weights[Margin::kValues];
        for (int e = 0; e < Margin::kValues; ++e) weights[e] = multipliers[output_of<Group>(k, e)];
        Margin::transposed(stored + (kMarginEntriesAt + Group::entries_of(k)), weights, sums);
        for (int e = 0; e < Margin::kArguments; ++e) values(0)[value_of<Group>(k, e)] = sums[e];
      }
    });
  }

  // Adds the adjoint of the state from the values at a point, and stores their Hessian.
  void add_point_adjoint(int point) {
    const Strided adjoints = values(point * Point::kValues);
    double sums[kArguments] = {};
    Point::transposed(stored + (kPointEntriesAt + point * Point::kEntries), adjoints, sums);
    for (int r = 0; r < kStates; ++r) state_adjoint[r] += sums[r];
    Point::hessian(stored + (kPointArgumentsAt + point * kArguments), adjoints, point_data, hoisted,
                   stored + (kPointSecondAt + point * Point::kSecond));
  }

  // Adjoints of the values and of the slopes, and the slopes' second derivatives, backwards from the multipliers of the
  // outputs.
  void find_adjoints() {
    find_value_adjoints();
    for (int r = 0; r < kStates; ++r) state_adjoint[r] = multipliers[r];
    add_point_adjoint(kPoints - 1);
#pragma unroll 1
    for (int step = kSteps - 1; step >= 0; --step) {
      double stage_adjoints[kStages][kStates];
#pragma unroll 1
      for (int stage = kStages - 1; stage >= 0; --stage) {
        const int slope = step * kStages + stage;
        double arguments[kArguments], adjoints[kExtended], sums[kArguments] = {};
        for (int r = 0; r < kExtended; ++r)
          adjoints[r] = kB[stage] * (r < kStates ? state_adjoint[r] : multipliers[kStates]);
#pragma unroll 1
        for (int i = stage + 1; i < kStages; ++i)
          for (int r = 0; r < kStates; ++r) adjoints[r] = fma(kA[i][stage], stage_adjoints[i][r], adjoints[r]);
        for (int r = 0; r < kExtended; ++r) adjoints[r] *= kSize;
        for (int k = 0; k < kArguments; ++k) arguments[k] = stored[kArgumentsAt + slope * kArguments + k];
        Rate::jacobian(arguments, nullptr, hoisted, entries());
        Rate::transposed(entries(), adjoints, sums);
        Rate::hessian(arguments, adjoints, nullptr, hoisted, entries() + kSecondAt);
        store_slope(slope);
        for (int r = 0; r < kStates; ++r) stage_adjoints[stage][r] = sums[r];
      }
#pragma unroll 1
      for (int i = 0; i < kStages; ++i)
        for (int r = 0; r < kStates; ++r) state_adjoint[r] += stage_adjoints[i][r];
      if (step % kStepsPerSubinterval == 0) add_point_adjoint(step / kStepsPerSubinterval);
    }
  }
};

"""The text of one CUDA kernel that integrates a trajectory, written from the tape of its dynamics.

Dormand and Prince's method of eighth order with adaptive steps, by diffrax's tableau and step control, as in
``in_jax``. A warp integrates one trajectory. Each thread sums the stages for some of the states, and evaluates some of
the requested points. All threads evaluate the whole derivative: to divide this work would save no time.
"""

from collections.abc import Iterator
from typing import Any

import numpy as np

from jaxscp.backends.codegen.cuda_text import COMPARISONS, Numbers, Scope, filled, literal, numbered
from jaxscp.backends.codegen.functions import TapedFunction
from jaxscp.verification.integrator.accuracy import FIRST_STEP, TOLERANCE, most_steps
from jaxscp.verification.integrator.method import eighth_order

WARP = 32  # threads that integrate one trajectory
BLOCK_THREADS = 128

_TEXT = """\
#ifdef __CUDACC__
constexpr int kLanes = @warp;
inline void meet() { __syncwarp(); }
inline double of_all_lanes(double v) {
  for (int mask = kLanes / 2; mask > 0; mask /= 2) v += __shfl_xor_sync(0xffffffff, v, mask);
  return v;
}
#else  // a single thread
constexpr int kLanes = 1;
inline void meet() {}
inline double of_all_lanes(double v) { return v; }
#endif

constexpr int kStates = @states, kControls = @controls, kIntervals = @intervals, kSamples = @samples;
constexpr int kSubintervals = kSamples - 1, kStages = @stages, kMostSteps = @most, kHoisted = @hoisted;
constexpr int kInputs = kStates + (kIntervals + 1) * (kControls + 1);
constexpr double kTolerance = @tolerance, kFirstStep = @first_step;
constexpr double kSafety = 0.9, kLeast = 0.2, kMost = 10.0;  // of how a step grows, as diffrax has it

__constant__ double kTable[kStages][kStages] = {@table};
__constant__ double kNodes[kStages] = {@nodes};
__constant__ double kError[kStages] = {@error};

// Shared by a warp: the state at a step's start, the state of a stage, and the slopes of the stages.
struct Shared {
  double state[kStates], stage[kStates], slopes[kStages][kStates];
};

// ``count`` trajectories; ``of_one`` consecutive ones share the constants. ``slopes`` are at the intervals' starts.
extern "C" __global__ void __launch_bounds__(@threads)
    jaxscp_kernel(const double* __restrict__ w, const double* __restrict__ hoisted, double* __restrict__ states,
                  double* __restrict__ slopes, long long count, long long of_one) {
  __shared__ Shared shared[@threads / kLanes];
  const long long number = (static_cast<long long>(blockIdx.x) * @threads + threadIdx.x) / kLanes;
  if (number >= count) return;
  const int lane = threadIdx.x % kLanes;
  Shared& f = shared[threadIdx.x / kLanes];
  w += number * kInputs;
  hoisted += number / of_one * kHoisted;
  states += number * kIntervals * kSamples * kStates;
  slopes += number * kIntervals * kStates;

  // act(s) for the thread's states
  auto each = [&](auto act) {
    for (int s = lane; s < kStates; s += kLanes) act(s);
    meet();
  };
  const double *controls = w + kStates, *dilation = controls + (kIntervals + 1) * kControls;
  // Slope of the stage's state, at a fraction of an interval.
  auto find_slope = [&](int interval, double fraction, double* to) {
    const double* u = controls + interval * kControls;
    const double by = (dilation[interval] + fraction * (dilation[interval + 1] - dilation[interval])) / kIntervals;
@slope
    meet();
  };
  // Weighted sum of the first stages, for a state.
  auto weighted = [&](const double* weights, int stages, int s) {
    double sums[2] = {};  // two sums in turn, so that neither waits for the other
#pragma unroll
    for (int j = 0; j < kStages; ++j)
      if (j < stages) sums[j % 2] = fma(weights[j], f.slopes[j][s], sums[j % 2]);
    return sums[0] + sums[1];
  };
  auto fraction_of = [](int sample) { return sample == kSubintervals ? 1.0 : sample * (1.0 / kSubintervals); };

  bool good = true;
  each([&](int s) { f.state[s] = w[s]; });
#pragma unroll 1
  for (int interval = 0; interval < kIntervals; ++interval) {
    double* out = states + interval * kSamples * kStates;
    double begin = 0.0, length = kFirstStep;
    int sample = 0, left = kMostSteps;
    each([&](int s) { f.stage[s] = f.state[s]; });
    find_slope(interval, 0.0, f.slopes[0]);
    each([&](int s) { slopes[interval * kStates + s] = f.slopes[0][s]; });
#pragma unroll 1
    while (good && begin < 1.0) {
      good = left-- > 0;
      const double end = begin + length < 1.0 ? begin + length : 1.0, size = end - begin;
#pragma unroll 1
      for (int stage = 1; stage < kStages; ++stage) {
        each([&](int s) { f.stage[s] = f.state[s] + size * weighted(kTable[stage], stage, s); });
        find_slope(interval, begin + kNodes[stage] * size, f.slopes[stage]);
      }
      // the last stage is at the step's end
      double squares = 0.0;
      each([&](int s) {
        const double of_state = fabs(f.state[s]), of_end = fabs(f.stage[s]);
        const double part = size * weighted(kError, kStages, s) / (kTolerance * (1.0 + greater(of_state, of_end)));
        squares += part * part;
      });
      const double error = sqrt(of_all_lanes(squares) / kStates);
      const bool accepted = error < 1.0;  // false for NaN
      if (accepted) {
        int next = end < 1.0 ? static_cast<int>(end * kSubintervals) + 1 : kSamples;
        for (int k = sample + lane; k < next; k += kLanes) {
          const double at = (fraction_of(k) - begin) / size;
          double weights[kStages];
@weights
          for (int s = 0; s < kStates; ++s) out[k * kStates + s] = f.state[s] + size * weighted(weights, kStages, s);
        }
        sample = next > sample ? next : sample;
        meet();
        each([&](int s) { f.state[s] = f.stage[s], f.slopes[0][s] = f.slopes[kStages - 1][s]; });
        begin = end;
      }
      const double growth = error == 0.0 ? kMost : error > 0.0 ? kSafety / sqrt(sqrt(sqrt(error))) : kLeast;
      const double least = accepted ? 1.0 : kLeast;
      length = size * (growth > least ? growth < kMost ? growth : kMost : least);
    }
    if (!good)
      for (int k = lane; k < kSamples * kStates; k += kLanes) out[k] = 1.0 / 0.0;
  }
}
"""


def kernel(slope: TapedFunction, intervals: int, samples: int) -> str:
    """Text of the kernel, for a derivative of states and controls."""
    from diffrax import Dopri8  # slow to import

    method, spelled = eighth_order(), numbered(slope.first, slope.inputs)
    error, dense = Dopri8.tableau.b_error, np.asarray(Dopri8.interpolation_cls.eval_coeffs)
    numbers: dict[str, Any] = {"warp": WARP, "threads": BLOCK_THREADS, "stages": method.stages}
    numbers |= {"states": slope.values, "controls": slope.arguments - slope.values}
    numbers |= {"intervals": intervals, "samples": samples, "most": most_steps(intervals)}
    numbers |= {"tolerance": literal(TOLERANCE), "first_step": literal(FIRST_STEP)}
    numbers |= {"table": ", ".join(f"{{{_row(row)}}}" for row in method.a)}
    numbers |= {"nodes": _row(method.c), "error": _row(error), "hoisted": len(spelled.hoisted)}
    numbers |= {"slope": "\n".join(f"    {line}" for line in _slope(slope, spelled))}
    numbers |= {"weights": "\n".join(f"          {line}" for line in _weights(dense))}
    return filled(COMPARISONS + _TEXT, numbers)


def _slope(slope: TapedFunction, numbers: Numbers) -> Iterator[str]:
    n = slope.values
    for k in range(slope.arguments):
        value = f"f.stage[{k}]" if k < n else f"u[{k - n}] + fraction * (u[kControls + {k - n}] - u[{k - n}])"
        yield f"const double a{k} = {value};"
    scope = Scope(numbers, [f"a{k}" for k in range(slope.arguments)], "v")
    for r, number in enumerate(numbers.outputs):
        yield from scope.make(number)
        yield f"if (lane == {r} % kLanes) to[{r}] = by * {scope.names[number]};"


def _weights(dense: np.ndarray) -> Iterator[str]:
    """Weights of the stages in the states inside a step: polynomials without constant, highest power first."""
    for j, row in enumerate(dense):
        value = literal(float(row[0]))
        for coefficient in row[1:]:
            value = f"fma({value}, at, {literal(float(coefficient))})"
        yield f"weights[{j}] = {f'at * {value}' if np.any(row) else '0.0'};"


def _row(numbers: Any) -> str:
    return ", ".join(literal(float(v)) for v in numbers)

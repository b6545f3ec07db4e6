"""The flight as the text of one CUDA kernel, made from the tape of the dynamics: Dormand and Prince's method of eighth
order with steps of its own choice, by diffrax's tables, as ``in_jax`` has diffrax do it.

The lanes of a warp fly together. Each has some of the states, which it weighs stages for, and some of the points that
are asked for; the slope each of them finds in full, since none would be faster for another's share of it.
"""

from collections.abc import Iterator
from typing import Any

import numpy as np

from jaxscp.backends.codegen.cuda_text import COMPARISONS, Numbers, Scope, filled, literal, numbered
from jaxscp.backends.codegen.functions import TapedFunction
from jaxscp.verification.integrator.accuracy import FIRST_STEP, TOLERANCE, most_steps
from jaxscp.verification.integrator.method import eighth_order

LANES = 32
THREADS = 128  # of a block

_TEXT = """\
#ifdef __CUDACC__
constexpr int kLanes = @lanes;
inline void meet() { __syncwarp(); }
inline double of_all_lanes(double v) {
  for (int apart = kLanes / 2; apart > 0; apart /= 2) v += __shfl_xor_sync(0xffffffff, v, apart);
  return v;
}
#else  // alone
constexpr int kLanes = 1;
inline void meet() {}
inline double of_all_lanes(double v) { return v; }
#endif

constexpr int kStates = @states, kControls = @controls, kIntervals = @intervals, kSamples = @samples;
constexpr int kStretches = kSamples - 1, kStages = @stages, kMostSteps = @most, kHoisted = @hoisted;
constexpr int kInputs = kStates + (kIntervals + 1) * (kControls + 1);
constexpr double kTolerance = @tolerance, kFirstStep = @first_step;
constexpr double kSafety = 0.9, kLeast = 0.2, kMost = 10.0;  // of how a step grows, as diffrax has it

__constant__ double kTable[kStages][kStages] = {@table};
__constant__ double kShares[kStages] = {@shares};
__constant__ double kError[kStages] = {@error};

// What the lanes that fly together share: the state that a step begins at, that of a stage, and the stages' slopes.
struct Flight {
  double state[kStates], stage[kStates], slopes[kStages][kStates];
};

// ``count`` flights, of which ``of_one`` in a row share what is known; ``slopes`` are those at the intervals' begins.
extern "C" __global__ void __launch_bounds__(@threads)
    jaxscp_kernel(const double* __restrict__ w, const double* __restrict__ hoisted, double* __restrict__ states,
                  double* __restrict__ slopes, long long count, long long of_one) {
  __shared__ Flight flights[@threads / kLanes];
  const long long number = (static_cast<long long>(blockIdx.x) * @threads + threadIdx.x) / kLanes;
  if (number >= count) return;
  const int lane = threadIdx.x % kLanes;
  Flight& f = flights[threadIdx.x / kLanes];
  w += number * kInputs;
  hoisted += number / of_one * kHoisted;
  states += number * kIntervals * kSamples * kStates;
  slopes += number * kIntervals * kStates;

  // act(s) for the lane's states
  auto each = [&](auto act) {
    for (int s = lane; s < kStates; s += kLanes) act(s);
    meet();
  };
  const double *controls = w + kStates, *dilation = controls + (kIntervals + 1) * kControls;
  // The slope of the stage's state, by the share of an interval.
  auto find_slope = [&](int interval, double share, double* to) {
    const double* u = controls + interval * kControls;
    const double by = (dilation[interval] + share * (dilation[interval + 1] - dilation[interval])) / kIntervals;
@slope
    meet();
  };
  // Of stages so many, weighed, for a state.
  auto weighed = [&](const double* weights, int stages, int s) {
    double sums[2] = {};  // in turn: neither waits for the one before
#pragma unroll
    for (int j = 0; j < kStages; ++j)
      if (j < stages) sums[j % 2] = fma(weights[j], f.slopes[j][s], sums[j % 2]);
    return sums[0] + sums[1];
  };
  auto share_of = [](int sample) { return sample == kStretches ? 1.0 : sample * (1.0 / kStretches); };

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
        each([&](int s) { f.stage[s] = f.state[s] + size * weighed(kTable[stage], stage, s); });
        find_slope(interval, begin + kShares[stage] * size, f.slopes[stage]);
      }
      // the last stage is at the step's end
      double squares = 0.0;
      each([&](int s) {
        const double of_state = fabs(f.state[s]), of_end = fabs(f.stage[s]);
        const double part = size * weighed(kError, kStages, s) / (kTolerance * (1.0 + greater(of_state, of_end)));
        squares += part * part;
      });
      const double error = sqrt(of_all_lanes(squares) / kStates);
      const bool accepted = error < 1.0;  // which what is no number is not
      if (accepted) {
        int next = end < 1.0 ? static_cast<int>(end * kStretches) + 1 : kSamples;
        for (int k = sample + lane; k < next; k += kLanes) {
          const double at = (share_of(k) - begin) / size;
          double weights[kStages];
@weights
          for (int s = 0; s < kStates; ++s) out[k * kStates + s] = f.state[s] + size * weighed(weights, kStages, s);
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
    """The kernel's text, for a slope of states and controls."""
    from diffrax import Dopri8  # slow to import

    method, spelled = eighth_order(), numbered(slope)
    error, dense = Dopri8.tableau.b_error, np.asarray(Dopri8.interpolation_cls.eval_coeffs)
    numbers: dict[str, Any] = {"lanes": LANES, "threads": THREADS, "stages": method.stages}
    numbers |= {"states": slope.values, "controls": slope.arguments - slope.values}
    numbers |= {"intervals": intervals, "samples": samples, "most": most_steps(intervals)}
    numbers |= {"tolerance": literal(TOLERANCE), "first_step": literal(FIRST_STEP)}
    numbers |= {"table": ", ".join(f"{{{_row(row)}}}" for row in method.a)}
    numbers |= {"shares": _row(method.c), "error": _row(error), "hoisted": len(spelled.hoisted)}
    numbers |= {"slope": "\n".join(f"    {line}" for line in _slope(slope, spelled))}
    numbers |= {"weights": "\n".join(f"          {line}" for line in _weights(dense))}
    return filled(COMPARISONS + _TEXT, numbers)


def _slope(slope: TapedFunction, numbers: Numbers) -> Iterator[str]:
    n = slope.values
    for k in range(slope.arguments):
        value = f"f.stage[{k}]" if k < n else f"u[{k - n}] + share * (u[kControls + {k - n}] - u[{k - n}])"
        yield f"const double a{k} = {value};"
    scope = Scope(numbers, [f"a{k}" for k in range(slope.arguments)], "v")
    for r, number in enumerate(numbers.outputs):
        yield from scope.make(number)
        yield f"if (lane == {r} % kLanes) to[{r}] = by * {scope.names[number]};"


def _weights(dense: np.ndarray) -> Iterator[str]:
    """Of the stages in the states between a step's ends: polynomials without constant, the highest power first."""
    for j, row in enumerate(dense):
        value = literal(float(row[0]))
        for coefficient in row[1:]:
            value = f"fma({value}, at, {literal(float(coefficient))})"
        yield f"weights[{j}] = {f'at * {value}' if np.any(row) else '0.0'};"


def _row(numbers: Any) -> str:
    return ", ".join(literal(float(v)) for v in numbers)

// The kernel that factors a problem by a block, as ``Elimination`` in ``recursion.h`` does. Where the matrix is not
// definite, the block tries again with a larger shift of the Hessian. The macros are the sizes of the problem.
#include "sizes.cuh"

constexpr int even(int count) { return (count + 1) / 2 * 2; }
constexpr int kEvenInputs = even(kInputs), kEvenStage = even(kStage);  // of padded arrays
constexpr int kWarp = 32, kPerLane = (kInputs + kWarp - 1) / kWarp;
constexpr unsigned kAllLanes = 0xffffffff;
constexpr double kLargest = 1.7976931348623157e308;

struct Memory {
  double value[kEvenStage][kEvenStage], flow[kStates][kEvenInputs], propagated[kEvenStage][kEvenInputs];
  double stage[kEvenInputs][kEvenInputs], cross[kControls][kEvenStage];
  bool definite;
};

// act(r, c) for the upper left entries of 2 by 2 tiles.
template <typename Act>
inline void by_tiles(int rows, int columns, Act act) {
  const int across = columns / 2;
  by_threads(rows / 2 * across, [&](int i) { act(i / across * 2, i % across * 2); });
}

// sum += left' right, for a tile: left(k, i) and right(k, j) with i and j in {0, 1}.
template <int kDepth, typename Left, typename Right>
inline void add_product(double (&sum)[2][2], Left left, Right right) {
#pragma unroll
  for (int k = 0; k < kDepth; ++k) {
    const double x[2] = {left(k, 0), left(k, 1)}, y[2] = {right(k, 0), right(k, 1)};
#pragma unroll
    for (int i = 0; i < 2; ++i)
#pragma unroll
      for (int j = 0; j < 2; ++j) sum[i][j] = fma(x[i], y[j], sum[i][j]);
  }
}

// stage += T' P T, where T w = (A w, U) is the next node and P the value.
inline void add_cost_to_go(Memory& m) {
  by_tiles(kEvenStage, kEvenInputs, [&](int r, int c) {
    double sum[2][2] = {};
    add_product<kStates>(
        sum, [&](int k, int i) { return m.value[k][r + i]; }, [&](int k, int j) { return m.flow[k][c + j]; });
    for (int i = 0; i < 2; ++i)
      for (int j = 0; j < 2; ++j) {
        const int control = c + j - kStage;
        const bool known = control >= 0 && control < kControls;
        m.propagated[r + i][c + j] = sum[i][j] + (known ? m.value[r + i][kStates + control] : 0.0);
      }
  });
  __syncthreads();
  by_tiles(kEvenInputs, kEvenInputs, [&](int r, int c) {
    double sum[2][2] = {};
    add_product<kStates>(
        sum, [&](int k, int i) { return m.flow[k][r + i]; }, [&](int k, int j) { return m.propagated[k][c + j]; });
    for (int i = 0; i < 2; ++i)
      for (int j = 0; j < 2; ++j) {
        const int control = r + i - kStage;
        const bool known = control >= 0 && control < kControls;
        m.stage[r + i][c + j] += sum[i][j] + (known ? m.propagated[kStates + control][c + j] : 0.0);
      }
  });
  __syncthreads();
}

// Minimises over the controls, by one warp: a lane has some columns of the controls' rows. Leaves L^-1 times these rows
// in ``cross``, for the columns of the interval's first node.
inline void eliminate_controls(Memory& m, double* to_lower, double* to_gain) {
  const int lane = threadIdx.x;
  double a[kPerLane][kControls], inverse[kControls];
  auto of_control = [&](int r, int k) {  // row k at the column of control r
    return __shfl_sync(kAllLanes, a[(kStage + r) / kWarp][k], (kStage + r) % kWarp);
  };
  bool definite = true;
#pragma unroll
  for (int s = 0; s < kPerLane; ++s)
#pragma unroll
    for (int r = 0; r < kControls; ++r) {
      const int column = lane + s * kWarp;
      a[s][r] = column < kInputs ? m.stage[kStage + r][column] : 0.0;
    }
#pragma unroll
  for (int k = 0; k < kControls; ++k) {
    const double pivot = of_control(k, k);
    definite = definite && pivot > 0.0 && pivot <= kLargest;
    inverse[k] = 1.0 / sqrt(pivot);
#pragma unroll
    for (int s = 0; s < kPerLane; ++s) a[s][k] *= inverse[k];
#pragma unroll
    for (int r = k + 1; r < kControls; ++r) {
      const double factor = of_control(r, k);
#pragma unroll
      for (int s = 0; s < kPerLane; ++s) a[s][r] = fma(-factor, a[s][k], a[s][r]);
    }
  }
  double gain[kPerLane][kControls];
#pragma unroll
  for (int r = kControls - 1; r >= 0; --r) {
#pragma unroll
    for (int s = 0; s < kPerLane; ++s) gain[s][r] = a[s][r];
#pragma unroll
    for (int k = r + 1; k < kControls; ++k) {
      const double factor = of_control(k, r);
#pragma unroll
      for (int s = 0; s < kPerLane; ++s) gain[s][r] = fma(-factor, gain[s][k], gain[s][r]);
    }
#pragma unroll
    for (int s = 0; s < kPerLane; ++s) gain[s][r] *= inverse[r];
  }
#pragma unroll
  for (int s = 0; s < kPerLane; ++s) {
    const int column = lane + s * kWarp, control = column - kStage;
#pragma unroll
    for (int r = 0; r < kControls; ++r) {
      if (column < kStage) m.cross[r][column] = a[s][r], to_gain[r * kStage + column] = gain[s][r];
      if (control >= 0 && control < kControls) to_lower[control * kControls + r] = r <= control ? a[s][r] : 0.0;
    }
  }
  if (lane == 0 && !definite) m.definite = false;
}

// The Hessian of the cost to go.
inline void find_value(Memory& m) {
  by_tiles(kEvenStage, kEvenStage, [&](int r, int c) {
    double sum[2][2] = {};
    add_product<kControls>(
        sum, [&](int k, int i) { return m.cross[k][r + i]; }, [&](int k, int j) { return m.cross[k][c + j]; });
    for (int i = 0; i < 2; ++i)
      for (int j = 0; j < 2; ++j)
        m.value[r + i][c + j] = 0.5 * (m.stage[r + i][c + j] + m.stage[c + j][r + i]) - sum[i][j];
  });
  __syncthreads();
}

// Cholesky factor of the value, column by column; the part above the diagonal becomes zero.
inline void factor_value(Memory& m) {
#pragma unroll 1
  for (int j = 0; j < kStage; ++j) {
    const double pivot = m.value[j][j];
    __syncthreads();
    if (threadIdx.x == 0 && !(pivot > 0.0 && pivot <= kLargest)) m.definite = false;
    const double inverse = 1.0 / sqrt(pivot);
    by_threads(kStage - j, [&](int i) { m.value[j + i][j] *= inverse; });
    __syncthreads();
    const int left = kStage - j - 1;
    by_threads(left * left, [&](int e) {
      const int i = j + 1 + e / left, k = j + 1 + e % left;
      if (k <= i) m.value[i][k] = fma(-m.value[i][j], m.value[k][j], m.value[i][k]);
    });
    __syncthreads();
  }
}

// Adds penalty * c' c to the value, for conditions c on states.
inline void add_penalty(Memory& m, const double* c, int conditions) {
  by_threads(kStates * kStates, [&](int e) {
    const int r = e / kStates, s = e % kStates;
    for (int k = 0; k < conditions; ++k)
      m.value[r][s] = fma(kPenalty * c[k * kStates + r], c[k * kStates + s], m.value[r][s]);
  });
  __syncthreads();
}

extern "C" __global__ void __launch_bounds__(kThreads)
    jaxscp_kernel(const double* __restrict__ hessian, const double* __restrict__ last, const double* __restrict__ flow,
                  const double* __restrict__ initial, const double* __restrict__ final,
                  const double* __restrict__ first_shift, double* __restrict__ to_value, double* __restrict__ to_lower,
                  double* __restrict__ to_gain, double* __restrict__ to_first, double* __restrict__ to_shift, long long,
                  long long) {
  constexpr int kHessian = kInputs * kInputs, kFlow = kStates * kInputs, kValue = kStage * kStage;
  __shared__ Memory m;
  const long long problem = blockIdx.x;
  hessian += problem * kIntervals * kHessian, last += problem * kValue, flow += problem * kIntervals * kFlow;
  initial += problem * kInitial * kStates, final += problem * kFinal * kStates;
  to_value += problem * kIntervals * kValue, to_lower += problem * kIntervals * kControls * kControls;
  to_gain += problem * kIntervals * kControls * kStage, to_first += problem * kValue;
  by_threads(sizeof(Memory) / sizeof(double), [&](int i) { reinterpret_cast<double*>(&m)[i] = 0.0; });

  for (double shift = 0.0;; shift = shift > 0.0 ? JAXSCP_GROWTH * shift : first_shift[problem]) {
    __syncthreads();
    if (threadIdx.x == 0) m.definite = true;
    by_threads(kValue, [&](int e) {
      const int r = e / kStage, c = e % kStage;
      m.value[r][c] = last[e] + (r == c ? shift : 0.0);
    });
    __syncthreads();
    add_penalty(m, final, kFinal);
#pragma unroll 1
    for (int i = kIntervals - 1; i >= 0 && m.definite; --i) {
      by_threads(kFlow, [&](int e) { m.flow[e / kInputs][e % kInputs] = flow[i * kFlow + e]; });
      by_threads(kHessian, [&](int e) {
        const int r = e / kInputs, c = e % kInputs;
        m.stage[r][c] = hessian[i * kHessian + e] + (r == c ? shift : 0.0);
      });
      by_threads(kValue, [&](int e) { to_value[i * kValue + e] = m.value[e / kStage][e % kStage]; });
      __syncthreads();
      add_cost_to_go(m);
      if (threadIdx.x < kWarp)
        eliminate_controls(m, to_lower + i * kControls * kControls, to_gain + i * kControls * kStage);
      __syncthreads();
      find_value(m);
    }
    if (m.definite) {
      add_penalty(m, initial, kInitial);
      factor_value(m);
    }
    if (m.definite || !(shift < JAXSCP_MOST)) {
      if (threadIdx.x == 0) to_shift[problem] = shift;
      if (!m.definite) {  // as ``no_factor``: parts were never written
        by_threads(kIntervals * kValue, [&](int e) { to_value[e] = 0.0 / 0.0; });
        by_threads(kIntervals * kControls * kControls, [&](int e) { to_lower[e] = 0.0 / 0.0; });
        by_threads(kIntervals * kControls * kStage, [&](int e) { to_gain[e] = 0.0 / 0.0; });
      }
      by_threads(kValue, [&](int e) {
        const int r = e / kStage, c = e % kStage;
        to_first[e] = !m.definite ? 0.0 / 0.0 : c <= r ? m.value[r][c] : 0.0;
      });
      return;
    }
  }
}

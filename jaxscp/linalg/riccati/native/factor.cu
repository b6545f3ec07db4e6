// The kernel that factors a problem by a block, in the steps of ``Elimination`` in ``recursion.h``. The macros are the
// sizes of the problem.
#include "sizes.cuh"

// Cholesky factor of the upper left corner of a matrix, by one thread; NaN if it is not definite.
template <int kCount, int kStride>
inline void cholesky(double* a) {
  for (int i = 0; i < kCount; ++i)
    for (int j = 0; j <= i; ++j) {
      double sum = a[i * kStride + j];
      for (int k = 0; k < j; ++k) sum = fma(-a[i * kStride + k], a[j * kStride + k], sum);
      a[i * kStride + j] = i == j ? sqrt(sum) : sum / a[j * kStride + j];
    }
}

// The same by a block, column by column; the part above the diagonal becomes zero.
inline void cholesky_by_block(double (*a)[kStage]) {
  for (int j = 0; j < kStage; ++j) {
    if (threadIdx.x == 0) a[j][j] = sqrt(a[j][j]);
    __syncthreads();
    by_threads(kStage - j - 1, [&](int i) { a[j + 1 + i][j] /= a[j][j]; });
    __syncthreads();
    const int left = kStage - j - 1;
    by_threads(left * left, [&](int e) {
      const int i = j + 1 + e / left, k = j + 1 + e % left;
      if (k <= i) a[i][k] = fma(-a[i][j], a[k][j], a[i][k]);
    });
    __syncthreads();
  }
  by_threads(kStage * kStage, [&](int e) {
    if (e % kStage > e / kStage) a[e / kStage][e % kStage] = 0.0;
  });
  __syncthreads();
}

extern "C" __global__ void __launch_bounds__(kThreads)
    jaxscp_kernel(const double* __restrict__ hessian, const double* __restrict__ last,
                  const double* __restrict__ all_flow, const double* __restrict__ initial,
                  const double* __restrict__ final, double* __restrict__ to_value, double* __restrict__ to_lower,
                  double* __restrict__ to_gain, double* __restrict__ to_first, long long, long long) {
  __shared__ double value[kStage][kStage], flow[kStates][kInputs], propagated[kStage][kInputs];
  __shared__ double stage[kInputs][kInputs], lower[kControls * kControls], cross[kControls][kStage];
  const long long problem = blockIdx.x;
  hessian += problem * kIntervals * kInputs * kInputs, last += problem * kStage * kStage;
  all_flow += problem * kIntervals * kStates * kInputs;
  initial += problem * kInitial * kStates, final += problem * kFinal * kStates;
  to_value += problem * kIntervals * kStage * kStage, to_lower += problem * kIntervals * kControls * kControls;
  to_gain += problem * kIntervals * kControls * kStage, to_first += problem * kStage * kStage;

  // value += penalty c' c, for conditions c on states
  auto add_penalty = [&](const double* c, int conditions) {
    by_threads(kStates * kStates, [&](int e) {
      for (int k = 0; k < conditions; ++k)
        value[e / kStates][e % kStates] += kPenalty * c[k * kStates + e / kStates] * c[k * kStates + e % kStates];
    });
    __syncthreads();
  };

  by_threads(kStage * kStage, [&](int e) { value[e / kStage][e % kStage] = last[e]; });
  __syncthreads();
  add_penalty(final, kFinal);
#pragma unroll 1
  for (int i = kIntervals - 1; i >= 0; --i) {
    const double* own = hessian + i * kInputs * kInputs;
    by_threads(kStates * kInputs, [&](int e) { flow[e / kInputs][e % kInputs] = all_flow[i * kStates * kInputs + e]; });
    by_threads(kInputs * kInputs, [&](int e) { stage[e / kInputs][e % kInputs] = own[e]; });
    by_threads(kStage * kStage, [&](int e) { to_value[i * kStage * kStage + e] = value[e / kStage][e % kStage]; });
    __syncthreads();
    // P T, where T w = (A w, U) is the next node
    by_threads(kStage * kInputs, [&](int e) {
      const int r = e / kInputs, c = e % kInputs;
      double sum = c < kStage ? 0.0 : value[r][kStates + c - kStage];
#pragma unroll
      for (int k = 0; k < kStates; ++k) sum = fma(value[r][k], flow[k][c], sum);
      propagated[r][c] = sum;
    });
    __syncthreads();
    // H + T' P T
    by_threads(kInputs * kInputs, [&](int e) {
      const int r = e / kInputs, c = e % kInputs;
      double sum = stage[r][c] + (r < kStage ? 0.0 : propagated[kStates + r - kStage][c]);
#pragma unroll
      for (int k = 0; k < kStates; ++k) sum = fma(flow[k][r], propagated[k][c], sum);
      stage[r][c] = sum;
    });
    __syncthreads();
    if (threadIdx.x == 0) {
      for (int r = 0; r < kControls; ++r)
        for (int c = 0; c < kControls; ++c) lower[r * kControls + c] = c <= r ? stage[kStage + r][kStage + c] : 0.0;
      cholesky<kControls, kControls>(lower);
    }
    __syncthreads();
    by_threads(kStage, [&](int c) {  // cross = L^-1 (the rows of the controls)
#pragma unroll
      for (int r = 0; r < kControls; ++r) {
        double sum = stage[kStage + r][c];
#pragma unroll
        for (int k = 0; k < r; ++k) sum = fma(-lower[r * kControls + k], cross[k][c], sum);
        cross[r][c] = sum / lower[r * kControls + r];
      }
    });
    by_threads(kControls * kControls, [&](int e) { to_lower[i * kControls * kControls + e] = lower[e]; });
    __syncthreads();
    by_threads(kStage * kStage, [&](int e) {  // the Hessian of the cost to go
      const int r = e / kStage, c = e % kStage;
      double sum = 0.5 * (stage[r][c] + stage[c][r]);
#pragma unroll
      for (int k = 0; k < kControls; ++k) sum = fma(-cross[k][r], cross[k][c], sum);
      value[r][c] = sum;
    });
    __syncthreads();
    by_threads(kStage, [&](int c) {  // gain = L'^-1 cross
      double gain[kControls];
#pragma unroll
      for (int r = kControls - 1; r >= 0; --r) {
        double sum = cross[r][c];
#pragma unroll
        for (int k = r + 1; k < kControls; ++k) sum = fma(-lower[k * kControls + r], gain[k], sum);
        gain[r] = sum / lower[r * kControls + r];
        to_gain[(i * kControls + r) * kStage + c] = gain[r];
      }
    });
    __syncthreads();
  }
  add_penalty(initial, kInitial);
  cholesky_by_block(value);
  by_threads(kStage * kStage, [&](int e) { to_first[e] = value[e / kStage][e % kStage]; });
}

// The kernel that solves a factored problem by a block, in the steps of ``Solution`` in ``recursion.h``. The macros are
// the sizes of the problem, and the number of refinements.
#include "sizes.cuh"

constexpr int kRefinements = JAXSCP_REFINEMENTS;
constexpr int at_least_one(int count) { return count > 0 ? count : 1; }

// A right-hand side, or a solution, in shared memory.
struct Vector {
  double nodes[kIntervals + 1][kStage], flow[kIntervals][kStates];
  double initial[at_least_one(kInitial)], final[at_least_one(kFinal)];
};
constexpr int kSize = sizeof(Vector) / sizeof(double);

// The arrays in shared memory.
struct Memory {
  Vector rhs, residual, step, solution;
  double gradients[kIntervals + 1][kStage], feedforward[kIntervals][kControls], linear[kInputs], gradient[kStage];
};

// A problem and its factor. A thread has one entry of a node's vectors; it reads all that it needs of an interval's
// matrices before it waits for the others.
struct System {
  const double *hessian, *last, *flow, *initial, *final, *value, *lower, *gain, *first;
  Memory& m;

  const double* flow_row(int i, int r) const { return flow + (i * kStates + r) * kInputs; }
  const double* gain_row(int i, int r) const { return gain + (i * kControls + r) * kStage; }
  const double* value_row(int i, int r) const { return value + (i * kStage + r) * kStage; }

  // Solves the system whose end conditions are penalties, without refinement.
  void solve_once(const Vector& rhs, Vector& x) const {
    backward(rhs);
    solve_first(x);
    forward(rhs, x);
  }

  // Gradients of the cost to go, from the last node to the first, and the controls' feedforward terms.
  void backward(const Vector& rhs) const {
    const int j = threadIdx.x;
    if (j < kStage) m.gradients[kIntervals][j] = -rhs.nodes[kIntervals][j] - penalty(final, kFinal, rhs.final, j);
    __syncthreads();
#pragma unroll 1
    for (int i = kIntervals - 1; i >= 0; --i) {
      double of_value[kStates], of_flow[kStates], of_gain[kControls];
#pragma unroll
      for (int k = 0; k < kStates; ++k) {
        of_value[k] = j < kStage ? value_row(i, k)[j] : 0.0;
        of_flow[k] = j < kInputs ? flow_row(i, k)[j] : 0.0;
      }
#pragma unroll
      for (int k = 0; k < kControls; ++k) of_gain[k] = j < kStage ? gain_row(i, k)[j] : 0.0;
      if (j < kStage) {  // the flow's equation: x = A w - rhs.flow
        double sum = m.gradients[i + 1][j];
#pragma unroll
        for (int k = 0; k < kStates; ++k) sum = fma(-rhs.flow[i][k], of_value[k], sum);
        m.gradient[j] = sum;
      }
      __syncthreads();
      if (j < kInputs) {
        double sum = j < kStage ? 0.0 : m.gradient[kStates + j - kStage];
#pragma unroll
        for (int k = 0; k < kStates; ++k) sum = fma(m.gradient[k], of_flow[k], sum);
        m.linear[j] = sum;
        if (j >= kStage) m.feedforward[i][j - kStage] = sum;
      }
      __syncthreads();
      if (j < kStage) {
        double sum = m.linear[j] - rhs.nodes[i][j];
#pragma unroll
        for (int k = 0; k < kControls; ++k) sum = fma(-m.linear[kStage + k], of_gain[k], sum);
        m.gradients[i][j] = sum;
      }
    }
    if (j < kStage) m.gradients[0][j] -= penalty(initial, kInitial, rhs.initial, j);
    __syncthreads();
    by_threads(kIntervals, [&](int i) { solve_cholesky(lower + i * kControls * kControls, m.feedforward[i]); });
  }

  // The first node, which minimises the cost to go.
  void solve_first(Vector& x) const {
    double* v = x.nodes[0];
    const int j = threadIdx.x;
    if (j < kStage) v[j] = -m.gradients[0][j];
    __syncthreads();
#pragma unroll 1
    for (int i = 0; i < kStage; ++i) {
      if (j == i) v[i] /= first[i * kStage + i];
      __syncthreads();
      if (i < j && j < kStage) v[j] = fma(-first[j * kStage + i], v[i], v[j]);
    }
#pragma unroll 1
    for (int i = kStage - 1; i >= 0; --i) {
      __syncthreads();
      if (j == i) v[i] /= first[i * kStage + i];
      __syncthreads();
      if (j < i) v[j] = fma(-first[i * kStage + j], v[i], v[j]);
    }
    __syncthreads();
  }

  // Nodes from the first to the last, and multipliers of the flow.
  void forward(const Vector& rhs, Vector& x) const {
    const int j = threadIdx.x;
#pragma unroll 1
    for (int i = 0; i < kIntervals; ++i) {
      double *next = x.nodes[i + 1], of_gain[kStage], of_flow[kInputs];
#pragma unroll
      for (int k = 0; k < kStage; ++k) of_gain[k] = j < kControls ? gain_row(i, j)[k] : 0.0;
#pragma unroll
      for (int k = 0; k < kInputs; ++k) of_flow[k] = j < kStates ? flow_row(i, j)[k] : 0.0;
      double sum = j < kStates ? -rhs.flow[i][j] : 0.0;
#pragma unroll
      for (int k = 0; k < kStage; ++k) sum = fma(of_flow[k], x.nodes[i][k], sum);
      if (j < kControls) {
        double control = -m.feedforward[i][j];
#pragma unroll
        for (int k = 0; k < kStage; ++k) control = fma(-of_gain[k], x.nodes[i][k], control);
        next[kStates + j] = control;
      }
      __syncthreads();
#pragma unroll
      for (int k = 0; k < kControls; ++k) sum = fma(of_flow[kStage + k], next[kStates + k], sum);
      if (j < kStates) next[j] = sum;
      __syncthreads();
    }
    by_threads(kIntervals * kStates, [&](int e) {
      const int i = e / kStates, r = e % kStates;
      double sum = m.gradients[i + 1][r];
#pragma unroll
      for (int k = 0; k < kStage; ++k) sum = fma(value_row(i, k)[r], x.nodes[i + 1][k], sum);
      x.flow[i][r] = sum;
    });
    by_threads(kInitial, [&](int k) {
      x.initial[k] = kPenalty * (condition(initial, k, x.nodes[0]) - rhs.initial[k]);
    });
    by_threads(kFinal, [&](int k) {
      x.final[k] = kPenalty * (condition(final, k, x.nodes[kIntervals]) - rhs.final[k]);
    });
    __syncthreads();
  }

  // residual = rhs - matrix * x
  void find_residual(const Vector& rhs, const Vector& x, Vector& residual) const {
    by_threads((kIntervals + 1) * kStage, [&](int e) {
      residual.nodes[e / kStage][e % kStage] = residual_at(rhs, x, e / kStage, e % kStage);
    });
    by_threads(kIntervals * kStates, [&](int e) {
      const int i = e / kStates, j = e % kStates;
      double sum = rhs.flow[i][j] + x.nodes[i + 1][j];
      for (int k = 0; k < kInputs; ++k) sum = fma(-flow_row(i, j)[k], input(x, i, k), sum);
      residual.flow[i][j] = sum;
    });
    by_threads(kInitial, [&](int k) { residual.initial[k] = rhs.initial[k] - condition(initial, k, x.nodes[0]); });
    by_threads(kFinal, [&](int k) { residual.final[k] = rhs.final[k] - condition(final, k, x.nodes[kIntervals]); });
    __syncthreads();
  }

  // Residual of variable j of node i.
  double residual_at(const Vector& rhs, const Vector& x, int i, int j) const {
    double sum = rhs.nodes[i][j];
    if (i < kIntervals) sum -= of_inputs(x, i, j);
    if (i > 0) sum += j < kStates ? x.flow[i - 1][j] : -of_inputs(x, i - 1, kStage + j - kStates);
    if (i == kIntervals) {
      for (int k = 0; k < kStage; ++k) sum = fma(-last[k * kStage + j], x.nodes[i][k], sum);
      for (int k = 0; k < kFinal && j < kStates; ++k) sum = fma(-final[k * kStates + j], x.final[k], sum);
    }
    for (int k = 0; k < kInitial && i == 0 && j < kStates; ++k)
      sum = fma(-initial[k * kStates + j], x.initial[k], sum);
    return sum;
  }

  // Entry j of H w + A' y, of an interval.
  double of_inputs(const Vector& x, int i, int j) const {
    const double* h = hessian + i * kInputs * kInputs;
    double sum = 0.0;
#pragma unroll
    for (int k = 0; k < kInputs; ++k) sum = fma(h[k * kInputs + j], input(x, i, k), sum);
#pragma unroll
    for (int k = 0; k < kStates; ++k) sum = fma(flow_row(i, k)[j], x.flow[i][k], sum);
    return sum;
  }

  // Entry k of w = (X, U), of an interval.
  static double input(const Vector& x, int i, int k) {
    return k < kStage ? x.nodes[i][k] : x.nodes[i + 1][kStates + k - kStage];
  }

  static double condition(const double* c, int k, const double* state) {
    double sum = 0.0;
    for (int j = 0; j < kStates; ++j) sum = fma(c[k * kStates + j], state[j], sum);
    return sum;
  }

  // Entry j of penalty * c' v, for conditions c on states.
  static double penalty(const double* c, int conditions, const double* v, int j) {
    double sum = 0.0;
    for (int k = 0; k < conditions && j < kStates; ++k) sum = fma(kPenalty * c[k * kStates + j], v[k], sum);
    return sum;
  }

  // (l l')^-1 v for a triangular l of the controls' size, by one thread.
  static void solve_cholesky(const double* l, double* v) {
#pragma unroll
    for (int i = 0; i < kControls; ++i) {
      double sum = v[i];
#pragma unroll
      for (int k = 0; k < i; ++k) sum = fma(-l[i * kControls + k], v[k], sum);
      v[i] = sum / l[i * kControls + i];
    }
#pragma unroll
    for (int i = kControls - 1; i >= 0; --i) {
      double sum = v[i];
#pragma unroll
      for (int k = i + 1; k < kControls; ++k) sum = fma(-l[k * kControls + i], v[k], sum);
      v[i] = sum / l[i * kControls + i];
    }
  }
};

extern "C" __global__ void __launch_bounds__(kThreads)
    jaxscp_kernel(const double* __restrict__ hessian, const double* __restrict__ last, const double* __restrict__ flow,
                  const double* __restrict__ initial, const double* __restrict__ final,
                  const double* __restrict__ value, const double* __restrict__ lower, const double* __restrict__ gain,
                  const double* __restrict__ first, const double* __restrict__ nodes,
                  const double* __restrict__ flow_rhs, const double* __restrict__ initial_rhs,
                  const double* __restrict__ final_rhs, double* __restrict__ to_nodes, double* __restrict__ to_flow,
                  double* __restrict__ to_initial, double* __restrict__ to_final, long long, long long) {
  double* memory = dynamic_memory<sizeof(Memory)>();
  Memory& m = *reinterpret_cast<Memory*>(memory);
  const long long p = blockIdx.x;
  const System system{hessian + p * kIntervals * kInputs * kInputs,   last + p * kStage * kStage,
                      flow + p * kIntervals * kStates * kInputs,      initial + p * kInitial * kStates,
                      final + p * kFinal * kStates,                   value + p * kIntervals * kStage * kStage,
                      lower + p * kIntervals * kControls * kControls, gain + p * kIntervals * kControls * kStage,
                      first + p * kStage * kStage,                    m};
  auto copy = [&](int count, const double* from, double* to) { by_threads(count, [&](int i) { to[i] = from[i]; }); };
  constexpr int kNodes = (kIntervals + 1) * kStage, kFlow = kIntervals * kStates;
  copy(kNodes, nodes + p * kNodes, m.rhs.nodes[0]), copy(kFlow, flow_rhs + p * kFlow, m.rhs.flow[0]);
  copy(kInitial, initial_rhs + p * kInitial, m.rhs.initial), copy(kFinal, final_rhs + p * kFinal, m.rhs.final);
  __syncthreads();
  system.solve_once(m.rhs, m.solution);
#pragma unroll 1
  for (int i = 0; i < kRefinements; ++i) {
    system.find_residual(m.rhs, m.solution, m.residual);
    system.solve_once(m.residual, m.step);
    by_threads(kSize, [&](int k) {
      reinterpret_cast<double*>(&m.solution)[k] += reinterpret_cast<const double*>(&m.step)[k];
    });
    __syncthreads();
  }
  copy(kNodes, m.solution.nodes[0], to_nodes + p * kNodes), copy(kFlow, m.solution.flow[0], to_flow + p * kFlow);
  copy(kInitial, m.solution.initial, to_initial + p * kInitial), copy(kFinal, m.solution.final, to_final + p * kFinal);
}

// The kernel that integrates an interval by a block of threads, with derivatives up to order kOrder.
//
// ``interval_source.py`` writes what comes before this text: sizes, tableau, the struct of the shared memory, and the
// functions of the problem with their sparse products. What does not depend on a column is computed by one thread for
// each slope, point or row, or by the first warp.
#include "interval_adjoints.cuh"
#include "interval_columns.cuh"
#include "interval_path.cuh"

// ``intervals`` intervals share hoisted constants; there is a block for each interval.
extern "C" __global__ void __launch_bounds__(kThreads)
    jaxscp_kernel(const double* __restrict__ w, const double* __restrict__ hoisted, const double* __restrict__ data,
                  const double* __restrict__ multipliers, double* __restrict__ outputs, double* __restrict__ jacobian,
                  double* __restrict__ hessian, long long, long long intervals) {
#if defined(JAXSCP_EMULATED_GPU)
  double* memory = emulated_memory;
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

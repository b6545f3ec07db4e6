// The kernel that finds an interval's Jacobian by a block of threads, and its Hessian if kOrder is two.
#include "dynamic_memory.cuh"
#include "interval_columns.cuh"

// ``of_slopes`` and ``stored``: by ``paths.cu``. There is a block for each interval.
extern "C" __global__ void __launch_bounds__(kThreads, JAXSCP_BLOCKS)
    jaxscp_kernel(const double* __restrict__ of_slopes, double* stored, double* __restrict__ jacobian,
                  double* __restrict__ hessian, long long count, long long) {
  const long long i = blockIdx.x;
  const Interval at{{stored + i, stride_of(count)}, of_slopes + i * kSteps * kStages * kSlopeEntries,
                    jacobian + i * kOutputs * kInputs, hessian + i * kInputs * kInputs,
                    *reinterpret_cast<Shared*>(dynamic_memory<sizeof(Shared)>())};
  Column column{static_cast<int>(threadIdx.x < kInputs ? threadIdx.x : kInputs - 1)};
  column.integrate(at);
  column.subtract_margins(at);
  column.evaluate_ends(at);
  if constexpr (kOrder > 1) column.write_hessian(at);
}

// The kernel that finds an interval's Jacobian by a block of threads, and its Hessian if kOrder is two.
#include "interval_columns.cuh"

// ``stored``: by ``paths.cu``. ``intervals`` intervals share hoisted constants; there is a block for each interval.
extern "C" __global__ void __launch_bounds__(kThreads, JAXSCP_BLOCKS)
    jaxscp_kernel(double* stored, const double* __restrict__ hoisted, double* __restrict__ jacobian,
                  double* __restrict__ hessian, long long count, long long intervals) {
#if defined(JAXSCP_EMULATED_GPU)
  double* memory = emulated_memory;
#else
  extern __shared__ double2 memory[];
#endif
  const long long i = blockIdx.x;
  const Interval at{hoisted + i / intervals * kHoisted, {stored + i, count}, jacobian + i * kOutputs * kInputs,
                    hessian + i * kInputs * kInputs, *reinterpret_cast<Shared*>(memory)};
  const int lane = threadIdx.x % kLanes;
  Column column{lane < kInputs ? lane : kInputs - 1, static_cast<int>(threadIdx.x) / kLanes};
  read_entries(at);
  column.integrate(at);
  column.subtract_margins(at);
  column.evaluate_ends(at);
  if constexpr (kOrder > 1) column.write_hessian(at.hessian);
}

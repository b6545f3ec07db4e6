// The kernel that integrates an interval by one thread. It stores what ``intervals.cu`` needs for derivatives up to order
// kOrder: all that does not depend on a column.
#include "interval_path.cuh"

// ``intervals`` intervals share hoisted constants.
extern "C" __global__ void __launch_bounds__(kPathThreads)
    jaxscp_kernel(const double* __restrict__ w, const double* __restrict__ hoisted, const double* __restrict__ data,
                  const double* __restrict__ multipliers, double* __restrict__ outputs, double* stored, long long count,
                  long long intervals) {
  const long long i = static_cast<long long>(blockIdx.x) * kPathThreads + threadIdx.x;
  if (i >= count) return;
  Path path(w + i * kInputs, hoisted + i / intervals * kHoisted, data + i * (kPointData + kEndsData + kPoints),
            multipliers + i * kOutputs, outputs + i * kOutputs, {stored + i, count});
  path.integrate();
  path.find_outputs();
  if constexpr (kOrder > 1) path.find_adjoints();
}

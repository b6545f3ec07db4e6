// The kernel that integrates an interval by one thread. It stores what ``intervals.cu`` needs for derivatives up to order
// kOrder: all that does not depend on a column.
#include "dynamic_memory.cuh"
#include "interval_path.cuh"

// ``intervals`` intervals share hoisted constants.
extern "C" __global__ void __launch_bounds__(kPathThreads)
    jaxscp_kernel(const double* __restrict__ w, const double* __restrict__ hoisted, const double* __restrict__ data,
                  const double* __restrict__ multipliers, double* __restrict__ outputs, double* stored,
                  double* of_slopes, long long count, long long intervals) {
  const long long first = static_cast<long long>(blockIdx.x) * kPathThreads, left = count - first;
  const int rows = left < kPathThreads ? left : kPathThreads;
  const long long i = first + (threadIdx.x < rows ? threadIdx.x : rows - 1);
  auto& slopes = *reinterpret_cast<SlopeRows*>(dynamic_memory<sizeof(SlopeRows)>());
  Path path(w + i * kInputs, hoisted + i / intervals * kHoisted, data + i * (kPointData + kEndsData + kPoints),
            multipliers + i * kOutputs, outputs + i * kOutputs, {stored + first + threadIdx.x, stride_of(count)},
            of_slopes + first * kSteps * kStages * kSlopeEntries, slopes, rows);
  path.integrate();
  path.find_outputs();
  if constexpr (kOrder > 1) path.find_adjoints();
}

// CUDA keywords and functions of kernels, on a CPU.
#pragma once

#include <cmath>
#include <utility>

#define JAXSCP_EMULATED_GPU

#define __global__
#define __noinline__
#define __constant__ static const
#define __shared__ static
#define __grid_constant__
#define __launch_bounds__(...)

struct Index {
  unsigned x = 0;
};
struct alignas(16) double2 {
  double x, y;
};
static Index threadIdx, blockIdx, blockDim;

// A block's dynamic shared memory. Its numbers are NaN when a block begins, as no kernel may rely on them.
alignas(16) static double emulated_memory[1 << 15];

static double __ldg(const double* at) { return *at; }
static double rsqrt(double v) { return 1.0 / std::sqrt(v); }
static int __clz(int v) { return v == 0 ? 32 : __builtin_clz(v); }
using std::cos, std::exp, std::fabs, std::fma, std::log, std::sin, std::sqrt, std::tanh;

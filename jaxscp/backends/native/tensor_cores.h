// Products of small matrices on a GPU's tensor cores.
#pragma once

namespace jaxscp {

// Adds the product of an 8 x 4 and a 4 x 8 matrix to 8 x 8 sums, by a whole warp. Lane 4 i + k holds entry (i, k) of the
// first factor, (k, i) of the second, and two sums in row i, from column 2 k on.
#if defined(JAXSCP_EMULATED_GPU)
void add_products(double (&sums)[2], double a, double b);
#else
inline void add_products(double (&sums)[2], double a, double b) {
  asm volatile("mma.sync.aligned.m8n8k4.row.col.f64.f64.f64.f64 {%0, %1}, {%2}, {%3}, {%0, %1};"
      : "+d"(sums[0]), "+d"(sums[1])
      : "d"(a), "d"(b));
}
#endif

}  // namespace jaxscp

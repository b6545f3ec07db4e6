// The shared memory of a block whose size the launch gives.
#pragma once

// It has so many bytes.
template <int kBytes>
inline double* dynamic_memory() {
#if defined(JAXSCP_EMULATED_GPU)
  static_assert(kBytes <= sizeof(emulated_memory));
  return emulated_memory;
#else
  extern __shared__ double2 of_block[];  // aligned for loads of two numbers
  return reinterpret_cast<double*>(of_block);
#endif
}

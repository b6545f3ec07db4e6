// What a library tells of itself.

// Digest of the sources that it was compiled from (sources.py).
extern "C" const char* jaxscp_sources() { return JAXSCP_SOURCES; }

// Whether this machine has the instruction set that the library was compiled for.

extern "C" int jaxscp_runs_here() {
#if JAXSCP_LEVEL == 4 || JAXSCP_LEVEL == 3  // of x86-64
  __builtin_cpu_init();
  bool runs = __builtin_cpu_supports("avx2") && __builtin_cpu_supports("fma") && __builtin_cpu_supports("bmi") &&
              __builtin_cpu_supports("bmi2");
#if JAXSCP_LEVEL == 4
  runs = runs && __builtin_cpu_supports("avx512f") && __builtin_cpu_supports("avx512bw") &&
         __builtin_cpu_supports("avx512cd") && __builtin_cpu_supports("avx512dq") && __builtin_cpu_supports("avx512vl");
#endif
  return runs;
#else
  return 1;
#endif
}

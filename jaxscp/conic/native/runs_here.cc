// Whether this machine has the instructions that the library was compiled for.

extern "C" int jaxscp_runs_here() {
#ifdef JAXSCP_ANY
  return 1;
#else
  return __builtin_cpu_supports(JAXSCP_LEVEL);
#endif
}

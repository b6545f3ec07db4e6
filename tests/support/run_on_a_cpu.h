// After a kernel's text: runs its blocks on a CPU, from the addresses of its parameters as the CUDA driver takes them.

namespace emulated {

template <typename... Parameters, size_t... I>
void call(void (*kernel)(Parameters...), void** parameters, std::index_sequence<I...>) {
  kernel(*static_cast<Parameters*>(parameters[I])...);
}

template <typename... Parameters>
void run_blocks(void (*kernel)(Parameters...), void** parameters, long long blocks, long long threads) {
  for (long long i = 0; i < blocks; ++i) {
    blockIdx.x = i;
    for (double& number : emulated_memory) number = 0.0 / 0.0;
    run_block(threads, [&] { call(kernel, parameters, std::index_sequence_for<Parameters...>()); });
  }
}

}  // namespace emulated

extern "C" void run(void** parameters, long long blocks, long long threads) {
  emulated::run_blocks(jaxscp_kernel, parameters, blocks, threads);
}

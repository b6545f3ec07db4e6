// The kernel: each block solves one program after another. ``gpu.py`` compiles it for the sizes of a program.
#include "batch.h"

using namespace jaxscp;

// Sizes: numbers of a program and its solver, version and size of ``Batch``, and bytes of shared memory for a block of
// JAXSCP_THREADS and one of JAXSCP_ALONE threads.
extern "C" __global__ void jaxscp_workspace(long long* sizes) {
  Arena counting;
  Program program(kLayout, counting);
  Scales scales(program, counting);
  InteriorPoint solver(program, scales, Settings{}, counting);
  sizes[0] = counting.used(), sizes[1] = kVersion, sizes[2] = sizeof(Batch);
  sizes[3] = shared_memory_size(JAXSCP_THREADS / kWarp) * sizeof(double);
  sizes[4] = shared_memory_size(JAXSCP_ALONE / kWarp) * sizeof(double);
}

extern "C" __global__ void __launch_bounds__(JAXSCP_ALONE, JAXSCP_THREADS * JAXSCP_BLOCKS / JAXSCP_ALONE)
    jaxscp_solve(const __grid_constant__ Batch batch, double* workspace, long long numbers, unsigned long long* next) {
  // One object per block: objects of each thread would be read from memory more often than their arrays.
  alignas(16) __shared__ char program_memory[sizeof(Program)], scales_memory[sizeof(Scales)];
  alignas(16) __shared__ char solver_memory[sizeof(InteriorPoint)];
  Program& program = *reinterpret_cast<Program*>(program_memory);
  Scales& scales = *reinterpret_cast<Scales*>(scales_memory);
  InteriorPoint& solver = *reinterpret_cast<InteriorPoint*>(solver_memory);
  once([&] {
    Arena arena(workspace + blockIdx.x * numbers);
    new (program_memory) Program(kLayout, arena);
    new (scales_memory) Scales(program, arena);
    new (solver_memory) InteriorPoint(program, scales, batch.settings, arena);
  });
  __shared__ long long element;
  for (;;) {
    once([&] { element = atomicAdd(next, 1ull); });
    if (element >= batch.size) break;
    solve_element(batch, element, program, scales, solver);
  }
}

// The kernel: each block solves one program after another. Compiled for the sizes by ``gpu.py``.
#include "batch.h"

using namespace jaxscp;

// Numbers that a program and its solver take, what ``Batch`` is to look like, and bytes that a block's threads share:
// those of one among others, and of one that has a multiprocessor to itself.
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
  // One for the block: with one for each thread, where its arrays are would be read more often than what is in them.
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

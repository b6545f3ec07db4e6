// The kernel: each block solves one program after another. Compiled for the sizes by ``gpu.py``.
#include "batch.h"

using namespace jaxscp;

// Numbers that a program and its solver take, what ``Batch`` is to look like, and bytes that a block's threads share:
// those of one among others, and of one that has a multiprocessor to itself.
extern "C" __global__ void jaxscp_room(long long* found) {
  Arena counting;
  Program program(kLayout, counting);
  Scales scales(program, counting);
  InteriorPoint solver(program, scales, Settings{}, counting);
  found[0] = counting.used(), found[1] = kVersion, found[2] = sizeof(Batch);
  found[3] = shared_room_of(JAXSCP_THREADS / kWarp) * sizeof(double);
  found[4] = shared_room_of(JAXSCP_ALONE / kWarp) * sizeof(double);
}

extern "C" __global__ void __launch_bounds__(JAXSCP_ALONE, JAXSCP_THREADS * JAXSCP_BLOCKS / JAXSCP_ALONE)
    jaxscp_solve(const __grid_constant__ Batch batch, double* room, long long numbers, unsigned long long* taken) {
  // One for the block: with one for each thread, where its arrays are would be read more often than what is in them.
  alignas(16) __shared__ char program_room[sizeof(Program)], scales_room[sizeof(Scales)];
  alignas(16) __shared__ char solver_room[sizeof(InteriorPoint)];
  Program& program = *reinterpret_cast<Program*>(program_room);
  Scales& scales = *reinterpret_cast<Scales*>(scales_room);
  InteriorPoint& solver = *reinterpret_cast<InteriorPoint*>(solver_room);
  once([&] {
    Arena arena(room + blockIdx.x * numbers);
    new (program_room) Program(kLayout, arena);
    new (scales_room) Scales(program, arena);
    new (solver_room) InteriorPoint(program, scales, batch.settings, arena);
  });
  __shared__ long long lane;
  for (;;) {
    once([&] { lane = atomicAdd(taken, 1ull); });
    if (lane >= batch.lanes) break;
    solve_lane(batch, lane, program, scales, solver);
  }
}

// What XLA calls on a CPU: solves a batch of programs, each to its own end. Its threads share the lanes, or the work of
// a single one.

#include <algorithm>
#include <memory>
#include <vector>

#include "buffers.h"
#include "spread.h"

namespace jaxscp {
namespace {

// A program's room and its solver's. Each thread keeps its last one: to find room anew takes longer than a step.
struct Worker {
  Sizes sizes;
  Settings settings;
  std::vector<Pack> memory;
  Arena arena;
  Program program;
  InteriorPoint solver;

  Worker(const Sizes& sizes, const Settings& settings)
      : sizes(sizes), settings(settings), memory(room(sizes, settings)), arena(memory.data()),
        program(Layout(sizes), arena), solver(program, settings, arena) {}

  static long long room(const Sizes& sizes, const Settings& settings) {
    Arena counting;
    Program program(Layout(sizes), counting);
    InteriorPoint solver(program, settings, counting);
    return counting.used();
  }

  static Worker& of_thread(const Sizes& sizes, const Settings& settings) {
    thread_local std::unique_ptr<Worker> kept;
    if (!kept || kept->sizes != sizes || kept->settings != settings) kept = std::make_unique<Worker>(sizes, settings);
    return *kept;
  }
};

// Takes a seat for as long as it does something.
template <typename Act>
void seated(Team& team, int me, Act act) {
  seat = {&team, me};
  act();
  seat = {};
}

// One program by as many threads as are free and have enough of it to do.
void solve_together(ffi::ThreadPool& pool, const Batch& batch, Worker& worker) {
  constexpr int kPacksEach = 2;
  const int packs = worker.program.packs;
  const int most = std::max<int64_t>(1, std::min<int64_t>(packs / kPacksEach, pool.num_threads()));
  Team team(most, packs);
  with_helpers(pool, most - 1, [&] { seated(team, 0, [&] { solve_lane(batch, 0, worker.program, worker.solver); }); },
               [&] { seated(team, -1, [&] { worker.solver.work(); }); });
}

ffi::Error solve(ffi::ThreadPool pool, ffi::RemainingArgs args, ffi::RemainingRets rets, ffi::Dictionary attrs) {
  auto found = shaped(args, rets, attrs);
  if (!found.has_value()) return found.error();
  const Batch& batch = found->batch;
  if (batch.lanes == 1) {
    solve_together(pool, batch, Worker::of_thread(found->sizes, batch.settings));
  } else {
    spread(pool, batch.lanes, [&](int64_t lane) {
      Worker& worker = Worker::of_thread(found->sizes, batch.settings);
      Team alone(1, worker.program.packs);
      seated(alone, 0, [&] { solve_lane(batch, lane, worker.program, worker.solver); });
    });
  }
  return ffi::Error::Success();
}

}  // namespace
}  // namespace jaxscp

XLA_FFI_DEFINE_HANDLER_SYMBOL(jaxscp_interior_point, jaxscp::solve,
                              xla::ffi::Ffi::Bind().Ctx<xla::ffi::ThreadPool>().RemainingArgs().RemainingRets().Attrs());

// What XLA calls on a CPU: solves a batch of programs, each to its own end, lanes shared among its threads.

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

ffi::Error solve(ffi::ThreadPool pool, ffi::RemainingArgs args, ffi::RemainingRets rets, ffi::Dictionary attrs) {
  auto found = shaped(args, rets, attrs);
  if (!found.has_value()) return found.error();
  const Batch& batch = found->batch;
  spread(pool, batch.lanes, [&](int64_t lane) {
    Worker& worker = Worker::of_thread(found->sizes, batch.settings);
    solve_lane(batch, lane, worker.program, worker.solver);
  });
  return ffi::Error::Success();
}

}  // namespace
}  // namespace jaxscp

XLA_FFI_DEFINE_HANDLER_SYMBOL(jaxscp_interior_point, jaxscp::solve,
                              xla::ffi::Ffi::Bind().Ctx<xla::ffi::ThreadPool>().RemainingArgs().RemainingRets().Attrs());

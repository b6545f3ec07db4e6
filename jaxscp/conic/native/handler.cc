// What XLA calls on a CPU: solves a batch of programs, each to its own end. Its threads share the lanes, or the work of
// a single one.

#include <algorithm>
#include <chrono>
#include <memory>
#include <vector>

#include "buffers.h"
#include "spread.h"

namespace jaxscp {
namespace {

// Whether others help with a program is for experience to say: their cores may be in use, and a thread that is not on a
// core holds up all. The answer is the same either way.
class HelperTimings {
 public:
  bool prefers_help() {
    if (alone_ == 0.0 || helped_ == 0.0) return helped_ == 0.0;
    return (helped_ < alone_) != (++turn_ % kTrialPeriod == 0);
  }
  void add(bool help, double seconds) {
    double& mean = help ? helped_ : alone_;
    mean = mean == 0.0 ? seconds : mean + kWeight * (std::min(seconds, 2.0 * mean) - mean);
  }

 private:
  static constexpr int kTrialPeriod = 16;      // the other way is tried once in so many
  static constexpr double kWeight = 0.25;  // weight of the last
  double alone_ = 0.0, helped_ = 0.0;  // of a step
  int turn_ = 0;
};

// A program's room and its solver's. Each thread keeps its last one: to find room anew takes longer than a step.
struct Worker {
  Sizes sizes;
  Settings settings;
  std::vector<Pack> memory;
  Arena arena;
  Program program;
  Scales scales;
  InteriorPoint solver;
  HelperTimings experience;

  Worker(const Sizes& sizes, const Settings& settings)
      : sizes(sizes), settings(settings), memory(workspace(sizes, settings)), arena(memory.data()),
        program(Layout(sizes), arena), scales(program, arena), solver(program, scales, settings, arena) {}

  static long long workspace(const Sizes& sizes, const Settings& settings) {
    Arena counting;
    Program program(Layout(sizes), counting);
    Scales scales(program, counting);
    InteriorPoint solver(program, scales, settings, counting);
    return counting.used();
  }

  static Worker& of_thread(const Sizes& sizes, const Settings& settings) {
    thread_local std::unique_ptr<Worker> worker;
    if (!worker || worker->sizes != sizes || worker->settings != settings) worker = std::make_unique<Worker>(sizes, settings);
    return *worker;
  }
};

// Takes a seat for as long as it does something.
template <typename Act>
void as_member(Team& team, int rank, Act act) {
  this_thread = {&team, rank};
  act();
  this_thread = {};
}

// One program by as many threads as have enough of it to do, where that is faster.
void solve_together(ffi::ThreadPool& pool, const Batch& batch, Worker& worker) {
  using Clock = std::chrono::steady_clock;
  constexpr int kPacksEach = 2;
  const int packs = worker.program.packs, threads = std::min<int64_t>(packs / kPacksEach, pool.num_threads());
  const bool help = threads > 1 && worker.experience.prefers_help();
  Team team(help ? threads : 1, packs);
  const auto begin = Clock::now();
  with_helpers(pool, help ? threads - 1 : 0,
               [&] { as_member(team, 0, [&] { solve_element(batch, 0, worker.program, worker.scales, worker.solver); }); },
               [&] { as_member(team, -1, [&] { worker.solver.work(); }); });
  const double seconds = std::chrono::duration<double>(Clock::now() - begin).count();
  worker.experience.add(help, seconds / (1 + worker.solver.iterations));
}

ffi::Error solve(ffi::ThreadPool pool, ffi::RemainingArgs args, ffi::RemainingRets rets, ffi::Dictionary attrs) {
  auto found = sized_batch(args, rets, attrs);
  if (!found.has_value()) return found.error();
  const Batch& batch = found->batch;
  if (batch.size == 1) {
    solve_together(pool, batch, Worker::of_thread(found->sizes, batch.settings));
  } else {
    spread(pool, batch.size, [&](int64_t element) {
      Worker& worker = Worker::of_thread(found->sizes, batch.settings);
      Team alone(1, worker.program.packs);
      as_member(alone, 0, [&] { solve_element(batch, element, worker.program, worker.scales, worker.solver); });
    });
  }
  return ffi::Error::Success();
}

}  // namespace
}  // namespace jaxscp

XLA_FFI_DEFINE_HANDLER_SYMBOL(jaxscp_interior_point, jaxscp::solve,
                              xla::ffi::Ffi::Bind().Ctx<xla::ffi::ThreadPool>().RemainingArgs().RemainingRets().Attrs());

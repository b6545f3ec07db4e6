// XLA's handler on a CPU: solves a batch of programs, each with its own number of steps. The threads share the batch
// elements, or the work on a single element.

#include <algorithm>
#include <chrono>
#include <memory>
#include <vector>

#include "buffers.h"
#include "parallel_for.h"

namespace jaxscp {
namespace {

// Measured times per step with and without helping threads. Helpers can be slower: other processes may use their cores,
// and a thread that is not running delays all others. The result is the same either way.
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
  static constexpr int kTrialPeriod = 16;  // the slower choice is tried once in so many programs
  static constexpr double kWeight = 0.25;  // weight of the latest time in the mean
  double alone_ = 0.0, helped_ = 0.0;  // mean seconds per step
  int turn_ = 0;
};

// Memory of a program and its solver. Each thread reuses its last worker, since an allocation takes longer than a step.
struct Worker {
  Sizes sizes;
  Settings settings;
  std::vector<Pack> memory;
  Arena arena;
  Program program;
  Scales scales;
  InteriorPoint solver;
  HelperTimings timings;

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
    if (!worker || worker->sizes != sizes || worker->settings != settings)
      worker = std::make_unique<Worker>(sizes, settings);
    return *worker;
  }
};

// Calls act() as a member of a team.
template <typename Act>
void as_member(Team& team, int rank, Act act) {
  this_thread = {&team, rank};
  act();
  this_thread = {};
}

// Solves one program with several threads, if that is faster and each thread has enough packs.
void solve_together(const Call& call, const Batch& batch, Worker& worker) {
  using Clock = std::chrono::steady_clock;
  constexpr int kPacksEach = 2;
  const int packs = worker.program.packs, threads = std::min<int64_t>(packs / kPacksEach, call.threads());
  const bool help = threads > 1 && worker.timings.prefers_help();
  Team team(help ? threads : 1, packs);
  const auto begin = Clock::now();
  with_helpers(call, help ? threads - 1 : 0,
               [&] {
                 as_member(team, 0, [&] { solve_element(batch, 0, worker.program, worker.scales, worker.solver); });
               },
               [&] { as_member(team, -1, [&] { worker.solver.work(); }); });
  const double seconds = std::chrono::duration<double>(Clock::now() - begin).count();
  worker.timings.add(help, seconds / (1 + worker.solver.iterations));
}

void solve(Call& call) {
  const auto [sizes, batch] = sized_batch(call);
  if (batch.size == 1) return solve_together(call, batch, Worker::of_thread(sizes, batch.settings));
  parallel_for(call, batch.size, [&sizes = sizes, &batch = batch](int64_t element) {
    Worker& worker = Worker::of_thread(sizes, batch.settings);
    Team alone(1, worker.program.packs);
    as_member(alone, 0, [&] { solve_element(batch, element, worker.program, worker.scales, worker.solver); });
  });
}

}  // namespace
}  // namespace jaxscp

JAXSCP_HANDLER(jaxscp_interior_point, jaxscp::solve);

// Work shared among the threads of XLA.
#pragma once

#include <atomic>
#include <condition_variable>
#include <memory>
#include <mutex>

#include "xla/ffi/api/ffi.h"

namespace jaxscp {

namespace ffi = xla::ffi;

// ``work(lane)`` for every lane. The caller takes part, and waits only for helpers that have begun, so that a pool with
// no thread to spare cannot hold it up.
template <typename Work>
void spread(ffi::ThreadPool& pool, int64_t lanes, const Work& work) {
  struct State {
    std::atomic<int64_t> next{0};
    std::mutex lock;
    std::condition_variable idle;
    int busy = 0;
    bool over = false;
  };
  auto state = std::make_shared<State>();
  auto take = [lanes](State& s, const Work& work) {
    for (int64_t lane; (lane = s.next++) < lanes;) work(lane);
  };
  for (int64_t i = 1; i < std::min<int64_t>(lanes, pool.num_threads()); ++i)
    pool.Schedule([state, take, &work] {
      {
        std::lock_guard<std::mutex> hold(state->lock);
        if (state->over) return;  // the caller has gone, and ``work`` with it
        ++state->busy;
      }
      take(*state, work);
      std::lock_guard<std::mutex> hold(state->lock);
      --state->busy;
      state->idle.notify_one();
    });
  take(*state, work);
  std::unique_lock<std::mutex> hold(state->lock);
  state->over = true;
  state->idle.wait(hold, [&] { return state->busy == 0; });
}

}  // namespace jaxscp

// Work shared among the threads of XLA.
#pragma once

#include <algorithm>
#include <atomic>
#include <condition_variable>
#include <memory>
#include <mutex>

#include "xla/ffi/api/ffi.h"

namespace jaxscp {

namespace ffi = xla::ffi;

// ``lead`` on this thread, and ``help`` on up to so many others. The caller waits only for helpers that have begun, so
// that a pool with no thread to spare cannot hold it up.
template <typename Lead, typename Help>
void with_helpers(ffi::ThreadPool& pool, int64_t helpers, const Lead& lead, const Help& help) {
  struct State {
    std::mutex lock;
    std::condition_variable idle;
    int busy = 0;
    bool over = false;
  };
  auto state = std::make_shared<State>();
  for (int64_t i = 0; i < helpers; ++i)
    pool.Schedule([state, &help] {
      {
        std::lock_guard<std::mutex> hold(state->lock);
        if (state->over) return;  // the caller has gone, and ``help`` with it
        ++state->busy;
      }
      help();
      std::lock_guard<std::mutex> hold(state->lock);
      --state->busy;
      state->idle.notify_one();
    });
  lead();
  std::unique_lock<std::mutex> hold(state->lock);
  state->over = true;
  state->idle.wait(hold, [&] { return state->busy == 0; });
}

// ``work(lane)`` for every lane.
template <typename Work>
void spread(ffi::ThreadPool& pool, int64_t lanes, const Work& work) {
  std::atomic<int64_t> next{0};
  auto take = [&] {
    for (int64_t lane; (lane = next++) < lanes;) work(lane);
  };
  with_helpers(pool, std::min<int64_t>(lanes, pool.num_threads()) - 1, take, take);
}

}  // namespace jaxscp

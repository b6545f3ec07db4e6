// Loops over XLA's thread pool.
#pragma once

#include <algorithm>
#include <atomic>
#include <condition_variable>
#include <memory>
#include <mutex>

#include "call.h"

namespace jaxscp {

// Runs ``lead`` on this thread and ``help`` on up to ``helpers`` others. The caller waits only for helpers that have
// begun, so that a busy pool cannot block the caller.
template <typename Lead, typename Help>
void with_helpers(const Call& call, int64_t helpers, const Lead& lead, const Help& help) {
  struct State {
    std::mutex lock;
    std::condition_variable idle;
    int busy = 0;
    bool over = false;
  };
  auto state = std::make_shared<State>();
  for (int64_t i = 0; i < helpers; ++i)
    call.schedule([state, &help] {
      {
        std::lock_guard<std::mutex> guard(state->lock);
        if (state->over) return;  // the caller has returned, and ``help`` no longer exists
        ++state->busy;
      }
      help();
      std::lock_guard<std::mutex> guard(state->lock);
      --state->busy;
      state->idle.notify_one();
    });
  lead();
  std::unique_lock<std::mutex> guard(state->lock);
  state->over = true;
  state->idle.wait(guard, [&] { return state->busy == 0; });
}

// Runs work(i) for i = 0 .. count - 1.
template <typename Work>
void parallel_for(const Call& call, int64_t count, const Work& work) {
  std::atomic<int64_t> next{0};
  auto take = [&] {
    for (int64_t i; (i = next++) < count;) work(i);
  };
  with_helpers(call, std::min(count, call.threads()) - 1, take, take);
}

}  // namespace jaxscp

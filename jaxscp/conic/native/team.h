// The threads of a CPU that solve a program together. One begins, and others join it as they become free.
//
// A phase is as short as a microsecond, so that who is done with it waits for the others without sleeping.
#pragma once

#include <algorithm>
#include <atomic>
#include <thread>
#include <vector>

#include "pack.h"

namespace jaxscp {

constexpr int kMaxTotals = 12;  // sums and the like, at most

class Team {
 public:
  // For up to ``most`` threads, whose sums are over up to ``packs``.
  Team(int most, int packs)
      : max_iterations_(most), parts_{std::vector<Pack>(packs * kMaxTotals), std::vector<Pack>(packs * kMaxTotals)} {}

  int size() const { return size_; }

  // Returns when all have come here: each then sees what the others did before.
  void wait(int me) {
    if (size_ == 1) return;
    if (me == 0) {
      gather();
      release();
    } else {
      await_leader();
    }
  }

  // Between phases: the number of a thread that wants to join, which waits here until it takes part. Negative where it
  // does not, as no others are needed, or what it was to do is done.
  int join() {
    const int me = ++joining_;
    if (me >= max_iterations_) return -1;
    until([&] { return admitted_.load(std::memory_order_acquire) > me || closed_.load(std::memory_order_acquire); });
    return admitted_.load(std::memory_order_acquire) > me ? me : -1;
  }

  // Between phases, for all who take part: those who came meanwhile do so from here on. False for who no longer does.
  bool admit(int me) {
    if (me > 0) {
      await_leader();
      return me < size_;
    }
    gather();
    if (late_ > kMaxDelays) closed_.store(true, std::memory_order_release);
    resize(closed_ ? 1 : std::min(1 + joining_, max_iterations_));
    release();
    admitted_.store(size_, std::memory_order_release);
    return true;
  }

  // The first thread goes on alone; the others have left after their last phase.
  void dismiss() {
    resize(1);
    closed_.store(true, std::memory_order_release);
  }

  // What packs add to sums. There are two, as one is still read when the next is written.
  Pack* parts(int turn) { return parts_[turn].data(); }

 private:
  static constexpr int kSpins = 400;     // a few microseconds: who is waited for may not be on a core
  static constexpr int kMaxDelays = 15;   // how often that, before others are not worth waiting for
  static constexpr int kYields = 1000;   // half a millisecond: as bad as all of these

  // Returns when it holds: how often its core was offered to others meanwhile.
  template <typename Condition>
  static int until(Condition holds) {
    for (int i = 0; i < kSpins; ++i) {
      if (holds()) return 0;
#if defined(__x86_64__)
      __builtin_ia32_pause();
#endif
    }
    int yields = 0;
    for (; !holds(); ++yields) std::this_thread::yield();
    return yields;
  }

  // Who was let go may still read the size, which then stays as it is.
  void resize(int size) {
    if (size != size_) size_ = size;
  }
  void gather() {
    int yields = until([&] { return arrived_.load(std::memory_order_acquire) == size_ - 1; });
    if (yields > 0) late_ += yields > kYields ? kMaxDelays + 1 : 1;
    arrived_.store(0, std::memory_order_relaxed);
  }
  void release() { round_.store(round_.load(std::memory_order_relaxed) + 1, std::memory_order_release); }
  void await_leader() {
    const long long round = round_.load(std::memory_order_relaxed);
    arrived_.fetch_add(1, std::memory_order_acq_rel);
    until([&] { return round_.load(std::memory_order_acquire) != round; });
  }

  const int max_iterations_;
  int size_ = 1, late_ = 0;  // changed by the first thread, while the others wait for it
  std::atomic<int> joining_{0};
  alignas(64) std::atomic<int> arrived_{0};
  alignas(64) std::atomic<long long> round_{0};
  alignas(64) std::atomic<int> admitted_{1};
  std::atomic<bool> closed_{false};
  std::vector<Pack> parts_[2];
};

// A thread's place in its team.
struct TeamMember {
  Team* team = nullptr;
  int me = 0;    // the first is zero, and who has not joined yet is negative
  int turn = 0;  // of ``Team::parts``
};
inline thread_local TeamMember this_thread;

}  // namespace jaxscp

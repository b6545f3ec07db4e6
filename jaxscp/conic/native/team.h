// Threads of a CPU that solve one program together. One thread begins, others join when they are free.
//
// A phase may take only a microsecond, so a thread that has finished its part spins instead of sleeping.
#pragma once

#include <algorithm>
#include <atomic>
#include <thread>
#include <vector>

#include "pack.h"

namespace jaxscp {

constexpr int kMaxTotals = 12;  // sums and maxima of one reduction

class Team {
 public:
  // Team of up to ``max_size`` threads, with reductions over up to ``packs`` packs.
  Team(int max_size, int packs)
      : max_size_(max_size), parts_{std::vector<Pack>(packs * kMaxTotals), std::vector<Pack>(packs * kMaxTotals)} {}

  int size() const { return size_; }

  // Barrier: returns when all threads have called it; each thread then sees the others' writes.
  void wait(int rank) {
    if (size_ == 1) return;
    if (rank == 0) {
      gather();
      release();
    } else {
      await_leader();
    }
  }

  // Rank of a thread that joins between phases, after it was admitted; negative if the team is full or closed.
  int join() {
    const int rank = ++joined_;
    if (rank >= max_size_) return -1;
    until([&] { return admitted_.load(std::memory_order_acquire) > rank || closed_.load(std::memory_order_acquire); });
    return admitted_.load(std::memory_order_acquire) > rank ? rank : -1;
  }

  // Called by all members between phases: admits the threads that joined meanwhile. False for a member that leaves.
  bool admit(int rank) {
    if (rank > 0) {
      await_leader();
      return rank < size_;
    }
    gather();
    if (delays_ > kMaxDelays) closed_.store(true, std::memory_order_release);
    resize(closed_ ? 1 : std::min(1 + joined_, max_size_));
    release();
    admitted_.store(size_, std::memory_order_release);
    return true;
  }

  // Closes the team after its last phase; the first thread goes on alone.
  void dismiss() {
    resize(1);
    closed_.store(true, std::memory_order_release);
  }

  // Contributions of packs to a reduction. Two buffers alternate, as one is still read while the next is written.
  Pack* parts(int turn) { return parts_[turn].data(); }

 private:
  static constexpr int kSpins = 400;     // a few microseconds; after that, an awaited thread may not be running
  static constexpr int kMaxDelays = 15;  // delays after which the team closes, as it is too slow
  static constexpr int kYields = 1000;   // half a millisecond: a delay that closes the team at once

  // Waits for a condition; returns how often this thread yielded its core meanwhile.
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

  // A member that has left may still read the size, so an unchanged size is not written.
  void resize(int size) {
    if (size != size_) size_ = size;
  }
  void gather() {
    int yields = until([&] { return arrived_.load(std::memory_order_acquire) == size_ - 1; });
    if (yields > 0) delays_ += yields > kYields ? kMaxDelays + 1 : 1;
    arrived_.store(0, std::memory_order_relaxed);
  }
  void release() { round_.store(round_.load(std::memory_order_relaxed) + 1, std::memory_order_release); }
  void await_leader() {
    const long long round = round_.load(std::memory_order_relaxed);
    arrived_.fetch_add(1, std::memory_order_acq_rel);
    until([&] { return round_.load(std::memory_order_acquire) != round; });
  }

  const int max_size_;
  int size_ = 1, delays_ = 0;  // written by the first thread while the others wait
  std::atomic<int> joined_{0};
  alignas(64) std::atomic<int> arrived_{0};
  alignas(64) std::atomic<long long> round_{0};
  alignas(64) std::atomic<int> admitted_{1};
  std::atomic<bool> closed_{false};
  std::vector<Pack> parts_[2];
};

// This thread's membership of a team.
struct TeamMember {
  Team* team = nullptr;
  int rank = 0;  // zero for the first thread, negative before joining
  int turn = 0;  // buffer of ``Team::parts``
};
inline thread_local TeamMember this_thread;

}  // namespace jaxscp

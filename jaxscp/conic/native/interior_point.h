// Primal-dual interior point: ``interior_point.py``, ``loop.py`` and the files below it, step for step.
#pragma once

#include "equilibrate.h"
#include "iterate.h"

namespace jaxscp {

class InteriorPoint {
 public:
  InteriorPoint(const Program& program, const Scales& scales, const Settings& settings, Arena& arena)
      : program_(program), scales_(scales), settings_(settings), iterate_(program, arena), direction_(program, arena),
        scaling_(program, arena), ry_(arena.take(iterate_.y.size)), rx_(arena.take(iterate_.x.size)),
        system_(program, arena), constant_x_(arena.take(rx_.size)), constant_y_(arena.take(ry_.size)),
        residuals_(program, arena), minus_q_(arena.take(rx_.size)) {}

  // Solves the equilibrated program.
  void run(double tolerance) {
    const Program::Largest largest = program_.largest_of_vectors();
    const double q = maximum(1.0, largest.largest(0)), b = maximum(1.0, largest.largest(1));
    parallel_for(minus_q_.size, [&](int i) { minus_q_[i] = -program_.q[i]; });
    system_.read();
    if (program_.data.warm_z) {
      program_.read_warm_start(iterate_.x, iterate_.y);
      scales_.apply(iterate_.x, iterate_.y);
    }
    once([&] {
      tolerance_ = tolerance, size_q_ = q, size_b_ = b;
      iterations = 0, max_iterations_ = settings_.max_iterations;
      warm_ = program_.data.warm_z;
      started_ = stalled = broken = false;
    });
    work();
    dismiss();
  }

  // Remaining iterations of ``run``; other threads may join between two of them.
  void work() {
    while (admit()) {
      if (started_) step();
      else if (warm_) start_warm();
      else start();
      if (decided()) return;
      if (!(stalled || broken || iterations >= max_iterations_)) continue;
      if (!warm_) return;
      once([&] {  // the warm start led nowhere: cold start in the embedding
        warm_ = started_ = stalled = broken = false;
        max_iterations_ = iterations + settings_.max_iterations;
      });
    }
  }

  const Iterate& iterate() const { return iterate_; }
  const Residuals& residuals() const { return residuals_; }
  int iterations = 0;
  bool stalled = false, broken = false;

 private:
  // --- stopping tests ---

  // Whether the program is solved, or proved infeasible or unbounded.
  bool decided() const { return decided(residuals_); }
  bool decided(const Measures& r) const {
    return r.error <= tolerance_ || r.infeasibility <= settings_.proof_tolerance ||
           r.unboundedness <= settings_.proof_tolerance;
  }

  // Whether the error or a proof is small enough for iterative refinement to matter.
  bool close_to_end() const { return close_to_end(residuals_); }
  bool close_to_end(const Measures& r) const {
    return minimum(r.error, minimum(r.infeasibility, r.unboundedness)) < settings_.refine_below;
  }

  // Whether a decision may follow from these measures, so that predicted ones are not good enough.
  bool needs_exact_residuals(const Measures& r) const {
    return close_to_end(r) || decided(r) || r.error <= settings_.loose_tolerance;
  }

  // --- starting points (starting_point.h) ---

  JAXSCP_CALLED void start();
  JAXSCP_CALLED void start_warm();
  static void split(Pack difference, double mu, Pack& s, Pack& y);
  void set_embedding(double kappa);
  void begin(const Measures& found);
  JAXSCP_CALLED void shift_inside(Packs v) const;

  // --- directions and steps (directions.h) ---

  // Largest steps in the cones, at most one, for slacks and for multipliers; and the products y'ds and ds'dy.
  struct Steps {
    double primal, dual, along, squared;
  };

  void step();
  double centring(const Steps& affine) const;
  bool affine_suffices(const Steps& affine, double fraction) const;
  double remaining(const Steps& affine, double fraction) const;
  JAXSCP_CALLED void correct(double fraction, double centre);
  JAXSCP_CALLED void embed(double fraction, double slope, double target);
  JAXSCP_CALLED Steps find_slacks(Packs slack_term);
  JAXSCP_CALLED double find_slope();
  JAXSCP_CALLED void take_step(double primal, double dual, double removed);

  // --- residuals and measures (residuals.h) ---

  enum { kQuadratic, kLinear, kOffset, kComplementarity, kSums };
  enum { kDual, kDualResidual, kHessianX, kPrimal, kPrimalResidual, kLargest };
  using Found = Totals<kSums, kLargest>;

  JAXSCP_CALLED Measures measure(const Iterate& v);
  JAXSCP_CALLED Measures measure_multipliers(const Iterate& v);
  JAXSCP_CALLED Measures predict(const Iterate& v, double primal, double dual);
  void add_row(const Iterate& v, int p, int i, Pack primal, Found& to) const;
  void add_variable(const Iterate& v, int p, int j, Pack hessian_x, Pack dual, Found& to) const;
  Measures measures(const Iterate& v, const Found& totals) const;

  // --- helpers ---

  NewtonSystem::KKTVectors direction_vectors() const { return {rx_, ry_, direction_.x, direction_.y}; }

  template <typename T>
  static void swap(T& a, T& b) {
    T old = a;
    a = b;
    b = old;
  }
  static double minimum(double a, double b) { return b < a ? b : a; }
  static double maximum(double a, double b) { return a < b ? b : a; }

  Entries at(Packs v, int p) const { return program_.of_cones(v, p); }

  const Program& program_;
  const Scales& scales_;
  Settings settings_;
  // most frequently used arrays first, close together in memory
  Iterate iterate_, direction_;
  Scaling scaling_;
  Packs ry_, rx_;
  NewtonSystem system_;
  NewtonSystem::KKTVectors systems_[kMaxRhs];  // direction of a step, and the embedding's constant direction
  Packs constant_x_, constant_y_;
  Residuals residuals_;
  Packs minus_q_;  // -q
  // constants of ``directions.py``, ``loop.py`` and ``warm_start.py``
  static constexpr double kEmbeddedFraction = 0.99, kProgramFraction = 0.98;  // of the step to the boundary
  static constexpr double kSafety = 0.8;  // fraction of the tolerance that the predicted error must meet
  static constexpr double kShortestStep = 1e-6, kWorse = 2.0;
  static constexpr double kMu = 0.3, kPower = 0.2, kLowestMu = 1e-3, kHighestMu = 3.0;
  static constexpr double kAtBound = 0.99, kRelaxation = 2.0;
  double tolerance_ = 0.0, size_q_ = 1.0, size_b_ = 1.0;
  int max_iterations_ = 0;
  bool warm_ = false, started_ = false;  // ``warm_``: steps of the program itself, not of the embedding
};

}  // namespace jaxscp

// in the order of their use
#include "starting_point.h"
#include "directions.h"
#include "residuals.h"

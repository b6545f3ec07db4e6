// The primal-dual interior point: ``interior_point.py``, ``directions.py`` and ``iterate.py``, step for step.
#pragma once

#include "newton_system.h"
#include "equilibrate.h"

namespace jaxscp {

struct Settings {
  double proof_tolerance, loose_tolerance, regularisation, refine_below;
  int max_iterations, refinements, equilibration;
  bool operator==(const Settings&) const = default;
};

struct Iterate {
  Packs all, x, y, s;
  double tau = 1.0, kappa = 1.0;
  Iterate(const Program& p, Arena& arena)
      : all(arena.take(p.packs * (p.primal.size + 2 * p.cone.size))), x(all.part(0, p.packs * p.primal.size)),
        y(all.part(x.size, p.packs * p.cone.size)), s(all.part(x.size + y.size, y.size)) {}
};

// What is missing at an iterate, as numbers.
struct Measures {
  double tau = 0.0, mu = 0.0, error = 0.0, infeasibility = 0.0, unboundedness = 0.0;
};

struct Residuals : Measures {
  Packs x, y, curved;  // ``curved``: P x
  Residuals(const Program& p, Arena& arena)
      : x(arena.take(p.packs * p.primal.size)), y(arena.take(p.packs * p.cone.size)),
        curved(arena.take(x.size)) {}
};

class InteriorPoint {
 public:
  InteriorPoint(const Program& program, const Scales& scales, const Settings& settings, Arena& arena)
      : program_(program), scales_(scales), settings_(settings), iterate_(program, arena), direction_(program, arena),
        scaling_(program, arena), ry_(arena.take(iterate_.y.size)), rx_(arena.take(iterate_.x.size)),
        system_(program, arena), constant_x_(arena.take(rx_.size)), constant_y_(arena.take(ry_.size)),
        residuals_(program, arena), minus_q_(arena.take(rx_.size)) {}

  // The equilibrated program.
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

  // What is left to do of ``run``; other threads may come to help with it.
  void work() {
    while (admit()) {
      if (started_) step();
      else if (warm_) start_warm();
      else start();
      if (decided()) return;
      if (!(stalled || broken || iterations >= max_iterations_)) continue;
      if (!warm_) return;
      once([&] {  // again, from afar and in the embedding
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
  // Whether the program is solved, or there is a proof that it has no solution.
  bool decided() const { return decided(residuals_); }
  bool decided(const Measures& r) const {
    return r.error <= tolerance_ || r.infeasibility <= settings_.proof_tolerance ||
           r.unboundedness <= settings_.proof_tolerance;
  }

  // Far from the end the digits that cones near their boundary take from a solution are not missed.
  bool close_to_end() const { return close_to_end(residuals_); }
  bool close_to_end(const Measures& r) const {
    return minimum(r.error, minimum(r.infeasibility, r.unboundedness)) < settings_.refine_below;
  }

  // Whether something may be said of an iterate by these, which are then to be exact.
  bool needs_exact_residuals(const Measures& r) const {
    return close_to_end(r) || decided(r) || r.error <= settings_.loose_tolerance;
  }

  // The point that solves the program with its cones replaced by a least-squares penalty.
  JAXSCP_CALLED void start() {
    const Program& g = program_;
    scaling_.set_unit();
    system_.factor(scaling_, settings_.regularisation);
    once([&] { systems_[0] = {minus_q_, g.b, iterate_.x, iterate_.y}; });
    system_.solve<1>(scaling_, settings_.refinements, systems_);
    parallel_for(iterate_.s.size, [&](int i) { iterate_.s[i] = -iterate_.y[i]; });
    shift_inside(iterate_.s);
    shift_inside(iterate_.y);
    // The bounds of the norms follow their cones, so that those rows start without residual.
    parallel_for(g.packs, [&](int p) {
      if (g.has_norm) g.of_primal(iterate_.x, p)[g.xi] = at(iterate_.s, p)[g.trust];
      g.of_primal(iterate_.x, p)[g.zeta] = at(iterate_.s, p)[g.virtual_];
    });
    set_embedding(1.0);
    begin(measure(iterate_));
  }

  // On the central path near the point that was given (``near.py``).
  JAXSCP_CALLED void start_warm() {
    const Program& g = program_;
    // Slacks as the program has them, which the residuals are to lack; the bound of a norm is the norm.
    g.times_constraints(iterate_.x, iterate_.s);
    using Total = Totals<1, 0>;
    const double distance = fold(g.packs, Parts{g.r, g.cone_count}, Total::none(), [&](int p, int k, Total& found) {
      Entries s = at(iterate_.s, p), y = at(iterate_.y, p), b = at(g.b, p), had = at(residuals_.y, p);
      if (k < g.r) {
        s[k] = had[k] = b[k] - s[k];
        found.add(0, g.of_nodes(p, magnitude(s[k] * y[k])));
      } else {
        const int c = k - g.r;
        auto [i, d, of_link] = g.cone_at(c);
        soc::ConeRegisters slack = soc::load(s + i, d);
        const soc::ConeRegisters right = soc::load(b + i, d);
        soc::each(slack, [&](int j) { return right[j] - slack[j]; });
        if (c >= g.user_cones) soc::set_head(slack, soc::tail_norm(slack));
        const soc::ConeRegisters multiplier = soc::load(y + i, d);
        const Pack product = once_per_cone(magnitude(soc::dot(slack, multiplier)));
        found.add(0, of_link ? g.of_links(p, product) : g.of_nodes(p, product));
        soc::ConeRegisters before = soc::output(had + i, d);
        soc::each(before, [&](int j) { return slack[j]; });
        if (c == g.virtual_cone) {
          const Pack used = where(soc::tail_norm(multiplier) > kAtBound * soc::head(multiplier), all(1.0), all(0.0));
          soc::each(slack, [&](int j) { return used * slack[j]; });
          soc::set_head(before, soc::head(slack));
        }
        if (c >= g.user_cones) g.of_primal(iterate_.x, p)[c == g.virtual_cone ? g.zeta : g.xi] = soc::head(slack);
        soc::store(before, had + i), soc::store(slack, s + i);
      }
    }).sum(0) / (g.degree - 1.0);
    const double mu = maximum(kLowestMu, minimum(kHighestMu, kMu * pow(distance, kPower)));
    g.each(
        [&](int p, int i) {
          Entries s = at(iterate_.s, p), y = at(iterate_.y, p);
          split(s[i] - y[i], mu, s[i], y[i]);
          at(residuals_.y, p)[i] = s[i] - at(residuals_.y, p)[i];
        },
        [&](int p, int i, int d, int) {
          const Entries of_s = at(iterate_.s, p) + i, of_y = at(iterate_.y, p) + i;
          soc::ConeRegisters s = soc::load(of_s, d), y = soc::load(of_y, d);
          soc::each(s, [&](int j) { return s[j] - y[j]; });
          // of the gap the spectral values, each of which is split
          const Pack gap = soc::head(s), norm = soc::tail_norm(s), over = inverse(soc::positive(norm));
          Pack s_plus, y_plus, s_minus, y_minus;
          split(gap + norm, mu, s_plus, y_plus);
          split(gap - norm, mu, s_minus, y_minus);
          soc::each(y, [&](int j) { return 0.5 * (y_plus - y_minus) * over * s[j]; });
          soc::each(s, [&](int j) { return 0.5 * (s_plus - s_minus) * over * s[j]; });
          const Pack multiplier = 0.5 * (y_plus + y_minus);
          const bool of_moves = g.has_norm && i == g.trust;  // which get room
          soc::set_head(s, 0.5 * (s_plus + s_minus) + (of_moves ? kRelaxation * mu * inverse(multiplier) : all(0.0)));
          soc::set_head(y, multiplier);
          soc::ConeRegisters residual = soc::load(at(residuals_.y, p) + i, d);
          soc::each(residual, [&](int j) { return s[j] - residual[j]; });
          soc::store(s, of_s), soc::store(y, of_y), soc::store(residual, at(residuals_.y, p) + i);
        });
    parallel_for(g.packs, Parts{g.m}, [&](int p, int i) {
      const int k = g.zero + i;
      at(residuals_.y, p)[k] = at(iterate_.s, p)[k] - at(g.b, p)[k];
    });
    set_embedding(0.0);
    begin(measure_multipliers(iterate_));
  }

  // s and y of which s y = mu and s - y are given; the smaller of them from their product, as the difference cancels.
  static void split(Pack gap, double mu, Pack& s, Pack& y) {
    const Pack large = 0.5 * (magnitude(gap) + root(gap * gap + 4.0 * mu)), small = mu * inverse(large);
    s = where(gap > 0.0, large, small), y = where(gap > 0.0, small, large);
  }

  // Whether it is the embedding's, by kappa; and of slacks the zero cone, which no step changes.
  void set_embedding(double kappa) {
    once([&] { iterate_.tau = 1.0, iterate_.kappa = kappa; });
    program_.clear_zero_cone(iterate_.s), program_.clear_zero_cone(direction_.s);
  }

  void begin(const Measures& found) {
    once([&] {
      static_cast<Measures&>(residuals_) = found;
      systems_[0] = direction_vectors(), systems_[1] = {minus_q_, program_.b, constant_x_, constant_y_};
      started_ = true;
      broken = !is_finite(residuals_.error);
    });
  }

  // Move every cone's part at least one unit inside its cone.
  JAXSCP_CALLED void shift_inside(Packs v) const {
    program_.each([&](int p, int i) { at(v, p)[i] = larger(at(v, p)[i], all(1.0)); },
                  [&](int p, int i, int d, int) {
                    soc::ConeRegisters part = soc::load(at(v, p) + i, d);
                    soc::set_head(part, larger(soc::head(part), soc::tail_norm(part) + 1.0));
                    soc::store(part, at(v, p) + i);
                  });
  }

  void step() {
    const Residuals& r = residuals_;
    const Iterate& old = iterate_;
    const int rounds = close_to_end() ? settings_.refinements : 0;
    scaling_.set(old.s, old.y);
    system_.factor(scaling_, settings_.regularisation);

    // the affine direction, which aims at s = 0; and the embedding's constant one, which both steps share
    parallel_for(rx_.size + ry_.size, [&](int i) {
      if (i < rx_.size) rx_[i] = -r.x[i];
      else i -= rx_.size, ry_[i] = old.s[i] - r.y[i];
    });
    if (warm_) system_.solve<1>(scaling_, rounds, systems_);
    else system_.solve<2>(scaling_, rounds, systems_);
    const double slope = warm_ ? 0.0 : find_slope(), product = old.tau * old.kappa;
    embed(1.0, slope, product);
    const double fraction = warm_ ? kProgramFraction : kEmbeddedFraction;
    const Steps affine = find_slacks(old.s);
    if (uniform(affine_suffices(affine, fraction))) return take(fraction * affine.primal, fraction * affine.dual, 1.0);
    const double sigma = centring(affine);
    const double target = product + direction_.tau * direction_.kappa - sigma * r.mu;

    // Mehrotra's combined direction: centring by sigma and second-order correction
    correct(1.0 - sigma, sigma * r.mu);
    system_.solve<1>(scaling_, rounds, systems_);
    embed(1.0 - sigma, slope, target);
    const Steps longest = find_slacks(direction_.s);
    take(fraction * longest.primal, fraction * longest.dual, 1.0 - sigma);
  }

  // How far a direction goes before it leaves the cones, at most one, with slacks and with multipliers; and what products
  // of the iterate and of the direction there are.
  struct Steps {
    double primal, dual, along, squared;  // y'ds, ds'dy
  };

  // Mehrotra's share of the complementarity to aim at: the cube of what the affine direction leaves of it.
  double centring(const Steps& affine) const {
    const double left = maximum(0.0, minimum(1.0, warm_ ? remaining(affine, 1.0) : 1.0 - affine.primal));
    return left * left * left;
  }

  // Whether nothing is left to correct: with the part of the affine direction that can be taken the program is solved.
  bool affine_suffices(const Steps& affine, double part) const {
    const double of_residuals = 1.0 - part * minimum(affine.primal, affine.dual);
    return warm_ && residuals_.error * maximum(remaining(affine, part), of_residuals) <= kSafety * tolerance_;
  }

  // What so much of the affine direction leaves of the complementarity. As s'dy + y'ds = -s'y of this direction, that is
  // known of y'ds and ds'dy.
  double remaining(const Steps& affine, double part) const {
    const double a = part * affine.primal, b = part * affine.dual, before = residuals_.mu * program_.degree;
    return 1.0 - b + ((a - b) * affine.along + a * b * affine.squared) / before;
  }

  // The combined right side, residuals reduced by ``part``:  lifted = s + W (lambda \ (W^-1 ds o W dy - centre e)),
  // where lambda = W y and ds, dy are the affine direction's. It takes the place of ds.
  JAXSCP_CALLED void correct(double part, double centre) {
    const Program& g = program_;
    const Residuals& r = residuals_;
    g.each(
        [&](int p, int i) {
          Entries slack = at(direction_.s, p);
          slack[i] = at(iterate_.s, p)[i] + (slack[i] * at(direction_.y, p)[i] - centre) * inverse(at(iterate_.y, p)[i]);
          at(ry_, p)[i] = slack[i] - part * at(r.y, p)[i];
        },
        [&](int p, int i, int d, int c) {
          auto load = [&](Packs v) { return soc::load(at(v, p) + i, d); };
          const soc::ConeRegisters w = load(scaling_.w), dy = load(direction_.y), y = load(iterate_.y), s = load(iterate_.s);
          const soc::ConeRegisters residual = load(r.y);
          soc::ConeRegisters slack = load(direction_.s), other = soc::output(at(ry_, p) + i, d);
          const Pack eta = scaling_.eta_of(p, c);
          soc::scale(w, eta, -1.0, slack, slack);
          soc::scale(w, eta, 1.0, dy, other);
          soc::product(slack, other, all(centre), slack);
          soc::scale(w, eta, 1.0, y, other);
          soc::divide(other, slack, slack);
          soc::scale(w, eta, 1.0, slack, slack);
          soc::each(slack, [&](int j) { return s[j] + slack[j]; });
          soc::each(other, [&](int j) { return slack[j] - part * residual[j]; });
          soc::store(slack, at(direction_.s, p) + i), soc::store(other, at(ry_, p) + i);
        });
    fill(g.packs, g.m, [&](int p, int i) -> Pack& { return at(ry_, p)[g.zero + i]; },
         [&](int p, int i) { return -part * at(r.y, p)[g.zero + i]; });
    fill(g.packs, g.primal.size, [&](int p, int i) -> Pack& { return g.of_primal(rx_, p)[i]; },
         [&](int p, int i) { return -part * g.of_primal(r.x, p)[i]; });
  }

  // Adds the multiple tau of the constant direction that the embedding's last equation asks for. A loop that starts near
  // is of the program itself, where tau is one.
  JAXSCP_CALLED void embed(double part, double slope, double target) {
    if (warm_) return once([&] { direction_.tau = direction_.kappa = 0.0; });
    const Program& g = program_;
    const Iterate& old = iterate_;
    Iterate& out = direction_;
    const Residuals& r = residuals_;
    using Total = Totals<1, 0>;
    const double along = fold(g.packs, Parts{g.primal.size + g.cone.size}, Total::none(), [&](int p, int k, Total& to) {
      if (k < g.primal.size) {
        Pack gradient = 2.0 / old.tau * g.of_primal(r.curved, p)[k] + g.of_primal(g.q, p)[k];
        to.add(0, g.of_stages(p, k, g.primal, gradient * g.of_primal(out.x, p)[k]));
      } else {
        const int i = k - g.primal.size;
        to.add(0, g.of_stages(p, i, g.cone, at(g.b, p)[i] * at(out.y, p)[i]));
      }
    }).sum(0);
    const double tau = (target / old.tau - part * r.tau - along) / slope;
    once([&] { out.tau = tau, out.kappa = -(target + old.kappa * tau) / old.tau; });
    parallel_for(out.x.size + out.y.size, [&](int i) {
      if (i < out.x.size) out.x[i] += tau * constant_x_[i];
      else i -= out.x.size, out.y[i] += tau * constant_y_[i];
    });
  }

  // The direction of the slacks, of that of the multipliers; it may take the place of ``lifted``. Of a linear program the
  // multipliers' residuals do not depend on the variables: both then go as far as they can.
  JAXSCP_CALLED Steps find_slacks(Packs slack_term) {
    const Program& g = program_;
    const Iterate& old = iterate_;
    const Iterate& out = direction_;
    enum { kAlong, kSquared, kProducts };
    enum { kOfSlacks, kOfMultipliers, kSpeeds };  // at which boundaries come near
    using Total = Totals<kProducts, kSpeeds>;
    const Total found = fold(g.packs, Parts{g.r, g.cone_count}, Total::none(), [&](int p, int k, Total& to) {
      auto see = [&](int of, Pack along, Pack squared, Pack slack, Pack multiplier) {
        auto counted = [&](Pack v) { return where(within(p, of), v, all(0.0)); };
        to.add(kAlong, counted(along)), to.add(kSquared, counted(squared));
        to.include_max(kOfSlacks, counted(slack)), to.include_max(kOfMultipliers, counted(multiplier));
      };
      if (const int i = k; i < g.r) {
        const Pack w = at(scaling_.w, p)[i], s = at(old.s, p)[i], y = at(old.y, p)[i], dy = at(out.y, p)[i];
        const Pack ds = -(at(slack_term, p)[i] + w * w * dy);
        at(out.s, p)[i] = ds;
        see(g.nodes, y * ds, ds * dy, -ds * inverse(s), -dy * inverse(y));
      } else {
        auto [first, d, of_link] = g.cone_at(k - g.r);
        auto load = [&](Packs v) { return soc::load(at(v, p) + first, d); };
        const soc::ConeRegisters w = load(scaling_.w), term = load(slack_term), s = load(old.s), y = load(old.y), dy = load(out.y);
        soc::ConeRegisters ds = soc::output(at(out.s, p) + first, d);
        soc::ConeRegisters square = soc::output(at(ry_, p) + first, d);  // whose right side has been used
        soc::square(w, scaling_.eta_of(p, k - g.r), dy, square);
        soc::each(ds, [&](int j) { return -(term[j] + square[j]); });
        soc::store(ds, at(out.s, p) + first);
        see(of_link ? g.nodes + 1 : g.nodes, soc::part_of_dot(y, ds), soc::part_of_dot(ds, dy),
            soc::inverse_step(s, ds), soc::inverse_step(y, dy));
      }
    });
    double primal = 1.0 / maximum(1.0, found.largest(kOfSlacks)), dual = 1.0 / maximum(1.0, found.largest(kOfMultipliers));
    if (!warm_ || g.hessian.entries > 0) {
      auto bound = [](double v, double d) { return d < 0.0 ? -v / d : 1.0; };
      primal = minimum(minimum(primal, dual), minimum(bound(old.tau, out.tau), bound(old.kappa, out.kappa)));
      dual = primal;
    }
    return {primal, dual, found.sum(kAlong), found.sum(kSquared)};
  }

  // Derivative of the embedding's last equation along the constant direction; always negative.
  JAXSCP_CALLED double find_slope() {
    const Program& g = program_;
    const double over = 1.0 / iterate_.tau;
    using Total = Totals<1, 0>;
    const Parts parts{g.n + g.r, g.cone_count};
    const double curvature = fold(g.packs, parts, Total::none(), [&](int p, int k, Total& found) {
      Entries w = at(scaling_.w, p), y = at(constant_y_, p);
      if (k < g.n) {
        Entries x = g.of_primal(iterate_.x, p), along = g.of_primal(constant_x_, p);
        auto distance = [&](int i) { return along[i] - over * x[i]; };
        found.add(0, g.of_nodes(p, distance(k) * g.hessian.add_transposed(p, k, all(0.0), distance)));
      } else if (const int i = k - g.n; i < g.r) {
        found.add(0, g.of_nodes(p, w[i] * w[i] * y[i] * y[i]));
      } else {
        auto [offset, d, of_link] = g.cone_at(i - g.r);
        Pack norm = soc::scaled_square(soc::load(w + offset, d), scaling_.eta_of(p, i - g.r), soc::load(y + offset, d));
        found.add(0, once_per_cone(of_link ? g.of_links(p, norm) : g.of_nodes(p, norm)));
      }
    }).sum(0);
    return -(curvature + iterate_.kappa / iterate_.tau);
  }

  // ``part``: of the residuals, that the direction is to take away.
  JAXSCP_CALLED void take(double primal, double dual, double part) {
    // the next iterate takes the place of the direction
    const Program& g = program_;
    Iterate &old = iterate_, &next = direction_;
    double tau = old.tau + primal * next.tau, kappa = old.kappa + primal * next.kappa, unit = 1.0 / maximum(tau, kappa);
    once([&] { next.tau = unit * tau, next.kappa = unit * kappa; });
    const Packs from = old.all, to = next.all;
    const int first = old.x.size, end = first + old.y.size;  // of multipliers
    fill(g.packs, from.size / g.packs, [&](int p, int i) -> Pack& { return to[i * g.packs + p]; },
         [&](int p, int i) {
           const int k = i * g.packs + p;
           return unit * (from[k] + (k < first || k >= end ? primal : dual) * to[k]);
         });
    const bool exact = close_to_end();
    Measures found = exact ? measure(next) : predict(next, unit * (1.0 - primal * part), unit * (1.0 - dual * part));
    if (!exact && uniform(needs_exact_residuals(found))) found = measure(next);
    once([&] {
      double error = found.error, before = residuals_.error;
      broken = !(is_finite(error) && is_finite(found.mu));
      // A step that makes a nearly solved iterate worse has run into rounding: keep the better one.
      stalled = minimum(primal, dual) < 1e-6 || (before < settings_.loose_tolerance && error > 2.0 * before);
      if (!(broken || (stalled && error > before))) {
        swap(iterate_, direction_);
        systems_[0] = direction_vectors();
        static_cast<Measures&>(residuals_) = found;
      }
      ++iterations;
    });
  }

  enum { kQuadratic, kLinear, kOffset, kComplementarity, kSums };
  enum { kDual, kDualResidual, kCurved, kPrimal, kPrimalResidual, kLargest };
  using Found = Totals<kSums, kLargest>;

  // What is missing at an iterate: vectors are left in ``residuals_``.
  JAXSCP_CALLED Measures measure(const Iterate& v) {
    const Program& g = program_;
    g.begin_times(v.x, v.y);
    return measures(v, fold(g.packs, g.products(), Found::none(), [&](int p, int k, Found& to) {
      auto row = [&](int i, Pack product) { add_row(v, p, i, product + at(v.s, p)[i], to); };
      auto variable = [&](int j, Pack curved, Pack dual) { add_variable(v, p, j, curved, dual, to); };
      g.product(p, k, v.x, v.y, row, variable);
    }));
  }

  // The same where ``residuals_`` has what rows lack.
  JAXSCP_CALLED Measures measure_multipliers(const Iterate& v) {
    const Program& g = program_;
    g.begin_transposed(v.y);
    return measures(v, fold(g.packs, Parts{g.cone.size + g.primal.size}, Found::none(), [&](int p, int k, Found& to) {
      if (k < g.cone.size) return add_row(v, p, k, at(residuals_.y, p)[k] + v.tau * at(g.b, p)[k], to);
      g.transposed(p, k - g.cone.size, v.x, v.y, [&](int j, Pack curved, Pack dual) {
        add_variable(v, p, j, curved, dual, to);
      });
    }));
  }

  // The same after a step, if directions solve their equations: what was missing, ``primal`` and ``dual`` of it.
  JAXSCP_CALLED Measures predict(const Iterate& v, double primal, double dual) {
    const Program& g = program_;
    const Residuals& r = residuals_;
    return measures(v, fold(g.packs, Parts{g.cone.size + g.primal.size}, Found::none(), [&](int p, int k, Found& to) {
      if (k < g.cone.size) return add_row(v, p, k, primal * at(r.y, p)[k] + v.tau * at(g.b, p)[k], to);
      const int j = k - g.cone.size;
      const Pack curved = j < g.n ? g.hessian.times(p, j, g.of_primal(v.x, p)) : all(0.0);
      add_variable(v, p, j, curved, dual * g.of_primal(r.x, p)[j] - curved - v.tau * g.of_primal(g.q, p)[j], to);
    }));
  }

  // A x + s, of which row i of the constraints asks for tau b.
  void add_row(const Iterate& v, int p, int i, Pack primal, Found& to) const {
    const Program& g = program_;
    auto counted = [&](Pack of) { return g.of_stages(p, i, g.cone, of); };
    const Pack y = at(v.y, p)[i], s = at(v.s, p)[i], b = at(g.b, p)[i], residual = primal - v.tau * b;
    at(residuals_.y, p)[i] = residual;
    to.include_max(kPrimal, counted(magnitude(primal))), to.include_max(kPrimalResidual, counted(magnitude(residual)));
    to.add(kOffset, counted(b * y)), to.add(kComplementarity, counted(s * y));
  }

  // P x and A'y, of whose sum a variable asks for -tau q.
  void add_variable(const Iterate& v, int p, int j, Pack curved, Pack dual, Found& to) const {
    const Program& g = program_;
    auto counted = [&](Pack of) { return g.of_stages(p, j, g.primal, of); };
    const Pack x = g.of_primal(v.x, p)[j], q = g.of_primal(g.q, p)[j], residual = curved + dual + v.tau * q;
    g.of_primal(residuals_.curved, p)[j] = curved, g.of_primal(residuals_.x, p)[j] = residual;
    to.include_max(kDual, counted(magnitude(dual))), to.include_max(kCurved, counted(magnitude(curved)));
    to.include_max(kDualResidual, counted(magnitude(residual)));
    to.add(kQuadratic, counted(x * curved)), to.add(kLinear, counted(q * x));
  }

  // As in ``iterate.py``.
  Measures measures(const Iterate& v, const Found& found) const {
    const double quadratic = found.sum(kQuadratic), linear = found.sum(kLinear), offset = found.sum(kOffset);
    const double mu = (found.sum(kComplementarity) + v.tau * v.kappa) / program_.degree;
    const double primal_cost = (0.5 * quadratic / v.tau + linear) / v.tau;
    const double dual_cost = (-0.5 * quadratic / v.tau - offset) / v.tau;
    // The gap is judged in the user's unit of cost, the residuals in equilibrated units.
    const double gap = fabs(primal_cost - dual_cost) / maximum(scales_.cost, minimum(fabs(primal_cost), fabs(dual_cost)));
    const double primal_error = found.largest(kPrimalResidual) / (v.tau * size_b_);
    const double dual_error = found.largest(kDualResidual) / (v.tau * size_q_);
    Measures m;
    m.tau = linear + offset + v.kappa + quadratic / v.tau;
    m.mu = mu;
    m.error = maximum(gap, maximum(primal_error, dual_error));
    // a maximum leaves NaN out: sums do not
    if (!is_finite(gap) || !is_finite(mu)) m.error = sqrt(-1.0);  // not a number
    m.infeasibility = found.largest(kDual) / maximum(-offset, soc::kTiny);
    m.unboundedness = maximum(found.largest(kCurved), found.largest(kPrimal)) / maximum(-linear, soc::kTiny);
    return m;
  }

  NewtonSystem::KKTVectors direction_vectors() const { return {rx_, ry_, direction_.x, direction_.y}; }

  template <typename T>
  static void swap(T& a, T& b) {
    T used = a;
    a = b;
    b = used;
  }
  static double minimum(double a, double b) { return b < a ? b : a; }
  static double maximum(double a, double b) { return a < b ? b : a; }

  Entries at(Packs v, int p) const { return program_.of_cones(v, p); }

  const Program& program_;
  const Scales& scales_;
  Settings settings_;
  // first what is read most, which is to be near
  Iterate iterate_, direction_;
  Scaling scaling_;
  Packs ry_, rx_;
  NewtonSystem system_;
  NewtonSystem::KKTVectors systems_[kMaxRhs];  // of a step: its direction, and the embedding's constant one
  Packs constant_x_, constant_y_;
  Residuals residuals_;
  Packs minus_q_;  // -q
  // as in ``directions.py`` and ``near.py``
  static constexpr double kEmbeddedFraction = 0.99, kProgramFraction = 0.98;  // of a step to the boundary
  static constexpr double kSafety = 0.8;                         // of a tolerance, of what is expected
  static constexpr double kMu = 0.3, kPower = 0.2, kLowestMu = 1e-3, kHighestMu = 3.0;
  static constexpr double kAtBound = 0.99, kRelaxation = 2.0;
  double tolerance_ = 0.0, size_q_ = 1.0, size_b_ = 1.0;
  int max_iterations_ = 0;  // iterations
  bool warm_ = false, started_ = false;  // ``near_``: without the embedding
};

}  // namespace jaxscp

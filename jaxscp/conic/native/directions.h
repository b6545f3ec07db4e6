// Newton directions of the interior point and the step along them (``directions.py``).
#pragma once

#include "interior_point.h"

namespace jaxscp {

inline void InteriorPoint::step() {
  const Residuals& r = residuals_;
  const Iterate& old = iterate_;
  const int rounds = close_to_end() ? settings_.refinements : 0;
  scaling_.set(old.s, old.y);
  system_.factor(scaling_, settings_.regularisation);

  // Affine direction, which aims at s o y = 0; in the embedding also the constant direction.
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
  if (uniform(affine_suffices(affine, fraction)))
    return take_step(fraction * affine.primal, fraction * affine.dual, 1.0);
  const double sigma = centring(affine);
  const double target = product + direction_.tau * direction_.kappa - sigma * r.mu;

  // Mehrotra's combined direction: centring by sigma and second-order correction.
  correct(1.0 - sigma, sigma * r.mu);
  system_.solve<1>(scaling_, rounds, systems_);
  embed(1.0 - sigma, slope, target);
  const Steps longest = find_slacks(direction_.s);
  take_step(fraction * longest.primal, fraction * longest.dual, 1.0 - sigma);
}

// Mehrotra's sigma: cube of the fraction of complementarity that remains after the affine step; in the embedding, of
// all residuals.
inline double InteriorPoint::centring(const Steps& affine) const {
  const double left = maximum(0.0, minimum(1.0, warm_ ? remaining(affine, 1.0) : 1.0 - affine.primal));
  return left * left * left;
}

// Whether the affine step alone is predicted to solve the program, so that no corrector is needed.
inline bool InteriorPoint::affine_suffices(const Steps& affine, double fraction) const {
  const double of_residuals = 1.0 - fraction * minimum(affine.primal, affine.dual);
  return warm_ && residuals_.error * maximum(remaining(affine, fraction), of_residuals) <= kSafety * tolerance_;
}

// Fraction of the complementarity s'y that remains after a fraction of the affine step. It follows from y'ds and ds'dy,
// since the affine direction has s'dy + y'ds = -s'y.
inline double InteriorPoint::remaining(const Steps& affine, double fraction) const {
  const double a = fraction * affine.primal, b = fraction * affine.dual, before = residuals_.mu * program_.degree;
  return 1.0 - b + ((a - b) * affine.along + a * b * affine.squared) / before;
}

// Right-hand side of the combined direction:  slack = s + W (lambda \ (W^-1 ds o W dy - centre e)), where lambda = W y
// and (ds, dy) is the affine direction; residuals are reduced by ``fraction``. The slack term overwrites ds.
JAXSCP_CALLED inline void InteriorPoint::correct(double fraction, double centre) {
  const Program& g = program_;
  const Residuals& r = residuals_;
  g.each(
      [&](int p, int i) {
        Entries slack = at(direction_.s, p);
        slack[i] = at(iterate_.s, p)[i] + (slack[i] * at(direction_.y, p)[i] - centre) * inverse(at(iterate_.y, p)[i]);
        at(ry_, p)[i] = slack[i] - fraction * at(r.y, p)[i];
      },
      [&](int p, int i, int d, int c) {
        auto load = [&](Packs v) { return soc::load(at(v, p) + i, d); };
        const soc::ConeRegisters w = load(scaling_.w), dy = load(direction_.y), y = load(iterate_.y);
        const soc::ConeRegisters s = load(iterate_.s);
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
        soc::each(other, [&](int j) { return slack[j] - fraction * residual[j]; });
        soc::store(slack, at(direction_.s, p) + i), soc::store(other, at(ry_, p) + i);
      });
  fill(g.packs, g.m, [&](int p, int i) -> Pack& { return at(ry_, p)[g.zero + i]; },
       [&](int p, int i) { return -fraction * at(r.y, p)[g.zero + i]; });
  fill(g.packs, g.primal.size, [&](int p, int i) -> Pack& { return g.of_primal(rx_, p)[i]; },
       [&](int p, int i) { return -fraction * g.of_primal(r.x, p)[i]; });
}

// Adds dtau times the constant direction, with dtau from the equation of tau. Without the embedding, tau is constant.
JAXSCP_CALLED inline void InteriorPoint::embed(double fraction, double slope, double target) {
  if (warm_) return once([&] { direction_.tau = direction_.kappa = 0.0; });
  const Program& g = program_;
  const Iterate& old = iterate_;
  Iterate& out = direction_;
  const Residuals& r = residuals_;
  using Total = Totals<1, 0>;
  const double along = fold(g.packs, Parts{g.primal.size + g.cone.size}, Total::none(), [&](int p, int k, Total& to) {
    if (k < g.primal.size) {
      Pack gradient = 2.0 / old.tau * g.of_primal(r.hessian_x, p)[k] + g.of_primal(g.q, p)[k];
      to.add(0, g.of_stages(p, k, g.primal, gradient * g.of_primal(out.x, p)[k]));
    } else {
      const int i = k - g.primal.size;
      to.add(0, g.of_stages(p, i, g.cone, at(g.b, p)[i] * at(out.y, p)[i]));
    }
  }).sum(0);
  const double tau = (target / old.tau - fraction * r.tau - along) / slope;
  once([&] { out.tau = tau, out.kappa = -(target + old.kappa * tau) / old.tau; });
  parallel_for(out.x.size + out.y.size, [&](int i) {
    if (i < out.x.size) out.x[i] += tau * constant_x_[i];
    else i -= out.x.size, out.y[i] += tau * constant_y_[i];
  });
}

// Direction of the slacks, ds = -(slack_term + W^2 dy), and the step lengths; ds may overwrite the slack term. In a
// linear program the dual residual does not depend on the variables, so that the two step lengths may differ.
JAXSCP_CALLED inline InteriorPoint::Steps InteriorPoint::find_slacks(Packs slack_term) {
  const Program& g = program_;
  const Iterate& old = iterate_;
  const Iterate& out = direction_;
  enum { kAlong, kSquared, kProducts };
  enum { kOfSlacks, kOfMultipliers, kInverseSteps };  // inverse step lengths to the boundary
  using Total = Totals<kProducts, kInverseSteps>;
  const Total found = fold(g.packs, Parts{g.r, g.cone_count}, Total::none(), [&](int p, int k, Total& to) {
    auto add_cone = [&](int of, Pack along, Pack squared, Pack slack, Pack multiplier) {
      auto counted = [&](Pack v) { return where(within(p, of), v, all(0.0)); };
      to.add(kAlong, counted(along)), to.add(kSquared, counted(squared));
      to.include_max(kOfSlacks, counted(slack)), to.include_max(kOfMultipliers, counted(multiplier));
    };
    if (const int i = k; i < g.r) {
      const Pack w = at(scaling_.w, p)[i], s = at(old.s, p)[i], y = at(old.y, p)[i], dy = at(out.y, p)[i];
      const Pack ds = -(at(slack_term, p)[i] + w * w * dy);
      at(out.s, p)[i] = ds;
      add_cone(g.nodes, y * ds, ds * dy, -ds * inverse(s), -dy * inverse(y));
    } else {
      auto [first, d, of_link] = g.cone_at(k - g.r);
      auto load = [&](Packs v) { return soc::load(at(v, p) + first, d); };
      const soc::ConeRegisters w = load(scaling_.w), term = load(slack_term), s = load(old.s), y = load(old.y);
      const soc::ConeRegisters dy = load(out.y);
      soc::ConeRegisters ds = soc::output(at(out.s, p) + first, d);
      soc::ConeRegisters square = soc::output(at(ry_, p) + first, d);  // the right-hand side is no longer needed
      soc::square(w, scaling_.eta_of(p, k - g.r), dy, square);
      soc::each(ds, [&](int j) { return -(term[j] + square[j]); });
      soc::store(ds, at(out.s, p) + first);
      add_cone(of_link ? g.nodes + 1 : g.nodes, soc::part_of_dot(y, ds), soc::part_of_dot(ds, dy),
          soc::inverse_step(s, ds), soc::inverse_step(y, dy));
    }
  });
  double primal = 1.0 / maximum(1.0, found.largest(kOfSlacks));
  double dual = 1.0 / maximum(1.0, found.largest(kOfMultipliers));
  if (!warm_ || g.hessian.entries > 0) {
    auto bound = [](double v, double d) { return d < 0.0 ? -v / d : 1.0; };
    primal = minimum(minimum(primal, dual), minimum(bound(old.tau, out.tau), bound(old.kappa, out.kappa)));
    dual = primal;
  }
  return {primal, dual, found.sum(kAlong), found.sum(kSquared)};
}

// Derivative of the equation of tau along the constant direction; always negative.
JAXSCP_CALLED inline double InteriorPoint::find_slope() {
  const Program& g = program_;
  const double over = 1.0 / iterate_.tau;
  using Total = Totals<1, 0>;
  const Parts parts{g.n + g.r, g.cone_count};
  const double curvature = fold(g.packs, parts, Total::none(), [&](int p, int k, Total& found) {
    Entries w = at(scaling_.w, p), y = at(constant_y_, p);
    if (k < g.n) {
      Entries x = g.of_primal(iterate_.x, p), along = g.of_primal(constant_x_, p);
      auto difference = [&](int i) { return along[i] - over * x[i]; };
      found.add(0, g.of_nodes(p, difference(k) * g.hessian.add_transposed(p, k, all(0.0), difference)));
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

// Takes a step and measures the next iterate; ``removed`` is the fraction of the residuals that the direction removes.
JAXSCP_CALLED inline void InteriorPoint::take_step(double primal, double dual, double removed) {
  // The next iterate overwrites the direction.
  const Program& g = program_;
  Iterate &old = iterate_, &next = direction_;
  double tau = old.tau + primal * next.tau, kappa = old.kappa + primal * next.kappa, unit = 1.0 / maximum(tau, kappa);
  once([&] { next.tau = unit * tau, next.kappa = unit * kappa; });
  const Packs from = old.all, to = next.all;
  const int first = old.x.size, end = first + old.y.size;  // range of the multipliers
  fill(g.packs, from.size / g.packs, [&](int p, int i) -> Pack& { return to[i * g.packs + p]; },
       [&](int p, int i) {
         const int k = i * g.packs + p;
         return unit * (from[k] + (k < first || k >= end ? primal : dual) * to[k]);
       });
  const bool exact = close_to_end();
  Measures found =
      exact ? measure(next) : predict(next, unit * (1.0 - primal * removed), unit * (1.0 - dual * removed));
  if (!exact && uniform(needs_exact_residuals(found))) found = measure(next);
  once([&] {
    double error = found.error, before = residuals_.error;
    broken = !(is_finite(error) && is_finite(found.mu));
    // A step that makes a nearly solved iterate worse is dominated by rounding: the better iterate remains.
    stalled = minimum(primal, dual) < kShortestStep || (before < settings_.loose_tolerance && error > kWorse * before);
    if (!(broken || (stalled && error > before))) {
      swap(iterate_, direction_);
      systems_[0] = direction_vectors();
      static_cast<Measures&>(residuals_) = found;
    }
    ++iterations;
  });
}

}  // namespace jaxscp

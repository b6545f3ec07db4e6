// Starting points of the interior point: cold (``iterate.py``) and warm (``warm_start.py``).
#pragma once

#include "interior_point.h"

namespace jaxscp {

// Cold start: solution of the program with the cones replaced by a least-squares penalty on s.
JAXSCP_CALLED inline void InteriorPoint::start() {
  const Program& g = program_;
  scaling_.set_unit();
  system_.factor(scaling_, settings_.regularisation);
  once([&] { systems_[0] = {minus_q_, g.b, iterate_.x, iterate_.y}; });
  system_.solve<1>(scaling_, settings_.refinements, systems_);
  parallel_for(iterate_.s.size, [&](int i) { iterate_.s[i] = -iterate_.y[i]; });
  shift_inside(iterate_.s);
  shift_inside(iterate_.y);
  // The bounds of the norms equal the heads of their cones, so that these rows start without residual.
  parallel_for(g.packs, [&](int p) {
    if (g.has_norm) g.of_primal(iterate_.x, p)[g.xi] = at(iterate_.s, p)[g.trust];
    g.of_primal(iterate_.x, p)[g.zeta] = at(iterate_.s, p)[g.virtual_];
  });
  set_embedding(1.0);
  begin(measure(iterate_));
}

// Start on the central path near the warm start (``warm_start.py``). The first pass finds the slacks b - A x, with the
// norms as their bounds, and their mean complementarity |s'y|. The second replaces s and y by the central pair with the
// same difference s - y.
JAXSCP_CALLED inline void InteriorPoint::start_warm() {
  const Program& g = program_;
  g.times_constraints(iterate_.x, iterate_.s);
  using Total = Totals<1, 0>;
  const Parts parts{g.r, g.cone_count};
  const double complementarity = fold(g.packs, parts, Total::none(), [&](int p, int k, Total& found) {
    Entries s = at(iterate_.s, p), y = at(iterate_.y, p), b = at(g.b, p), computed = at(residuals_.y, p);
    if (k < g.r) {
      s[k] = computed[k] = b[k] - s[k];
      found.add(0, g.of_nodes(p, magnitude(s[k] * y[k])));
    } else {
      const int c = k - g.r;
      auto [i, d, of_link] = g.cone_at(c);
      soc::ConeRegisters slack = soc::load(s + i, d);
      const soc::ConeRegisters offset = soc::load(b + i, d);
      soc::each(slack, [&](int j) { return offset[j] - slack[j]; });
      if (c >= g.user_cones) soc::set_head(slack, soc::tail_norm(slack));
      const soc::ConeRegisters multiplier = soc::load(y + i, d);
      const Pack product = once_per_cone(magnitude(soc::dot(slack, multiplier)));
      found.add(0, of_link ? g.of_links(p, product) : g.of_nodes(p, product));
      soc::ConeRegisters slack_before = soc::output(computed + i, d);
      soc::each(slack_before, [&](int j) { return slack[j]; });
      if (c == g.virtual_cone) {
        // Virtual control keeps its value only if its multiplier is at its bound.
        const Pack used = where(soc::tail_norm(multiplier) > kAtBound * soc::head(multiplier), all(1.0), all(0.0));
        soc::each(slack, [&](int j) { return used * slack[j]; });
        soc::set_head(slack_before, soc::head(slack));
      }
      if (c >= g.user_cones) g.of_primal(iterate_.x, p)[c == g.virtual_cone ? g.zeta : g.xi] = soc::head(slack);
      soc::store(slack_before, computed + i), soc::store(slack, s + i);
    }
  }).sum(0) / (g.degree - 1.0);
  const double mu = maximum(kLowestMu, minimum(kHighestMu, kMu * pow(complementarity, kPower)));
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
        // Both spectral values of s - y are split.
        const Pack difference = soc::head(s), norm = soc::tail_norm(s), over = inverse(soc::positive(norm));
        Pack s_plus, y_plus, s_minus, y_minus;
        split(difference + norm, mu, s_plus, y_plus);
        split(difference - norm, mu, s_minus, y_minus);
        soc::each(y, [&](int j) { return 0.5 * (y_plus - y_minus) * over * s[j]; });
        soc::each(s, [&](int j) { return 0.5 * (s_plus - s_minus) * over * s[j]; });
        const Pack multiplier = 0.5 * (y_plus + y_minus);
        const bool is_trust = g.has_norm && i == g.trust;  // whose bound is relaxed further
        soc::set_head(s, 0.5 * (s_plus + s_minus) + (is_trust ? kRelaxation * mu * inverse(multiplier) : all(0.0)));
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

// s and y with s y = mu and s - y = difference; the smaller one as mu over the larger, since the difference cancels.
inline void InteriorPoint::split(Pack difference, double mu, Pack& s, Pack& y) {
  const Pack large = 0.5 * (magnitude(difference) + root(difference * difference + 4.0 * mu));
  const Pack small = mu * inverse(large);
  s = where(difference > 0.0, large, small), y = where(difference > 0.0, small, large);
}

// Sets tau = 1 and kappa (zero for the program itself), and the zero cone's slacks, which no step changes.
inline void InteriorPoint::set_embedding(double kappa) {
  once([&] { iterate_.tau = 1.0, iterate_.kappa = kappa; });
  program_.clear_zero_cone(iterate_.s), program_.clear_zero_cone(direction_.s);
}

// Start of the iterations, with the measures of the starting point.
inline void InteriorPoint::begin(const Measures& found) {
  once([&] {
    static_cast<Measures&>(residuals_) = found;
    systems_[0] = direction_vectors(), systems_[1] = {minus_q_, program_.b, constant_x_, constant_y_};
    started_ = true;
    broken = !is_finite(residuals_.error);
  });
}

// Shifts every cone's part at least one unit inside its cone.
JAXSCP_CALLED inline void InteriorPoint::shift_inside(Packs v) const {
  program_.each([&](int p, int i) { at(v, p)[i] = larger(at(v, p)[i], all(1.0)); },
                [&](int p, int i, int d, int) {
                  soc::ConeRegisters part = soc::load(at(v, p) + i, d);
                  soc::set_head(part, larger(soc::head(part), soc::tail_norm(part) + 1.0));
                  soc::store(part, at(v, p) + i);
                });
}

}  // namespace jaxscp

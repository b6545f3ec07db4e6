// Residuals and measures of an iterate (``residuals.py``).
#pragma once

#include "interior_point.h"

namespace jaxscp {

// Measures of an iterate; its residual vectors go to ``residuals_``.
JAXSCP_CALLED inline Measures InteriorPoint::measure(const Iterate& v) {
  const Program& g = program_;
  g.begin_times(v.x, v.y);
  return measures(v, fold(g.packs, g.products(), Found::none(), [&](int p, int k, Found& to) {
    auto row = [&](int i, Pack product) { add_row(v, p, i, product + at(v.s, p)[i], to); };
    auto variable = [&](int j, Pack hessian_x, Pack dual) { add_variable(v, p, j, hessian_x, dual, to); };
    g.product(p, k, v.x, v.y, row, variable);
  }));
}

// The same if ``residuals_`` already has the residuals of the rows.
JAXSCP_CALLED inline Measures InteriorPoint::measure_multipliers(const Iterate& v) {
  const Program& g = program_;
  g.begin_transposed(v.y);
  return measures(v, fold(g.packs, Parts{g.cone.size + g.primal.size}, Found::none(), [&](int p, int k, Found& to) {
    if (k < g.cone.size) return add_row(v, p, k, at(residuals_.y, p)[k] + v.tau * at(g.b, p)[k], to);
    g.transposed(p, k - g.cone.size, v.x, v.y, [&](int j, Pack hessian_x, Pack dual) {
      add_variable(v, p, j, hessian_x, dual, to);
    });
  }));
}

// The same after a step, if the direction solves its equations exactly: residuals shrink by ``primal`` and ``dual``.
JAXSCP_CALLED inline Measures InteriorPoint::predict(const Iterate& v, double primal, double dual) {
  const Program& g = program_;
  const Residuals& r = residuals_;
  return measures(v, fold(g.packs, Parts{g.cone.size + g.primal.size}, Found::none(), [&](int p, int k, Found& to) {
    if (k < g.cone.size) return add_row(v, p, k, primal * at(r.y, p)[k] + v.tau * at(g.b, p)[k], to);
    const int j = k - g.cone.size;
    const Pack hessian_x = j < g.n ? g.hessian.times(p, j, g.of_primal(v.x, p)) : all(0.0);
    add_variable(v, p, j, hessian_x, dual * g.of_primal(r.x, p)[j] - hessian_x - v.tau * g.of_primal(g.q, p)[j], to);
  }));
}

// Adds row i: residual (A x + s) - tau b, with ``primal`` = A x + s.
inline void InteriorPoint::add_row(const Iterate& v, int p, int i, Pack primal, Found& to) const {
  const Program& g = program_;
  auto counted = [&](Pack of) { return g.of_stages(p, i, g.cone, of); };
  const Pack y = at(v.y, p)[i], s = at(v.s, p)[i], b = at(g.b, p)[i], residual = primal - v.tau * b;
  at(residuals_.y, p)[i] = residual;
  to.include_max(kPrimal, counted(magnitude(primal))), to.include_max(kPrimalResidual, counted(magnitude(residual)));
  to.add(kOffset, counted(b * y)), to.add(kComplementarity, counted(s * y));
}

// Adds variable j: residual P x + A'y + tau q, with ``hessian_x`` = P x and ``dual`` = A'y.
inline void InteriorPoint::add_variable(const Iterate& v, int p, int j, Pack hessian_x, Pack dual, Found& to) const {
  const Program& g = program_;
  auto counted = [&](Pack of) { return g.of_stages(p, j, g.primal, of); };
  const Pack x = g.of_primal(v.x, p)[j], q = g.of_primal(g.q, p)[j], residual = hessian_x + dual + v.tau * q;
  g.of_primal(residuals_.hessian_x, p)[j] = hessian_x, g.of_primal(residuals_.x, p)[j] = residual;
  to.include_max(kDual, counted(magnitude(dual))), to.include_max(kHessianX, counted(magnitude(hessian_x)));
  to.include_max(kDualResidual, counted(magnitude(residual)));
  to.add(kQuadratic, counted(x * hessian_x)), to.add(kLinear, counted(q * x));
}

// Measures from sums and maxima, as in ``residuals.py``.
inline Measures InteriorPoint::measures(const Iterate& v, const Found& totals) const {
  const double quadratic = totals.sum(kQuadratic), linear = totals.sum(kLinear), offset = totals.sum(kOffset);
  const double mu = (totals.sum(kComplementarity) + v.tau * v.kappa) / program_.degree;
  const double primal_cost = (0.5 * quadratic / v.tau + linear) / v.tau;
  const double dual_cost = (-0.5 * quadratic / v.tau - offset) / v.tau;
  // The gap is in the user's unit of cost, the residuals are in equilibrated units.
  const double gap = fabs(primal_cost - dual_cost) / maximum(scales_.cost, minimum(fabs(primal_cost), fabs(dual_cost)));
  const double primal_error = totals.largest(kPrimalResidual) / (v.tau * size_b_);
  const double dual_error = totals.largest(kDualResidual) / (v.tau * size_q_);
  Measures m;
  m.tau = linear + offset + v.kappa + quadratic / v.tau;
  m.mu = mu;
  m.error = maximum(gap, maximum(primal_error, dual_error));
  // Maxima ignore NaN, sums do not.
  if (!is_finite(gap) || !is_finite(mu)) m.error = sqrt(-1.0);  // not a number
  m.infeasibility = totals.largest(kDual) / maximum(-offset, soc::kTiny);
  m.unboundedness = maximum(totals.largest(kHessianX), totals.largest(kPrimal)) / maximum(-linear, soc::kTiny);
  return m;
}

}  // namespace jaxscp

// Settings, iterates and residuals of the interior point.
#pragma once

#include "newton_system.h"

namespace jaxscp {

struct Settings {
  double proof_tolerance, loose_tolerance, regularisation, refine_below;
  int max_iterations, refinements, equilibration;
  bool operator==(const Settings&) const = default;
};

// Point (x, y, s, tau, kappa) of the homogeneous embedding; with tau = 1 and kappa = 0, of the program.
struct Iterate {
  Packs all, x, y, s;
  double tau = 1.0, kappa = 1.0;
  Iterate(const Program& p, Arena& arena)
      : all(arena.take(p.packs * (p.primal.size + 2 * p.cone.size))), x(all.part(0, p.packs * p.primal.size)),
        y(all.part(x.size, p.packs * p.cone.size)), s(all.part(x.size + y.size, y.size)) {}
};

// Scalar measures of an iterate; ``tau`` is the residual of the equation of tau.
struct Measures {
  double tau = 0.0, mu = 0.0, error = 0.0, infeasibility = 0.0, unboundedness = 0.0;
};

struct Residuals : Measures {
  Packs x, y, hessian_x;  // P x + A'y + tau q, A x + s - tau b, P x
  Residuals(const Program& p, Arena& arena)
      : x(arena.take(p.packs * p.primal.size)), y(arena.take(p.packs * p.cone.size)),
        hessian_x(arena.take(x.size)) {}
};

}  // namespace jaxscp

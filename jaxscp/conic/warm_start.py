"""Starting point of the interior point near an estimate of the solution: a pair on the central path.

Slacks s follow from the estimate z and the program. Pushed inside the cones separately, s and its multipliers y would
be far from centred. Instead, the pair with s o y = mu e and the same difference s - y is centred (``smoothing``). The
pair differs from the estimate by about sqrt(mu) at most. A larger complementarity of the estimate gives a larger mu.

If the soft rows do not hold at z, virtual control could close them, but at a cost that the steps would have to remove.
So virtual control starts at its value only if its multiplier is at its bound, the penalty weight. At a solution that
uses virtual control, the multiplier is at this bound. Otherwise virtual control starts at zero, and the soft rows have
a residual, which a full step removes.

The trust region's bounds are relaxed further than the central path does at a point that has not moved yet. Without
the relaxation, these bounds alone would limit the first steps.
"""

import jax
import jax.numpy as jnp

from jaxscp.cones.product import ConeVector, degree
from jaxscp.conic import conic_form
from jaxscp.conic.conic_form import Primal
from jaxscp.conic.program import StagedProgram, WarmStart
from jaxscp.conic.smoothing import central_pair
from jaxscp.core.trees import tree_axpy
from jaxscp.core.types import Scalar

# mu = clip(MU c^POWER, LOWEST_MU, HIGHEST_MU), c the mean complementarity of the estimate, all in equilibrated units.
# Tuned on subproblems of random flights in the paper's mode.
MU, POWER, LOWEST_MU, HIGHEST_MU = 0.3, 0.2, 1e-3, 3.0

RELAXATION = 2.0  # of a trust region's bound, in units of mu over its multiplier; tuned likewise
AT_BOUND = 0.99  # fraction of the penalty weight from which on a multiplier counts as at its bound


def central_start(program: StagedProgram, warm_start: WarmStart) -> tuple[Primal, ConeVector, ConeVector]:
    """Variables, multipliers and slacks of the start, for an equilibrated program."""
    norm, soft, links = program.norm, program.links.soft, warm_start.multipliers.links
    virtual = jnp.linalg.norm(program.virtual_control(warm_start.z), axis=1)
    step = None if norm is None else norm.scale * (warm_start.z - norm.centre)
    xi = jnp.zeros((0,), virtual.dtype) if step is None else jnp.linalg.norm(step, axis=1)
    x = Primal(warm_start.z, xi, virtual)

    # The heads of the norms' multipliers equal the weights of the norms. The trust region's tail is unknown: zero.
    head, tail = (None, None) if norm is None else (norm.weight, jnp.zeros_like(warm_start.z))
    second = conic_form.pack_cones(
        program, warm_start.multipliers.cones, head, tail, program.links.weight, soft * links
    )
    y = ConeVector((1.0 - soft) * links, warm_start.multipliers.rows, second)
    s = tree_axpy(-1.0, conic_form.times_constraints(program, x), conic_form.constraint_offset(program))
    s = ConeVector(jnp.zeros_like(s.zero), s.orthant, s.second)
    mu = jnp.clip(MU * _mean_complementarity(s, y) ** POWER, LOWEST_MU, HIGHEST_MU)

    trust_cones, virtual_cones = conic_form.norm_slices(program)
    used = jnp.linalg.norm(soft * links, axis=1) > AT_BOUND * program.links.weight
    used = used.astype(virtual.dtype)  # one where virtual control keeps its value
    x = Primal(warm_start.z, xi, used * virtual)
    s = ConeVector(s.zero, s.orthant, s.second.at[virtual_cones].multiply(used[:, None]))
    pair = central_pair(jax.tree.map(jnp.subtract, s, y), mu)
    second = pair.s.second.at[trust_cones, 0].add(RELAXATION * mu / pair.y.second[trust_cones, 0])
    return x, pair.y, ConeVector(pair.s.zero, pair.s.orthant, second)


def _mean_complementarity(s: ConeVector, y: ConeVector) -> Scalar:
    """Mean of |s'y| over half-spaces and second-order cones."""
    rows, cones = jnp.abs(s.orthant * y.orthant), jnp.abs(jnp.sum(s.second * y.second, axis=1))
    return (jnp.sum(rows) + jnp.sum(cones)) / degree(s)

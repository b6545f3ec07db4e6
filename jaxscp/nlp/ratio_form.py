"""Second-order conditions away from their apex, as smooth inequalities of one number.

Where t > 0, |w| <= t is the same as h >= 0 with h(t, w) = (t - |w|^2 / t) / 2. This h is concave. Source: Benson and
Vanderbei, "Solving problems with semidefinite and conic constraints using interior-point methods for nonlinear
programming", Mathematical Programming, 2003.

A slack in a second-order cone must stay inside the curved boundary: at distance d from it, no step along it is longer
than sqrt(2 t d). Where a limit holds at many points, each step turns the slack of one of them, and the iterations
crawl. The slack of h is a number, which turns nothing. The boundary's curvature is in the Hessian instead.

No shape changes: a number h is the value (h, 0, ..., 0) of the same second-order cone.
"""

from collections.abc import Callable
from typing import Any

import jax.numpy as jnp
from jaxtyping import Array, Bool, Float

from jaxscp.problem.multipliers import Multipliers
from jaxscp.problem.scaled_time import ScaledTimeProblem
from jaxscp.transcription.inequalities import Jacobians, Values

AWAY = 0.1  # least t of a constraint that stays away from its apex, relative to its largest

Chosen = tuple[Bool[Array, "_ _"] | None, ...]
"""(locations, points) of every constraint: which conditions are numbers; None for other cones."""


def away_from_apex(problem: ScaledTimeProblem, values: Values) -> Chosen:
    """All conditions of the constraints that nowhere come near their apex; none of a landing cone, say.

    Args:
        problem: whose inequalities they are.
        values: of the inequalities.
    """
    found = []
    for constraint, v in zip(problem.constraints, values, strict=False):
        if not constraint.cone.curved:
            found.append(None)
            continue
        t, active = v[..., 0], constraint.active_at_locations(v.shape[1])
        least = jnp.min(jnp.where(active, t, jnp.inf), initial=jnp.inf)
        most = jnp.max(jnp.where(active, t, 0.0), initial=0.0)
        found.append(jnp.broadcast_to(active & (least > AWAY * most), t.shape))
    return (*found, None)


def in_ratio_form(chosen: Chosen, values: Values) -> Values:
    """(h, 0, ..., 0) where chosen, else the values."""
    return _changed(chosen, lambda v: _alone(_height(v), v), values)


def jacobians_in_ratio_form(
    chosen: Chosen, values: Values, jacobians: Jacobians, slack: Values
) -> tuple[Jacobians, Jacobians]:
    """Jacobians of ``in_ratio_form``, and the same with more rows for the curvature of h.

    The Hessian of h is -B'B / t with B = (-w / t, 1). With slack s and multiplier y, each row of a Jacobian is weighed
    by y / s in the Newton matrix. So the rows sqrt(s / t) B J add the curvature y B'B / t.
    """
    plain, curved = [], []
    for at, v, jacobian, s in zip(chosen, values, jacobians, slack, strict=True):
        if at is None:
            plain.append(jacobian)
            curved.append(jacobian)
            continue
        ratio, t = _ratio(v), v[..., :1]
        first = jnp.einsum("ipr,iprw->ipw", _gradient(v), jacobian)[:, :, None]
        rows = jacobian[:, :, 1:] - ratio[..., None] * jacobian[:, :, :1]
        size = jnp.sqrt(jnp.maximum(s[..., :1], 0.0) / jnp.where(t > 0.0, t, 1.0))[..., None]
        here = at[..., None, None]
        plain.append(jnp.where(here, jnp.concatenate([first, jnp.zeros_like(rows)], axis=2), jacobian))
        curved.append(jnp.where(here, jnp.concatenate([first, size * rows], axis=2), jacobian))
    return tuple(plain), tuple(curved)


def cone_multipliers(chosen: Chosen, y: Multipliers, values: Values) -> Multipliers:
    """Multipliers of the values in the cones, from the multipliers of h: y dh."""
    in_cones = _changed(chosen, lambda m, v: m[..., :1] * _gradient(v), y.values, values)
    return Multipliers(y.flow, y.initial, y.final, in_cones)


def back_to_cones(chosen: Chosen, slack: Values, values: Values) -> Values:
    """Slacks in the cones, (sqrt(|w|^2 + t s), w), from slacks s of h.

    That leaves half of s, because the barrier of the cone is half the barrier of t h.
    """
    return _changed(chosen, lambda s, v: _with_head(v, s[..., :1]), slack, values)


def replaced(chosen: Chosen, values: Values, by: Values) -> Values:
    """Values of ``by`` where chosen, else the values."""
    return _changed(chosen, lambda _, new: new, values, by)


def curved_alone(chosen: Chosen, arrays: Values | Jacobians) -> tuple[Array, ...]:
    """Values, or Jacobians, without the rows of all other cones."""
    return tuple(v[:, :, :0] if at is None else v for at, v in zip(chosen, arrays, strict=True))


def _changed(chosen: Chosen, change: Callable[..., Array], values: Values, *others: Values) -> Values:
    """Values, changed where chosen."""
    new: list[Any] = [
        v if at is None else jnp.where(at[..., None], change(v, *more), v)
        for at, v, *more in zip(chosen, values, *others, strict=True)
    ]
    return tuple(new)


def any_of(chosen: Chosen) -> Bool[Array, ""]:
    """Whether any condition is in ratio form."""
    return jnp.any(jnp.stack([jnp.zeros((), bool), *(jnp.any(at) for at in chosen if at is not None)]))


def _ratio(values: Array) -> Array:
    """w / t; any number where t is not positive, which nobody chooses."""
    t = values[..., :1]
    return values[..., 1:] / jnp.where(t > 0.0, t, 1.0)


def _height(values: Array) -> Float[Array, "*b 1"]:
    """h."""
    return 0.5 * (values[..., :1] - jnp.sum(values[..., 1:] * _ratio(values), axis=-1, keepdims=True))


def _gradient(values: Array) -> Array:
    """Of h."""
    ratio = _ratio(values)
    return jnp.concatenate([0.5 + 0.5 * jnp.sum(ratio * ratio, axis=-1, keepdims=True), -ratio], axis=-1)


def _alone(first: Array, like: Array) -> Array:
    """(first, 0, ..., 0)."""
    return jnp.concatenate([first, jnp.zeros_like(like[..., 1:])], axis=-1)


def _with_head(values: Array, slack: Array) -> Array:
    w = values[..., 1:]
    return jnp.concatenate(
        [jnp.sqrt(jnp.maximum(jnp.sum(w * w, axis=-1, keepdims=True) + values[..., :1] * slack, 0.0)), w],
        axis=-1,
    )

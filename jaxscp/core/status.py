"""Every way a solve can end, as one enumeration that lives in arrays and survives ``jit`` and ``vmap``."""

from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool

# A member of Status, or a batch of them; equinox gives its type no public name.
StatusCode = Any


class Status(eqx.Enumeration):
    """How a solve ended; the message of each member says what likely happened and what to try.

    Compare with ``==`` (an array of booleans under ``vmap``), choose with ``Status.where``.

    Example:
        >>> from jaxscp import Status, status_names
        >>> bool(Status.converged == Status.converged)
        True
        >>> status_names(Status.iteration_limit)
        'iteration_limit'
    """

    converged = "Converged: the tolerances were met."
    almost_converged = (
        "Almost converged: progress ended at a looser accuracy than asked. The problem may be badly scaled or "
        "its tolerances below what float64 gives."
    )
    iteration_limit = (
        "The iteration limit came first. Allow more iterations, start from a better guess, loosen the tolerances, or "
        "give a problem of your own its typical sizes: scale=jaxscp.Scale(...)."
    )
    infeasible = (
        "The constraints of a convex subproblem contradict each other (a certificate was found). Likely causes: "
        "start or goal violates a limit, a corridor cell does not reach the next, the landing cone lies outside "
        "the corridor, or the final time is fixed too short."
    )
    unbounded = (
        "The cost of a convex subproblem falls without bound (a certificate was found). Likely causes: a missing "
        "limit on a control or on time, or a negative weight."
    )
    insufficient_progress = (
        "The steps became too small before the tolerances were met, or a convex subproblem could not be solved to its "
        "accuracy. Likely causes: constraints leave no room, as where start or goal lies on a face of the corridor "
        "that the landing cone meets; the final time or the limits make the task impossible; or the problem is badly "
        "scaled."
    )
    numerical_error = (
        "A number that is not finite arose inside the solver. In a problem of your own, call jaxscp.solve(problem, "
        "guess, check=True): it names the function whose value or derivative is not finite at the guess. Else check "
        "scales: SI units, and masses and times near one."
    )
    dynamics_unmet = (
        "No flight was found that obeys the dynamics and meets both ends: virtual control or an end residual remains. "
        "Likely causes: the final time or thrust limits make the task impossible, or the corridor forces too sharp a "
        "turn for so few nodes. More nodes or another guess may help."
    )
    constraints_unmet = (
        "No flight was found that keeps a constraint that is not convex: virtual buffer remains. Likely causes: "
        "keep-out zones block the corridor, or the guess passes them on the wrong side."
    )
    verification_failed = (
        "The solver met its tolerances, but the independent certificate disagrees: see its report for "
        "which check failed."
    )
    invalid_input = (
        "The scenario is not valid: a value is not finite, or start, goal, corridor or limits contradict each other. "
        "Call jaxscp.validate(scenario) on this element, outside jit and vmap, for the field and the cause; of a "
        "problem of your own, jaxscp.solve(problem, guess)."
    )


_NAMES = (
    "converged",
    "almost_converged",
    "iteration_limit",
    "infeasible",
    "unbounded",
    "insufficient_progress",
    "numerical_error",
    "dynamics_unmet",
    "constraints_unmet",
    "verification_failed",
    "invalid_input",
)


_OF_OWN_PROBLEMS = {
    "infeasible": (
        "The constraints of a convex subproblem contradict each other (a certificate was found). Likely causes: a "
        "condition at an end violates a bound or a constraint, two constraints exclude each other, or the final time "
        "is fixed too short."
    ),
    "insufficient_progress": (
        "The steps became too small before the tolerances were met, or a convex subproblem could not be solved to its "
        "accuracy. Likely causes: constraints leave no room, as where an end lies on two of them at once; the final "
        "time or the bounds make the task impossible; a function has a kink; or the problem is badly scaled."
    ),
    "dynamics_unmet": (
        "No trajectory was found that obeys the dynamics and meets both ends: virtual control or an end residual "
        "remains. Likely causes: the final time or the bounds of the controls make the task impossible, or there are "
        "too few nodes. More nodes or another guess may help."
    ),
    "constraints_unmet": (
        "No trajectory was found that keeps a constraint that is not convex: virtual buffer remains. Likely causes: "
        "the constraints leave no way, or the guess passes an obstacle on the wrong side."
    ),
    "invalid_input": (
        "The problem or its guess holds a value that is not finite. Call jaxscp.solve(problem, guess) on this element, "
        "outside jit and vmap, for the field and the cause."
    ),
}


def status_text(name: str, landing: bool) -> str:
    """What likely happened and what to try.

    Args:
        name: of the status.
        landing: whether a scenario was planned, and no problem of the user's own.

    Example:
        >>> from jaxscp.core.status import status_text
        >>> status_text("dynamics_unmet", landing=False)[:24]
        'No trajectory was found '
    """
    own = None if landing else _OF_OWN_PROBLEMS.get(name)
    return own or Status[getattr(Status, name)]  # by name: JAX does not know a status of NumPy


STATUS_NAMES = _NAMES
"""All names, in the order of the codes."""


def status_names(status: StatusCode):
    """Short names of a status, for tables and files: a string, or an array of strings for a batch."""
    # as NumPy's numbers: to compare statuses themselves, JAX would compile a program
    number = lambda of: np.asarray(jax.tree.leaves(of)[0])  # noqa: E731
    member_of = [number(status) == number(getattr(Status, name)) for name in _NAMES]
    names = np.select(member_of, _NAMES, default="unknown")
    return str(names) if names.ndim == 0 else names


def status_codes(names: Any) -> StatusCode:
    """The status of a name, or the statuses of an array of names: inverts ``status_names``.

    Raises:
        KeyError: for an unknown name.
    """
    names = np.asarray(names)
    codes = {name: np.asarray(jax.tree.leaves(getattr(Status, name))[0]) for name in _NAMES}
    unknown = sorted(set(names.ravel().tolist()) - set(codes))
    if unknown:
        raise KeyError(f"{unknown[0]!r} is no status")
    found = np.array([codes[name] for name in names.ravel().tolist()], codes["converged"].dtype)
    return jax.tree.unflatten(jax.tree.structure(Status.converged), [jnp.asarray(found.reshape(names.shape))])


def after_failed_subproblem(status: StatusCode) -> StatusCode:
    """Status of a loop that ends because it cannot use the answer of a subproblem.

    The iteration limit of the subproblem's solver is not the loop's: more iterations of the loop would not help.

    Args:
        status: of the subproblem.

    Example:
        >>> from jaxscp.core.status import Status, after_failed_subproblem, status_names
        >>> status_names(after_failed_subproblem(Status.iteration_limit))
        'insufficient_progress'
        >>> status_names(after_failed_subproblem(Status.infeasible))
        'infeasible'
    """
    found = Status.where(status == Status.iteration_limit, Status.insufficient_progress, status)
    return Status.where(usable(status), Status.numerical_error, found)  # solved, but not to a finite point


def usable(status: StatusCode) -> Bool[Array, "*batch"]:
    """Whether a subproblem's answer may be used as the next reference."""
    return (status == Status.converged) | (status == Status.almost_converged)

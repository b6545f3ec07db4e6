"""What comes of a case: named numbers, and perhaps a trajectory."""

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from jaxscp.core.arrays import namespace
from jaxscp.core.status import STATUS_NAMES, Status
from jaxscp.monte_carlo.errors import InvalidStudy
from jaxscp.monte_carlo.parameters import dotted_leaves
from jaxscp.problem.trajectory import Trajectory
from jaxscp.solver.solution import Solution
from jaxscp.verification.certificate import Certificate

SUCCESS = "success"
STATUS = "status"
TRAJECTORY = "time", "state", "control", "dilation"
"""Stored arrays of a ``Trajectory``."""
_STATUS_TYPE = type(Status.converged)
_CONVERGED = STATUS_NAMES.index("converged")


class Outcome(NamedTuple):
    """Result of a function of yours: numbers and a trajectory.

    Args:
        scalars: a pytree of numbers. A boolean called ``success`` makes success shares.
        trajectory: a pytree of arrays, whose shapes are the same for all cases; None for none.
    """

    scalars: Any
    trajectory: Any = None


class Quantity(NamedTuple):
    """A stored quantity: its type, its shape for one case, and what tables say of it."""

    dtype: str
    shape: tuple[int, ...]
    unit: str
    trajectory: bool


def outcome_of(value: Any) -> Outcome:
    """Named numbers and named arrays of a case, from a ``Solution``, an ``Outcome`` or a pytree of numbers.

    Raises:
        InvalidStudy: if a number is an array.
    """
    if isinstance(value, Solution):
        return Outcome(_solution_scalars(value), _arrays_of(value.trajectory))
    found = value if isinstance(value, Outcome) else Outcome(value)
    scalars = dict(dotted_leaves(jax.tree.map(_number, found.scalars, is_leaf=_is_status)))
    if not scalars:
        raise InvalidStudy(
            "run: its function returned no numbers; return a dictionary of them, or an Outcome(scalars, trajectory)."
        )
    for name, leaf in scalars.items():
        if np.shape(leaf) != ():
            raise InvalidStudy(
                f"run: {name or 'its result'} has the shape {np.shape(leaf)}; results are numbers. Arrays go into "
                "Outcome(scalars, trajectory)."
            )
    numbers = {name or "value": leaf for name, leaf in scalars.items()}
    path = found.trajectory
    if isinstance(path, Trajectory):
        path = _arrays_of(path)
    return Outcome(numbers, None if path is None else dict(dotted_leaves(path)))


def _arrays_of(trajectory: Trajectory) -> dict[str, Any]:
    return {name: getattr(trajectory, name) for name in TRAJECTORY}


def _solution_scalars(solution: Solution) -> dict[str, Any]:
    status = jax.tree.leaves(solution.status)[0]
    return {
        SUCCESS: status == _CONVERGED,
        STATUS: status,
        "cost": solution.cost,
        "final_time": solution.final_time,
        "iterations": solution.iterations,
        "interior_point_iterations": solution.interior_point_iterations,
        **certificate_scalars(solution.certificate),
    }


def certificate_scalars(certificate: Certificate) -> dict[str, Any]:
    """Worst violation, defect, every row of a certificate by name, and the clearance where obstacles are known."""
    rows = {f"error_{_word(n)}": certificate.end_errors[i] for i, n in enumerate(certificate.end_names)}
    rows |= {f"violation_{_word(n)}": certificate.between_nodes[i] for i, n in enumerate(certificate.names)}
    if certificate.clearance is not None:
        rows["clearance"] = certificate.clearance
    # ``certificate.violation`` would run compiled code for each case
    xp = namespace(certificate.between_nodes)
    hard = xp.where(xp.isinf(certificate.allowed), 0.0, certificate.between_nodes)
    return {"violation": xp.max(hard, initial=0.0), "defect": certificate.defect, **rows}


def units_of(value: Any) -> dict[str, str]:
    """Units of the named numbers that are known."""
    if not isinstance(value, Solution):
        return {}
    ends = zip(value.certificate.end_names, value.certificate.end_units, strict=True)
    return {"final_time": "s", "clearance": "m"} | {f"error_{_word(name)}": unit for name, unit in ends}


def quantities(outcome: Outcome, units: dict[str, str]) -> dict[str, Quantity]:
    """Stored quantities of every case, from the outcome of one case or from its shapes."""

    def quantity(name: str, leaf: Any, trajectory: bool) -> Quantity:
        dtype = str(leaf.dtype if hasattr(leaf, "dtype") else np.asarray(leaf).dtype)
        return Quantity(dtype, tuple(np.shape(leaf)), units.get(name, ""), trajectory)

    found = {name: quantity(name, leaf, False) for name, leaf in outcome.scalars.items()}
    path = outcome.trajectory or {}
    return found | {stored_name(name): quantity(name, leaf, True) for name, leaf in path.items()}


def stored_name(name: str) -> str:
    """Name of a trajectory's array among the stored quantities."""
    return f"trajectory.{name}"


def _is_status(value: Any) -> bool:
    return isinstance(value, _STATUS_TYPE)


def _number(value: Any) -> Any:
    return jax.tree.leaves(value)[0] if _is_status(value) else value


def _word(name: str) -> str:
    return name.replace(" ", "_")


def as_arrays(outcome: Outcome) -> dict[str, np.ndarray]:
    """All numbers and arrays by their stored names, on the host."""
    path = outcome.trajectory or {}
    return {name: np.asarray(leaf) for name, leaf in outcome.scalars.items()} | {
        stored_name(name): np.asarray(leaf) for name, leaf in path.items()
    }


def traced_arrays(outcome: Outcome) -> dict[str, jax.Array]:
    """The same inside a traced function."""
    path = outcome.trajectory or {}
    found = dict(outcome.scalars) | {stored_name(name): leaf for name, leaf in path.items()}
    return {name: jnp.asarray(leaf) for name, leaf in found.items()}

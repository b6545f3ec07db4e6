"""What comes of a case: named numbers, and perhaps a trajectory."""

import hashlib
from collections.abc import Iterable
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from jaxscp.core.arrays import namespace
from jaxscp.core.status import STATUS_NAMES, Status
from jaxscp.monte_carlo.errors import InvalidStudy, SweepError
from jaxscp.monte_carlo.parameters import dotted_leaves
from jaxscp.problem.trajectory import Trajectory
from jaxscp.solver.solution import Solution
from jaxscp.verification.certificate import Certificate

SUCCESS = "success"
STATUS = "status"
TRAJECTORY = "time", "state", "control", "dilation"
"""Stored arrays of a ``Trajectory``."""
STORED = "trajectory_stored"
"""Name of the array that says whose trajectories are stored."""
_TAKEN = "case", STORED
_NUMBERS = set("biufc")  # kinds of NumPy's types: booleans, whole numbers, floats, complex numbers
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
        InvalidStudy: if a number is an array or None, there is none, or two have the same name.
    """
    if isinstance(value, Solution):
        return Outcome(_solution_scalars(value), _arrays_of(value.trajectory))
    found = value if isinstance(value, Outcome) else Outcome(value)
    scalars = _by_name(jax.tree.map(_number, found.scalars, is_leaf=_is_status))
    if not scalars:
        raise InvalidStudy(
            "run returned no numbers; return a dictionary of them, or an Outcome(scalars, trajectory)."
        )
    for name, leaf in scalars.items():
        if np.shape(leaf) != ():
            raise InvalidStudy(
                f"{name or 'the result'} has the shape {np.shape(leaf)}; results are numbers. Arrays go into "
                "Outcome(scalars, trajectory)."
            )
    numbers = {name or "value": leaf for name, leaf in scalars.items()}
    path = found.trajectory
    if isinstance(path, Trajectory):
        path = _arrays_of(path)
    return Outcome(numbers, None if path is None else _by_name(path))


def _by_name(tree: Any) -> dict[str, Any]:
    """Leaves by their dotted paths; None is an error, which JAX would leave out."""
    for path, leaf in jax.tree_util.tree_leaves_with_path(tree, is_leaf=lambda leaf: leaf is None):
        if leaf is None:
            name = jax.tree_util.keystr(path, simple=True, separator=".")
            raise InvalidStudy(f"{name or 'the result'} is None; return a number, float('nan') say.")
    leaves = list(dotted_leaves(tree))
    found = dict(leaves)
    if len(found) < len(leaves):
        names = [name for name, _ in leaves]
        both = next(name for name in names if names.count(name) > 1)
        raise InvalidStudy(f"two results are called {both!r}; name them differently.")
    return found


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


def check_parameters(names: Iterable[str]) -> None:
    """Raise ``InvalidStudy`` if no array can have the name of a parameter."""
    if wrong := [name for name in names if not names_an_array(name)]:
        raise InvalidStudy(
            f"parameters: no array can have the name {wrong[0]!r}; use letters, digits and '_', 200 at most."
        )


def names_an_array(name: str) -> bool:
    """Whether an array of a Zarr group can have a name: it is the name of a folder.

    Example:
        >>> names_an_array("reach"), names_an_array("m/s"), names_an_array("..")
        (True, False, False)
    """
    letters = name.isprintable() and not set(name) & set("/\\") and len(name.encode()) <= 200
    return letters and name.strip(".") != "" and not name.startswith("__") and name != "zarr.json"


def names_in_use(quantities: dict[str, Quantity]) -> set[str]:
    """Names of the sweep's own arrays and axes, which no parameter or result may have."""
    return {*_TAKEN, *(f"{name}_{axis}" for name, q in quantities.items() for axis in range(len(q.shape)))}


def check_results(quantities: dict[str, Quantity]) -> None:
    """Raise ``SweepError`` if a result of the base is no number, or has a wrong name.

    Args:
        quantities: results of the base, by name.
    """
    own = names_in_use(quantities)
    for name, quantity in quantities.items():
        about = f"the base: the result {name!r}"
        if not names_an_array(name):
            raise SweepError(
                f"{about}: no array can have this name; use letters, digits and '_', 200 at most."
            )
        if name in own or (not quantity.trajectory and name.startswith(stored_name(""))):
            raise SweepError(f"{about}: the sweep itself uses this name; give the result another one.")
        _check_type(name, quantity.dtype)


def _check_type(name: str, dtype: str) -> None:
    try:
        kind = np.dtype(dtype).kind
    except TypeError:  # a type of JAX alone
        kind = ""
    if kind not in _NUMBERS:
        raise SweepError(f"the base: {name} has the type {dtype}; results are numbers that NumPy stores.")
    if name == SUCCESS and kind != "b":
        raise SweepError(f"the base: {name} has the type {dtype}; it must be True or False.")
    if name == STATUS and kind not in "iu":
        raise SweepError(f"the base: {name} has the type {dtype}; it must be a member of jaxscp.Status.")


def checksum(values: dict[str, np.ndarray]) -> str:
    """SHA-256 of names and values."""
    digest = hashlib.sha256()
    for name in sorted(values):
        array = np.ascontiguousarray(values[name])
        digest.update(f"{name} {array.dtype} {array.shape} ".encode())
        digest.update(array.tobytes())
    return digest.hexdigest()

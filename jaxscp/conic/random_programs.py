"""Small programs for examples, tests and benchmarks."""

import jax.numpy as jnp
import numpy as np

from jaxscp.conic.program import Cones, CouplingRows, HalfSpaceRows, NormCost, StagedProgram


def smallest_program() -> StagedProgram:
    """Program of two nodes (position x, force u): least u^2 from x_0 = 0 to x_1 = 1, x_1 = x_0 + u_0, |u| <= 2.

    The optimum is u_0 = 1, u_1 = 0 with cost 1/2. The step may use virtual control, but the optimum does not.

    Example:
        >>> from jaxscp.conic.random_programs import smallest_program
        >>> program = smallest_program()
        >>> program.nodes, program.variables
        (2, 2)
    """
    position, none = jnp.array([[1.0, 0.0]]), jnp.zeros((1, 2))
    step = jnp.array([[1.0, 1.0]])
    limits = jnp.array([[0.0, 1.0], [0.0, -1.0]])
    return StagedProgram(
        hessian=jnp.broadcast_to(jnp.diag(jnp.array([0.0, 1.0])), (2, 2, 2)),
        gradient=jnp.zeros((2, 2)),
        links=CouplingRows(
            before=jnp.stack([none, step, position]),
            after=jnp.stack([position, -position, none]),
            offset=jnp.array([[0.0], [0.0], [1.0]]),
            soft=jnp.array([[0.0], [1.0], [0.0]]),
            weight=jnp.full(3, 10.0),
        ),
        rows=HalfSpaceRows(jnp.broadcast_to(limits, (2, 2, 2)), jnp.full((2, 2), 2.0)),
    )


def random_program(
    seed: int,
    *,
    nodes: int = 5,
    variables: int = 4,
    rows: int = 3,
    cones: int = 1,
    norm: bool = True,
    kind: str = "feasible",
) -> StagedProgram:
    """Random program that is feasible, infeasible or unbounded by construction.

    Args:
        seed: seed of the random numbers.
        nodes: number of nodes N.
        variables: variables of a node. A link has half as many rows; the first has virtual control.
        rows: half-spaces of a node, at least two.
        cones: second-order cones of dimension 3 of a node.
        norm: whether the cost is linear with a trust-region norm; quadratic otherwise.
        kind: ``feasible``, ``infeasible`` or ``unbounded``. Feasible: a point is inside every constraint, and the cost
            is bounded. Infeasible: two half-spaces of the second node contradict each other. Unbounded: only the cost
            depends on the first variable of the second node.

    Example:
        >>> from jaxscp.conic.random_programs import random_program
        >>> random_program(0, nodes=3, variables=4).links.offset.shape
        (4, 2)
    """
    random = np.random.default_rng(seed)
    free = np.zeros((nodes, variables))
    free[1, 0] = kind == "unbounded"
    point = random.standard_normal((nodes, variables))
    links = _random_links(random, point, 1.0 - free)
    half_spaces = _random_rows(random, point, 1.0 - free, rows, contradictory=kind == "infeasible")
    gradient = np.where(free > 0, 1.0, random.standard_normal((nodes, variables)))
    root = random.standard_normal((nodes, variables, variables)) * (1.0 - free)[:, :, None]
    hessian = np.zeros_like(root) if norm else root @ np.swapaxes(root, 1, 2)
    return StagedProgram(
        hessian=jnp.asarray(hessian),
        gradient=jnp.asarray(gradient),
        links=links,
        rows=half_spaces,
        cones=(_random_cones(random, point, 1.0 - free, cones),),
        norm=_random_norm(random, point, gradient, 1.0 - free) if norm else None,
    )


def _random_links(random: np.random.Generator, point: np.ndarray, used: np.ndarray) -> CouplingRows:
    """Links that virtual control satisfies at a point; ``used`` masks the variables that they depend on."""
    nodes, variables = point.shape
    shape = (nodes + 1, variables // 2, variables)
    before, after = random.standard_normal(shape), random.standard_normal(shape)
    before[0], after[-1] = 0.0, 0.0
    before[1:] *= used[:, None]
    after[:-1] *= used[:, None]
    soft = np.zeros(shape[:2])
    soft[1:-1, 0] = 1.0
    offset = 0.3 * soft * random.standard_normal(shape[:2])  # virtual control at the point
    offset[1:] += np.einsum("krn,kn->kr", before[1:], point)
    offset[:-1] += np.einsum("krn,kn->kr", after[:-1], point)
    weight = random.uniform(1.0, 5.0, nodes + 1)
    return CouplingRows(*map(jnp.asarray, (before, after, offset, soft, weight)))


def _random_rows(
    random: np.random.Generator, point: np.ndarray, used: np.ndarray, rows: int, contradictory: bool
) -> HalfSpaceRows:
    """Half-spaces with a point inside; contradictory: two of the second node exclude each other."""
    matrix = random.standard_normal((len(point), rows, point.shape[1])) * used[:, None]
    offset = np.einsum("krn,kn->kr", matrix, point) + random.uniform(0.1, 1.0, (len(point), rows))
    if contradictory:
        matrix[1, 1], offset[1, 1] = -matrix[1, 0], -offset[1, 0] - random.uniform(0.1, 1.0)
    return HalfSpaceRows(jnp.asarray(matrix), jnp.asarray(offset))


def _random_cones(random: np.random.Generator, point: np.ndarray, used: np.ndarray, cones: int) -> Cones:
    """Second-order cones of dimension 3 with a point inside."""
    nodes, variables = point.shape
    matrix = random.standard_normal((nodes, cones, 3, variables)) * used[:, None, None]
    slack = random.uniform(-0.5, 0.5, (nodes, cones, 3))
    slack[..., 0] += 1.5
    offset = np.einsum("kcdn,kn->kcd", matrix, point) + slack
    return Cones(jnp.asarray(matrix), jnp.asarray(offset))


def _random_norm(
    random: np.random.Generator, point: np.ndarray, gradient: np.ndarray, used: np.ndarray
) -> NormCost:
    """Norm whose weight exceeds the gradient, so that the cost is bounded."""
    scale = random.uniform(0.5, 2.0, point.shape) * used
    slope = np.linalg.norm(used * gradient / np.where(scale > 0, scale, 1.0), axis=1)
    centre = point + 0.5 * random.standard_normal(point.shape)
    return NormCost(*map(jnp.asarray, (1.0 + 2.0 * slope, scale, centre)))

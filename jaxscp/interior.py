"""From a point near the optimum to a point of the central path: a primal-dual interior point on the nonlinear problem.

Newton's method on the conditions of ``central_path`` with slacks s = g(z) and multipliers y of their own, s o y = mu e,
in Nesterov-Todd scaling; mu falls as the iterates follow (Waechter and Biegler, "On the implementation of an
interior-point filter line-search algorithm for large-scale nonlinear programming", 2006, without its line search: what
the convex subproblems lead to is near enough). One factorisation an iteration, and second derivatives throughout:
the end is quadratic, where that of the subproblems is not.
"""

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from jaxscp import lanes, riccati
from jaxscp.central_path import MU, ROOM, inverse
from jaxscp.conic import cones as second_order
from jaxscp.constraints import Cone, SecondOrder
from jaxscp.convexify import terminal_cost
from jaxscp.discretise import interval_inputs
from jaxscp.expansion import expand
from jaxscp.inequalities import (
    Jacobians,
    Values,
    at_nodes,
    cones,
    inequalities,
    jacobians,
    node_hessians,
    onto_nodes,
    unit,
)
from jaxscp.intervals import Grid, evaluate
from jaxscp.lifted import stage_sizes
from jaxscp.multipliers import FlightMultipliers
from jaxscp.normal import Rows, normal
from jaxscp.problem import OptimalControlProblem, end_condition, start_condition, typical_sizes
from jaxscp.stationarity import equalities_gradient
from jaxscp.types import Count, Flag, Scalar

TO_BOUNDARY = 0.99  # share of the way to the cone's boundary that a step may go
FOLLOWED = 300.0  # times mu: error of the conditions, from which down the path is near enough for mu to fall
LONGEST = 0.3  # of a variable's typical size, that a step may change it by
Scalings = tuple["OrthantScaling | second_order.SecondOrderScaling", ...]
LEAST_SHIFT, GROWTH, MOST_SHIFT = 1e-4, 8.0, 1e4  # of the diagonal where the second-order condition fails


class Iterate(eqx.Module):
    """State of the loop."""

    z: Float[Array, "nodes variables"]
    y: FlightMultipliers
    slack: Values
    mu: Scalar
    shift: Scalar
    """Added to the (scaled) curvature when last that was needed."""
    error: Scalar
    """Largest of what the conditions of the point before lack, at the final mu; infinite before that."""
    moved: Scalar
    """Largest change of a variable by the last step, in typical sizes."""
    steps: Count
    ended: Flag
    """Whether no step can be taken."""


class Local(eqx.Module):
    """The problem about an iterate, to second order."""

    flow: Float[Array, "intervals states inputs"]
    """Jacobian of every interval's end."""
    initial: Float[Array, "initial states"]
    """Jacobian of the conditions at the start."""
    final: Float[Array, "final states"]
    """Jacobian of the conditions at the end."""
    intervals: Float[Array, "intervals inputs inputs"]
    """Second derivatives of the Lagrangian, by intervals."""
    nodes: Float[Array, "nodes variables variables"]
    """And what belongs to nodes alone."""
    values: Values
    jacobians: Jacobians
    lack: riccati.Side
    """Gradient of the Lagrangian without inequalities, and residuals of the equalities."""


class Interior(eqx.Module):
    """Settings of the method.

    Args:
        first: mu to begin with.
        last: mu of the answer.
        tolerance: largest residual of the conditions, in typical sizes of the variables.
        settled: change of the variables by the last step, in typical sizes: along directions that hardly matter to the
            cost, the conditions alone would stop too early for derivatives.
        max_steps: Newton steps allowed.
    """

    first: float = 1e-3
    last: float = MU
    tolerance: float = 1e-8
    settled: float = 1e-6
    max_steps: int = eqx.field(default=80, static=True)

    def run(
        self,
        problem: OptimalControlProblem,
        z: Float[Array, "nodes variables"],
        y: FlightMultipliers,
        grid: Grid,
        wanted: Flag | bool = True,
    ) -> Iterate:
        """Iterate to the end; not at all for a lane that is not wanted."""
        scale = typical_sizes(z)
        start = self.init(problem, z, y, grid)
        start = eqx.tree_at(lambda s: s.ended, start, ~jnp.asarray(wanted))

        def step(fixed, iterate):
            problem, grid, scale = fixed
            return self.step(problem, iterate, grid, scale)

        return lanes.while_loop(lambda s: ~self.terminate(s), step, (problem, grid, scale), start)

    def reached(self, iterate: Iterate) -> Flag:
        """Whether an iterate is the optimum."""
        return iterate.error <= self.tolerance

    def terminate(self, iterate: Iterate) -> Flag:
        """Whether the loop is over."""
        settled = self.reached(iterate) & (iterate.moved <= self.settled)
        return settled | iterate.ended | (iterate.steps >= self.max_steps)

    def init(
        self,
        problem: OptimalControlProblem,
        z: Float[Array, "nodes variables"],
        y: FlightMultipliers,
        grid: Grid,
    ) -> Iterate:
        """Slacks as the point has them, but far enough inside that a multiplier need not exceed the one given."""
        mu = jnp.asarray(self.first, z.dtype)
        values = inequalities(problem, z, evaluate(problem, z, grid), ROOM)
        slack = tuple(
            _inside(k, g, mu / jnp.maximum(price, jnp.sqrt(mu)))
            for k, g, price in zip(cones(problem), values, y.values, strict=True)
        )
        prices = tuple(mu * inverse(k, s) for k, s in zip(cones(problem), slack, strict=True))
        # The ends' multipliers, like the prices, follow from the rest in the first step.
        return Iterate(
            z=z,
            y=FlightMultipliers(y.flow, y.initial, y.final, prices),
            slack=slack,
            mu=mu,
            shift=jnp.zeros_like(mu),
            error=jnp.full_like(mu, jnp.inf),
            moved=jnp.full_like(mu, jnp.inf),
            steps=jnp.zeros((), int),
            ended=jnp.zeros((), bool),
        )

    def step(
        self, problem: OptimalControlProblem, old: Iterate, grid: Grid, scale: Float[Array, "variables"]
    ) -> Iterate:
        """One Newton step."""
        here = local(problem, old.z, old.y, grid)
        weigh = scalings(problem, old.slack, old.y.values)
        inverses = tuple(inverse(k, s) for k, s in zip(cones(problem), old.slack, strict=True))
        apart = tuple(w.inverse_square(g - s) for w, s, g in zip(weigh, old.slack, here.values, strict=True))
        condensed = weighed(problem, here.jacobians, weigh, old.y.values, inverses, apart)
        priced, poles, owed = condensed.sides

        error = _error(problem, old, here, priced, scale)
        ready = (error <= FOLLOWED * old.mu) & (old.mu > self.last)
        mu = jnp.where(ready, jnp.maximum(self.last, jnp.minimum(0.2 * old.mu, old.mu**1.5)), old.mu)

        factor, shift = _definite(newton_chain(problem, here, condensed, scale), old.shift)
        gradient = mu * poles - owed - here.lack.nodes
        right = riccati.Side(gradient, -here.lack.flow, -here.lack.initial, -here.lack.final)
        move = scaled(riccati.solve(factor, scaled(right, scale)), scale)

        slopes = along(problem, here.jacobians, move.nodes)
        dslack = tuple(slope + g - s for slope, g, s in zip(slopes, here.values, old.slack, strict=True))
        dprices = tuple(
            mu * pole - y - w.inverse_square(ds)
            for w, pole, y, ds in zip(weigh, inverses, old.y.values, dslack, strict=True)
        )
        dy = FlightMultipliers(move.flow, move.initial, move.final, dprices)
        size = jnp.max(jnp.abs(move.nodes / scale))
        primal = jnp.minimum(_longest(problem, old.slack, dslack), LONGEST / jnp.maximum(size, LONGEST))
        dual = _longest(problem, old.y.values, dprices)

        good = factor.definite & jnp.isfinite(size)
        advance = lambda v, dv, t: jax.tree.map(lambda a, b: jnp.where(good, a + t * b, a), v, dv)  # noqa: E731
        return Iterate(
            z=advance(old.z, move.nodes, primal),
            y=advance(old.y, dy, dual),
            slack=advance(old.slack, dslack, primal),
            mu=mu,
            shift=shift,
            error=jnp.where(old.mu <= self.last, error, jnp.inf),
            moved=primal * size,
            steps=old.steps + 1,
            ended=~good,
        )


def local(
    problem: OptimalControlProblem, z: Float[Array, "nodes variables"], y: FlightMultipliers, grid: Grid
) -> Local:
    """Everything about a point, to second order."""
    (linear, intervals), n = expand(problem, z, y, grid), problem.state_size
    gradient = equalities_gradient(problem, z, linear, y)
    defect = linear.outputs.end - z[1:, :n]
    return Local(
        flow=linear.jacobian.end,
        initial=linear.initial.jacobian,
        final=linear.final.jacobian,
        intervals=intervals,
        nodes=node_hessians(problem, z, y.values) + _ends_hessians(problem, z, y),
        values=inequalities(problem, z, linear.outputs, ROOM),
        jacobians=jacobians(problem, z, linear),
        lack=riccati.Side(gradient, defect, linear.initial.value, linear.final.value),
    )


class Weighed(eqx.Module):
    """What the inequalities, eliminated, add to the Newton system."""

    intervals: Float[Array, "intervals inputs inputs"]
    """J' W^-2 J, of those of intervals."""
    nodes: Float[Array, "nodes variables variables"]
    """And of those of nodes."""
    sides: tuple[Float[Array, "nodes variables"], ...]
    """J' v of all, by nodes."""


def weighed(problem: OptimalControlProblem, jacobians: Jacobians, weigh: Scalings, *sides: Values) -> Weighed:
    """Eliminate the inequalities; with J' v for so many v."""
    parts: dict[bool, list[Rows]] = {False: [], True: []}
    for w, jacobian, nodal, *of in zip(weigh, jacobians, at_nodes(problem), *sides, strict=True):
        none = jnp.zeros((*jacobian.shape[:3], 0), jacobian.dtype)
        stacked = jnp.concatenate([none, *(v[..., None] for v in of)], axis=-1)
        parts[nodal].append(Rows(jacobian, *_weights(w), stacked))
    nodes = normal(tuple(parts[True]))
    if not parts[False]:
        count, inputs = problem.nodes - 1, interval_inputs(problem, nodes.matrix[:, 0]).shape[1]
        blank = jnp.zeros((count, inputs, inputs), nodes.matrix.dtype)
        return Weighed(blank, nodes.matrix, tuple(jnp.moveaxis(nodes.sides, 1, 0)))
    intervals = normal(tuple(parts[False]))
    pulls = zip(jnp.moveaxis(intervals.sides, 1, 0), jnp.moveaxis(nodes.sides, 1, 0), strict=True)
    return Weighed(intervals.matrix, nodes.matrix, tuple(onto_nodes(problem, i) + n for i, n in pulls))


def _weights(w: "OrthantScaling | second_order.SecondOrderScaling"):
    """W^-2 as a diagonal and, of a second-order cone, a vector whose square is added."""
    if isinstance(w, OrthantScaling):
        return w.inverse_square(jnp.ones_like(w.slack)), None
    size = w.eta[..., None]
    return -second_order.reflect(jnp.ones_like(w.w)) / size**2, jnp.sqrt(2.0) * second_order.reflect(
        w.w
    ) / size


def newton_chain(
    problem: OptimalControlProblem, here: Local, condensed: Weighed, scale: Float[Array, "variables"]
) -> riccati.Chain:
    """Matrix of the Newton system in scaled variables, inequalities eliminated: the Lagrangian's second derivatives,
    and W^-2 of every cone."""
    both = here.intervals + condensed.intervals, here.nodes + condensed.nodes
    return lagrangian_chain(problem, eqx.tree_at(lambda h: (h.intervals, h.nodes), here, both), scale)


def lagrangian_chain(
    problem: OptimalControlProblem, here: Local, scale: Float[Array, "variables"]
) -> riccati.Chain:
    """The Lagrangian's second derivatives in the scaled node variables and the multipliers of the equalities."""
    n, stage = problem.state_size, problem.variables
    intervals = here.intervals.at[:, :stage, :stage].add(here.nodes[:-1])
    sizes = stage_sizes(problem, scale)
    return riccati.Chain(
        hessian=intervals * sizes * sizes[:, None],
        last=here.nodes[-1] * scale * scale[:, None],
        flow=here.flow * sizes / scale[:n, None],
        initial=here.initial * scale[:n],
        final=here.final * scale[:n],
    )


class OrthantScaling(eqx.Module):
    """Nesterov-Todd scaling W of values that are nonnegative: W^2 = s / y."""

    slack: Float[Array, "*b"]
    price: Float[Array, "*b"]

    def square(self, v: Float[Array, "*b"]) -> Float[Array, "*b"]:
        """W^2 v."""
        return v * self.slack / self.price

    def inverse_square(self, v: Float[Array, "*b"]) -> Float[Array, "*b"]:
        """W^-2 v."""
        return v * self.price / self.slack


def scalings(problem: OptimalControlProblem, slack: Values, prices: Values) -> Scalings:
    """The Nesterov-Todd scaling of every pair of a slack and its price."""

    def one(cone, s, y):
        return (
            second_order.second_order_scaling(s, y) if isinstance(cone, SecondOrder) else OrthantScaling(s, y)
        )

    return tuple(map(one, cones(problem), slack, prices))


def scaled(side: riccati.Side, scale: Float[Array, "variables"]) -> riccati.Side:
    """Right-hand side of the system in scaled variables, from one in the variables' own units; and the unknowns in
    their own units, from scaled ones."""
    return riccati.Side(side.nodes * scale, side.flow / scale[: side.flow.shape[1]], side.initial, side.final)


def _ends_hessians(problem: OptimalControlProblem, z: Float[Array, "nodes variables"], y: FlightMultipliers):
    """Second derivatives of the conditions at both ends, times their multipliers, and of the terminal cost in the
    last state."""
    n, last = problem.state_size, problem.nodes - 1

    def at_start(state):
        return jnp.vdot(y.initial, start_condition(problem, state))

    def at_end(state):
        cost = terminal_cost(problem, z.at[last, :n].set(state))
        return cost + jnp.vdot(y.final, end_condition(problem, state))

    nodes = jnp.zeros((*z.shape, z.shape[1]), z.dtype)
    nodes = nodes.at[0, :n, :n].set(jax.hessian(at_start)(z[0, :n]))
    return nodes.at[last, :n, :n].add(jax.hessian(at_end)(z[last, :n]))


def along(
    problem: OptimalControlProblem, jacobians: Jacobians, dz: Float[Array, "nodes variables"]
) -> Values:
    """Slopes of the inequalities along a direction."""
    dw = interval_inputs(problem, dz)
    return tuple(
        jnp.einsum("iprw,iw->ipr", jacobian, dz if nodal else dw)
        for jacobian, nodal in zip(jacobians, at_nodes(problem), strict=True)
    )


def _definite(chain: riccati.Chain, last: Scalar) -> tuple[riccati.Factor, Scalar]:
    """Factor the matrix; where the second-order condition fails, with the least shift of a rising few that mends it."""

    def another(carry):
        _, _, after = carry
        least = jnp.maximum(LEAST_SHIFT, last / GROWTH)
        return riccati.factor(chain.shifted(after)), after, jax.lax.select(after > 0, GROWTH * after, least)

    def fails(carry):
        factor, shift, _ = carry
        return ~factor.definite & (shift < MOST_SHIFT)

    none = jnp.zeros_like(last)
    factor, used, _ = jax.lax.while_loop(fails, another, (riccati.no_factor(chain), none, none))
    kept: Array = jnp.where(used > 0, used, last)
    return factor, kept


def _error(
    problem: OptimalControlProblem,
    at: Iterate,
    here: Local,
    priced: Float[Array, "nodes variables"],
    scale: Float[Array, "variables"],
) -> Scalar:
    dual = (here.lack.nodes - priced) * scale
    apart = [g - s for g, s in zip(here.values, at.slack, strict=True)]
    pairs = [
        (second_order.jordan_product(s, y) if isinstance(k, SecondOrder) else s * y)
        - at.mu * unit(k, s.shape[-1])
        for k, s, y in zip(cones(problem), at.slack, at.y.values, strict=True)
    ]
    parts = [dual, here.lack.flow, here.lack.initial, here.lack.final, *apart, *pairs]
    return jnp.max(jnp.stack([jnp.max(jnp.abs(part), initial=0.0) for part in parts]))


def _inside(cone: Cone, values: Float[Array, "*b rows"], least: Float[Array, "*b rows"]):
    """The values, moved in where they have less than ``least`` to the cone's boundary."""
    if not isinstance(cone, SecondOrder):
        return jnp.maximum(values, least)
    norm = jnp.linalg.norm(values[..., 1:], axis=-1)
    return values.at[..., 0].set(norm + jnp.maximum(values[..., 0] - norm, least[..., 0]))


def _longest(problem: OptimalControlProblem, point: Values, direction) -> Scalar:
    """Step, at most one, that keeps a point in the cones."""

    def one(cone: Cone, v: Array, dv: Array) -> Array:
        if isinstance(cone, SecondOrder):
            return jnp.min(second_order.step_to_boundary(v, dv))
        falls = dv < 0.0
        speed: Array = jnp.where(falls, -dv, 1.0)
        reach: Array = jnp.where(falls, v / speed, jnp.inf)
        return jnp.min(reach)

    steps = [one(k, v, dv) for k, v, dv in zip(cones(problem), point, direction, strict=True)]
    return jnp.minimum(1.0, TO_BOUNDARY * jnp.min(jnp.stack(steps)))

"""The cones of constraints, with the algebra that the methods need of each. Values lie along the last axis.

Zero, nonnegative and second-order cones are symmetric or trivial; formulas are in ``second_order`` and ``orthant``.
Names follow Goulart and Chen, "Clarabel: an interior-point solver for conic programs with quadratic objectives" (2024).
"""

import abc
from typing import ClassVar

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from jaxscp.cones import second_order
from jaxscp.cones.orthant import OrthantScaling
from jaxscp.core.types import Scalar

Rows = Float[Array, "*b rows"]
Conditions = Float[Array, "*b conditions"]
Scaling = OrthantScaling | second_order.SecondOrderScaling

_CORNER = 1e-4  # in the unit of the values: smooths max(0, d); the margin may be short by a sixteenth of it


class Cone(eqx.Module):
    """A convex cone that the values of a constraint must lie in.

    A condition is one scalar inequality: every row of a nonnegative cone, or a second-order cone as a whole.
    """

    least_rows: ClassVar[int] = 1
    """Values that it holds at least."""
    inequality: ClassVar[bool] = True
    """Whether it has an interior."""
    curved: ClassVar[bool] = False
    """Whether its boundary is curved: values (t, w) as in the second-order cone."""

    @abc.abstractmethod
    def condition_rows(self, rows: int) -> int:
        """Number of rows that form one condition."""

    @abc.abstractmethod
    def margin(self, values: Rows) -> Conditions:
        """Distance of the values to the boundary, one number a condition; negative outside the cone."""

    @abc.abstractmethod
    def margin_jacobian(
        self, values: Float[Array, "*b rows"], jacobian: Float[Array, "*b rows inputs"]
    ) -> Float[Array, "*b conditions inputs"]:
        """Jacobian of ``margin``, from the values and their Jacobian."""

    @abc.abstractmethod
    def violations(self, values: Rows) -> Conditions:
        """Violation of each condition, in the unit of the values; negative inside."""

    def violation(self, values: Float[Array, "rows"]) -> Scalar:
        """Largest violation, in the unit of the values; negative inside."""
        return jnp.max(self.violations(values))

    @abc.abstractmethod
    def project_dual(self, v: Rows) -> Rows:
        """Nearest point of the dual cone."""

    @abc.abstractmethod
    def inactive_value(self, values: Rows) -> Rows:
        """Constant values inside the cone, which replace the values of an inactive constraint."""

    @abc.abstractmethod
    def multiplier_size(self, multiplier: Rows) -> Conditions:
        """Size of a multiplier, one number a condition."""

    @abc.abstractmethod
    def tighten(
        self, values: Float[Array, "points rows"], second_difference: Float[Array, "points rows"], mask: Array
    ) -> Float[Array, "points rows"]:
        """Values less a bound on their dip between equally spaced points.

        Args:
            values: at the points of an interval; the rows of one condition.
            second_difference: of the values, at every point.
            mask: (points,) one where the bound is subtracted, else zero.
        """


class Zero(Cone):
    """Every value is zero: an equality."""

    inequality: ClassVar[bool] = False

    def condition_rows(self, rows: int) -> int:
        """One."""
        return 1

    def margin(self, values: Rows) -> Rows:
        """-|values|."""
        return -jnp.abs(values)

    def margin_jacobian(self, values, jacobian):
        """The Jacobian of the values themselves."""
        return jacobian

    def violations(self, values: Rows) -> Conditions:
        """Absolute values."""
        return jnp.abs(values)

    def project_dual(self, v: Rows) -> Rows:
        """The dual cone is the whole space."""
        return v

    def inactive_value(self, values: Rows) -> Rows:
        """Zeros."""
        return jnp.zeros_like(values)

    def multiplier_size(self, multiplier: Rows) -> Rows:
        """|multiplier|."""
        return jnp.abs(multiplier)

    def tighten(self, values, second_difference, mask):
        """The values: an equality has no margin."""
        return values


class SymmetricCone(Cone):
    """A cone with an interior, its own dual: interior points work on pairs (slack s, multiplier y) inside it."""

    def violations(self, values: Rows) -> Conditions:
        """Minus the margin."""
        return -self.margin(values)

    @abc.abstractmethod
    def identity(self, rows: int) -> Float[Array, "rows"]:
        """Identity e of the Jordan algebra."""

    def inactive_value(self, values: Rows) -> Rows:
        """The identity."""
        return jnp.broadcast_to(self.identity(values.shape[-1]).astype(values.dtype), values.shape)

    @abc.abstractmethod
    def log_barrier(self, values: Rows) -> Float[Array, "*b"]:
        """-log det(values)."""

    def barrier_gradient(self, values: Rows) -> Rows:
        """Gradient of ``log_barrier``: minus the inverse in the Jordan algebra."""
        return jax.grad(lambda v: jnp.sum(self.log_barrier(v)))(values)

    @abc.abstractmethod
    def jordan_product(self, a: Rows, b: Rows) -> Rows:
        """a o b."""

    @abc.abstractmethod
    def scaling(self, s: Rows, y: Rows) -> Scaling:
        """Nesterov-Todd scaling W of a pair inside the cone: W y = W^-1 s."""

    @abc.abstractmethod
    def step_length(self, point: Rows, direction: Rows) -> Scalar:
        """Largest step that keeps all points in the cone; infinite where every step does."""

    @abc.abstractmethod
    def shift_inside(self, values: Rows, least: Rows) -> Rows:
        """Values with a margin of at least ``least``."""


class NonNegative(SymmetricCone):
    """Every value is zero or more."""

    def condition_rows(self, rows: int) -> int:
        """One."""
        return 1

    def margin(self, values: Rows) -> Rows:
        """The values."""
        return values

    def margin_jacobian(self, values, jacobian):
        """The Jacobian of the values."""
        return jacobian

    def project_dual(self, v: Rows) -> Rows:
        """max(v, 0)."""
        return jnp.maximum(v, 0.0)

    def multiplier_size(self, multiplier: Rows) -> Rows:
        """|multiplier|."""
        return jnp.abs(multiplier)

    def tighten(self, values, second_difference, mask):
        """Each row by its own second difference."""
        return _tighten_rows(values, second_difference, mask)

    def identity(self, rows: int) -> Float[Array, "rows"]:
        """Ones."""
        return jnp.ones(rows)

    def log_barrier(self, values: Rows) -> Float[Array, "*b"]:
        """-sum log(values)."""
        return -jnp.sum(jnp.log(values), axis=-1)

    def jordan_product(self, a: Rows, b: Rows) -> Rows:
        """The product of every row."""
        return a * b

    def scaling(self, s: Rows, y: Rows) -> OrthantScaling:
        """W^2 = s / y."""
        return OrthantScaling(s, y)

    def step_length(self, point: Rows, direction: Rows) -> Scalar:
        """Least ratio of a falling value to its fall."""
        falls = direction < 0.0
        speed: Array = jnp.where(falls, -direction, 1.0)
        reach: Array = jnp.where(falls, point / speed, jnp.inf)
        return jnp.min(reach)

    def shift_inside(self, values: Rows, least: Rows) -> Rows:
        """max(values, least)."""
        return jnp.maximum(values, least)


class SecondOrder(SymmetricCone):
    """The values (t, v) obey |v| <= t."""

    least_rows: ClassVar[int] = 2
    curved: ClassVar[bool] = True

    def condition_rows(self, rows: int) -> int:
        """All rows."""
        return rows

    def margin(self, values: Rows) -> Conditions:
        """t - |v|."""
        return values[..., :1] - jnp.linalg.norm(values[..., 1:], axis=-1, keepdims=True)

    def margin_jacobian(self, values, jacobian):
        """Jacobian of t - |v|, with a direction of zeros at the axis."""
        norm = jnp.linalg.norm(values[..., 1:], axis=-1, keepdims=True)
        unit = values[..., 1:] / jnp.maximum(norm, 1e-6)
        inward = jnp.einsum("...k,...kw->...w", unit, jacobian[..., 1:, :])
        return (jacobian[..., 0, :] - inward)[..., None, :]

    def project_dual(self, v: Rows) -> Rows:
        """Projection onto the cone, its own dual."""
        head, norm = v[..., :1], jnp.linalg.norm(v[..., 1:], axis=-1, keepdims=True)
        middle = 0.5 * (head + norm)
        between = jnp.concatenate([middle, middle * v[..., 1:] / jnp.maximum(norm, 1e-12)], axis=-1)
        return jnp.where(norm <= head, v, jnp.where(norm <= -head, 0.0, between))

    def multiplier_size(self, multiplier: Rows) -> Conditions:
        """The first component."""
        return multiplier[..., :1]

    def tighten(self, values, second_difference, mask):
        """All of the bound is subtracted from t; at the apex the bound is zero."""
        size = jnp.sqrt(jnp.sum(second_difference * second_difference, axis=1) + _CORNER**2) - _CORNER
        bound = jnp.sqrt(2.0) / 8.0 * mask * size
        return jnp.concatenate([values[:, :1] - bound[:, None], values[:, 1:]], axis=1)

    def identity(self, rows: int) -> Float[Array, "rows"]:
        """(1, 0, ..., 0)."""
        return jnp.zeros(rows).at[0].set(1.0)

    def log_barrier(self, values: Rows) -> Float[Array, "*b"]:
        """-1/2 log(t^2 - |v|^2): halved, so that one condition counts as one complementary pair.

        The difference of squares is t^2 (1 - |v / t|^2), which is smooth at the axis, where |v| is not.
        """
        ratio = values[..., 1:] / values[..., :1]
        return -(jnp.log(values[..., 0]) + 0.5 * jnp.log1p(-jnp.sum(ratio * ratio, axis=-1)))

    def jordan_product(self, a: Rows, b: Rows) -> Rows:
        """(a'b, a_0 b_1 + b_0 a_1)."""
        return second_order.jordan_product(a, b)

    def scaling(self, s: Rows, y: Rows) -> second_order.SecondOrderScaling:
        """W^2 = eta^2 (2 w w' - J)."""
        return second_order.second_order_scaling(s, y)

    def step_length(self, point: Rows, direction: Rows) -> Scalar:
        """Least step to the boundary."""
        return jnp.min(second_order.step_to_boundary(point, direction))

    def shift_inside(self, values: Rows, least: Rows) -> Rows:
        """t raised to |v| + least."""
        norm = jnp.linalg.norm(values[..., 1:], axis=-1)
        return values.at[..., 0].set(norm + jnp.maximum(values[..., 0] - norm, least[..., 0]))


def _tighten_rows(values: Array, second_difference: Array, mask: Array) -> Array:
    """Values less max(0, d) / 8, smoothed, with d the second difference: between points a chord errs by d / 8."""
    smooth = second_difference + jnp.sqrt(second_difference * second_difference + _CORNER**2) - _CORNER
    return values - mask[:, None] * smooth / 16.0

"""States of a trajectory at any time, by integration of its dynamics from the node before."""

import csv
import os
from collections.abc import Sequence
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from jaxscp.core.types import Scalar
from jaxscp.dynamics.base import Dynamics
from jaxscp.dynamics.rigid_body import RigidBody
from jaxscp.dynamics.rotations import tilt
from jaxscp.integration import tableaus
from jaxscp.problem.node_values import interval_at

STEPS = 20  # Runge-Kutta steps from a node: four times as many as the solver's, so 4096 times as accurate
MOST_SAMPLES = 10_000_000  # gigabytes: a higher rate is a mistake
# A final time is known to the solver's tolerance. So near to a multiple of 1 / rate, it takes that one's place.
NEAR_END = 1e-6  # of the final time
NEAR_STEP = 0.01  # of a step
ROUNDING = 1e-9  # of the final time: a time so little outside counts as inside


class Samples(eqx.Module):
    """Values of a trajectory at times; one time has no leading axis.

    Example:
        >>> import jaxscp
        >>> drive = jaxscp.Trajectory.from_arrays([0.0, 2.0], [[0.0, 0.0], [2.0, 2.0]], [[1.0], [1.0]])
        >>> samples = drive.with_dynamics(jaxscp.DoubleIntegrator(1)).at([0.5, 1.0])
        >>> samples.state.round(9).tolist(), samples.state_rate.round(9).tolist()
        ([[0.125, 0.5], [0.5, 1.0]], [[0.5, 1.0], [1.0, 1.0]])
    """

    time: Float[Array, "*times"]
    """s"""
    state: Float[Array, "*times states"]
    control: Float[Array, "*times controls"]
    state_rate: Float[Array, "*times states"]
    """Time derivative of the state, dx/dt."""
    state_names: tuple[str, ...] = eqx.field(static=True)
    """Columns of ``to_csv``, with units."""
    control_names: tuple[str, ...] = eqx.field(static=True)
    rate_names: tuple[str, ...] = eqx.field(static=True)

    def to_csv(
        self,
        file: str | os.PathLike,
        states: Sequence[str] | None = None,
        controls: Sequence[str] | None = None,
    ) -> None:
        """Write a table: a line of names with units, then one line a time. Numbers are read back bitwise.

        The columns are the time, the states, the controls, and the derivatives of the states that are no states.

        Args:
            file: to write.
            states: names of the states; by default x0, x1, ..., and ``x [m]``, ... for a landing.
            controls: names of the controls; by default u0, u1, ..., and ``thrust 1 [N]``, ... for a landing.

        Raises:
            ValueError: for a batch of trajectories, or if the number of names is wrong.

        Example:
            >>> import jaxscp, pathlib, tempfile
            >>> drive = jaxscp.Trajectory.from_arrays([0.0, 2.0], [[0.0, 0.0], [2.0, 2.0]], [[1.0], [1.0]])
            >>> file = pathlib.Path(tempfile.mkdtemp()) / "drive.csv"
            >>> drive.with_dynamics(jaxscp.DoubleIntegrator(1)).sample(rate=1).to_csv(file)
            >>> print(file.read_text().splitlines()[0])
            time [s],x0,x1,u0,dx0/dt,dx1/dt
        """
        time = np.atleast_1d(np.asarray(self.time))
        if time.ndim != 1:
            raise ValueError(
                f"samples: a table holds one trajectory, not a batch of shape {time.shape[:-1]}; take one element: "
                "jax.tree.map(lambda v: v[0], samples)"
            )
        rates = tuple(f"d{name}/dt" for name in states) if states is not None else self.rate_names
        groups = [
            (self.state, _names("states", states, self.state_names)),
            (self.control, _names("controls", controls, self.control_names)),
            (self.state_rate, rates),
        ]
        columns, header = [time], ["time [s]"]
        for values, names in groups:
            chosen = [i for i, name in enumerate(names) if name]
            columns += [np.asarray(values).reshape(len(time), -1)[:, i] for i in chosen]
            header += [names[i] for i in chosen]
        with open(file, "w", newline="", encoding="utf-8") as stream:
            writer = csv.writer(stream, lineterminator="\n")
            writer.writerow(header)
            writer.writerows(np.stack(columns, axis=1).tolist())


class FlightSamples(Samples):
    """Samples of a rigid body."""

    @property
    def position(self) -> Float[Array, "*times 3"]:
        """m, world."""
        return self.state[..., :3]

    @property
    def velocity(self) -> Float[Array, "*times 3"]:
        """m/s, world."""
        return self.state[..., 3:6]

    @property
    def attitude(self) -> Float[Array, "*times 4"]:
        """Quaternion (w, x, y, z), body to world."""
        return self.state[..., 6:10]

    @property
    def body_rate(self) -> Float[Array, "*times 3"]:
        """rad/s, body."""
        return self.state[..., 10:13]

    @property
    def speed(self) -> Float[Array, "*times"]:
        """m/s."""
        return jnp.linalg.norm(self.velocity, axis=-1)

    @property
    def tilt(self) -> Float[Array, "*times"]:
        """Angle in radians between the body's z axis and the vertical."""
        unit = self.attitude / jnp.linalg.norm(self.attitude, axis=-1, keepdims=True)
        return jnp.vectorize(tilt, signature="(q)->()")(unit)

    @property
    def acceleration(self) -> Float[Array, "*times 3"]:
        """m/s^2, world: the derivative of the velocity, with gravity."""
        return self.state_rate[..., 3:6]

    @property
    def angular_acceleration(self) -> Float[Array, "*times 3"]:
        """rad/s^2, body: the derivative of the body rate."""
        return self.state_rate[..., 10:13]


class Pieces(eqx.Module):
    """A trajectory, interval by interval."""

    time: Float[Array, "nodes"]
    dilation: Float[Array, "nodes"]
    state: Float[Array, "nodes states"]
    first: Float[Array, "intervals controls"]
    """Controls at the first point of every interval."""
    last: Float[Array, "intervals controls"]


@eqx.filter_jit  # compiled once for each shape, outside of ``jit`` too
def samples_at(dynamics: Dynamics, pieces: Pieces, times: Float[Array, "*times"], steps: int) -> Samples:
    """Samples of a trajectory; NaN at times outside of it.

    Args:
        dynamics: of the trajectory.
        pieces: its nodes.
        times: in s, one or an axis of them.
        steps: Runge-Kutta steps from the node before each time.
    """
    one = lambda time: _sample(dynamics, pieces, time, steps)  # noqa: E731
    state, control, rate = one(times) if times.ndim == 0 else jax.vmap(one)(times)
    flight = isinstance(dynamics, RigidBody)
    names = dynamics.state_names, dynamics.control_names, dynamics.rate_names
    return (FlightSamples if flight else Samples)(times, state, control, rate, *names)


def _sample(dynamics: Dynamics, pieces: Pieces, time: Scalar, steps: int):
    """State, controls and the state's derivative at one time."""
    intervals = pieces.time.shape[0] - 1
    begin, end = pieces.time[0], pieces.time[-1]
    rounding = ROUNDING * (end - begin)
    inside = (time >= begin - rounding) & (time <= end + rounding)
    time = jnp.clip(time, begin, end)
    i, fraction = interval_at(pieces.time, pieces.dilation, time)
    first, last = pieces.first[i], pieces.last[i]
    s0, slope = pieces.dilation[i], pieces.dilation[i + 1] - pieces.dilation[i]

    def rate(part, state):
        at = part * fraction
        now = pieces.time[i] + (s0 * at + 0.5 * slope * at**2) / intervals
        grows = dynamics(state, first + at * (last - first), now)
        return fraction * (s0 + at * slope) / intervals * grows

    state = tableaus.integrate(tableaus.SIXTH_ORDER, rate, pieces.state[i], steps)[-1]
    control = first + fraction * (last - first)
    found = state, control, dynamics(state, control, time)
    return jax.tree.map(lambda v: jnp.where(inside, v, jnp.nan), found)


def sample_times(duration: float, rate: float, end: bool) -> np.ndarray:
    """Times 0, 1 / rate, ..., and the duration itself, if asked for and not among them.

    Raises:
        ValueError: if the duration is not finite, or the samples are too many.
    """
    if not np.isfinite(duration):
        raise ValueError(f"trajectory.time: ends at {duration}, so that nothing can be sampled")
    if duration * rate > MOST_SAMPLES:
        raise ValueError(
            f"rate: {rate:g} Hz would make {duration * rate:.3g} samples; {MOST_SAMPLES:g} are allowed"
        )
    count = int(np.floor(duration * rate * (1.0 + ROUNDING))) + 1
    times = np.minimum(np.arange(count) / rate, duration)
    if not end:
        return times
    nearest = round(duration * rate) / rate
    near = abs(duration - nearest) <= min(NEAR_END * duration, NEAR_STEP / rate)
    before = times[: round(duration * rate)] if near else times
    return np.append(before, duration)


def check_inside(times: Any, nodes: np.ndarray) -> None:
    """Raise for times that are no numbers, or not between the first node and the last."""
    try:
        numbers = np.ravel(np.asarray(times))
    except ValueError:  # rows of several lengths
        numbers = np.array([None])
    if numbers.size and numbers.dtype.kind not in "iuf":
        raise ValueError(f"times: numbers are expected, in s, got {times!r}")
    rounding = ROUNDING * (nodes[-1] - nodes[0])
    outside = numbers[~((numbers >= nodes[0] - rounding) & (numbers <= nodes[-1] + rounding))]
    if outside.size and np.isfinite(nodes).all():
        raise ValueError(
            f"times: {outside[0]:g} s is outside the trajectory, from {nodes[0]:g} s to {nodes[-1]:g} s"
        )


def _names(kind: str, given: Sequence[str] | None, default: tuple[str, ...]) -> tuple[str, ...]:
    """The names given, one for each column."""
    if given is not None and len(given) != len(default):
        raise ValueError(f"{kind}: {len(default)} names are needed, got {len(given)}")
    return default if given is None else tuple(given)

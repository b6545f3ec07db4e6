"""A trajectory at N nodes: save, load, and values between the nodes."""

from __future__ import annotations

import os
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from jaxscp.core.arrays import namespace
from jaxscp.core.errors import InvalidProblem
from jaxscp.core.numpy_files import DAMAGED
from jaxscp.core.types import Controls, Nodes, Scalar, States
from jaxscp.dynamics.base import Dynamics
from jaxscp.problem.node_values import interval_at, node_times
from jaxscp.problem.samples import ROUNDING, STEPS, Pieces, Samples, samples_at

LEAST_PART = 0.1  # of scaled time


class Trajectory(eqx.Module):
    """States and controls at the nodes; of a landing, in SI units.

    Between nodes the controls and the dilation are linear in scaled time tau, k / (N - 1) at node k.
    """

    time: Nodes
    """Seconds from the start, (nodes,)."""
    state: States
    """(nodes, states); of a landing 13: position m, velocity m/s, attitude quaternion (w, x, y, z), body rate rad/s."""
    control: Controls
    """(nodes, controls); of a landing, the thrust of each rotor in N."""
    dilation: Nodes
    """dt/dtau in seconds, (nodes,)."""

    zero_order_hold: tuple[int, ...] = eqx.field(default=(), static=True)
    """Numbers of the controls that keep the value of an interval's first node."""
    dynamics: Dynamics | None = None
    """Of the states between nodes; a solution's trajectory has them."""

    @property
    def nodes(self) -> int:
        """Number of nodes."""
        return self.time.shape[-1]

    def interval_controls(self) -> tuple[Array, Array]:
        """Controls at the first and at the last point of every interval, (intervals, controls) each."""
        return self.controls_of_intervals(self.control)

    def controls_of_intervals(self, control: Controls) -> tuple[Array, Array]:
        """The same for other values at the nodes."""
        first, last = control[:-1], control[1:]
        if self.zero_order_hold:
            chosen = jnp.array(self.zero_order_hold)
            last = last.at[:, chosen].set(first[:, chosen])
        return first, last

    def scaled_time(self, time: Scalar | float) -> Scalar:
        """Scaled time tau of a time in seconds (held at the ends); inverts t(tau) exactly."""
        time = jnp.clip(time, self.time[0], self.time[-1])
        i, fraction = interval_at(self.time, self.dilation, time)
        return (i.astype(self.time.dtype) + fraction) / (self.time.shape[0] - 1)

    def control_at(self, time: Scalar | float) -> Float[Array, "controls"]:
        """Controls at a time in seconds, exactly as planned (held at the ends)."""
        first, last = self.interval_controls()
        i, fraction = self._interval(time)
        return (1.0 - fraction) * first[i] + fraction * last[i]

    def state_at(self, time: Scalar | float) -> Float[Array, "states"]:
        """State at a time in seconds, linear between nodes: for display. ``at`` integrates the dynamics."""
        i, fraction = self._interval(time)
        return (1.0 - fraction) * self.state[i] + fraction * self.state[i + 1]

    def with_dynamics(self, dynamics: Dynamics | None) -> Trajectory:
        """The trajectory with other dynamics, or without any.

        Args:
            dynamics: ``problem.dynamics``, or ``scenario.airframe.body`` of a landing.
        """
        return Trajectory(self.time, self.state, self.control, self.dilation, self.zero_order_hold, dynamics)

    def at(self, times: Any, *, steps: int = STEPS) -> Samples:
        """States, controls and derivatives at times, by integration of the dynamics from the node before.

        The controls between nodes are those that the problem states. ``jit``, ``vmap`` and ``grad`` work. At a node
        that is not the last, the values are the node's own.

        Args:
            times: (n,) in s, or one number; from zero to the final time.
            steps: steps from the node before, of a method of sixth order.

        Returns:
            Samples with axes (n, ...); for a landing ``FlightSamples``, with accelerations.

        Raises:
            ValueError: if a time is outside; inside ``jit`` and ``vmap``, its values are NaN. Also without dynamics.

        Example:
            >>> import jaxscp
            >>> drive = jaxscp.Trajectory.from_arrays([0.0, 2.0], [[0.0, 0.0], [2.0, 2.0]], [[1.0], [1.0]])
            >>> drive.with_dynamics(jaxscp.DoubleIntegrator(1)).at(1.0).state.round(9).tolist()  # linear: 1.0, 1.0
            [0.5, 1.0]
        """
        dynamics = self._known_dynamics()
        if namespace(times, self.time) is np:
            _check_inside(np.asarray(times), np.asarray(self.time))
        times = jnp.asarray(times).astype(self.time.dtype)
        if times.ndim > 1:
            raise ValueError(f"times: one number or one axis is expected, got shape {times.shape}")
        first, last = self.interval_controls()
        return samples_at(dynamics, Pieces(self.time, self.dilation, self.state, first, last), times, steps)

    def sample(self, *, rate: float | int, steps: int = STEPS) -> Samples:
        """``at`` equal steps in time: 0, 1 / rate, ... up to the final time, which need not be one of them.

        Args:
            rate: samples a second, in Hz.
            steps: as in ``at``.

        Raises:
            TypeError: inside ``jit`` and ``vmap``, where the number of samples is not known.
            ValueError: if the rate is not positive, for a batch, or without dynamics.

        Example:
            >>> import jaxscp
            >>> drive = jaxscp.Trajectory.from_arrays([0.0, 2.0], [[0.0, 0.0], [2.0, 2.0]], [[1.0], [1.0]])
            >>> drive.with_dynamics(jaxscp.DoubleIntegrator(1)).sample(rate=2.0).time.tolist()
            [0.0, 0.5, 1.0, 1.5, 2.0]
        """
        self._known_dynamics()
        if namespace(self.time, rate) is jnp:
            raise TypeError(
                "trajectory.sample: the number of samples follows from the final time, which is not known inside jit "
                "and vmap. Call trajectory.at(times), with as many times as you choose."
            )
        if not np.isfinite(rate) or rate <= 0.0:
            raise ValueError(f"rate: a positive number of samples a second is expected, got {rate}")
        duration = float(np.asarray(self.time)[-1])
        if not np.isfinite(duration):
            raise ValueError(f"trajectory.time: ends at {duration}, so that nothing can be sampled")
        count = int(np.floor(duration * rate * (1.0 + ROUNDING))) + 1
        return self.at(np.minimum(np.arange(count) / rate, duration), steps=steps)

    def _known_dynamics(self) -> Dynamics:
        """The dynamics of one trajectory."""
        if self.dynamics is None:
            raise ValueError(
                "trajectory: it has no dynamics, so that nothing between its nodes is known. A solution's trajectory "
                "has them. Else call trajectory.with_dynamics(problem.dynamics) first, or of a landing, "
                "trajectory.with_dynamics(scenario.airframe.body)."
            )
        if self.time.ndim != 1:
            raise ValueError(
                f"trajectory: it is a batch, with time of shape {self.time.shape}. Take one element, "
                "jax.tree.map(lambda v: v[0], trajectory), or call trajectory.at inside jax.vmap."
            )
        return self.dynamics

    def _interval(self, time: Scalar | float):
        """Number of the interval at a time, and the fraction of it, by scaled time."""
        position = self.scaled_time(time) * (self.time.shape[0] - 1)
        i = jnp.clip(jnp.floor(position).astype(int), 0, self.time.shape[0] - 2)
        return i, position - i.astype(position.dtype)

    def resampled(self, nodes: int) -> Trajectory:
        """The trajectory on another number of nodes, linear in scaled time between its own.

        Example:
            >>> import jaxscp
            >>> line = jaxscp.Trajectory.from_arrays([0.0, 2.0], [[0.0], [4.0]], [[1.0], [1.0]])
            >>> line.resampled(5).state[:, 0].tolist()
            [0.0, 1.0, 2.0, 3.0, 4.0]
        """
        return self if nodes == self.nodes else self._at_scaled(jnp.linspace(0.0, 1.0, nodes), 1.0)

    def remainder(self, first: Scalar | float) -> Trajectory:
        """The part from a fraction of scaled time on, on as many nodes.

        Controls and dilation are exact at the new nodes; states are linear between the old ones.

        Example:
            >>> import jaxscp
            >>> line = jaxscp.Trajectory.from_arrays([0.0, 2.0], [[0.0], [4.0]], [[1.0], [1.0]])
            >>> rest = line.remainder(0.5)
            >>> rest.state[:, 0].tolist(), float(rest.time[-1])
            ([2.0, 4.0], 1.0)
        """
        places = first + (1.0 - first) * jnp.linspace(0.0, 1.0, self.nodes)
        return self._at_scaled(places, 1.0 - first)

    def after(self, time: Scalar | float) -> Trajectory:
        """The part from a time in s on; near the end, the last ``LEAST_PART`` of scaled time. See ``remainder``."""
        return self.remainder(jnp.minimum(self.scaled_time(time), 1.0 - LEAST_PART))

    def _at_scaled(self, places: Nodes, width: Scalar | float) -> Trajectory:
        """Nodes at scaled times that span a width, each value linear between the own nodes; without dynamics."""
        own = jnp.linspace(0.0, 1.0, self.nodes)
        columns = jax.vmap(lambda v: jnp.interp(places, own, v), in_axes=1, out_axes=1)
        dilation = width * jnp.interp(places, own, self.dilation)
        return Trajectory(
            node_times(dilation), columns(self.state), columns(self.control), dilation, self.zero_order_hold
        )

    @staticmethod
    def from_arrays(times: Any, states: Any, controls: Any) -> Trajectory:
        """A trajectory from values at rising times, of any number; it is linear between them.

        Args:
            times: (n,) in s, from zero on.
            states: (n, states).
            controls: (n, controls).

        Returns:
            As many nodes, at equal distances in time.

        Raises:
            InvalidProblem: if times do not rise, lengths differ, or a value is no finite number; a ``ValueError``. The
                message names the field.

        Example:
            >>> import jaxscp
            >>> path = jaxscp.Trajectory.from_arrays([0.0, 1.0, 4.0], [[0.0], [1.0], [2.0]], [[0.0], [0.0], [0.0]])
            >>> path.time.tolist(), path.state[:, 0].round(2).tolist()
            ([0.0, 2.0, 4.0], [0.0, 1.33, 2.0])
        """
        times, states, controls = (
            _numbers(values, name)
            for name, values in (("times", times), ("states", states), ("controls", controls))
        )
        if times.ndim != 1 or len(times) < 2 or np.any(np.diff(times) <= 0.0) or times[0] != 0.0:
            raise InvalidProblem("times: two or more are needed, rising from zero on")
        for name, values in (("states", states), ("controls", controls)):
            if values.ndim != 2 or len(values) != len(times):
                raise InvalidProblem(
                    f"{name}: expected ({len(times)}, columns) as times has, got {values.shape}"
                )
        even = np.linspace(0.0, times[-1], len(times))
        columns = lambda v: np.stack([np.interp(even, times, c) for c in v.T], axis=1)  # noqa: E731
        dilation = np.full(len(times), times[-1])
        path = jnp.asarray(even), jnp.asarray(columns(states)), jnp.asarray(columns(controls))
        return Trajectory(*path, jnp.asarray(dilation))

    def save(self, file: str | os.PathLike) -> None:
        """Write an .npz with ``time``, ``state``, ``control`` and ``dilation``, in SI units."""
        arrays = {name: np.asarray(getattr(self, name)) for name in ("time", "state", "control", "dilation")}
        if self.zero_order_hold:
            arrays["zero_order_hold"] = np.array(self.zero_order_hold)
        with open(file, "wb") as stream:
            np.savez(stream, allow_pickle=False, **arrays)

    @staticmethod
    def load(file: str | os.PathLike) -> Trajectory:
        """Read what ``save`` wrote.

        Raises:
            ValueError: if the file is not such an archive or its shapes disagree; the message names the field.
        """
        names = ("time", "state", "control", "dilation")
        try:
            # Opened here: NumPy leaves the file open where it is no archive.
            with open(file, "rb") as stream, np.load(stream) as archive:
                missing = [name for name in names if name not in archive]
                arrays = {name: archive[name] for name in names if name not in missing}
                hold = tuple(archive["zero_order_hold"].tolist()) if "zero_order_hold" in archive else ()
        except DAMAGED as error:
            raise ValueError(f"{file}: not a trajectory archive (.npz): {error}") from error
        if missing:
            raise ValueError(f"{file}: missing field(s) {', '.join(missing)}")
        nodes = arrays["time"].shape[0]
        for name, array in arrays.items():
            if array.shape[0] != nodes:
                raise ValueError(f"{file}: field {name!r} has {array.shape[0]} nodes, but 'time' has {nodes}")
        time, state, control, dilation = (jnp.asarray(arrays[name]) for name in names)
        return Trajectory(time, state, control, dilation, hold)


def _check_inside(times: np.ndarray, nodes: np.ndarray) -> None:
    """Raise for a time that is not between the first node and the last."""
    rounding = ROUNDING * (nodes[-1] - nodes[0])
    outside = np.ravel(times)[~((times >= nodes[0] - rounding) & (times <= nodes[-1] + rounding)).ravel()]
    if outside.size and np.isfinite(nodes).all():
        raise ValueError(
            f"times: {outside[0]:g} s is outside the trajectory, from {nodes[0]:g} s to {nodes[-1]:g} s"
        )


def _numbers(values: Any, name: str) -> np.ndarray:
    """An array of finite numbers."""
    try:
        found = np.asarray(values, float)
    except (TypeError, ValueError) as error:
        raise InvalidProblem(f"{name}: expected rows of numbers of one length: {error}") from error
    if not np.isfinite(found).all():
        raise InvalidProblem(f"{name}: holds a value that is NaN or infinite")
    return found

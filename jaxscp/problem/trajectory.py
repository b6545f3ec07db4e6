"""A trajectory at N nodes: save, load, and values between the nodes."""

from __future__ import annotations

import os
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from jaxscp.core.arrays import check_whole, is_number, namespace
from jaxscp.core.errors import InvalidProblem
from jaxscp.core.types import Controls, Nodes, Scalar, States
from jaxscp.dynamics.base import Dynamics
from jaxscp.problem import node_files
from jaxscp.problem.node_values import held_at, interval_at, node_times
from jaxscp.problem.samples import STEPS, Pieces, Samples, check_inside, sample_times, samples_at

LEAST_PART = 0.1  # of scaled time


class Trajectory(eqx.Module):
    """States and controls at the nodes; of a landing, in SI units.

    Between nodes the controls and the dilation are linear in scaled time tau, k / (N - 1) at node k, not in time.
    The time is the integral of the dilation over tau, and dx/dtau is the dilation times the dynamics. ``at`` and
    ``sample`` obey this; ``numpy.interp(t, time, control)`` is another control.
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

        Raises:
            ValueError: if they have other numbers of states or controls.
        """
        if dynamics is not None:
            own = self.state.shape[-1], self.control.shape[-1]
            given = dynamics.state_size, dynamics.control_size
            if own != given:
                raise ValueError(f"dynamics: expected {own} states and controls, got {given}")
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
            ValueError: if a time is outside; inside ``jit`` and ``vmap``, its values are NaN. Also without dynamics,
                for times that are no numbers, and for ``steps`` that are no positive whole number.

        Example:
            >>> import jaxscp
            >>> drive = jaxscp.Trajectory.from_arrays([0.0, 2.0], [[0.0, 0.0], [2.0, 2.0]], [[1.0], [1.0]])
            >>> drive.with_dynamics(jaxscp.DoubleIntegrator(1)).at(1.0).state.round(9).tolist()  # linear: 1.0, 1.0
            [0.5, 1.0]
        """
        dynamics = self._known_dynamics()
        check_whole("steps", steps, 1)
        if namespace(times, self.time) is np:
            check_inside(times, np.asarray(self.time))
        times = jnp.asarray(times).astype(self.time.dtype)
        if times.ndim > 1:
            raise ValueError(f"times: one number or one axis is expected, got shape {times.shape}")
        first, last = self.interval_controls()
        return samples_at(dynamics, Pieces(self.time, self.dilation, self.state, first, last), times, steps)

    def sample(self, *, rate: float | int, end: bool = False, steps: int = STEPS) -> Samples:
        """``at`` equal steps in time: 0, 1 / rate, ... up to the final time, which need not be one of them.

        Args:
            rate: samples a second, in Hz.
            end: whether the final time is added where it is no multiple of 1 / rate: the last step is then shorter.
            steps: as in ``at``.

        Raises:
            TypeError: inside ``jit`` and ``vmap``, where the number of samples is not known.
            ValueError: if the rate is no positive number or far too high, for a batch, or without dynamics.

        Example:
            >>> import jaxscp
            >>> drive = jaxscp.Trajectory.from_arrays([0.0, 1.7], [[0.0, 0.0], [2.0, 2.0]], [[1.0], [1.0]])
            >>> drive = drive.with_dynamics(jaxscp.DoubleIntegrator(1))
            >>> drive.sample(rate=2.0).time.tolist(), drive.sample(rate=2.0, end=True).time.tolist()
            ([0.0, 0.5, 1.0, 1.5], [0.0, 0.5, 1.0, 1.5, 1.7])
        """
        self._known_dynamics()
        if namespace(self.time, rate) is jnp:
            raise TypeError(
                "trajectory.sample: the number of samples follows from the final time, which is not known inside jit "
                "and vmap. Call trajectory.at(times), with as many times as you choose."
            )
        if not is_number(rate) or not np.isfinite(rate) or rate <= 0.0:
            raise ValueError(f"rate: a positive number of samples a second is expected, got {rate!r}")
        return self.at(sample_times(float(np.asarray(self.time)[-1]), float(rate), end), steps=steps)

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

        Raises:
            ValueError: if ``nodes`` is no whole number of two or more.

        Example:
            >>> import jaxscp
            >>> line = jaxscp.Trajectory.from_arrays([0.0, 2.0], [[0.0], [4.0]], [[1.0], [1.0]])
            >>> line.resampled(5).state[:, 0].tolist()
            [0.0, 1.0, 2.0, 3.0, 4.0]
        """
        check_whole("nodes", nodes, 2)
        return self if nodes == self.nodes else self._at_scaled(jnp.linspace(0.0, 1.0, nodes), 1.0)

    def remainder(self, first: Scalar | float) -> Trajectory:
        """The part from a fraction of scaled time on, on as many nodes.

        Controls and dilation are exact at the new nodes; states are linear between the old ones. A control that is held
        switches at the next new node.

        Raises:
            ValueError: if ``first`` is not in [0, 1); inside ``jit``, the values are then NaN.

        Example:
            >>> import jaxscp
            >>> line = jaxscp.Trajectory.from_arrays([0.0, 2.0], [[0.0], [4.0]], [[1.0], [1.0]])
            >>> rest = line.remainder(0.5)
            >>> rest.state[:, 0].tolist(), float(rest.time[-1])
            ([2.0, 4.0], 1.0)
        """
        if namespace(first) is np and not (is_number(first) and 0.0 <= first < 1.0):
            raise ValueError(
                f"first: expected a fraction of scaled time, 0 or more and below 1, got {first!r}"
            )
        first = jnp.where((first >= 0.0) & (first < 1.0), first, jnp.nan)
        places = first + (1.0 - first) * jnp.linspace(0.0, 1.0, self.nodes)
        return self._at_scaled(places, 1.0 - first)

    def after(self, time: Scalar | float) -> Trajectory:
        """The part from a time in s on; near the end, the last ``LEAST_PART`` of scaled time. See ``remainder``."""
        return self.remainder(jnp.minimum(self.scaled_time(time), 1.0 - LEAST_PART))

    def _at_scaled(self, places: Nodes, width: Scalar | float) -> Trajectory:
        """Nodes at scaled times that span a width, with the values there; without dynamics."""
        own = jnp.linspace(0.0, 1.0, self.nodes)
        columns = jax.vmap(lambda v: jnp.interp(places, own, v), in_axes=1, out_axes=1)
        dilation, control = width * jnp.interp(places, own, self.dilation), columns(self.control)
        for i in self.zero_order_hold:
            control = control.at[:, i].set(held_at(places, self.control[:, i]))
        return Trajectory(node_times(dilation), columns(self.state), control, dilation, self.zero_order_hold)

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
        """Write an .npz with ``time``, ``state``, ``control`` and ``dilation``, in SI units.

        The file has the name that you give: no suffix is added.
        """
        arrays = {name: np.asarray(getattr(self, name)) for name in node_files.FIELDS}
        node_files.write(file, arrays, self.zero_order_hold)

    @staticmethod
    def load(file: str | os.PathLike) -> Trajectory:
        """Read what ``save`` wrote. A table of ``Samples.to_csv`` cannot be loaded: it lacks the mesh.

        Raises:
            ValueError: if the file is not such an archive or its shapes disagree; the message names the field.
        """
        arrays, hold = node_files.read(file)
        time, state, control, dilation = (jnp.asarray(arrays[name]) for name in node_files.FIELDS)
        return Trajectory(time, state, control, dilation, hold)


def _numbers(values: Any, name: str) -> np.ndarray:
    """An array of finite numbers."""
    try:
        found = np.asarray(values, float)
    except (TypeError, ValueError) as error:
        raise InvalidProblem(f"{name}: expected rows of numbers of one length: {error}") from error
    if not np.isfinite(found).all():
        raise InvalidProblem(f"{name}: holds a value that is NaN or infinite")
    return found

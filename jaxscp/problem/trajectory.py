"""A trajectory at N nodes: save, load, and values between the nodes."""

from __future__ import annotations

import os
import zipfile

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from jaxscp.core.types import Controls, Nodes, Scalar, States


class Trajectory(eqx.Module):
    """States and controls at the nodes, in SI units.

    Between nodes the controls and the dilation are linear in scaled time tau, k / (N - 1) at node k.
    """

    time: Nodes
    """Seconds from the start, (nodes,)."""
    state: States
    """(nodes, 13): position m, velocity m/s, attitude quaternion (w, x, y, z), body rate rad/s."""
    control: Controls
    """(nodes, rotors): thrusts in N."""
    dilation: Nodes
    """dt/dtau in seconds, (nodes,)."""

    def scaled_time(self, time: Scalar | float) -> Scalar:
        """Scaled time tau of a time in seconds (held at the ends); inverts t(tau) exactly."""
        time = jnp.clip(time, self.time[0], self.time[-1])
        last = self.time.shape[0] - 2
        i = jnp.clip(jnp.searchsorted(self.time, time, side="right") - 1, 0, last)
        # Within an interval t grows by width (s0 f + (s1 - s0) f^2 / 2) at the fraction f: take the stable root.
        s0, s1 = self.dilation[i], self.dilation[i + 1]
        elapsed = (time - self.time[i]) * (self.time.shape[0] - 1)
        root = jnp.sqrt(jnp.maximum(s0**2 + 2.0 * (s1 - s0) * elapsed, 0.0))
        return (i.astype(self.time.dtype) + 2.0 * elapsed / (s0 + root)) / (last + 1)

    def control_at(self, time: Scalar | float) -> Float[Array, "controls"]:
        """Controls at a time in seconds, exactly as planned (held at the ends)."""
        return self._linear(self.control, time)

    def state_at(self, time: Scalar | float) -> Float[Array, "states"]:
        """State at a time in seconds, linear between nodes: for display. Integrate the controls for more."""
        return self._linear(self.state, time)

    def _linear(self, values, time):
        position = self.scaled_time(time) * (self.time.shape[0] - 1)
        i = jnp.clip(jnp.floor(position).astype(int), 0, self.time.shape[0] - 2)
        fraction = position - i.astype(position.dtype)
        return (1.0 - fraction) * values[i] + fraction * values[i + 1]

    def save(self, file: str | os.PathLike) -> None:
        """Write an .npz with ``time``, ``state``, ``control`` and ``dilation``, in SI units."""
        arrays = {name: np.asarray(getattr(self, name)) for name in ("time", "state", "control", "dilation")}
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
        except (zipfile.BadZipFile, EOFError, TypeError, ValueError) as error:
            raise ValueError(f"{file}: not a trajectory archive (.npz): {error}") from error
        if missing:
            raise ValueError(f"{file}: missing field(s) {', '.join(missing)}")
        nodes = arrays["time"].shape[0]
        for name, array in arrays.items():
            if array.shape[0] != nodes:
                raise ValueError(f"{file}: field {name!r} has {array.shape[0]} nodes, but 'time' has {nodes}")
        return Trajectory(**{name: jnp.asarray(array) for name, array in arrays.items()})

"""Attitudes on the host: thousands of them in a record, one for each scan. Eager JAX would compile for each length."""

import numpy as np
from jaxtyping import Float
from scipy.spatial.transform import Rotation


def rotations(attitudes: Float[np.ndarray, "*batch 4"]) -> Rotation:
    """Rotations from body axes into the world's, of unit quaternions with the scalar first.

    Example:
        >>> rotations(np.array([1.0, 0.0, 0.0, 0.0])).as_matrix().tolist()
        [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]]
    """
    return Rotation.from_quat(np.roll(attitudes, -1, axis=-1))  # SciPy has the scalar last

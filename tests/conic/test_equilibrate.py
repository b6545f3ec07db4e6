"""Equilibration against its definition."""

import jax
import numpy as np
import pytest

from jaxscp.conic.equilibrate import equilibrate
from jaxscp.conic.random_programs import random_program


@pytest.mark.parametrize("seed", range(3))
def test_equilibration_changes_units_only(seed):
    """Cost of the equilibrated program at a scaled point = scaled cost of the given program at the point."""
    program = random_program(seed)
    scaled, scales = equilibrate(program)
    z = jax.random.normal(jax.random.key(seed), program.gradient.shape)
    np.testing.assert_allclose(
        scaled.objective(z / scales.columns), scales.cost * program.objective(z), rtol=1e-10
    )

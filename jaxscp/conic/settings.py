"""Settings of the interior point."""

import equinox as eqx


class Settings(eqx.Module):
    """Settings of the interior point; ``InteriorPoint`` says what each of them does."""

    tolerance: float = eqx.field(default=1e-8, static=True)
    proof_tolerance: float = eqx.field(default=1e-6, static=True)
    loose_tolerance: float = eqx.field(default=1e-5, static=True)
    max_iterations: int = eqx.field(default=50, static=True)
    regularisation: float = eqx.field(default=1e-11, static=True)
    refinements: int = eqx.field(default=1, static=True)
    refine_below: float = eqx.field(default=1e-4, static=True)
    equilibration: int = eqx.field(default=3, static=True)
    compiled: bool = eqx.field(default=True, static=True)

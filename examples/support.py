"""References of the examples, and the report of a script."""

from pathlib import Path
from typing import NamedTuple

from matplotlib.figure import Figure

import jaxscp as js

PICTURES = Path(__file__).parents[1] / "docs" / "pictures" / "gallery"
ANALYTIC = 1e-4  # relative: nodes are many enough for it
BEST_OF_IPOPT = 1e-3  # relative


class Reference(NamedTuple):
    """The cost that an example must reach."""

    value: float
    tolerance: float
    """Relative."""
    source: str

    def error(self, cost) -> float:
        """Relative error of a cost."""
        return abs(float(cost) / self.value - 1.0)


def exact(value: float, source: str) -> Reference:
    """A reference in closed form."""
    return Reference(float(value), ANALYTIC, source)


def ipopt(value: float) -> Reference:
    """The best of four starts of IPOPT on the same transcription, as the benchmark prints it."""
    return Reference(value, BEST_OF_IPOPT, "python -m benchmarks.gallery --ipopt")


def show(name: str, solution: js.Solution, reference: Reference, figure: Figure) -> None:
    """Print cost, reference and certificate, and write the picture."""
    print(f"{name}: {js.status_names(solution.status)} after {int(solution.iterations)} subproblems")
    print(f"cost {float(solution.cost):.6g}, reference {reference.value:.6g} ({reference.source})")
    print(f"relative error {reference.error(solution.cost):.1e}, allowed {reference.tolerance:.0e}")
    print(solution.certificate.report())
    PICTURES.mkdir(parents=True, exist_ok=True)
    figure.savefig(PICTURES / f"{name}.png", dpi=200)

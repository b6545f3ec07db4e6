"""The gallery: one optimal control problem a file, each with the value that it must reach.

``python -m examples.NAME`` solves one, compares it with its reference, and draws ``docs/pictures/gallery/NAME.png``.
Every file has these names:

- ``problem(number)``: the problem, as a function of one number that a study may vary;
- ``guess(problem)``: where the solver starts;
- ``REFERENCE``: the cost of the optimum, its tolerance, and its source;
- ``draw(solution)``: the picture.
"""

import importlib
from types import ModuleType

GALLERY = (
    "brachistochrone",
    "minimum_time",
    "minimum_energy",
    "dubins",
    "planar_quadrotor",
    "cart_pole",
    "gates",
    "rocket_landing",
    "rendezvous",
    "crossing",
)


def example(name: str) -> ModuleType:
    """The module of one example."""
    return importlib.import_module(f"{__name__}.{name}")


def default_number(module: ModuleType) -> float:
    """The number that ``problem`` takes by default."""
    return module.problem.__defaults__[0]

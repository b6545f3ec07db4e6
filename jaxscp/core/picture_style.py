"""How pictures look: the colours of Okabe and Ito, which colour-blind readers can tell apart."""

from typing import Any

ORANGE, SKY, GREEN, YELLOW, BLUE, VERMILLION, PURPLE, BLACK = (
    "#E69F00",
    "#56B4E9",
    "#009E73",
    "#F0E442",
    "#0072B2",
    "#D55E00",
    "#CC79A7",
    "#000000",
)
GREY = "#777777"
LIMIT = VERMILLION
"""Limits, zones to stay out of, and nothing else."""
START, GOAL, GATE = GREEN, ORANGE, PURPLE
BODY_AXES = ("#882255", "#117733", "#332288")
"""Body x, y and z: the dark tones of Paul Tol's muted scheme, which nothing else has."""
COLUMN = 3.5
"""Width of a paper's column, inches."""
DPI = 200
"""Resolution of figures, dots per inch."""
DASHED: dict[str, Any] = {"linestyle": (0, (5, 2)), "linewidth": 1.1}
LEGEND: dict[str, Any] = {"fontsize": 8, "frameon": False}

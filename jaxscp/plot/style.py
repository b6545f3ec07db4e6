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
ROTORS = (BLUE, ORANGE, GREEN, PURPLE, SKY, VERMILLION, YELLOW, BLACK)
GREY = "#777777"
DASHED: dict[str, Any] = {"linestyle": (0, (5, 2)), "linewidth": 1.1}
LEGEND: dict[str, Any] = {"fontsize": 8, "frameon": False}

"""Safe flight corridors: half-space polytopes, and how to make them."""

from jaxscp.corridor.polytopes import Corridor as Corridor
from jaxscp.corridor.polytopes import box as box
from jaxscp.corridor.polytopes import connect as connect

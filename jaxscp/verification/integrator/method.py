"""Integration method of the verifier; the solver uses another one."""

import numpy as np

from jaxscp.integration.tableaus import Method


def eighth_order() -> Method:
    """Dormand and Prince's method of eighth order, from diffrax's tableau."""
    from diffrax import Dopri8  # slow to import

    tableau = Dopri8.tableau
    table = np.zeros((tableau.num_stages, tableau.num_stages))
    for stage, row in enumerate(tableau.a_lower, start=1):
        table[stage, :stage] = row
    return Method(np.append(0.0, tableau.c), np.asarray(tableau.b_sol), table)

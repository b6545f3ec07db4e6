"""CLARABEL's optimum of a conic program, as a reference."""

import clarabel


def clarabel_optimum(P, q, A, b, sizes) -> tuple[str, float]:
    """Status and optimal value of min 1/2 x'Px + q'x, A x + s = b, s in K.

    ``sizes`` are (rows of the zero cone, rows of the nonnegative orthant, dimensions of the second-order cones).
    """
    zero, nonnegative, second_order = sizes
    cones = [clarabel.ZeroConeT(zero), clarabel.NonnegativeConeT(nonnegative)]
    cones += [clarabel.SecondOrderConeT(dimension) for dimension in second_order]
    settings = clarabel.DefaultSettings()
    settings.verbose = False
    solution = clarabel.DefaultSolver(P, q, A, b, cones, settings).solve()
    return str(solution.status), solution.obj_val

"""Solutions of a controller's program by independent solvers."""

import numpy as np
import scipy.sparse

TIGHT = 1e-9  # of the solvers, absolute and relative


def row_matrix(qp):
    """The controls and their changes as a matrix."""
    nodes, controls = qp.gradient.shape
    change = np.eye(nodes) - np.eye(nodes, k=-1)
    return np.concatenate([np.eye(nodes * controls), np.kron(change, np.eye(controls))])


def bounds(qp):
    """Lower and upper bounds of the rows of the matrix."""
    before = np.zeros((2, *qp.gradient.shape))
    before[1, 0] = qp.before
    return (np.asarray(qp.lower) + before).ravel(), (np.asarray(qp.upper) + before).ravel()


def solution_of_osqp(qp):
    import osqp

    lower, upper = bounds(qp)
    solver = osqp.OSQP()
    matrices = scipy.sparse.triu(np.asarray(qp.hessian)).tocsc(), scipy.sparse.csc_matrix(row_matrix(qp))
    settings = {"eps_abs": TIGHT, "eps_rel": TIGHT, "max_iter": 200_000, "verbose": False, "polishing": True}
    solver.setup(matrices[0], np.asarray(qp.gradient).ravel(), matrices[1], lower, upper, **settings)
    found = solver.solve(raise_error=True)
    assert found.info.status == "solved"
    return found.x.reshape(qp.gradient.shape)


def solution_of_clarabel(qp):
    import clarabel

    lower, upper = bounds(qp)
    rows = row_matrix(qp)
    matrix = scipy.sparse.csc_matrix(np.concatenate([rows, -rows]))
    settings = clarabel.DefaultSettings()
    settings.verbose = False
    settings.tol_gap_abs = settings.tol_gap_rel = settings.tol_feas = TIGHT
    cost = scipy.sparse.triu(np.asarray(qp.hessian)).tocsc(), np.asarray(qp.gradient).ravel()
    right = np.concatenate([upper, -lower])
    cones = [clarabel.NonnegativeConeT(right.size)]
    found = clarabel.DefaultSolver(*cost, matrix, right, cones, settings).solve()
    assert str(found.status) == "Solved"
    return np.array(found.x).reshape(qp.gradient.shape)

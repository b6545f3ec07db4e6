"""acados' real-time iteration on the tracking problem of ``benchmarks.control``: time of a tick.

The vehicle is the same, with 13 states and 4 thrusts; so are the ten intervals of a second, the weights and the bounds.
It starts 1 m away. Thrusts are constant over an interval, and have no rate limits; there is no
disturbance estimate and no delay. It needs NumPy and acados alone, which brings its own CasADi. So it runs in an
environment of its own, where ``pip install comma-deps-acados`` put both:

    PYTHON benchmarks/rivals/acados_rti.py [NODES]
"""

import ctypes
import json
import os
import sys
import tempfile
import time

import numpy as np

MASS, MOMENTS, ARM, KAPPA, GRAVITY = 0.928, (2.5e-3, 2.1e-3, 4.3e-3), 0.076, 0.016, 9.81
WEIGHTS = np.repeat([60.0, 6.0, 6.0, 0.3], 3)
FINAL, CONTROL_WEIGHT, LIMITS = 0.5, 0.02, (0.3, 5.0)
TICKS, TICK = 3000, 0.01


def rigid_body(ca):
    """State, control and derivative of the state, as CasADi's symbols."""
    x, u = ca.SX.sym("x", 13), ca.SX.sym("u", 4)
    q, w = x[6:10], x[10:13]
    angle = (np.arange(4) + 0.5) * np.pi / 2
    torque_map = np.stack([ARM * np.sin(angle), -ARM * np.cos(angle), KAPPA * np.array([1, -1, 1, -1])])
    axis = ca.vertcat(
        2 * (q[1] * q[3] + q[0] * q[2]), 2 * (q[2] * q[3] - q[0] * q[1]), 1 - 2 * (q[1] ** 2 + q[2] ** 2)
    )
    acceleration = axis * ca.sum1(u) / MASS - ca.vertcat(0, 0, GRAVITY)
    spin = 0.5 * ca.vertcat(-ca.dot(q[1:], w), q[0] * w + ca.cross(q[1:], w))
    inertia = ca.DM(MOMENTS)
    turn = (ca.mtimes(torque_map, u) - ca.cross(w, inertia * w)) / inertia
    return x, u, ca.vertcat(x[3:6], acceleration, spin, turn)


def solver(intervals, folder):
    """The compiled solver; the reference is a hover at the origin, so that the error is linear but for the attitude."""
    import acados
    import casadi as ca

    # the package names its folders, but does not set the variables that the interface reads
    os.environ.setdefault("ACADOS_SOURCE_DIR", acados.DIR)
    os.environ.setdefault("ACADOS_PYTHON_INTERFACE_PATH", acados.TEMPLATE_DIR)
    for name in ("blasfeo", "hpipm", "qpOASES_e", "acados"):
        ctypes.CDLL(os.path.join(acados.LIB_DIR, f"lib{name}.so"), mode=ctypes.RTLD_GLOBAL)
    from acados.acados_template import AcadosModel, AcadosOcp, AcadosOcpSolver

    x, u, rate = rigid_body(ca)
    model = AcadosModel()
    model.name, model.x, model.u, model.f_expl_expr = "vehicle", x, u, rate
    error = ca.vertcat(x[:6], 2 * x[7:10], x[10:13])
    ocp = AcadosOcp()
    ocp.model = model
    ocp.solver_options.N_horizon = ocp.dims.N = len(intervals)
    ocp.cost.cost_type, ocp.cost.cost_type_e = "NONLINEAR_LS", "NONLINEAR_LS"
    model.cost_y_expr, model.cost_y_expr_e = ca.vertcat(error, u), error
    ocp.cost.W = np.diag(np.append(WEIGHTS, np.full(4, CONTROL_WEIGHT)))
    ocp.cost.W_e = FINAL * np.diag(WEIGHTS)
    hover = np.full(4, MASS * GRAVITY / 4)
    ocp.cost.yref, ocp.cost.yref_e = np.append(np.zeros(12), hover), np.zeros(12)
    ocp.constraints.lbu, ocp.constraints.ubu = np.full(4, LIMITS[0]), np.full(4, LIMITS[1])
    ocp.constraints.idxbu = np.arange(4)
    ocp.constraints.x0 = start()
    options = ocp.solver_options
    options.time_steps, options.tf = np.asarray(intervals), float(np.sum(intervals))
    options.qp_solver, options.hessian_approx = "FULL_CONDENSING_HPIPM", "GAUSS_NEWTON"
    options.integrator_type, options.sim_method_num_steps = "ERK", 2
    options.nlp_solver_type = "SQP_RTI"
    ocp.code_export_directory = os.path.join(folder, "code")
    return AcadosOcpSolver(ocp, json_file=os.path.join(folder, "ocp.json"), verbose=False), hover


def start():
    """Level and at rest, 1 m away."""
    state = np.zeros(13)
    state[[0, 6]] = 1.0
    return state


def timings(nodes=10, ratio=1.2):
    """Milliseconds of each tick."""
    lengths = ratio ** np.arange(nodes)
    with tempfile.TemporaryDirectory() as folder:
        rti, hover = solver(lengths / np.sum(lengths), folder)
        for k in range(nodes):
            rti.set(k, "x", start())
            rti.set(k, "u", hover)
        state, found = start(), []
        for number in range(TICKS):
            if number % 150 == 0:
                state = start()
            began = time.perf_counter()
            rti.set(0, "lbx", state)
            rti.set(0, "ubx", state)
            rti.solve()
            rti.get(0, "u")
            found.append(1e3 * (time.perf_counter() - began))
            # the prediction at the end of a tick stands for the vehicle
            state = state + TICK / (lengths[0] / np.sum(lengths)) * (rti.get(1, "x") - state)
    return np.array(found[10:])


if __name__ == "__main__":
    if hasattr(os, "sched_setaffinity"):
        os.sched_setaffinity(0, {min(os.sched_getaffinity(0))})
    times = timings(*map(int, sys.argv[1:2]))
    print(json.dumps({"median_ms": float(np.median(times)), "p99_ms": float(np.quantile(times, 0.99))}))

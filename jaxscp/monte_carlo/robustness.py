"""How one plan fares open loop, when the vehicle and the start are not as planned."""

import os
import tempfile
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any, NamedTuple

import equinox as eqx
import jax.numpy as jnp
import numpy as np

from jaxscp.core.picture_style import BLUE, DPI, GREY, LEGEND, VERMILLION
from jaxscp.monte_carlo.driver import sweep
from jaxscp.monte_carlo.engines import InProcess
from jaxscp.monte_carlo.evaluators import Together
from jaxscp.monte_carlo.intervals import wilson
from jaxscp.monte_carlo.outcome import SUCCESS, Outcome, certificate_scalars
from jaxscp.monte_carlo.parameters import Parameter
from jaxscp.monte_carlo.results import Sweep
from jaxscp.monte_carlo.sampling import Independent
from jaxscp.monte_carlo.study import Study
from jaxscp.monte_carlo.trajectories import AllTrajectories
from jaxscp.problem.form import Continuous
from jaxscp.problem.trajectory import Trajectory
from jaxscp.solver.solution import Solution
from jaxscp.verification.certificate import certify
from jaxscp.verification.rollout import rollout

if TYPE_CHECKING:
    from matplotlib.figure import Figure

ALLOWED = {"error_final_position": 0.2, "violation": 0.1}  # m
POINTS = 300  # of the plan in the picture
SAMPLES = 8
SIZE = 50


class OpenLoop(eqx.Module):
    """Planned controls, integrated with the dynamics and from the start of a case.

    Args:
        plan: gives controls over time.
        context: of the solution; for a landing, the place of every interval (``landing.places``).
        allowed: names of results, and their greatest values that count as a success.
    """

    plan: Trajectory
    context: Any
    allowed: tuple[tuple[str, float], ...] = eqx.field(static=True)

    def __call__(self, scenario: Any) -> Outcome:
        """Errors, violations and path; ``success`` if all values are within ``allowed``."""
        problem, _ = scenario.problem(self.plan.nodes, Continuous(), self.context)
        start = scenario.start.vector() if hasattr(scenario, "start") else self.plan.state[0]
        path = eqx.tree_at(lambda t: t.state, self.plan, self.plan.state.at[0].set(start))
        found = certificate_scalars(certify(problem, path, SAMPLES))
        flight = rollout(problem, path, SAMPLES)
        success = jnp.all(jnp.stack([found[name] <= limit for name, limit in self.allowed]))
        state = flight.state.reshape(-1, flight.state.shape[-1])
        return Outcome({SUCCESS: success, **found}, {"time": flight.time.reshape(-1), "state": state})


class Robustness(NamedTuple):
    """A plan and its sweep; ``draw`` is the picture."""

    plan: Trajectory
    sweep: Sweep

    def draw(self) -> "Figure":
        """Paths from above and from the side; failures in red, the plan in blue. The legend has the success share."""
        return draw_robustness(self)


def robustness(
    solution: Solution,
    scenario: Any,
    parameters: Sequence[Parameter],
    count: int = 200,
    seed: int = 0,
    allowed: Mapping[str, float] | None = None,
    folder: str | os.PathLike | None = None,
) -> Robustness:
    """Integrate a plan's controls with scattered dynamics and starts; no controller corrects them.

    A scaled ``airframe.body.thrust_map`` is thrust that differs from the command. A force of a steady wind, for each
    kilogram, adds to ``airframe.body.gravity``.

    Args:
        solution: the plan.
        scenario: that was planned.
        parameters: that scatter, leaves of the scenario.
        count: of cases.
        seed: of the cases.
        allowed: greatest values of results that count as a success: 0.2 m of ``error_final_position`` and 0.1 of
            ``violation`` by default.
        folder: of the sweep; a temporary one by default.

    Raises:
        InvalidStudy: if a parameter is no float of the scenario.
    """
    limits = ALLOWED if allowed is None else dict(allowed)
    plan = solution.trajectory
    parameters = [parameter.resolved(scenario) for parameter in parameters]
    study = Study(
        OpenLoop(plan.with_dynamics(None), solution.context, tuple(limits.items())),
        scenario,
        parameters,
        Independent(count, seed),
    )
    address = tempfile.mkdtemp() if folder is None else folder
    engine = InProcess(Together(min(SIZE, count)))
    return Robustness(plan, sweep(study, address, engine=engine, keep=AllTrajectories(), chunk=10 * SIZE))


def draw_robustness(found: Robustness) -> "Figure":
    """See ``Robustness.draw``."""
    from matplotlib.figure import Figure

    success = found.sweep.values(SUCCESS).astype(bool)
    states = np.asarray(found.sweep.store.arrays["trajectory.state"][:])[found.sweep.numbers]
    path = _path(found.plan)
    figure = Figure(figsize=(5.0, 5.5), dpi=DPI, layout="constrained")
    for ax, up, name in zip(figure.subplots(2, 1, sharex=True), (1, 2), "yz", strict=True):
        for flag, colour, label in ((False, VERMILLION, "not"), (True, GREY, "within limits")):
            chosen = states[success == flag]
            for i, state in enumerate(chosen):
                text = f"{len(chosen)} {label}" if i == 0 else None
                ax.plot(state[:, 0], state[:, up], color=colour, linewidth=0.5, alpha=0.4, label=text)
        ax.plot(path[:, 0], path[:, up], color=BLUE, label="plan")
        ax.plot(found.plan.state[:, 0], found.plan.state[:, up], ".", color=BLUE, markersize=3)
        ax.set_ylabel(f"{name} [m]")
        ax.spines[["top", "right"]].set_visible(False)
    ax.set_xlabel("x [m]")
    handles, labels = ax.get_legend_handles_labels()
    share = wilson(int(np.sum(success)), len(success))
    percent = [f"{100 * value:.0f}" for value in share]
    title = f"open loop: {percent[0]} % within limits ({percent[1]} to {percent[2]} %)"
    figure.legend(handles, labels, title=title, loc="outside upper center", ncols=3, **LEGEND)
    return figure


def _path(plan: Trajectory) -> np.ndarray:
    """States along the plan's integrated path; its nodes where its dynamics are not known, as after loading."""
    if plan.dynamics is None:
        return np.asarray(plan.state)
    return np.asarray(plan.at(np.linspace(0.0, float(plan.time[-1]), POINTS)).state)

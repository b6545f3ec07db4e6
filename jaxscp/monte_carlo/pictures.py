"""Pictures of a sweep; each function returns a matplotlib figure."""

from typing import TYPE_CHECKING, Any

import numpy as np

from jaxscp.core.picture_style import BLUE, DPI, GREY, LEGEND, SKY, VERMILLION
from jaxscp.monte_carlo.errors import InvalidStudy
from jaxscp.monte_carlo.intervals import wilson_limits
from jaxscp.monte_carlo.outcome import SUCCESS
from jaxscp.monte_carlo.sensitivity import rank_correlations

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from jaxscp.monte_carlo.results import Sweep

BINS = 12
MANY = 200  # failures that are drawn in full size
SHOWN = 60  # trajectories of a picture: more hide each other


def draw_success_map(sweep: "Sweep", across: str, up: str, bins: int = BINS) -> "Figure":
    """Share of successes over two parameters, in cells of equal width; failures as crosses.

    Args:
        sweep: its results.
        across: parameter of the horizontal axis.
        up: parameter of the vertical axis.
        bins: cells an axis.
    """
    x, y, success = sweep.values(across), sweep.values(up), _success(sweep)
    edges = [np.histogram_bin_edges(v, bins) for v in (x, y)]
    counts, _, _ = np.histogram2d(x, y, bins=edges)
    good, _, _ = np.histogram2d(x, y, bins=edges, weights=success.astype(float))
    share = np.full_like(counts, np.nan)
    np.divide(good, counts, out=share, where=counts > 0)
    figure, ax = _figure()
    mesh = ax.pcolormesh(*edges, 100.0 * share.T, vmin=0.0, vmax=100.0, cmap="viridis")
    failed = ~success
    size = 4.0 if np.sum(failed) <= MANY else 1.5
    ax.plot(x[failed], y[failed], "x", color=VERMILLION, markersize=size, label=f"{np.sum(failed)} failures")
    figure.colorbar(mesh, ax=ax, label="success [%]")
    _label(ax, _named(sweep, across), _named(sweep, up))
    if np.any(failed):
        figure.legend(loc="outside upper center", **LEGEND)
    return figure


def draw_distributions(sweep: "Sweep", results: list[str]) -> "Figure":
    """Empirical distribution functions of results, with the simultaneous 95 % band of Dvoretzky, Kiefer and Wolfowitz.

    The band holds for independent cases, and is drawn for these only. Failures are left out.

    Args:
        sweep: its results.
        results: their names; a panel each.
    """
    figure, axes = _figure(len(results))
    success = _success(sweep) if SUCCESS in sweep.results else np.ones(sweep.complete, bool)
    for ax, name in zip(np.atleast_1d(axes), results, strict=True):
        values = np.sort(sweep.values(name)[success].astype(float))
        values = values[np.isfinite(values)]
        if len(values) == 0:
            continue
        level = np.arange(1, len(values) + 1) / len(values)
        if sweep.independent:
            half = np.sqrt(np.log(2.0 / 0.05) / (2.0 * len(values)))
            band = np.clip(level - half, 0.0, 1.0), np.clip(level + half, 0.0, 1.0)
            ax.fill_between(
                values, *band, step="post", color=SKY, alpha=0.4, linewidth=0.0, label="95 % band"
            )
        ax.step(values, level, where="post", color=BLUE)
        _label(ax, _named(sweep, name), "share of successful cases")
        ax.set_ylim(0.0, 1.0)
    return figure


def draw_convergence(sweep: "Sweep") -> "Figure":
    """The estimated share of successes after 1, 2, 3 ... cases, with Wilson's interval of each moment."""
    success = _success(sweep)
    count = np.arange(1, len(success) + 1)
    places = np.unique(np.geomspace(1, len(count), 400).astype(int)) - 1
    total, count = np.cumsum(success)[places], count[places]
    figure, ax = _figure()
    if sweep.independent:
        lower, upper = wilson_limits(total.astype(float), count, 0.95)
        ax.fill_between(count, 100 * lower, 100 * upper, color=SKY, alpha=0.4, linewidth=0.0)
        ax.plot([], [], color=SKY, linewidth=6, alpha=0.4, label="95 % interval (Wilson)")
    ax.plot(count, 100 * total / count, color=BLUE, label="share of successes")
    ax.set_xscale("log")
    _label(ax, "cases", "success [%]")
    ax.legend(**LEGEND)
    return figure


def draw_tornado(sweep: "Sweep", result: str) -> "Figure":
    """Rank correlation of each parameter with a result, the strongest on top, with 95 % intervals."""
    effects = [effect for effect in rank_correlations(sweep, result) if np.isfinite(effect.value)][::-1]
    if not effects:
        raise InvalidStudy(f"draw_tornado: {result} does not vary, or has too few finite values.")
    figure, ax = _figure(height=1.2 + 0.35 * len(effects))
    value = np.array([effect.value for effect in effects])
    spread = np.array([[e.value - e.lower for e in effects], [e.upper - e.value for e in effects]])
    colours = [BLUE if v >= 0 else VERMILLION for v in value]
    ax.barh(
        range(len(effects)), value, color=colours, xerr=spread, error_kw={"ecolor": "black", "capsize": 2}
    )
    ax.set_yticks(range(len(effects)), [effect.parameter for effect in effects])
    ax.axvline(0.0, color=GREY, linewidth=0.8)
    ax.set_xlim(-1.0, 1.0)
    ax.set_xticks([-1.0, -0.5, 0.0, 0.5, 1.0])
    _label(ax, f"rank correlation with {result}", "")
    return figure


def draw_failures(
    sweep: "Sweep", across: int = 0, up: int = 1, labels: tuple[str, str] | None = None
) -> "Figure":
    """Stored trajectories, failures in red, at most 60 of each kind: one state over another.

    Args:
        sweep: with stored trajectories that have states, (nodes, states).
        across: number of the state of the horizontal axis; of a landing, 0 to 2 are x, y and z.
        up: number of the state of the vertical axis.
        labels: of both axes.

    Raises:
        InvalidStudy: if no trajectory with states is stored.
    """
    stored = sweep.with_trajectories()
    if len(stored) == 0 or "trajectory.state" not in sweep.layout.quantities:
        raise InvalidStudy(
            "draw_failures: no trajectory with states is stored; sweep(..., keep=FailedTrajectories())."
        )
    success = dict(zip(sweep.numbers.tolist(), _success(sweep).tolist(), strict=True))
    paths = {n: np.asarray(sweep.store.arrays["trajectory.state"][n]) for n in stored.tolist()}
    drawn = [n for n, path in paths.items() if np.all(np.isfinite(path))]  # an invalid case has none
    bad, good = ([n for n in drawn if success[n] is flag] for flag in (False, True))
    figure, ax = _figure()
    for numbers, colour, name in ((good, GREY, "successes"), (bad, VERMILLION, "failures")):
        count = f"{len(numbers)}" if len(numbers) <= SHOWN else f"{SHOWN} of {len(numbers)}"
        for i, number in enumerate(numbers[:SHOWN]):
            label = f"{count} {name}" if i == 0 else None
            ax.plot(
                paths[number][:, across],
                paths[number][:, up],
                color=colour,
                linewidth=0.8,
                alpha=0.6,
                label=label,
            )
    ax.set_aspect("equal", adjustable="datalim")
    _label(ax, *(labels or (f"state {across}", f"state {up}")))
    if drawn:
        ax.legend(**LEGEND)
    return figure


def _figure(columns: int = 1, height: float = 3.2) -> Any:
    from matplotlib.figure import Figure

    figure = Figure(figsize=(4.2 * columns, height), dpi=DPI, layout="constrained")
    return figure, figure.subplots(1, columns)


def _label(ax: Any, across: str, up: str) -> None:
    ax.set_xlabel(across)
    ax.set_ylabel(up)
    ax.spines[["top", "right"]].set_visible(False)


def _named(sweep: "Sweep", name: str) -> str:
    quantity = sweep.layout.quantities.get(name)
    unit = quantity.unit if quantity is not None else sweep.layout.parameters.get(name, "")
    return f"{name} [{unit}]" if unit else name


def _success(sweep: "Sweep") -> np.ndarray:
    if SUCCESS not in sweep.results:
        raise InvalidStudy("the cases have no result called 'success'.")
    return sweep.values(SUCCESS).astype(bool)

"""Whether two commits plan the same: every plan, batch, export and gradient, leaf by leaf."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

from benchmarks.commits.builds import LEVELS, NO_LIBRARY, Side, in_parallel
from benchmarks.commits.differences import Difference, compare

Echo = Callable[[str], None]


def run(old: Side, new: Side, tolerance: float, quick: bool, echo: Echo) -> dict[str, Any]:
    """Compare all, and print a line for each; if it is to be quick, the plans of the best level alone."""
    levels = [level for level in new.levels() if level in old.levels()][: 1 if quick else None]
    complaints = _libraries(old, new)
    for line in complaints:
        echo(line)
    found: list[Difference] = []

    def add(items: list[Difference]) -> None:
        for item in items:
            echo(f"{item.item:48} {item.report()}")
        found.extend(items)

    for level in levels:
        add(_plans(level, *(side if level == levels[0] else side.at_level(level) for side in (old, new))))
    seconds = []
    if not quick:
        add([_one("export, called in a fresh process", "call_export", old, new)[0]])
        add([_one("gradient of final time and cost", "gradient", old, new)[0]])
        difference, answers = _one("batch of eight", "batch", old, new)
        add([difference])
        seconds = [answer["seconds"] for answer in answers]
        echo(f"first call of the batch, once, side by side: {seconds[0]:.1f} s and {seconds[1]:.1f} s")
    return {
        "levels": levels,
        "libraries": complaints,
        "items": [item.as_json() for item in found],
        "batch_first_call_s": seconds,
        "equal": not complaints and all(item.passes(tolerance) for item in found),
    }


def _libraries(old: Side, new: Side) -> list[str]:
    """Levels of which one commit has other libraries than the other."""
    counts = {level: [len(side.libraries(level)) for side in (old, new)] for level in LEVELS}
    return [
        f"libraries of level {level}: {before} of the old commit, {after} of the new one"
        for level, (before, after) in counts.items()
        if before != after
    ]


def _plans(level: str, old: Side, new: Side) -> list[Difference]:
    """Both cases in both modes, at one level."""

    def plans(side: Side) -> tuple[Path, dict[str, str]]:
        folder = side.scratch / f"plans_{level}"
        folder.mkdir()
        return folder, side.run("plans", folder=str(folder))

    (before, old_statuses), (after, statuses) = in_parallel(plans, old, new)
    where = "JAX alone" if level == NO_LIBRARY else level
    return [
        compare(
            f"{name}, {where}",
            before / f"{name}.npz",
            after / f"{name}.npz",
            _note(old_statuses[name], status),
        )
        for name, status in statuses.items()
    ]


def _one(item: str, task: str, old: Side, new: Side) -> tuple[Difference, list[dict[str, Any]]]:
    """A task that saves one file; and what it answered on both sides."""

    def run(side: Side) -> tuple[Path, dict[str, Any]]:
        file = side.scratch / f"{task}.npz"
        more = {"export": side.export()} if task == "call_export" else {}
        return file, side.run(task, file=str(file), **more)

    (before, first), (after, second) = in_parallel(run, old, new)
    return compare(item, before, after, _note(first["status"], second["status"])), [first, second]


def _note(before: str, after: str) -> str:
    """Statuses, unless both are the good one."""
    return "" if before == after == "converged" else f"statuses: {before}; {after}"

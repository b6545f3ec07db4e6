"""Comparison of a run's ratios with stored ratios. Times are not compared: they differ between machines."""

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

BASELINE = Path(__file__).parents[1] / "baseline.json"
HIGHER_IS_BETTER = {
    "paper_ratio": True,
    "optimum_ratio": True,
    "ipopt_ratio": True,
    "scaling_240_over_30": False,
}
TOLERANCE = 1.5  # factor: other programs may use the machine during a measurement


def regressions(found: dict[str, Any], echo: Callable[[str], None]) -> list[str]:
    """Names of the ratios that are worse by more than the tolerance; skips ratios without a measurement."""
    kept = json.loads(BASELINE.read_text())["ratios"]
    worse = []
    for name, higher in HIGHER_IS_BETTER.items():
        if name not in found or name not in kept:
            echo(f"{name:22} not compared")
            continue
        now, before = found[name] or 0.0, kept[name]
        bad = now < before / TOLERANCE if higher else now > before * TOLERANCE
        echo(f"{name:22}{now:9.2f}, kept {before:.2f}: {'worse' if bad else 'fine'}")
        worse += [name] if bad else []
    return worse

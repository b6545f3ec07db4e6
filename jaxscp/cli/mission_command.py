"""``jaxscp mission``: fly a whole mission in simulation, and tell how it ended."""

import dataclasses
import json
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import numpy as np
import typer
from rich.console import Console

from jaxscp.cli.endings import check_platform, refusals, told_of_files
from jaxscp.cli.map_options import finite, known, one_of
from jaxscp.cli.requests import CACHE, JSON, writable
from jaxscp.core.extras import of_extra
from jaxscp.mission import FIELDS, MOST_DECK_SPEED, MOST_SEED, MOST_WIND

if TYPE_CHECKING:
    from jaxscp.mission import Mission

_FIELD = typer.Argument(callback=known(FIELDS, "field"), metavar="FIELD", help=one_of(FIELDS))
_SEED = typer.Option(
    min=0,
    max=MOST_SEED,
    help="Seed of obstacles, vehicle, air and noise; the same seed flies the same mission.",
)
_WIND = typer.Option(
    min=0.0, max=MOST_WIND, callback=finite, metavar="SPEED", help="Mean wind, m/s; drawn by default."
)
_DECK = typer.Option(
    min=0.0,
    max=MOST_DECK_SPEED,
    callback=finite,
    metavar="SPEED",
    help="Of the deck in the landing, m/s; drawn by default.",
)
_VIDEO = typer.Option(callback=writable, metavar="FILE", help="Write an animation (.gif).")
_SAVE = typer.Option(callback=writable, metavar="FILE", help="Write true and estimated histories (.npz).")
_PLOT = typer.Option(callback=writable, metavar="FILE", help="Write a picture (.png, .pdf).")


@dataclasses.dataclass(kw_only=True)
class MissionRequest:
    """Arguments and options of ``jaxscp mission``."""

    field: Annotated[str, _FIELD]
    seed: Annotated[int, _SEED] = 0
    wind: Annotated[float | None, _WIND] = None
    deck_speed: Annotated[float | None, _DECK] = None
    video: Annotated[Path | None, _VIDEO] = None
    plot: Annotated[Path | None, _PLOT] = None
    save: Annotated[Path | None, _SAVE] = None
    cache: Annotated[Path | None, CACHE] = None
    as_json: Annotated[bool, JSON] = False

    def run(self) -> bool:
        """Fly, print and write; returns whether the vehicle was at the goal and landed."""
        if self.video is not None and self.video.suffix.lower() != ".gif":
            raise typer.BadParameter(f"{self.video} is no animation; end its name in .gif")
        check_platform()
        notes = Console(stderr=True, style="dim")
        if not self.as_json:
            notes.print(
                f"flying {self.field}, seed {self.seed}: compiling first, which takes a minute or two ..."
            )
        with refusals():
            of_extra("mujoco.mjx", "simulation,clouds", "missions need the packages mujoco and mujoco-mjx")
            from jaxscp.mission import Choices, run_mission

            mission = run_mission(self.field, self.seed, Choices(self.wind, self.deck_speed))
        if self.as_json:
            typer.echo(json.dumps(facts(mission, self), allow_nan=False))
        else:
            Console().print(text(facts(mission, self)), markup=False, highlight=False, soft_wrap=True)
        self._write(mission)
        told_of_files(notes, self.save, self.plot, self.video)
        return mission.accomplished

    def _write(self, mission: "Mission") -> None:
        from jaxscp.mission import pictures

        if self.save is not None:
            mission.save(self.save)
        if self.plot is not None:
            pictures.page(mission).savefig(self.plot, dpi=110)
        if self.video is not None:
            pictures.animation(mission, self.video)


def facts(mission: "Mission", request: MissionRequest) -> dict[str, Any]:
    """Contents of the JSON object."""
    outcome = {k: _finite(v) for k, v in dataclasses.asdict(mission.outcome).items()}
    wind = float(np.linalg.norm(np.asarray(mission.case.world.gusts.wind)))
    deck_speed = float(np.linalg.norm(np.asarray(mission.case.world.course.velocity)))
    return {
        "field": request.field,
        "seed": request.seed,
        "status": _status(mission),
        "wind": wind,
        "deck_speed": deck_speed,
        **outcome,
        "aborts": mission.commander.aborts,
        "plans": [planned.message for _, planned in mission.commander.plans],
    }


def _status(mission: "Mission") -> str:
    if mission.accomplished:
        return "landed"
    return "landed_without_goal" if mission.outcome.landed else "not_landed"


def _finite(value: Any) -> Any:
    if isinstance(value, tuple):
        return [_finite(v) for v in value]
    return None if isinstance(value, float) and not np.isfinite(value) else value


def text(found: dict[str, Any]) -> str:
    """The same for a reader."""
    end = "" if found["end"] == found["status"] else f" (last phase: {found['end'].replace('_', ' ')})"
    lines = [f"{found['field']}, seed {found['seed']}: {found['status'].replace('_', ' ')}{end}"]
    lines.append(
        f"wind {found['wind']:.1f} m/s, deck {found['deck_speed']:.2f} m/s, {found['duration']:.0f} s in all"
    )
    if found["touchdown"] is not None:
        lines.append(
            f"touch-down {1e2 * found['touchdown']:.1f} cm from the point, {found['vertical_speed']:.2f} m/s, "
            f"{found['tilt']:.1f} degrees, approach {found['attempts']}"
        )
    lines.append(
        f"nearest obstacle {found['least_distance']:.2f} m from the centre, collision: {found['collision']}"
    )
    lines += [f"abort: {reason}" for reason in found["aborts"]]
    return "\n".join(lines)

"""``jaxscp sweep``: run a study from a file, show its progress, and print what came of it."""

import dataclasses
import json
import sys
from pathlib import Path
from typing import Annotated

import typer
from rich.console import Console

import jaxscp.monte_carlo as mc
from jaxscp.cli.endings import check_platform, refusals
from jaxscp.cli.requests import CACHE, JSON, writable
from jaxscp.cli.sweep_config import SweepConfig, read_config

_FOLDER = typer.Option(help="Where results are stored, instead of the file's own folder; any fsspec address.")
_WORKERS = typer.Option(min=1, help="Processes of this machine, instead of the file's own number.")
_REPORT = typer.Option(callback=writable, metavar="FILE", help="Write a report with pictures (.html).")
_PARQUET = typer.Option(callback=writable, metavar="FILE", help="Write a table, a row a case (.parquet).")


@dataclasses.dataclass(kw_only=True)
class SweepRequest:
    """Arguments and options of ``jaxscp sweep``."""

    config: Annotated[Path, typer.Argument(metavar="CONFIG.toml", help="What is run, and what varies.")]
    folder: Annotated[str | None, _FOLDER] = None
    workers: Annotated[int | None, _WORKERS] = None
    report: Annotated[Path | None, _REPORT] = None
    parquet: Annotated[Path | None, _PARQUET] = None
    cache: Annotated[Path | None, CACHE] = None
    as_json: Annotated[bool, JSON] = False

    def run(self) -> None:
        """Run the sweep; the exit code is 0, 2 for a wrong request, or 130 after Ctrl-C."""
        check_platform()
        with refusals():
            asked = read_config(self.config)
        with refusals():
            try:
                found = self._sweep(asked)
            except mc.InvalidStudy as error:
                raise typer.BadParameter(f"{self.config}: {error}") from error
            except mc.SweepError as error:
                raise typer.BadParameter(str(error)) from error
            except KeyboardInterrupt as error:
                raise typer.Exit(130) from error
        self._print(found)

    def _sweep(self, asked: SweepConfig) -> mc.Sweep:
        workers = self.workers or asked.workers
        return mc.sweep(
            asked.study,
            self.folder or asked.folder,
            engine=mc.InProcess(mc.OneByOne(1)) if workers == 1 else mc.Processes(workers),
            keep=asked.keep,
            stop=asked.stop,
            progress=mc.JSONLines(stream=sys.stdout) if self.as_json else mc.Bar(),
            chunk=asked.chunk,
        )

    def _print(self, found: mc.Sweep) -> None:
        summary = mc.summarise(found)
        if self.as_json:
            event = {"event": "summary", "folder": found.store.address, **summary.plain()}
            typer.echo(json.dumps(event, allow_nan=False))
        else:
            Console().print(str(summary), markup=False, highlight=False, soft_wrap=True)
        with refusals():
            if self.parquet is not None:
                found.to_parquet(self.parquet)
            if self.report is not None:
                mc.write_report(found, self.report)

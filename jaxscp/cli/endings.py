"""How a command ends: with the names of the files that it wrote, or with a refusal.

A wrong request gives a message, exit code 2, and one JSON object if that was asked for.
"""

import json
import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import jax
import typer
from rich.console import Console
from typer.core import TyperGroup

_JSON_ASKED = "jaxscp.json"


class Commands(TyperGroup):
    """A group of commands that answers a wrong request in JSON, too."""

    def parse_args(self, ctx: Any, args: list[str]) -> list[str]:
        """See Click; also notes whether JSON was asked for."""
        ctx.meta[_JSON_ASKED] = "--json" in args
        return super().parse_args(ctx, args)

    def invoke(self, ctx: Any) -> Any:
        """See Click; Click itself prints the message and ends with exit code 2."""
        try:
            return super().invoke(ctx)
        except Exception as error:
            # the errors of Click have this method; older versions of Typer have Click beside them, newer ones within
            message = getattr(error, "format_message", None)
            if message is not None and ctx.meta[_JSON_ASKED]:
                text = message().removeprefix("Invalid value: ")
                typer.echo(json.dumps({"status": "invalid_request", "message": text}))
            raise


@contextmanager
def refusals() -> Iterator[None]:
    """Errors of the files and options that a user gave become messages and exit code 2."""
    try:
        yield
    except (ValueError, OSError, ImportError, MemoryError) as error:
        raise typer.BadParameter(str(error) or type(error).__name__) from error


@contextmanager
def told_warnings(console: Console) -> Iterator[list[str]]:
    """Warnings become lines of a console, and a list of texts, instead of lines of code."""
    told: list[str] = []
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always", UserWarning)
        try:
            yield told
        finally:
            told += [str(warning.message) for warning in caught]
            for text in told:
                console.print(f"warning: {text}", style="yellow", markup=False, soft_wrap=True)


def check_platform() -> None:
    """Refuse a platform that JAX cannot use before anything is compiled.

    Raises:
        typer.BadParameter: JAX finds no such device.
    """
    try:
        jax.devices()
    except (RuntimeError, AssertionError) as error:
        asked = jax.config.jax_platforms  # pyright: ignore[reportAttributeAccessIssue]
        why = str(error) or "no such device, or its plugin is not installed"
        raise typer.BadParameter(f"JAX cannot run on JAX_PLATFORMS={asked}: {why}") from error


def told_of_files(notes: Console, *files: Path | None) -> None:
    """Say which files were written; None stands for one that was not asked for."""
    written = [str(file) for file in files if file is not None]
    if written:
        notes.print(f"wrote {', '.join(written)}", markup=False, highlight=False, soft_wrap=True)

"""A report of a sweep: one HTML file with the summary, the pictures and the worst cases."""

import base64
import html
import io
import os
from collections.abc import Iterator
from typing import TYPE_CHECKING, Any

import numpy as np

from jaxscp.monte_carlo import pictures
from jaxscp.monte_carlo.errors import InvalidStudy
from jaxscp.monte_carlo.outcome import STATUS, SUCCESS
from jaxscp.monte_carlo.sensitivity import rank_correlations
from jaxscp.monte_carlo.summary import summarise

if TYPE_CHECKING:
    from jaxscp.monte_carlo.results import Sweep

_STYLE = """
body { font-family: system-ui, sans-serif; max-width: 60rem; margin: 2rem auto; padding: 0 1rem; color: #222; }
img { width: 100%; max-width: 40rem; } table { border-collapse: collapse; font-size: 0.85rem; display: block;
overflow-x: auto; } td, th { padding: 0.2rem 0.6rem; text-align: right; border-bottom: 1px solid #ddd; }
pre { background: #f5f5f5; padding: 0.8rem; white-space: pre-wrap; } h2 { margin-top: 2rem; }
"""


def write_report(sweep: "Sweep", file: str | os.PathLike, title: str = "Sweep") -> None:
    """Write a report; it needs no other file.

    Args:
        sweep: its results.
        file: to write; ``report.html``, say.
        title: of the page.

    Raises:
        OSError: if the file cannot be written.
    """
    summary = summarise(sweep)
    parts = [f"<h1>{html.escape(title)}</h1>", f"<pre>{html.escape(str(summary))}</pre>"]
    parts += [f"<h2>{html.escape(name)}</h2>{_image(figure)}" for name, figure in _figures(sweep)]
    parts.append(f"<h2>Worst cases</h2>{_table(sweep, summary.worst)}")
    parts.append(f"<p>Results: <code>{html.escape(sweep.store.address)}</code></p>")
    head = f'<meta charset="utf-8"><title>{html.escape(title)}</title><style>{_STYLE}</style>'
    with open(file, "w", encoding="utf-8") as stream:
        stream.write(
            f"<!doctype html><html lang=en><head>{head}</head><body>{''.join(parts)}</body></html>\n"
        )


def _figures(sweep: "Sweep") -> Iterator[tuple[str, Any]]:
    """Titles and figures that this sweep has data for."""
    results = [name for name in ("cost", "final_time") if name in sweep.results]
    others = [n for n in sweep.results if n not in (SUCCESS, STATUS) and sweep.values(n).dtype.kind == "f"]
    if SUCCESS in sweep.results:
        yield "Share of successes", pictures.draw_convergence(sweep)
        if len(sweep.parameters) >= 2:
            effects = [e.parameter for e in rank_correlations(sweep, SUCCESS)]
            yield "Where cases succeed", pictures.draw_success_map(sweep, effects[0], effects[1])
    if chosen := (results or others[:2]):
        yield "Distributions", pictures.draw_distributions(sweep, chosen)
    for result in [*([SUCCESS] if SUCCESS in sweep.results else []), *chosen]:
        try:
            yield f"What {result} depends on", pictures.draw_tornado(sweep, result)
        except InvalidStudy:
            continue  # it does not vary
    if len(sweep.with_trajectories()) and "trajectory.state" in sweep.layout.quantities:
        yield "Trajectories", pictures.draw_failures(sweep)


def _image(figure: Any) -> str:
    stream = io.BytesIO()
    figure.savefig(stream, format="png", dpi=150)
    return f'<img alt="" src="data:image/png;base64,{base64.b64encode(stream.getvalue()).decode()}">'


def _table(sweep: "Sweep", numbers: list[int]) -> str:
    table = sweep.dataset().sel(case=numbers)
    names = [
        *sweep.parameters,
        *(n for n in sweep.results if n in (SUCCESS, STATUS, "violation", "clearance", "cost", "final_time")),
    ]
    head = "".join(f"<th>{html.escape(name)}</th>" for name in ("case", *names))
    rows = []
    for i, number in enumerate(numbers):
        cells = [str(number), *(_cell(table[name].values[i]) for name in names)]
        rows.append("<tr>" + "".join(f"<td>{html.escape(cell)}</td>" for cell in cells) + "</tr>")
    return f"<table><tr>{head}</tr>{''.join(rows)}</table>"


def _cell(value: Any) -> str:
    return f"{value:.4g}" if np.issubdtype(np.asarray(value).dtype, np.floating) else str(value)

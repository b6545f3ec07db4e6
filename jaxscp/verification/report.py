"""A certificate as text: of one solution, or of a batch by its worst elements."""

from typing import Any

import numpy as np

_ROUNDING = 1e-12  # in any row's unit


def report(certificate: Any) -> str:
    """Lines for people: a row for each end, constraint and residual.

    Args:
        certificate: a ``Certificate`` of one solution, or of a batch. A row of a batch has its worst element's value.
    """
    names = (*certificate.names, *certificate.end_names)
    width = max(map(len, names), default=0)
    lines = [] if certificate.defect.ndim == 0 else [_share(certificate)]
    for name, unit, error in zip(
        certificate.end_names, certificate.end_units, _rows(certificate.end_errors), strict=True
    ):
        value, where = _worst(error)
        lines.append(f"{name:<{width}}  off by {value} {unit}".rstrip() + where)
    for name, nodes, between in zip(
        certificate.names, _rows(certificate.at_nodes), _rows(certificate.between_nodes), strict=True
    ):
        value, where = _worst(between)
        lines.append(f"{name:<{width}}  violated by {_worst(nodes)[0]} at nodes, {value} between{where}")
    if certificate.clearance is not None:
        value, where = _worst(certificate.clearance, sign=-1.0)
        lines.append(f"{'clearance':<{width}}  {value} m or more from the hull to obstacles{where}")
    lines.append("largest defect {}{}".format(*_worst(certificate.defect)))
    if certificate.optimality is not None:
        lines.append("KKT residual {}, relative to the cost{}".format(*_worst(certificate.optimality)))
    return "\n".join(lines)


def _rows(values: Any) -> np.ndarray:
    """Rows first, then the elements of the batch."""
    return np.moveaxis(np.asarray(values), -1, 0)


def _worst(values: Any, sign: float = 1.0) -> tuple[str, str]:
    """The largest value, or the least for the sign -1, and the element that has it; invalid elements are NaN."""
    values = np.asarray(values)
    if values.ndim == 0:
        return _text(values), ""
    known = np.where(np.isnan(values), -np.inf, sign * values)
    if not np.any(np.isfinite(known) | (known == np.inf)):
        return "nan", ""
    where = np.unravel_index(np.argmax(known), known.shape)
    return _text(values[where]), f" (element {', '.join(map(str, where))})"


def _text(value: Any) -> str:
    """Three digits; a value of the size of rounding is zero."""
    return "0" if abs(value) < _ROUNDING else f"{value:.3g}"


def _share(certificate: Any) -> str:
    passed, valid = np.asarray(certificate.passed()), ~np.isnan(np.asarray(certificate.defect))
    invalid = passed.size - np.sum(valid)
    text = f"{np.sum(passed & valid)} of {passed.size} pass; each row has the worst element's value"
    return f"{text}; {invalid} invalid" if invalid else text

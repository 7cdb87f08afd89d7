"""The result files of a folder: in a few words, as text, and as charts."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import numpy as np
from rich.console import RenderableType
from rich.text import Text

from labhil.analysis.schema import (
    COMPARISON,
    ComparisonPart,
    DiagnosisPart,
    EstimatedCurve,
    FitPart,
    VerificationPart,
    any_result_of,
    json_of,
    validate,
)
from labhil.errors import LabhilError
from labhil.signals import FloatArray
from labhil.tui.comparison_text import (
    comparison_headline,
    comparison_renderable,
    verification_headline,
    verification_renderable,
)
from labhil.tui.curve import Pen, PlotCurve
from labhil.tui.result_text import headline, result_renderable

ResultPart = FitPart | DiagnosisPart | ComparisonPart | VerificationPart

NO_CURVES = (
    "[$muted]No curves lie beside this result: it was made by a command. "
    "f or d on its recording (4) makes one with curves.[/]"
)


def shorten(name: str, width: int) -> str:
    """Cut the middle out of a name that is longer than ``width``."""
    return name if len(name) <= width else f"{name[: width // 2 - 1]}…{name[-(width // 2) :]}"


def read_part(path: Path) -> ResultPart | str:
    """Return the result in a file, or the error in reading it."""
    try:
        data = json_of(path.read_bytes(), path.name)
        if isinstance(data, dict) and data.get("schema") == COMPARISON:
            return validate(ComparisonPart, data, path.name)
        return any_result_of(data, path.name)
    except (OSError, LabhilError) as error:
        return str(error)


def has_model(part: ResultPart | str) -> bool:
    """Return whether the result has a model, to compare or to lay over a measurement."""
    return isinstance(part, FitPart | DiagnosisPart)


def in_a_line(part: ResultPart) -> str:
    """Return a result in a few words, for a list."""
    if isinstance(part, ComparisonPart):
        return comparison_headline(part)
    if isinstance(part, VerificationPart):
        return verification_headline(part)
    return headline(part)


def in_full(part: ResultPart, colours: dict[str, str]) -> RenderableType:
    """Return a result as text."""
    if isinstance(part, ComparisonPart):
        return comparison_renderable(part, colours)
    if isinstance(part, VerificationPart):
        return verification_renderable(part, colours)
    return result_renderable(part, colours)


def charts_of(
    part: ResultPart, curves: dict[str, FloatArray]
) -> Iterator[tuple[str | Text, list[PlotCurve]]]:
    """Yield the charts of a result: simulation and error of each channel, missing terms, their curve.

    Args:
        part: The result.
        curves: Arrays of its file of curves, by name.

    Yields:
        Title and curves of each chart.
    """
    for name in dict.fromkeys(key.rpartition("/")[0] for key in curves if key.endswith("/t")):
        t, measured, unit = curves[f"{name}/t"], curves[f"{name}/measured"], str(curves[f"{name}/unit"])
        models = [
            (label, curves[f"{name}/{label}"], colour, pen)
            for label, colour, pen in (("before", "curve-1", Pen.DASHED), ("after", "curve-0", Pen.SOLID))
            if f"{name}/{label}" in curves
        ]
        is_single = len(models) == 1
        measurement = PlotCurve(t, measured, "curve-measured", Pen.DOTS, "measured")
        yield (
            f"{name}, {unit}",
            [
                measurement,
                *(PlotCurve(t, y, c, p, "model" if is_single else label) for label, y, c, p in models),
            ],
        )
        yield (
            f"error of {name}, {unit}",
            [PlotCurve(t, y - measured, c, p, "" if is_single else label) for label, y, c, p in models],
        )
    for key in (key for key in curves if key.startswith("missing/") and f"{key}/x" in curves):
        x, y = curves[f"{key}/x"], curves[key]
        order = np.argsort(x)
        axis = str(curves[f"{key}/axis"])
        yield (
            f"{key.removeprefix('missing/')} over {axis}",
            [PlotCurve(x[order], y[order], "curve-3", Pen.DOTS)],
        )
    if isinstance(part, DiagnosisPart):
        estimates = [curve for curve in (part.curve, *part.further_curves) if curve is not None]
        yield from (_curve(curve) for curve in estimates if len(curve.depends_on) == 1)


def _curve(curve: EstimatedCurve) -> tuple[str, list[PlotCurve]]:
    x, value = np.array(curve.x, dtype=float).ravel(), np.array(curve.value, dtype=float)
    curves = [PlotCurve(x, value, "curve-0", Pen.SOLID, "estimate")]
    for side in curve.ci99:
        label = "99 % band" if len(curves) == 1 else ""
        curves.append(PlotCurve(x, np.array(side, dtype=float), "curve-measured", Pen.DOTS, label))
    where = "" if curve.joint is None else f" on joint {curve.joint}"
    return f"what has no name{where}, {curve.unit}, over {curve.depends_on[0]}", curves

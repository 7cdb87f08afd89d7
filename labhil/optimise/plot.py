"""Plot the study: force curves, Pareto front and sensitivities."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from labhil.atomic_file import atomic_file
from labhil.errors import UsageError
from labhil.optimise.circuit import positions
from labhil.optimise.geometry import PARAMETERS
from labhil.optimise.objectives import largest_force, rms_slope
from labhil.optimise.study import INTERPOLATED_NAME, ORIGINAL_NAME, REFINED_NAME, TEXT_NAME, Optimisation

if TYPE_CHECKING:
    from matplotlib.axes import Axes

COLOURS = {
    ORIGINAL_NAME: "#444444",
    TEXT_NAME: "#c8553d",
    INTERPOLATED_NAME: "#d9a441",
    REFINED_NAME: "#2a7f62",
}
MARKERS = {ORIGINAL_NAME: "s", TEXT_NAME: "D", INTERPOLATED_NAME: "^", REFINED_NAME: "*"}


def plot(study: Optimisation, path: Path) -> None:
    """Write four panels to a file; UsageError where it cannot be written or its suffix is not a format."""
    import matplotlib as mpl
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    with mpl.rc_context({"axes.grid": True, "grid.alpha": 0.3}):
        figure = Figure(figsize=(12.0, 8.5), layout="constrained")
        FigureCanvasAgg(figure)
        axes = figure.subplots(2, 2)
        _draw_curves(axes[0, 0], study)
        _draw_front(axes[0, 1], study)
        _draw_local(axes[1, 0], study)
        _draw_overall(axes[1, 1], study)
    try:
        with atomic_file(path, "the plot") as draft:
            figure.savefig(draft, dpi=110)
    except ValueError as error:
        raise UsageError(f"{path}: the plot cannot be written: {error}") from error


def _draw_curves(axes: Axes, study: Optimisation) -> None:
    x = 1e3 * positions()
    for candidate in study.candidates:
        label = f"{candidate.name}, {1e-3 * candidate.rms_slope:.0f} N/mm rms"
        axes.plot(x, candidate.curve, color=COLOURS[candidate.name], lw=1.8, label=label)
        if study.field is not None:
            axes.plot(x, study.field.curves[candidate.name], ".", color=COLOURS[candidate.name], ms=7)
    if study.field is not None:
        axes.plot([], [], ".", color="#444444", label="field solver")
    axes.set_ylim(bottom=0.0)
    _finish(axes, "Force along the stroke, 2.7 A", "plunger position, mm", "force, N")


def _draw_front(axes: Axes, study: Optimisation) -> None:
    low, high = study.objectives.force_range
    inverse_low, inverse_high = study.objectives.inverse_slope_range
    force = low + study.scores[:, 0] * (high - low)
    slope = 1e-3 / (inverse_low + study.scores[:, 1] * (inverse_high - inverse_low))
    axes.plot(force, slope, ".", color="#999999", ms=2, alpha=0.5, label="every design evaluated")
    curves = study.database.curves
    axes.plot(
        largest_force(curves), 1e-3 * rms_slope(curves), "o", color="#3b6ea5", ms=3.5, label="the 55 runs"
    )
    axes.plot(force[study.front], slope[study.front], "k.-", lw=1.0, ms=4, label="Pareto front")
    for candidate in study.candidates:
        axes.plot(
            candidate.largest_force,
            1e-3 * candidate.rms_slope,
            MARKERS[candidate.name],
            color=COLOURS[candidate.name],
            ms=13 if candidate.name == REFINED_NAME else 9,
            mec="w",
            label=candidate.name,
        )
    _finish(
        axes,
        "Large force against level force (right and down is better)",
        "largest force, N",
        "rms dF/dx, N/mm",
    )


def _draw_local(axes: Axes, study: Optimisation) -> None:
    """Draw relative changes per range, so that an angle of zero has a bar."""
    width, at = 0.2, np.arange(len(PARAMETERS))
    n = 0
    for name, local in study.local.items():
        for values, what, alpha in zip(
            local.per_range, ("largest force", "rms slope"), (1.0, 0.5), strict=True
        ):
            place = at + (n - 1.5) * width
            axes.bar(place, values, width, color=COLOURS[name], alpha=alpha, label=f"{what} at {name}")
            n += 1
    axes.axhline(0.0, color="k", lw=0.8)
    axes.set_xticks(at, [parameter.symbol for parameter in PARAMETERS])
    _finish(axes, "Local: relative change per whole range of a parameter", "", "")


def _draw_overall(axes: Axes, study: Optimisation) -> None:
    width, at, overall = 0.38, np.arange(len(PARAMETERS)), study.overall
    for n, (what, colour) in enumerate((("largest force", "#3b6ea5"), ("rms slope", "#a5673b"))):
        place = at + (n - 0.5) * width
        reach = np.abs(np.stack([overall.total_low[n], overall.total_high[n]]) - overall.total[n])
        axes.bar(place, overall.total[n], width, color=colour, alpha=0.45, yerr=reach, label=f"{what}, total")
        axes.bar(place, overall.first_order[n], 0.6 * width, color=colour, label=f"{what}, alone")
    axes.set_xticks(at, [parameter.symbol for parameter in PARAMETERS])
    _finish(axes, "Over all of Table A.2: Sobol's shares of the variance", "", "share")


def _finish(axes: Axes, title: str, x: str, y: str) -> None:
    axes.set_title(title, loc="left", fontsize=10, fontweight="bold")
    axes.set_xlabel(x)
    axes.set_ylabel(y)
    axes.legend(fontsize=8, framealpha=0.8, edgecolor="none")

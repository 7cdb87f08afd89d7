"""Print the study as tables."""

from __future__ import annotations

from collections.abc import Iterator
from typing import TYPE_CHECKING

import numpy as np
from rich.table import Table
from rich.text import Text

from labhil.optimise.field_check import FieldCheck
from labhil.optimise.geometry import PARAMETERS, design_text
from labhil.optimise.objectives import rms_slope
from labhil.optimise.study import (
    INTERPOLATED_NAME,
    ORIGINAL_NAME,
    REFINED_NAME,
    TEXT_NAME,
    Candidate,
    Optimisation,
)
from labhil.signals import FloatArray

if TYPE_CHECKING:
    from rich.console import Console

MIN_SHOWN_ERROR = 0.1
"""Error of the interpolated optimum's CF above which it is printed."""


def show(study: Optimisation, console: Console) -> None:
    """Print the study."""
    console.print(_candidate_table(study))
    for line in _conclusions(study):
        console.print(Text("· " + line))
    console.print(_sensitivity_table(study))
    if study.field is not None:
        console.print(_field_table(study.field))
        for line in _field_conclusions(study.field):
            console.print(Text("· " + line))
    console.print(
        f"Model: equivalent circuit with our own housing and steel; {len(study.evaluated)} force curves in "
        f"{study.seconds:.0f} s. CF1, CF2: eq. A.2 and A.3 over the 55 runs, with the root-mean-square slope."
    )


def _table(title: str) -> Table:
    return Table(title=title, title_justify="left", title_style="bold", box=None, pad_edge=False)


def _candidate_table(study: Optimisation) -> Table:
    table = _table("Designs, by the magnetic circuit (450 turns, 2.7 A, stroke 5 mm)")
    table.add_column("design", no_wrap=True)
    for parameter in PARAMETERS:
        table.add_column(f"{parameter.symbol}, {parameter.shown_unit}", justify="right", no_wrap=True)
    for name in ("largest F, N", "rms dF/dx, N/mm", "mean dF/dx, N/mm", "CF1", "CF2", "CF"):
        table.add_column(name, justify="right", no_wrap=True)
    for candidate in study.candidates:
        table.add_row(candidate.name, *_candidate_cells(candidate))
    return table


def _candidate_cells(candidate: Candidate) -> Iterator[str]:
    for parameter, value in zip(PARAMETERS, candidate.design, strict=True):
        yield f"{value * parameter.shown_scale:.2f}"
    yield f"{candidate.largest_force:.1f}"
    yield f"{1e-3 * candidate.rms_slope:.1f}"
    yield f"{1e-3 * candidate.mean_slope:+.1f}"
    yield from (f"{score:.2f}" for score in (*candidate.scores, candidate.cost))


def _conclusions(study: Optimisation) -> Iterator[str]:
    original, text = study.candidate(ORIGINAL_NAME), study.candidate(TEXT_NAME)
    ours, interpolated = study.candidate(REFINED_NAME), study.candidate(INTERPOLATED_NAME)
    for name, candidate in (("The text's optimum", text), ("Ours", ours)):
        yield f"{name} against the original: {_comparison(original, candidate)}."
    for candidate in (text, original):
        better = study.flattest_with_force_of(candidate)
        yield (
            f"Of all designs evaluated with at least {candidate.largest_force:.0f} N ({candidate.name}), the "
            f"most level one has {1e-3 * study.slope_of(better):.1f} N/mm: "
            f"{design_text(study.evaluated[better])}."
        )
    missed = study.predicted_cost - interpolated.cost
    error = study.interpolation
    if abs(missed) > MIN_SHOWN_ERROR:
        yield (
            f"The optimum of the interpolated database has CF {study.predicted_cost:.2f} by interpolation, "
            f"and {interpolated.cost:.2f} by the circuit: an optimiser moves to errors of the interpolation."
        )
    yield (
        f"Interpolation between the 55 runs, at {error.designs} designs it has not seen: "
        f"{error.curve_rms:.1f} N (rms) of a curve, {error.force_rms:.1f} N of the largest force, "
        f"{1e-3 * error.slope_rms:.1f} N/mm of the slope; worst {error.curve_worst:.0f} N."
    )
    yield (
        f"{study.n_agreeing} of {study.swarms} swarms on the database ended at its best CF (within 1 %); "
        f"{len(study.front)} designs of all evaluated ones are on the Pareto front."
    )


def _comparison(before: Candidate, after: Candidate) -> str:
    force = 100.0 * (after.largest_force / before.largest_force - 1.0)
    slope = 100.0 * (after.rms_slope / before.rms_slope - 1.0)
    return f"largest force {force:+.0f} %, rms slope {slope:+.0f} %, CF {after.cost - before.cost:+.2f}"


def _sensitivity_table(study: Optimisation) -> Table:
    table = _table("Sensitivities of largest force | rms slope")
    table.add_column("")
    for parameter in PARAMETERS:
        table.add_column(parameter.symbol, justify="right", no_wrap=True)
    for name, local in study.local.items():
        table.add_row(f"elasticity at {name}", *(_pair(column, "{:+.2f}") for column in local.elasticity.T))
        table.add_row(f"per range at {name}", *(_pair(column, "{:+.2f}") for column in local.per_range.T))
    for name, values in (("first order", study.overall.first_order), ("total", study.overall.total)):
        table.add_row(f"Sobol, {name}", *(_pair(column, "{:.2f}") for column in values.T))
    return table


def _pair(values: FloatArray, style: str) -> str:
    return " | ".join(style.format(value) if np.isfinite(value) else "–" for value in values)


def _field_table(field: FieldCheck) -> Table:
    x = [point.position for point in field.points if point.candidate == ORIGINAL_NAME][:-1]
    table = _table("Force by the field solver | by the circuit, N, at 2.7 A")
    table.add_column("x, mm")
    for name in field.curves:
        table.add_column(name, justify="right", no_wrap=True)
    for n, position in enumerate(x):
        row = []
        for name in field.curves:
            point = [p for p in field.points if p.candidate == name][n]
            row.append(f"{point.field:.1f} | {point.circuit:.1f}")
        table.add_row(f"{1e3 * position:.1f}", *row)
    both = [(field.curves[name], circuit_curve(field, name)) for name in field.curves]
    table.add_row("largest", *(f"{a.max():.1f} | {b.max():.1f}" for a, b in both))
    slopes = [1e-3 * rms_slope(np.stack(pair)) for pair in both]
    table.add_row("rms dF/dx, N/mm", *(f"{a:.1f} | {b:.1f}" for a, b in slopes))
    return table


def circuit_curve(field: FieldCheck, name: str) -> FloatArray:
    """Return the circuit's forces (m,), N, of a candidate at full current."""
    return np.array([p.circuit for p in field.points if p.candidate == name][:-1])


def _field_conclusions(field: FieldCheck) -> Iterator[str]:
    ratios = field.ratios()
    weak = [point.circuit / point.field for point in field.points if point.current < field.points[0].current]
    yield (
        f"Circuit over field: median {np.median(ratios):.2f}, from {ratios.min():.2f} to {ratios.max():.2f}; "
        f"at half the current {min(weak):.2f} to {max(weak):.2f}. Grids twice as fine change the field's "
        f"forces by up to {100.0 * field.refined:.1f} % ({field.unknowns} unknowns)."
    )
    original = field.curves[ORIGINAL_NAME]
    for what, name in (("the text's optimum", TEXT_NAME), ("ours", REFINED_NAME)):
        force = 100.0 * (field.curves[name].max() / original.max() - 1.0)
        slopes = rms_slope(np.stack([field.curves[name], original]))
        yield (
            f"By the field solver, {what} against the original: largest force {force:+.0f} %, "
            f"rms slope {100.0 * (slopes[0] / slopes[1] - 1.0):+.0f} %."
        )

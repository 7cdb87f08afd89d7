"""The page of a fit: parameters with intervals, identifiability, scores, residuals."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from labhil.analysis.schema import ChannelErrors, FitPart, Identifiability, Parameter, Score
from labhil.report.figure import AFTER, MEASURED, figure_of, finish
from labhil.report.formatting import (
    format_count,
    format_multiple,
    format_p_value,
    format_percent,
    format_quantity,
    is_refuted,
    square_unit,
)
from labhil.report.html.element import Content, Markup, tag
from labhil.report.html.model import (
    channel_name,
    intervals_picture,
    names,
    next_steps_section,
    parameters_table,
    recordings_table,
    warning,
)
from labhil.report.html.page import Page, PageSection, drop_empty, section
from labhil.report.html.picture import Album, label
from labhil.report.html.table import bullets, facts, numbers, table, text, tiles
from labhil.signals import FloatArray

NORMAL_99 = 2.576
PANELS_IN_ROW = 3
MOST_PANELS = 36
MOST_CORRELATED = 60


def fit_page(fit: FitPart, foot: str, album: Album, pictures: Sequence[Markup] = ()) -> Page:
    """Make the page of a fit.

    Args:
        fit: The result.
        foot: Last line of the page: where it comes from.
        album: The pictures of the page.
        pictures: Pictures that need the samples; they are shown under the scores.
    """
    return Page(
        kind=f"Fit of a white-box model · {fit.rig}",
        title=f"Fit of {fit.rig}",
        headline=_headline(fit),
        tone="plain",
        lead=_lead(fit),
        sections=drop_empty(
            next_steps_section(fit.next_steps),
            _parameters(fit, album),
            _identifiability(fit.identifiability),
            _scores(fit, pictures),
            _windows(fit, album),
            _residuals(fit),
            _correlations(fit, album),
            _method(fit),
        ),
        foot=foot,
    )


def _headline_score(fit: FitPart) -> tuple[Score, str]:
    return (
        (fit.train, "the data it was fitted to") if fit.test is None else (fit.test, "data it has not seen")
    )


def _headline(fit: FitPart) -> str:
    score, data = _headline_score(fit)
    number = len(fit.parameters)
    size = "1 parameter" if number == 1 else f"{number} parameters"
    summary = f"A model of {fit.rig} with {size}: R² {format_percent(score.r2)} on {data}."
    return summary if fit.statement is None else f"{fit.statement} {summary}"


def _lead(fit: FitPart) -> tuple[Content, ...]:
    score, data = _headline_score(fit)
    identifiability = fit.identifiability
    figures = tiles(
        (
            ("RMSE", format_quantity(score.rmse, score.unit), f"on {data}"),
            (
                "Noise floor",
                format_quantity(score.noise_floor, score.unit),
                "the error of a perfect model",
            ),
            (
                "RMSE ÷ noise floor",
                format_multiple(score.rmse, score.noise_floor),
                "1 × is as good as can be",
            ),
            (
                "Parameters identified",
                f"{identifiability.rank} of {identifiability.of}",
                "identifiable from these data",
            ),
        )
    )
    terms = tag("p", "Terms: ", names(fit.terms), ".", class_="lead")
    unsettled = None if fit.converged else warning("The search stopped before it had settled.")
    return terms, *map(warning, fit.doubts), unsettled, _misfit_warning(fit), figures


def _misfit_warning(fit: FitPart) -> Markup | None:
    """What the intervals mean where the model leaves more than noise."""
    if fit.verdict in (None, "explained"):
        return None
    return warning(
        "The model leaves more than noise. Intervals hold how far the estimates move with the length of the "
        "windows, not what all lengths have in common; no parameter is called significant."
    )


def _parameters(fit: FitPart, album: Album) -> PageSection | None:
    together = ", all together" if fit.intervals.simultaneous else ""
    caption = (
        f"Standard errors are robust to correlated residuals; 99 % intervals by {fit.intervals.method}"
        f"{together}; the standard error of the reference text is for comparison only"
    )
    return section(
        "Parameters",
        parameters_table(fit.judged_rows, caption, reference=True),
        intervals_picture(album, fit.judged_rows),
    )


def _identifiability(identifiability: Identifiability) -> PageSection | None:
    lines: list[Content] = []
    if identifiability.combinations:
        lines.append(tag("p", "Not every single value is identifiable, but these combinations are:"))
        lines.append(bullets(tag("code", name) for name in identifiability.combinations))
    if identifiability.would_help:
        lines.append(
            tag("p", f"It would help to know or to record: {', '.join(identifiability.would_help)}.")
        )
    complete = "These data determine every parameter." if identifiability.rank == identifiability.of else None
    partial = (
        f"These data determine {identifiability.rank} of {identifiability.of} directions in parameter space."
    )
    return section("Identifiability", tag("p", complete or partial), *lines)


def _scores(fit: FitPart, pictures: Sequence[Markup]) -> PageSection | None:
    columns = (
        *text("Data", "Channel"),
        *numbers("RMSE", "Noise floor", "RMSE ÷ floor", "Largest error", "MSE", "R²"),
    )
    rows = _channels("train", fit.train)
    if fit.test is not None:
        rows += _channels("test", fit.test)
    if fit.train.metric == "inverse_dynamics":
        caption = "Errors of inverse dynamics"
    else:
        caption = f"Errors of simulated windows of {format_quantity(fit.train.horizon, 's')}"
    return section("How well it predicts", table(caption, columns, rows), *pictures)


def _channels(data: str, score: Score) -> list[list[Content]]:
    """Rows of all channels, then of those of each recording."""
    rows = [_channel(data, channel, score) for channel in score.per_channel]
    for recording in score.per_recording:
        rows += [
            _channel(f"{data} @{recording.recording}", channel, score) for channel in recording.per_channel
        ]
    return rows


def _channel(data: str, channel: ChannelErrors, score: Score) -> list[Content]:
    return [
        data,
        channel_name(channel, score.metric),
        format_quantity(channel.rmse, channel.unit),
        format_quantity(channel.noise_floor, channel.unit),
        format_multiple(channel.rmse, channel.noise_floor),
        format_quantity(channel.max_abs_error, channel.unit),
        format_quantity(channel.mse, square_unit(channel.unit)),
        format_percent(channel.r2),
    ]


def _windows(fit: FitPart, album: Album) -> PageSection | None:
    if len(fit.by_window) < 2:
        return None
    columns = (
        *text("Windows of"),
        *numbers(*(format_quantity(estimate.window, "s") for estimate in fit.by_window)),
    )
    residuals = (
        "Residual ÷ noise",
        *(format_quantity(estimate.residual, digits=3) for estimate in fit.by_window),
    )
    caption = (
        "Estimates with 99 % intervals against the length of the fitted windows; the band is the final "
        "estimate's interval. Estimates that drift show a disturbed plant or missing physics."
    )
    if len(fit.parameters) > MOST_PANELS:
        caption = f"{caption} The first {MOST_PANELS} of {len(fit.parameters)} parameters."
    return section(
        "How the estimates move with the window",
        table(f"The fit uses windows of {format_quantity(fit.window, 's')}", columns, [residuals]),
        album.picture(caption, lambda: _draw_windows(fit)),
    )


def _draw_windows(fit: FitPart) -> Figure:
    drawn = [row for row in fit.parameters if row.key in fit.by_window[0].values]
    drawn = drawn[:MOST_PANELS]
    height = max(1, -(-len(drawn) // PANELS_IN_ROW))
    figure = figure_of((10.5, 2.1 * height + 0.3))
    panels = figure.subplots(height, PANELS_IN_ROW, squeeze=False).ravel()
    for axes in panels[len(drawn) :]:
        axes.set_axis_off()
    for axes, row in zip(panels, drawn, strict=False):
        key = row.key
        places = range(len(fit.by_window))
        values = np.array([estimate.values.get(key) for estimate in fit.by_window], dtype=np.float64)
        errors = np.array([estimate.std_errors.get(key) for estimate in fit.by_window], dtype=np.float64)
        if row.ci99 is not None and row.ci99[0] is not None and row.ci99[1] is not None:
            axes.axhspan(row.ci99[0], row.ci99[1], color=MEASURED, alpha=0.13, lw=0)
        axes.errorbar(places, values, NORMAL_99 * errors, fmt="o-", color=AFTER, ms=4, lw=1.0, capsize=3)
        axes.set_xticks(places, [f"{estimate.window:.3g}" for estimate in fit.by_window])
        finish(axes, "", "", label(row.unit))
        axes.set_title(label(key), loc="left", fontsize=9)
    figure.supxlabel("length of the fitted windows, s", fontsize=9)
    return figure


def _residuals(fit: FitPart) -> PageSection | None:
    tests = fit.residuals
    columns = (*text("Question"), *numbers("p"), *text("Answer at 1 %"))
    rows = [
        (
            "Are the residuals white? (Ljung-Box)",
            format_p_value(tests.ljung_box_p),
            _answer(tests.ljung_box_p),
        ),
        (
            "Are they free of the input? (cross-correlation)",
            format_p_value(tests.input_crosscorrelation_p),
            _answer(tests.input_crosscorrelation_p),
        ),
    ]
    note = "The standard errors above allow for residuals that are not white."
    return section("Residuals", table("Tests of the fitted residuals", columns, rows), tag("p", note))


def _answer(p: float | None) -> str:
    if p is None:
        return "not known"
    return "no" if is_refuted(p) else "nothing speaks against it"


def _correlations(fit: FitPart, album: Album) -> PageSection | None:
    square = {len(row) for row in fit.covariance} == {len(fit.covariance)}
    if not square or not 2 <= len(fit.covariance) <= MOST_CORRELATED:
        return None
    if len(fit.covariance) != len(fit.parameters):
        return None
    caption = "Correlations of the estimates. Near ±1 the data determine a combination, not the two values."
    return section(
        "Correlations", album.picture(caption, lambda: _draw_correlations(fit.covariance, fit.parameters))
    )


def _draw_correlations(covariance: tuple[tuple[float | None, ...], ...], rows: Sequence[Parameter]) -> Figure:
    matrix = np.array(covariance, dtype=np.float64)
    spread = np.sqrt(np.maximum(np.diag(matrix), 0.0))
    scale = np.outer(spread, spread)
    correlation = np.divide(matrix, scale, out=np.full_like(matrix, np.nan), where=scale > 0.0)
    figure = figure_of((10.0, min(9.0, 1.0 + 0.4 * len(rows))))
    axes = figure.subplots()
    image = axes.imshow(correlation, cmap="RdBu_r", vmin=-1.0, vmax=1.0, aspect="auto")
    axes.set_yticks(
        range(len(rows)),
        [f"{label(row.key)}  {i}" for i, row in enumerate(rows, 1)],
        fontsize=8,
    )
    axes.set_xticks(range(len(rows)), [str(i + 1) for i in range(len(rows))], fontsize=8)
    if len(rows) <= 12:
        _write_numbers(axes, correlation)
    figure.colorbar(image, ax=axes, pad=0.01)
    return figure


def _write_numbers(axes: Axes, correlation: FloatArray) -> None:
    for (i, j), value in np.ndenumerate(correlation):
        if np.isfinite(value):
            colour = "white" if abs(value) > 0.6 else "black"
            axes.text(j, i, f"{value:.2f}", ha="center", va="center", fontsize=7, color=colour)


def _method(fit: FitPart) -> PageSection | None:
    details = facts(
        (
            ("Estimator", f"{fit.estimator}, seed {fit.seed}" if fit.estimator else "not stated"),
            ("Fitted windows", format_quantity(fit.window, "s")),
            ("Simulations", format_count(fit.evaluations)),
            ("Time taken", format_quantity(fit.seconds, "s", digits=3)),
        )
    )
    return section("Recordings and method", recordings_table(fit.recordings), details)

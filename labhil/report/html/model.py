"""What pages of fits and of diagnoses share: recordings, parameters, and pictures of their intervals."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from labhil.analysis.schema import ChannelErrors, ChannelImprovement, ParameterRow, Source
from labhil.physics.terms import keyed, listed
from labhil.report.figure import AFTER, figure_of, finish
from labhil.report.html.element import Content, Markup, joined, tag
from labhil.report.html.picture import Album, label
from labhil.report.html.quantity import NOTHING, count, interval, p_value, percent, quantity
from labhil.report.html.table import numbers, table, text

WIDEST = 120.0
"""Intervals beyond that many per cent of their value are drawn with an arrow."""

UNSURE = "#8a8f96"


def recordings_table(sources: Sequence[Source]) -> Markup:
    """Which recordings a result comes from."""
    columns = (*text("Recording", "Role"), *numbers("Samples", "Duration"), *text("SHA-256"))
    rows = [
        (
            tag("code", source.path),
            source.role if source.recording is None else f"{source.role} @{source.recording}",
            count(source.samples),
            quantity(source.duration, "s"),
            tag("code", source.sha256, class_="hash"),
        )
        for source in sources
    ]
    return table("Recordings that this result comes from", columns, rows)


def parameters_table(rows: Sequence[ParameterRow], caption: str, *, reference: bool = False) -> Markup | None:
    """Values with errors and intervals; with ``reference``, the reference text's own error beside ours."""
    if not rows:
        return None
    errors = ("Std. error", "Reference's error") if reference else ("Std. error",)
    columns = (*text("Parameter"), *numbers("Value", *errors, "99 % interval", "z", "p"), *text("Remark"))
    return table(caption, columns, [_parameter(row, reference) for row in rows])


def _parameter(row: ParameterRow, reference: bool) -> list[Content]:
    errors = [quantity(row.std_error, digits=2)]
    if reference:
        errors.append(quantity(row.std_error_reference, digits=2))
    return [
        named(row.name, row.joint, row.recording),
        quantity(row.value, row.unit),
        *errors,
        interval(row.ci99),
        quantity(row.z, digits=3),
        p_value(row.p_value),
        remark(row),
    ]


def remark(row: ParameterRow) -> str:
    """What has to be known of an estimate beside its numbers."""
    if not row.identifiable:
        return "not identifiable"
    found = ["at its bound"] if row.at_bound else []
    if row.significant is not None:
        found.append("significant" if row.significant else "not significant")
    return ", ".join(found) or NOTHING


def intervals_picture(album: Album, rows: Sequence[ParameterRow]) -> Markup | None:
    """Every parameter with its 99 % interval, in per cent of its value."""
    drawn = [row for row in rows if row.value and row.ci99 and None not in row.ci99]
    if not drawn:
        return None
    caption = (
        "99 % intervals in per cent of the estimate. Grey: not significantly different from zero, "
        "or not identifiable. An arrow: the interval goes on."
    )
    return album.picture(caption, lambda: _draw_intervals(drawn))


def _draw_intervals(rows: Sequence[ParameterRow]) -> Figure:
    figure = figure_of((10.0, 0.9 + 0.3 * len(rows)))
    axes = figure.subplots()
    spans = np.array([_relative(row) for row in rows])
    limit = min(WIDEST, 1.15 * float(np.abs(spans).max()) or 1.0)
    for place, (row, (low, high)) in enumerate(zip(rows, spans.tolist(), strict=True)):
        _draw_interval(axes, place, (low, high), limit, UNSURE if _unsure(row) else AFTER)
    axes.axvline(0.0, color="k", lw=0.6)
    axes.set_xlim(-1.08 * limit, 1.08 * limit)
    axes.set_ylim(len(rows) - 0.4, -0.6)
    axes.set_yticks(range(len(rows)), [label(_labelled(row)) for row in rows])
    finish(axes, "", "99 % interval − estimate, % of the estimate", "")
    axes.grid(visible=False, axis="y")
    return figure


def _draw_interval(axes: Axes, place: int, span: tuple[float, float], limit: float, colour: str) -> None:
    low, high = max(span[0], -limit), min(span[1], limit)
    axes.plot([low, high], [place, place], color=colour, lw=3.0, solid_capstyle="butt")
    axes.plot([0.0], [place], "o", color=colour, ms=5.5)
    if span[0] < -limit:
        axes.plot([low], [place], "<", color=colour, ms=7)
    if span[1] > limit:
        axes.plot([high], [place], ">", color=colour, ms=7)


def _relative(row: ParameterRow) -> tuple[float, float]:
    """Ends of the interval less the value, in per cent of the value."""
    value = row.value or 1.0
    low, high = row.ci99 or (None, None)
    ends = [100.0 * ((value if end is None else end) - value) / abs(value) for end in (low, high)]
    return ends[0], ends[1]


def _unsure(row: ParameterRow) -> bool:
    return not row.identifiable or row.significant is False


def _labelled(row: ParameterRow) -> str:
    return f"{row.key} = {quantity(row.value, row.unit)}"


def named(name: str, joint: int | None = None, recording: int | None = None) -> Markup:
    """A name as code, which a narrow column may break behind its dots."""
    first, *others = keyed(name, joint, recording).split(".")
    return tag("code", first, *(joined((".", tag("wbr"), other)) for other in others))


def channel_named(
    row: ChannelErrors | ChannelImprovement, metric: str, recording: int | None = None
) -> Content:
    """A channel's name, with its metric where that is not the headline's ``metric``."""
    name = named(row.channel, row.joint, recording)
    if row.metric in (None, metric):
        return name
    share = row.relative_error if isinstance(row, ChannelErrors) else None
    error = "" if share is None else f", {percent(share)} of the RMS"
    return joined((name, f" ({str(row.metric).replace('_', ' ')}{error})"))


def bars(before: float | None, after: float | None, floor: float | None) -> Markup | None:
    """Two bars, before above after, with a line at the noise floor."""
    known = [value for value in (before, after, floor) if value is not None]
    largest = max(known, default=0.0)
    if largest <= 0.0 or before is None or after is None:
        return None
    share = [100.0 * (value or 0.0) / largest for value in (before, after, floor)]
    return tag(
        "svg",
        tag("rect", class_="before", x=0, y=2, width=f"{share[0]:.2f}", height=10),
        tag("rect", class_="after", x=0, y=14, width=f"{max(share[1], 0.4):.2f}", height=10),
        tag("line", x1=f"{share[2]:.2f}", x2=f"{share[2]:.2f}", y1=0, y2=26, stroke_width="0.8"),
        class_="bar",
        viewBox="0 0 100 26",
        preserveAspectRatio="none",
        role="img",
        aria_label="RMSE before and after, as bars, with a line at the noise floor",
    )


def warning(*content: Content) -> Markup:
    """A paragraph that must not be overlooked."""
    return tag("p", *content, class_="warning")


def names(terms: Sequence[str]) -> Markup:
    """Names of terms as code, with commas; the joints of a name together."""
    pieces: list[Content] = []
    for i, term in enumerate(listed(terms)):
        pieces += [", " if i else None, tag("code", term)]
    return joined(pieces)

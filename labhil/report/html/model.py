"""Parts that pages share: next steps, recordings, parameters, names of terms."""

from __future__ import annotations

from collections.abc import Sequence

from labhil.analysis.schema import ChannelErrors, ChannelImprovement, Parameter, Source
from labhil.physics.terms import keyed, listed
from labhil.report.formatting import NOTHING, format_count, format_percent, format_quantity
from labhil.report.html.element import Content, Markup, join, tag
from labhil.report.html.page import PageSection, section
from labhil.report.html.picture import Album
from labhil.report.html.table import bullets, numbers, table, text, with_code
from labhil.report.intervals_plot import drawable, intervals_figure
from labhil.report.parameter_columns import COLUMNS


def recordings_table(sources: Sequence[Source]) -> Markup:
    """Make a table of the recordings that a result comes from."""
    columns = (*text("Recording", "Role"), *numbers("Samples", "Duration"), *text("SHA-256"))
    rows = [
        (
            tag("code", source.path),
            source.role if source.recording is None else f"{source.role} @{source.recording}",
            format_count(source.samples),
            format_quantity(source.duration, "s"),
            tag("code", source.sha256, class_="hash"),
        )
        for source in sources
    ]
    return table("Recordings that this result comes from", columns, rows)


def next_steps_section(steps: Sequence[str]) -> PageSection | None:
    """Make the section of what to do next; None for no steps."""
    return section("What to do next", bullets(map(with_code, steps)) if steps else None)


def parameters_table(rows: Sequence[Parameter], caption: str, *, reference: bool = False) -> Markup | None:
    """Make a table of parameters with errors and intervals.

    Args:
        rows: The parameters.
        caption: Caption of the table.
        reference: Whether to show the standard error of the reference text beside ours.

    Returns:
        The table; None where there are no parameters.
    """
    if not rows:
        return None
    shown = [
        column.page for column in COLUMNS if column.page is not None and (reference or not column.reference)
    ]
    columns = (*text("Parameter"), *numbers(*(title for title, _ in shown)), *text("Remark"))
    cells: list[Sequence[Content]] = [
        (name_code(row.name, row.joint, row.recording), *(cell(row) for _, cell in shown), remark(row))
        for row in rows
    ]
    return table(caption, columns, cells)


def remark(row: Parameter) -> str:
    """Return what qualifies an estimate: held, not identifiable, at its bound, significant."""
    if row.held:
        return "held"
    if not row.identifiable:
        return "not identifiable"
    remarks = ["at its bound"] if row.at_bound else []
    if row.significant is not None:
        remarks.append("significant" if row.significant else "not significant")
    return ", ".join(remarks) or NOTHING


def intervals_picture(album: Album, rows: Sequence[Parameter]) -> Markup | None:
    """Draw every parameter with its 99 % interval, in per cent of its value."""
    if not drawable(rows):
        return None
    caption = (
        "99 % intervals in per cent of the estimate. Grey: not significantly different from zero, "
        "or not identifiable. An arrow: the interval continues."
    )
    return album.picture(caption, lambda: intervals_figure(rows))


def name_code(name: str, joint: int | None = None, recording: int | None = None) -> Markup:
    """Return a name as code that may be broken after its dots."""
    first, *parts = keyed(name, joint, recording).split(".")
    return tag("code", first, *(join((".", tag("wbr"), part)) for part in parts))


def channel_name(
    row: ChannelErrors | ChannelImprovement, metric: str, recording: int | None = None
) -> Content:
    """Return a channel's name, with its metric where that is not the one of the score.

    Args:
        row: The errors of the channel.
        metric: The metric of the score.
        recording: Number of its recording, where there are several.
    """
    name = name_code(row.channel, row.joint, recording)
    if row.metric in (None, metric):
        return name
    share = row.relative_error if isinstance(row, ChannelErrors) else None
    error = "" if share is None else f", {format_percent(share)} of the RMS"
    return join((name, f" ({str(row.metric).replace('_', ' ')}{error})"))


def bars(before: float | None, after: float | None, floor: float | None) -> Markup | None:
    """Draw two bars, before above after, with a line at the noise floor; None without both."""
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
    """Return a paragraph in the style of a warning."""
    return tag("p", *content, class_="warning")


def names(terms: Sequence[str]) -> Markup:
    """Return names of terms as code, separated by commas, with the joints of a term in one name."""
    pieces: list[Content] = []
    for i, term in enumerate(listed(terms)):
        pieces += [", " if i else None, tag("code", term)]
    return join(pieces)

"""The columns of the list of recordings: those for which a terminal has room, none of them cut."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from rich.text import Text

from labhil.report.formatting import format_count
from labhil.tui.formatting import format_duration, format_size, outcome_label
from labhil.tui.recording_library import LibraryEntry

COLUMNS = {
    "mark": ("", 1),
    "name": ("recording", 18),
    "status": ("ended", 11),
    "rig": ("rig", 9),
    "duration": ("duration", 8),
    "samples": ("samples", 7),
    "gaps": ("gaps", 4),
    "size": ("size", 7),
    "when": ("written", 12),
    "reason": ("reason", 12),
}
"""Heading and least width of each column."""
LEAST_IMPORTANT = ("when", "size", "samples", "rig", "duration", "gaps")
"""Columns that go, in this order, where there is no room; the details name time and size too."""
PADDING = 2
"""Blanks around a cell."""
LONGEST_NAME = 40
TAIL = 11
"""Characters at the end of a shortened name: names of one experiment differ there."""


def row_of(entry: LibraryEntry, mark: str, colours: Mapping[str, str]) -> dict[str, Text]:
    """Return the cells of a recording by column.

    Args:
        entry: The recording.
        mark: Its mark; empty for none.
        colours: Colours of the theme.
    """
    gaps = Text(format_count(entry.gaps), justify="right")
    if entry.gaps:
        gaps.stylize(f"bold {colours['warning']}")
    outcome = outcome_label(entry.status).text(dict(colours)) if entry.status else None
    return {
        "mark": Text(mark, style=f"bold {colours['accent']}"),
        "name": Text(entry.path.name.removesuffix(".mcap")),
        "status": outcome or Text("…", style=colours["muted"]),
        "rig": Text(entry.rig or "–"),
        "duration": Text(format_duration(entry.duration), justify="right"),
        "samples": Text(format_count(entry.samples), justify="right"),
        "gaps": gaps,
        "size": Text(format_size(entry.size), justify="right"),
        "when": Text(entry.when, style=colours["muted"]),
        "reason": Text(
            entry.fault or entry.reason, style=colours["muted"], no_wrap=True, overflow="ellipsis"
        ),
    }


def fit_columns(rows: Sequence[Mapping[str, Text]], room: int) -> dict[str, int]:
    """Return the widths of the columns that have room, with their cells uncut but for names and reasons.

    Args:
        rows: Cells of the recordings by column.
        room: Columns of the terminal.
    """
    widths = {
        key: max([least, *(row[key].cell_len for row in rows)])
        for key, (_, least) in COLUMNS.items()
        if key != "reason"
    }
    widths["name"] = min(widths["name"], LONGEST_NAME)
    for key in LEAST_IMPORTANT:
        excess = _total(widths) - room
        if excess <= widths["name"] - COLUMNS["name"][1]:
            break
        del widths[key]
    excess = max(0, _total(widths) - room)
    widths["name"] = max(COLUMNS["name"][1], widths["name"] - excess)
    rest = room - _total(widths) - PADDING
    return widths | ({"reason": rest} if rest >= COLUMNS["reason"][1] else {})


def _total(widths: Mapping[str, int]) -> int:
    return sum(widths.values()) + PADDING * len(widths)


def cells(row: Mapping[str, Text], widths: Mapping[str, int]) -> list[Text]:
    """Return the cells of the visible columns; a long name has an ellipsis before its end."""
    name, width = row["name"].plain, widths["name"]
    if len(name) > width:
        name = f"{name[: width - TAIL - 1]}…{name[-TAIL:]}"
    return [Text(name) if key == "name" else row[key] for key in widths]

"""What an import of a foreign table says: extent, signals, notes, and what was dropped and why."""

from __future__ import annotations

from labhil.recording.bad_rows import REASONS
from labhil.recording.tables import EDGE, PART, ImportedTable


def describe_import(table: ImportedTable, *, max_rate_difference: float = 0.02) -> list[str]:
    """Describe an import for users.

    Args:
        table: the imported table.
        max_rate_difference: relative difference of mean and median rate from which both are shown.

    Returns:
        Lines of text.
    """
    signals = ", ".join(f"{signal.name} [{signal.unit}]" for signal in table.stream.signals)
    extent = f"{table.t[-1]:.6g} s at {table.stream.rate:.6g} Hz"
    mean = (len(table) - 1) / table.t[-1]
    if abs(mean / table.stream.rate - 1.0) > max_rate_difference:
        extent += f" (by the median step; {mean:.4g} rows a second on average)"
    lines = [f"{table.source}: {len(table)} of {table.rows} rows, {extent}", f"signals: {signals}"]
    lines += table.notes
    why = {
        **REASONS,
        EDGE: "before the first or after the last sample of a slower channel",
        PART: "in other parts",
    }
    lines += [
        f"dropped: {count} rows {why[reason]}{_first_bad(table, reason)}"
        for reason, count in table.dropped.items()
        if count
    ]
    lines += [
        f"outside [limits], kept: {count} rows of {name}" for name, count in table.outside.items() if count
    ]
    return lines


def _first_bad(table: ImportedTable, reason: str) -> str:
    return f", the first in {table.first_bad[reason]}" if reason in table.first_bad else ""

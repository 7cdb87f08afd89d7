"""Excluded and undecided effects, grouped for tables: the joints of an arm side by side.

``text.py``, the pages in ``html/`` and the screen show these groups.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field

from rich.table import Table

from labhil.analysis.schema import ExcludedEffect, UndecidedEffect
from labhil.physics.terms import keyed, listed
from labhil.report.formatting import format_quantity


@dataclass(frozen=True, slots=True)
class TermLimits:
    """Detection limits of one term of an arm, by joint.

    Attributes:
        term: Name of the term.
        unit: SI unit of the limits.
        largest: Largest size that could hide, by joint; joints without a limit are absent.
    """

    term: str
    unit: str
    largest: dict[int, float | None] = field(default_factory=dict)


def limits_by_joint(excluded: Iterable[ExcludedEffect]) -> list[TermLimits]:
    """Group the excluded effects of joints by term, in the order of the terms."""
    rows: dict[tuple[str, str], TermLimits] = {}
    for effect in excluded:
        if effect.joint is not None:
            row = rows.setdefault((effect.term, effect.unit), TermLimits(effect.term, effect.unit))
            row.largest[effect.joint] = effect.largest_hidden
    return list(rows.values())


def joints_in(rows: Iterable[TermLimits]) -> list[int]:
    """Return all joints that have a limit in any row."""
    return sorted({joint for row in rows for joint in row.largest})


def joints_table(rows: Sequence[TermLimits], style: str) -> Table:
    """Make a table of detection limits with a row for each term and a column for each joint.

    Args:
        rows: The limits.
        style: Style of all text, as rich understands it.
    """
    table = Table(box=None, pad_edge=False, padding=(0, 2, 0, 0), style=style, header_style=style)
    joints = joints_in(rows)
    table.add_column("effect", no_wrap=True)
    for joint in joints:
        table.add_column(str(joint), justify="right", no_wrap=True)
    table.add_column("unit", no_wrap=True)
    for row in rows:
        cells = [format_quantity(row.largest.get(joint), digits=2) for joint in joints]
        table.add_row(row.term, *cells, row.unit if row.unit != "1" else "")
    return table


@dataclass(frozen=True, slots=True)
class UndecidedGroup:
    """A term on which the data cannot decide, for all joints with the same reason.

    Attributes:
        name: Name of the term, with its joints in brackets.
        reason: Why, as part of a sentence.
        needs: Missing channels.
    """

    name: str
    reason: str
    needs: tuple[str, ...]


def group_undecided(undecided: Iterable[UndecidedEffect]) -> list[UndecidedGroup]:
    """Group undecided effects by term and reason, in the order of the terms."""
    keys: dict[tuple[str, str, tuple[str, ...]], list[str]] = {}
    for effect in undecided:
        names = keys.setdefault((effect.term, effect.reason, effect.needs), [])
        names.append(keyed(effect.term, effect.joint))
    return [UndecidedGroup(listed(names)[0], reason, needs) for (_, reason, needs), names in keys.items()]

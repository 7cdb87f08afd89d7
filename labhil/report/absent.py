"""What is not there, and of what data cannot speak: the joints of an arm side by side."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field
from typing import Protocol

from rich.table import Table

from labhil.physics.terms import keyed, listed
from labhil.report.html.quantity import quantity


class Limit(Protocol):
    """The largest size of a term's main parameter that could hide."""

    @property
    def term(self) -> str:
        """Its name."""
        ...

    @property
    def joint(self) -> int | None:
        """The one that it acts on, where terms have one each."""
        ...

    @property
    def unit(self) -> str:
        """Of the parameter."""
        ...

    @property
    def largest_hidden(self) -> float | None:
        """None where it is not known."""
        ...


@dataclass(frozen=True, slots=True)
class OfJoints:
    """That of a term of an arm in its ``unit``, by joint; a joint of which nothing is said is not in it."""

    term: str
    unit: str
    largest: dict[int, float | None] = field(default_factory=dict)


def of_joints(limits: Iterable[Limit]) -> list[OfJoints]:
    """A row for each term of a joint, in the order of the terms."""
    rows: dict[tuple[str, str], OfJoints] = {}
    for limit in limits:
        if limit.joint is not None:
            row = rows.setdefault((limit.term, limit.unit), OfJoints(limit.term, limit.unit))
            row.largest[limit.joint] = limit.largest_hidden
    return list(rows.values())


def joints_in(rows: Iterable[OfJoints]) -> list[int]:
    """All joints of which something is said."""
    return sorted({joint for row in rows for joint in row.largest})


def joints_table(rows: Sequence[OfJoints], style: str) -> Table:
    """What could still hide, a column for each joint."""
    table = Table(box=None, pad_edge=False, padding=(0, 2, 0, 0), style=style, header_style=style)
    joints = joints_in(rows)
    table.add_column("effect", no_wrap=True)
    for joint in joints:
        table.add_column(str(joint), justify="right", no_wrap=True)
    table.add_column("unit", no_wrap=True)
    for row in rows:
        cells = [quantity(row.largest.get(joint), digits=2) for joint in joints]
        table.add_row(row.term, *cells, row.unit if row.unit != "1" else "")
    return table


class Silent(Protocol):
    """A term of which data cannot speak."""

    @property
    def term(self) -> str:
        """Its name."""
        ...

    @property
    def joint(self) -> int | None:
        """The one that it acts on, where terms have one each."""
        ...

    @property
    def needs(self) -> Sequence[str]:
        """Channels that are not there."""
        ...

    @property
    def reason(self) -> str:
        """Why, as part of a sentence."""
        ...


@dataclass(frozen=True, slots=True)
class Silence:
    """Why data cannot speak of a ``name``: a term, with all of its joints in brackets."""

    name: str
    reason: str
    needs: tuple[str, ...]


def silences(undecided: Iterable[Silent]) -> list[Silence]:
    """One for each term and reason, in the order of the terms."""
    keys: dict[tuple[str, str, tuple[str, ...]], list[str]] = {}
    for each in undecided:
        of = keys.setdefault((each.term, each.reason, tuple(each.needs)), [])
        of.append(keyed(each.term, each.joint))
    return [Silence(listed(of)[0], reason, needs) for (_, reason, needs), of in keys.items()]

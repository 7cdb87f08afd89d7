"""Excluded and undecided terms, with the joints of an arm side by side."""

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
        """The joint that it acts on; None for a term without one."""
        ...

    @property
    def unit(self) -> str:
        """Unit of the parameter."""
        ...

    @property
    def largest_hidden(self) -> float | None:
        """The limit; None where it is not known."""
        ...


@dataclass(frozen=True, slots=True)
class JointLimits:
    """Limits of one term of an arm in its ``unit``, by joint; a joint without a statement is absent."""

    term: str
    unit: str
    largest: dict[int, float | None] = field(default_factory=dict)


def limits_by_joint(limits: Iterable[Limit]) -> list[JointLimits]:
    """A row for each term of a joint, in the order of the terms."""
    rows: dict[tuple[str, str], JointLimits] = {}
    for limit in limits:
        if limit.joint is not None:
            row = rows.setdefault((limit.term, limit.unit), JointLimits(limit.term, limit.unit))
            row.largest[limit.joint] = limit.largest_hidden
    return list(rows.values())


def joints_in(rows: Iterable[JointLimits]) -> list[int]:
    """All joints with a limit in any row."""
    return sorted({joint for row in rows for joint in row.largest})


def joints_table(rows: Sequence[JointLimits], style: str) -> Table:
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


class Undecided(Protocol):
    """A term on which the data cannot decide."""

    @property
    def term(self) -> str:
        """Its name."""
        ...

    @property
    def joint(self) -> int | None:
        """The joint that it acts on; None for a term without one."""
        ...

    @property
    def needs(self) -> Sequence[str]:
        """Missing channels."""
        ...

    @property
    def reason(self) -> str:
        """Why, as part of a sentence."""
        ...


@dataclass(frozen=True, slots=True)
class UndecidedTerm:
    """Why the data cannot decide on ``name``: a term, with all of its joints in brackets."""

    name: str
    reason: str
    needs: tuple[str, ...]


def group_undecided(undecided: Iterable[Undecided]) -> list[UndecidedTerm]:
    """One for each term and reason, in the order of the terms."""
    keys: dict[tuple[str, str, tuple[str, ...]], list[str]] = {}
    for term in undecided:
        names = keys.setdefault((term.term, term.reason, tuple(term.needs)), [])
        names.append(keyed(term.term, term.joint))
    return [UndecidedTerm(listed(names)[0], reason, needs) for (_, reason, needs), names in keys.items()]

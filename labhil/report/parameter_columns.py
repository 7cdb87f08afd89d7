"""The columns of the table of parameters, each declared once for every place where the table is shown.

A new column is one more :class:`Column` here: the terminal, the pages, the screen and the frames of pandas
take it from there. The name of the parameter stands before these columns, and each face's remark after them.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from labhil.analysis.schema import Number, Parameter
from labhil.report.html.quantity import NOTHING, interval, p_value, quantity

Cell = Callable[[Parameter], str]


@dataclass(frozen=True, slots=True)
class Column:
    """One column: heading and cell for the terminal, for pages and for the screen; None where it is not
    shown.

    ``frame`` holds its columns in a pandas frame. A ``reference`` column, from the reference text, stands on
    pages for comparison only.
    """

    terminal: tuple[str, Cell] | None = None
    page: tuple[str, Cell] | None = None
    screen: tuple[str, Cell] | None = None
    frame: tuple[tuple[str, Callable[[Parameter], Any]], ...] = ()
    reference: bool = False


def number_text(value: Number, format_spec: str) -> str:
    """A number; a dash where it is not known, or not finite."""
    return NOTHING if value is None else f"{value:{format_spec}}"


def p_text(probability: Number) -> str:
    """A p value as people write it: ``= 0.03``, ``<1e-99``; a dash where it is not known."""
    if probability is None:
        return NOTHING
    return "<1e-99" if probability < 1e-99 else f"= {probability:.2g}"


def _ends(row: Parameter) -> tuple[Number, Number]:
    return row.ci99 or (None, None)


def _interval(row: Parameter) -> str:
    low, high = _ends(row)
    return (
        NOTHING
        if low is None and high is None
        else f"[{number_text(low, '.4g')}, {number_text(high, '.4g')}]"
    )


COLUMNS = (
    Column(
        terminal=("value", lambda row: number_text(row.value, ".5g")),
        page=("Value", lambda row: quantity(row.value, row.unit)),
        screen=("value", lambda row: quantity(row.value, row.unit)),
        frame=(("value", lambda row: row.value), ("unit", lambda row: row.unit)),
    ),
    Column(
        terminal=("± std. error", lambda row: number_text(row.std_error, ".2g")),
        page=("Std. error", lambda row: quantity(row.std_error, digits=2)),
        frame=(("std_error", lambda row: row.std_error),),
    ),
    Column(
        page=("Reference's error", lambda row: quantity(row.std_error_reference, digits=2)),
        reference=True,
    ),
    Column(
        terminal=("99 % interval", _interval),
        page=("99 % interval", lambda row: interval(row.ci99)),
        screen=("99 % interval", lambda row: interval(row.ci99)),
        frame=(("ci_low", lambda row: _ends(row)[0]), ("ci_high", lambda row: _ends(row)[1])),
    ),
    Column(
        terminal=("z", lambda row: number_text(row.z, ".1f")),
        page=("z", lambda row: quantity(row.z, digits=3)),
        frame=(("z", lambda row: row.z),),
    ),
    Column(
        terminal=("p", lambda row: p_text(row.p_value).removeprefix("= ")),
        page=("p", lambda row: p_value(row.p_value)),
        frame=(("p_value", lambda row: row.p_value),),
    ),
    Column(
        frame=(
            ("significant", lambda row: row.significant),
            ("identifiable", lambda row: row.identifiable),
        )
    ),
)

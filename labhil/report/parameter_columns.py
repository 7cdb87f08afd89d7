"""The columns of the table of parameters, declared once for all places where it is shown.

A new :class:`ParameterColumn` in ``COLUMNS`` appears in the terminal, on pages, on the screen and in pandas
frames. The name of the parameter comes before these columns, and a remark after them.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from labhil.analysis.schema import Number, Parameter
from labhil.report.formatting import (
    NOTHING,
    format_interval,
    format_number,
    format_p,
    format_p_value,
    format_quantity,
)

Cell = Callable[[Parameter], str]


@dataclass(frozen=True, slots=True)
class ParameterColumn:
    """Declare one column: heading and cell for each place; None where it is not shown.

    Attributes:
        terminal: In a terminal.
        page: On HTML pages.
        screen: In the terminal UI.
        frame: Columns of a pandas frame, with their values.
        reference: Whether it compares with the reference text, and only pages of fits show it.
    """

    terminal: tuple[str, Cell] | None = None
    page: tuple[str, Cell] | None = None
    screen: tuple[str, Cell] | None = None
    frame: tuple[tuple[str, Callable[[Parameter], Any]], ...] = ()
    reference: bool = False


def _ends(row: Parameter) -> tuple[Number, Number]:
    return row.ci99 or (None, None)


def _interval(row: Parameter) -> str:
    low, high = _ends(row)
    return (
        NOTHING
        if low is None and high is None
        else f"[{format_number(low, '.4g')}, {format_number(high, '.4g')}]"
    )


COLUMNS = (
    ParameterColumn(
        terminal=("value", lambda row: format_number(row.value, ".5g")),
        page=("Value", lambda row: format_quantity(row.value, row.unit)),
        screen=("value", lambda row: format_quantity(row.value, row.unit)),
        frame=(("value", lambda row: row.value), ("unit", lambda row: row.unit)),
    ),
    ParameterColumn(
        terminal=("± std. error", lambda row: format_number(row.std_error, ".2g")),
        page=("Std. error", lambda row: format_quantity(row.std_error, digits=2)),
        frame=(("std_error", lambda row: row.std_error),),
    ),
    ParameterColumn(
        page=("Reference's error", lambda row: format_quantity(row.std_error_reference, digits=2)),
        reference=True,
    ),
    ParameterColumn(
        terminal=("99 % interval", _interval),
        page=("99 % interval", lambda row: format_interval(row.ci99)),
        screen=("99 % interval", lambda row: format_interval(row.ci99)),
        frame=(("ci_low", lambda row: _ends(row)[0]), ("ci_high", lambda row: _ends(row)[1])),
    ),
    ParameterColumn(
        terminal=("z", lambda row: format_number(row.z, ".1f")),
        page=("z", lambda row: format_quantity(row.z, digits=3)),
        frame=(("z", lambda row: row.z),),
    ),
    ParameterColumn(
        terminal=("p", lambda row: format_p(row.p_value)),
        page=("p", lambda row: format_p_value(row.p_value)),
        frame=(("p_value", lambda row: row.p_value),),
    ),
    ParameterColumn(
        frame=(
            ("significant", lambda row: row.significant),
            ("identifiable", lambda row: row.identifiable),
        )
    ),
)

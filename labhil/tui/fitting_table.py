"""A table whose figures are never cut: where they have no room side by side, they go below."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

from rich.console import Console, ConsoleOptions, RenderableType, RenderResult
from rich.style import StyleType
from rich.table import Table
from rich.text import Text

WIDEST = 1000
"""Columns in which any table has room."""

INDENT = "  "
GAP = 2
"""Columns between two figures."""


def has_room(table: Table, console: Console, options: ConsoleOptions) -> bool:
    """Return whether a table is drawn without cutting or wrapping any cell."""
    wide = options.update(max_width=WIDEST)
    return console.measure(table, options=wide).maximum <= options.max_width


@dataclass(frozen=True, slots=True)
class FittingTable:
    """Draw a table; where it has no room, the figures of each row stand below its texts.

    Attributes:
        table: The table. Its first columns are texts, up to the first one that is aligned on the right.
    """

    table: Table

    def __rich_console__(self, console: Console, options: ConsoleOptions) -> RenderResult:
        """Draw the table in as few lines as the width allows."""
        if has_room(self.table, console, options):
            yield self.table
        else:
            yield from self._below(options.max_width)

    @property
    def _texts(self) -> int:
        """Number of columns before the figures."""
        aligned = [column.justify == "right" for column in self.table.columns]
        return aligned.index(True) if True in aligned else len(aligned)

    def _below(self, width: int) -> Iterator[Text]:
        texts = self._texts
        headings = [_text(column.header) for column in self.table.columns]
        columns = [[_text(cell) for cell in column.cells] for column in self.table.columns]
        widths = [
            max(text.cell_len for text in (heading, *cells))
            for heading, cells in zip(headings[texts:], columns[texts:], strict=True)
        ]
        side_by_side = len(INDENT) + sum(widths) + GAP * (len(widths) - 1) <= width
        if side_by_side:
            yield self._styled(self._aligned(headings[texts:], widths), self.table.header_style)
        for row, cells in zip(self.table.rows, zip(*columns, strict=True), strict=True):
            lines = [Text(" ").join(text for text in cells[:texts] if text.plain)]
            if side_by_side:
                lines.append(self._aligned(cells[texts:], widths))
            else:
                lines += _one_by_one(headings[texts:], cells[texts:])
            yield from (self._styled(line, row.style or "") for line in lines)

    def _styled(self, line: Text, style: StyleType) -> Text:
        """A line in the style of its row."""
        return Text.assemble(line, style=style or self.table.style)

    def _aligned(self, cells: Sequence[Text], widths: Sequence[int]) -> Text:
        line = Text(INDENT)
        for cell, width, column in zip(cells, widths, self.table.columns[self._texts :], strict=True):
            padding = " " * (width - cell.cell_len)
            is_right = column.justify == "right"
            line.append(padding if is_right else "").append_text(cell)
            line.append("" if is_right else padding).append(" " * GAP)
        line.rstrip()
        return line


def _text(cell: RenderableType) -> Text:
    """A cell as a text in one line."""
    return Text(" ").join(cell.split()) if isinstance(cell, Text) else Text(str(cell))


def _one_by_one(headings: Sequence[Text], cells: Sequence[Text]) -> Iterator[Text]:
    """Each figure in a line of its own, behind its heading."""
    for heading, cell in zip(headings, cells, strict=True):
        if cell.plain:
            yield Text.assemble(INDENT, heading, " " if heading.plain else "", cell)

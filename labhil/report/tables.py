"""The form of the tables in a terminal, shared by the texts of all results."""

from __future__ import annotations

from collections.abc import Sequence

from rich.table import Table


def titled_table(
    title: str, text_columns: Sequence[str], number_columns: Sequence[str] = (), *, wrap: bool = False
) -> Table:
    """Make an empty table without a frame, under a title in bold.

    Args:
        title: Text above the table.
        text_columns: Headings of the first columns, which hold text.
        number_columns: Headings of the columns after them, which hold numbers, aligned at the right.
        wrap: Whether cells may be wrapped where room is short.
    """
    table = Table(title=title, title_justify="left", title_style="bold", box=None, pad_edge=False)
    for name in text_columns:
        table.add_column(name, no_wrap=not wrap)
    for name in number_columns:
        table.add_column(name, justify="right", no_wrap=not wrap)
    return table

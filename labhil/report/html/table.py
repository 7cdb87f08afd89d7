"""Tables, lists and tiles of a page, with captions and headers for screen readers."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

from labhil.report.html.element import Content, Markup, join, tag


@dataclass(frozen=True, slots=True)
class Column:
    """Declare a column: its heading, and whether it holds numbers, which are aligned at the right."""

    title: Content
    number: bool = False


def text(*titles: str) -> tuple[Column, ...]:
    """Declare columns of text."""
    return tuple(Column(title) for title in titles)


def numbers(*titles: str) -> tuple[Column, ...]:
    """Declare columns of numbers."""
    return tuple(Column(title, number=True) for title in titles)


def table(caption: str, columns: Sequence[Column], rows: Iterable[Sequence[Content]]) -> Markup:
    """Make a table, which scrolls by itself on a narrow screen.

    Args:
        caption: Caption of the table.
        columns: The columns.
        rows: Cells of each row; the first is the header of its row.
    """
    heading = tag("tr", *(tag("th", c.title, scope="col", class_=_class(c)) for c in columns))
    element = tag(
        "table",
        tag("caption", caption),
        tag("thead", heading),
        tag("tbody", *(_row(columns, row) for row in rows)),
    )
    return tag("div", element, class_="wide", role="region", aria_label=caption, tabindex=0)


def _row(columns: Sequence[Column], cells: Sequence[Content]) -> Markup:
    first, *others = zip(columns, cells, strict=True)
    return tag(
        "tr",
        tag("th", first[1], scope="row", class_=_class(first[0])),
        *(tag("td", cell, class_=_class(column)) for column, cell in others),
    )


def _class(column: Column) -> str | None:
    return "number" if column.number else None


def facts(pairs: Iterable[tuple[Content, Content]], class_: str | None = None) -> Markup:
    """Make a list of names and values.

    Args:
        pairs: Names and values.
        class_: Class of the element; "row" puts all pairs in one row.
    """
    entries = (tag("div", tag("dt", name), tag("dd", value)) for name, value in pairs)
    return tag("dl", *entries, class_=class_)


def tiles(entries: Iterable[tuple[str, Content, Content]]) -> Markup:
    """Make tiles of key figures: name, value and remark of each."""
    return tag(
        "dl",
        *(
            tag("div", tag("dt", name), tag("dd", value), tag("dd", remark, class_="remark"))
            for name, value, remark in entries
        ),
        class_="tiles",
    )


def with_code(text: str) -> Markup:
    """Return a text with its parts between backticks as code."""
    return join(tag("code", piece) if i % 2 else piece for i, piece in enumerate(text.split("`")))


def bullets(lines: Iterable[Content]) -> Markup:
    """Make a list with bullets."""
    return tag("ul", *(tag("li", line) for line in lines))

"""The title and the legend of a chart, in one line where they have room, and in two otherwise."""

from __future__ import annotations

from collections.abc import Sequence

from rich.text import Text

MORE = "…"


def chart_heading(title: Text, entries: Sequence[Text], columns: int, *, gap: str = "   ") -> Text:
    """Return the heading of a chart, in which no word is cut.

    Where one line has no room for all, the entries take a second one. What has no room even so is left out
    from the end, in whole words of the title and in whole entries, with an ellipsis in its place.

    Args:
        title: The title.
        entries: Values and entries of the legend, each of which stays in one piece.
        columns: Width of a line; 0 where it is not known yet.
        gap: Text between the title and the entries.
    """
    separator = Text(gap)
    whole = separator.join([title, *entries])
    if whole.cell_len <= columns or not columns:
        return one_line(whole)
    first = whole_words(title, columns)
    if not entries:
        return one_line(first)
    return one_line(Text("\n").join([first, _whole_entries(entries, columns, separator)]))


def one_line(text: Text) -> Text:
    """Return the text, with no line of it wrapped."""
    line = text.copy()
    line.no_wrap, line.overflow = True, "ellipsis"
    return line


def whole_words(text: Text, columns: int) -> Text:
    """Return the words of a text that have room, with an ellipsis in the place of the others.

    A first word that has no room is cut.
    """
    if text.cell_len <= columns:
        return text
    kept = text.copy()
    kept.truncate(columns - 1)
    if len(kept) and not text.plain[len(kept) :].startswith(" "):
        kept = kept[: kept.plain.rfind(" ") + 1] if " " in kept.plain.strip() else kept
    return kept[: len(kept.plain.rstrip(" ,:"))].append(MORE)


def _whole_entries(entries: Sequence[Text], columns: int, separator: Text) -> Text:
    """The first entries that have room, with an ellipsis in the place of the others."""
    for number in range(len(entries), 0, -1):
        more = [] if number == len(entries) else [Text(MORE)]
        line = separator.join([*entries[:number], *more])
        if line.cell_len <= columns:
            return line
    return whole_words(entries[0], columns)

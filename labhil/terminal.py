"""The way out to a terminal: everything that is printed for people goes through here.

Names and texts come from files, buses and devices. A control character in one of them could move the
cursor, retitle the window or reorder what is shown; such characters are printed as escapes instead.
"""

from __future__ import annotations

import re
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from rich.console import Console
    from rich.table import Table

# Everything that Unicode calls a control (Cc), a format character (Cf: bidirectional overrides, zero-width
# marks, tags), half a surrogate pair (Cs) or a line separator (Zl, Zp). Line feed and tab lay text out.
_LAYOUT = "\n\t"
_FORMAT = (
    "\x7f-\x9f\u00ad\u0600-\u0605\u061c\u06dd\u070f\u0890\u0891\u08e2\u180e\u200b-\u200f\u2028-\u202e"
    "\u2060-\u206f\ud800-\udfff\ufeff\ufff9-\ufffb\U000110bd\U000110cd\U00013430-\U0001343f"
    "\U0001bca0-\U0001bca3\U0001d173-\U0001d17a\U000e0001\U000e0020-\U000e007f"
)
_UNPRINTABLE = re.compile(f"[\x00-\x08\x0b-\x1f{_FORMAT}]")
_UNPRINTABLE_IN_JSON = re.compile(f"[{_FORMAT}]")

LONGEST_NAME = 120
"""Characters of a name that a message shows: a line of a terminal; longer ones are cut, with an ellipsis."""

WIDEST_TABLE = 10_000
"""Characters of a line that no table reaches."""


def printable(text: object) -> str:
    r"""Return a text with every character that could steer a terminal as an escape.

    Line feeds and tabs stay.

    Example:
        >>> printable("speed\x1b[31m")
        'speed\\x1b[31m'
    """
    return _UNPRINTABLE.sub(_escape, str(text))


def printable_name(name: object) -> str:
    r"""Return a name from outside for use within a line: escaped, line feeds too, and cut where it is long.

    Example:
        >>> printable_name("speed\nall is well")
        'speed\\nall is well'
    """
    text = str(name)
    if len(text) > LONGEST_NAME:
        text = text[:LONGEST_NAME] + "…"
    return printable(text).replace("\n", "\\n").replace("\t", "\\t")


def printable_json(text: str) -> str:
    """Return JSON text whose strings hold escapes for what could steer a terminal; it means the same."""
    return _UNPRINTABLE_IN_JSON.sub(_escape_in_json, text)


def show(*texts: object) -> None:
    """Print a result: a line on stdout for each text."""
    for text in texts:
        print(printable(text), flush=True)


def complain(*texts: object) -> None:
    """Print what a person should know beside the result: a line on stderr for each text."""
    for text in texts:
        print(printable(text), file=sys.stderr, flush=True)


def terminal(**options: Any) -> Console:
    """Return rich's console with all that it prints made printable; ``options`` are those of rich.

    A table is as wide as its numbers need: a line that a terminal breaks is better than half a number.
    """
    from rich.console import Console
    from rich.segment import Segment
    from rich.table import Table

    class PrintableConsole(Console):
        """Escapes strings before they are laid out, and whatever else is printed after that."""

        def print(self, *objects: Any, **styles: Any) -> None:
            super().print(*objects, **{"crop": False, **styles})

        def render_str(self, text: str, **styles: Any) -> Any:
            return super().render_str(printable(text), **styles)

        def render(self, renderable: Any, options: Any = None) -> Any:
            if isinstance(renderable, Table):
                _keep_cells_whole(self, renderable)
            for segment in super().render(renderable, options):
                if segment.control or not _UNPRINTABLE.search(segment.text):
                    yield segment
                else:
                    yield Segment(printable(segment.text), segment.style)

    # [red] and :smile: in a name are part of the name
    return PrintableConsole(**{"markup": False, "emoji": False, **options})


def _keep_cells_whole(console: Console, table: Table) -> None:
    """Give the columns of a table the room that their words need, and that unbroken cells need as a whole."""
    wide = console.options.update(width=WIDEST_TABLE)
    for column in table.columns:
        sizes = [console.measure(cell, options=wide) for cell in (column.header, *column.cells)]
        column.min_width = max(size.maximum if column.no_wrap else size.minimum for size in sizes)


@contextmanager
def status() -> Iterator[Callable[[str], None]]:
    """Show what is being done on stderr: a line that changes on a terminal, lines elsewhere."""
    console = terminal(stderr=True)
    if not console.is_terminal:
        yield lambda text: console.print(text, highlight=False, soft_wrap=True)
        return
    from rich.text import Text

    # a bare string would be read as markup there
    with console.status(Text("starting")) as line:
        yield lambda text: line.update(Text(printable(text)))


def _escape(match: re.Match[str]) -> str:
    return match.group().encode("unicode_escape", "surrogatepass").decode("ascii")


def _escape_in_json(match: re.Match[str]) -> str:
    units = match.group().encode("utf-16-be", "surrogatepass").hex()
    return "".join(f"\\u{units[start : start + 4]}" for start in range(0, len(units), 4))

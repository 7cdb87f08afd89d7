"""Results as text and as HTML of a notebook, and as frames of pandas and xarray."""

from __future__ import annotations

import io
from collections.abc import Iterable, Mapping, Sequence
from typing import TYPE_CHECKING, Any

from labhil.errors import UnknownNameError, UsageError
from labhil.extras import load_optional
from labhil.terminal import terminal

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from rich.console import RenderableType

WIDTH = 140
"""Characters of a line, as the commands write where there is no terminal."""

HTML = "<pre style=\"font-family:'DejaVu Sans Mono',monospace;line-height:1.25;overflow-x:auto\">{code}</pre>"


def text_of(renderables: Iterable[RenderableType], width: int = WIDTH) -> str:
    """What the command line prints, without colours and without spaces at the ends of lines."""
    written = io.StringIO()
    console = terminal(width=width, file=written, color_system=None)
    for renderable in renderables:
        console.print(renderable)
    return "\n".join(line.rstrip() for line in written.getvalue().splitlines())


def html_of(renderables: Iterable[RenderableType], width: int = WIDTH) -> str:
    """The same with its colours, for a notebook; every value is escaped."""
    console = terminal(width=width, file=io.StringIO(), record=True)
    for renderable in renderables:
        console.print(renderable)
    return str(console.export_html(inline_styles=True, code_format=HTML))


def data_frame(columns: Mapping[str, Any], index: Any = None, index_name: str | None = None) -> Any:
    """A pandas DataFrame; MissingExtraError says what to install where pandas is not there."""
    pd = load_optional("pandas", "to_pandas")
    frame = pd.DataFrame(dict(columns), index=index)
    frame.index.name = index_name
    return frame


def data_set(
    variables: Mapping[str, tuple[Sequence[str], Any, Mapping[str, str]]],
    coordinates: Mapping[str, Any],
    attributes: Mapping[str, Any],
) -> Any:
    """An xarray Dataset; MissingExtraError says what to install where xarray is not there."""
    xr = load_optional("xarray", "to_xarray")
    return xr.Dataset(
        {
            name: (list(dimensions), values, dict(about))
            for name, (dimensions, values, about) in variables.items()
        },
        coords=dict(coordinates),
        attrs=dict(attributes),
    )


def channel_of(channel: int | str, names: Sequence[str]) -> int:
    """The place of an output that is given by its place or its name."""
    if isinstance(channel, str):
        if channel not in names:
            raise UnknownNameError("output", channel, names)
        return list(names).index(channel)
    if isinstance(channel, bool) or not isinstance(channel, int) or not 0 <= channel < len(names):
        raise UsageError(
            f"channel: expected a number from 0 to {len(names) - 1} or one of {', '.join(names)}, "
            f"found {channel!r}"
        )
    return channel


def axes_of(ax: Axes | None, size: tuple[float, float] = (9.0, 4.0)) -> Axes:
    """The axes to draw into: the given ones, or new ones.

    New ones belong to pyplot where it is imported, so that a notebook shows them; else they need no display.
    """
    if ax is not None:
        if not hasattr(ax, "plot"):
            raise UsageError(f"ax: expected axes of matplotlib, found {ax!r:.80} ({type(ax).__name__})")
        return ax
    import sys

    if "matplotlib.pyplot" in sys.modules:
        plt = sys.modules["matplotlib.pyplot"]
        axes: Axes = plt.subplots(figsize=size, layout="constrained")[1]
        return axes
    from labhil.report.figure import figure_of

    return figure_of(size).subplots()

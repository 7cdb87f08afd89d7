"""Conversion of results to text, HTML for notebooks, and data of pandas and xarray."""

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
"""Characters of a line, as in the output of commands without a terminal."""

HTML = "<pre style=\"font-family:'DejaVu Sans Mono',monospace;line-height:1.25;overflow-x:auto\">{code}</pre>"


def text_of(renderables: Iterable[RenderableType], width: int = WIDTH) -> str:
    """Return the output of the command line, without colours and trailing spaces."""
    output = io.StringIO()
    console = terminal(width=width, file=output, color_system=None)
    for renderable in renderables:
        console.print(renderable)
    return "\n".join(line.rstrip() for line in output.getvalue().splitlines())


def html_of(renderables: Iterable[RenderableType], width: int = WIDTH) -> str:
    """Return the output of the command line with its colours as HTML; every value is escaped."""
    console = terminal(width=width, file=io.StringIO(), record=True)
    for renderable in renderables:
        console.print(renderable)
    return str(console.export_html(inline_styles=True, code_format=HTML))


def data_frame(columns: Mapping[str, Any], index: Any = None, index_name: str | None = None) -> Any:
    """Make a pandas DataFrame.

    Raises:
        MissingExtraError: pandas is not installed.
    """
    pd = load_optional("pandas", "to_pandas")
    frame = pd.DataFrame(dict(columns), index=index)
    frame.index.name = index_name
    return frame


def data_set(
    variables: Mapping[str, tuple[Sequence[str], Any, Mapping[str, str]]],
    coordinates: Mapping[str, Any],
    attributes: Mapping[str, Any],
) -> Any:
    """Make an xarray Dataset.

    Raises:
        MissingExtraError: xarray is not installed.
    """
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
    """Return the index of an output by its index or name.

    Raises:
        UsageError: There is no such output (also as UnknownNameError).
    """
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
    """Return the axes to draw into: ``ax``, or new ones.

    New ones belong to pyplot if it is imported, so that a notebook shows them; else they need no display.

    Raises:
        UsageError: ``ax`` are no axes.
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

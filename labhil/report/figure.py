"""Size, colours and labels that all figures of results share."""

from __future__ import annotations

from pathlib import Path

import matplotlib as mpl
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from labhil.atomic_file import atomic_file
from labhil.errors import UsageError

BEFORE, AFTER, MEASURED = "#c8553d", "#2a7f62", "#444444"


def figure_of(size: tuple[float, float]) -> Figure:
    """Make an empty figure of this size (inches) that needs no display."""
    with mpl.rc_context({"axes.grid": True}):
        figure = Figure(figsize=size, layout="constrained")
    FigureCanvasAgg(figure)
    return figure


def finish(axes: Axes, title: str, x: str, y: str) -> None:
    """Add title, labels and grid to axes, and a legend where something is labelled.

    Args:
        axes: The axes, with everything drawn.
        title: Title in bold; empty for none.
        x: Label of the x axis.
        y: Label of the y axis.
    """
    axes.set_title(title, loc="left", fontsize=10, fontweight="bold")
    axes.set_xlabel(x)
    axes.set_ylabel(y)
    axes.grid(alpha=0.3)
    if axes.get_legend_handles_labels()[0]:
        axes.legend(fontsize=8, markerscale=4, framealpha=0.8, edgecolor="none")


def save(figure: Figure, path: Path) -> None:
    """Write a figure to a file.

    Args:
        figure: The figure.
        path: The file; its extension decides the format.

    Raises:
        UsageError: The file cannot be written, or its extension is no format of figures.
        DiskFailedError: The disk is full or fails.
    """
    try:
        with atomic_file(path, "the plot") as draft:
            figure.savefig(draft, dpi=110)
    except ValueError as error:
        raise UsageError(f"{path}: the plot cannot be written: {error}") from error

"""Curves as braille characters, a whole picture at a time.

A cell of the terminal holds 2 x 4 dots. Coordinates are in dots from the upper left corner; dots outside are
cut off.
"""

from __future__ import annotations

from collections.abc import Iterator
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from labhil.signals import FloatArray, IntArray

ACROSS, DOWN = 2, 4
BITS = np.array([[0x01, 0x08], [0x02, 0x10], [0x04, 0x20], [0x40, 0x80]], dtype=np.uint8)
"""Bit of each dot in a braille character, by row and column."""
FIRST_BRAILLE, BLANK = 0x2800, 0x20
NO_OWNER = -1

Mask = NDArray[np.bool_]


class Raster:
    """Hold ``columns`` x ``rows`` cells; a curve covers the cells of earlier ones."""

    def __init__(self, columns: int, rows: int) -> None:
        self.columns, self.rows = columns, rows
        self._bits = np.zeros(rows * columns, dtype=np.uint8)
        self._owner = np.full(rows * columns, NO_OWNER, dtype=np.int16)

    def dots(self, x: FloatArray, y: FloatArray, owner: int) -> None:
        """Draw a dot at each point.

        Args:
            x: (n,), dots from the left.
            y: (n,), dots from the top.
            owner: Number of the curve.
        """
        column, row = np.rint(x), np.rint(y)
        inside = (column >= 0) & (column < ACROSS * self.columns) & (row >= 0) & (row < DOWN * self.rows)
        self._put(column[inside].astype(np.int64), row[inside].astype(np.int64), owner)

    def line(self, x: FloatArray, y: FloatArray, owner: int, drawn: Mask | None = None) -> None:
        """Join points by straight lines.

        Args:
            x: (n,), dots from the left.
            y: (n,), dots from the top.
            owner: Number of the curve.
            drawn: (n − 1,), which of the lines are drawn; None for all.
        """
        start, step = np.column_stack([x[:-1], y[:-1]]), np.column_stack([np.diff(x), np.diff(y)])
        if drawn is not None:
            start, step = start[drawn], step[drawn]
        start, step = _cut(start, step, (ACROSS * self.columns - 1.0, DOWN * self.rows - 1.0))
        counts = np.rint(np.abs(step).max(axis=1, initial=0.0)).astype(np.int64) + 1
        line = np.repeat(np.arange(len(counts)), counts)
        number = np.arange(len(line)) - np.repeat(np.cumsum(counts) - counts, counts)
        share = number / np.maximum(counts - 1, 1)[line]
        points = start[line] + step[line] * share[:, None]
        self.dots(points[:, 0], points[:, 1], owner)

    def _put(self, column: IntArray, row: IntArray, owner: int) -> None:
        cell = (row // DOWN) * self.columns + column // ACROSS
        bits = np.zeros_like(self._bits)
        np.bitwise_or.at(bits, cell, BITS[row % DOWN, column % ACROSS])
        hit = bits > 0
        self._bits[hit], self._owner[hit] = bits[hit], owner

    def runs(self, row: int) -> Iterator[tuple[str, int]]:
        """Yield a row of cells as pieces of text, each with its owner; blanks have the owner −1."""
        cells = slice(row * self.columns, (row + 1) * self.columns)
        bits, owner = self._bits[cells], self._owner[cells]
        edges = [0, *(np.flatnonzero(np.diff(owner)) + 1).tolist(), self.columns]
        written = np.where(bits > 0, FIRST_BRAILLE + bits.astype(np.uint32), BLANK).astype("<u4")
        text = written.tobytes().decode("utf-32-le")
        for first, stop in pairwise(edges):
            yield text[first:stop], int(owner[first])


def _cut(start: FloatArray, step: FloatArray, size: tuple[float, float]) -> tuple[FloatArray, FloatArray]:
    """The part of each step (n, 2) from a start (n, 2) that lies inside, by Liang and Barsky (1984)."""
    room = np.array(size)
    with np.errstate(divide="ignore", invalid="ignore"):
        low, high = (-0.49 - start) / step, (room + 0.49 - start) / step
    is_parallel = step == 0.0
    within = (start >= -0.49) & (start <= room + 0.49)
    enter = np.where(is_parallel, np.where(within, 0.0, np.inf), np.minimum(low, high)).max(
        axis=1, initial=0.0
    )
    leave = np.where(is_parallel, 1.0, np.maximum(low, high)).min(axis=1, initial=1.0)
    visible = enter <= leave
    first = start[visible] + enter[visible, None] * step[visible]
    return first, (leave - enter)[visible, None] * step[visible]

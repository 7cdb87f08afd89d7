"""Curves to braille characters, a whole picture at a time.

A cell of the terminal holds 2 x 4 dots. Coordinates are in dots from the upper left corner; what lies
outside is cut off.
"""

from __future__ import annotations

from collections.abc import Iterator
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from labhil.signals import FloatArray, IntArray

ACROSS, DOWN = 2, 4
BITS = np.array([[0x01, 0x08], [0x02, 0x10], [0x04, 0x20], [0x40, 0x80]], dtype=np.uint8)
"""Which bit of a braille character each dot is, by row and column."""
FIRST_BRAILLE, BLANK = 0x2800, 0x20
NOTHING = -1

Mask = NDArray[np.bool_]


class Raster:
    """``columns`` x ``rows`` cells; a curve covers what is under it, cell by cell."""

    def __init__(self, columns: int, rows: int) -> None:
        self.columns, self.rows = columns, rows
        self._bits = np.zeros(rows * columns, dtype=np.uint8)
        self._owner = np.full(rows * columns, NOTHING, dtype=np.int16)

    def dots(self, x: FloatArray, y: FloatArray, owner: int) -> None:
        """Put a dot at each point (n,); ``owner`` is whose they are."""
        column, row = np.rint(x), np.rint(y)
        inside = (column >= 0) & (column < ACROSS * self.columns) & (row >= 0) & (row < DOWN * self.rows)
        self._put(column[inside].astype(np.int64), row[inside].astype(np.int64), owner)

    def line(self, x: FloatArray, y: FloatArray, owner: int, drawn: Mask | None = None) -> None:
        """Join the points (n,); of the n - 1 steps only those where ``drawn``."""
        start, step = np.column_stack([x[:-1], y[:-1]]), np.column_stack([np.diff(x), np.diff(y)])
        if drawn is not None:
            start, step = start[drawn], step[drawn]
        start, step = _cut(start, step, (ACROSS * self.columns - 1.0, DOWN * self.rows - 1.0))
        counts = np.rint(np.abs(step).max(axis=1, initial=0.0)).astype(np.int64) + 1
        which = np.repeat(np.arange(len(counts)), counts)
        number = np.arange(len(which)) - np.repeat(np.cumsum(counts) - counts, counts)
        share = number / np.maximum(counts - 1, 1)[which]
        points = start[which] + step[which] * share[:, None]
        self.dots(points[:, 0], points[:, 1], owner)

    def _put(self, column: IntArray, row: IntArray, owner: int) -> None:
        cell = (row // DOWN) * self.columns + column // ACROSS
        bits = np.zeros_like(self._bits)
        np.bitwise_or.at(bits, cell, BITS[row % DOWN, column % ACROSS])
        hit = bits > 0
        self._bits[hit], self._owner[hit] = bits[hit], owner

    def runs(self, row: int) -> Iterator[tuple[str, int]]:
        """One row of cells as pieces of text, each with its owner; blanks have none."""
        cells = slice(row * self.columns, (row + 1) * self.columns)
        bits, owner = self._bits[cells], self._owner[cells]
        edges = [0, *(np.flatnonzero(np.diff(owner)) + 1).tolist(), self.columns]
        written = np.where(bits > 0, FIRST_BRAILLE + bits.astype(np.uint32), BLANK).astype("<u4")
        text = written.tobytes().decode("utf-32-le")
        for first, stop in pairwise(edges):
            yield text[first:stop], int(owner[first])


def _cut(start: FloatArray, step: FloatArray, size: tuple[float, float]) -> tuple[FloatArray, FloatArray]:
    """The part of each step that lies inside, after Liang and Barsky: steps (n, 2) from starts (n, 2)."""
    room = np.array(size)
    with np.errstate(divide="ignore", invalid="ignore"):
        low, high = (-0.49 - start) / step, (room + 0.49 - start) / step
    still = step == 0.0
    within = (start >= -0.49) & (start <= room + 0.49)
    enter = np.where(still, np.where(within, 0.0, np.inf), np.minimum(low, high)).max(axis=1, initial=0.0)
    leave = np.where(still, 1.0, np.maximum(low, high)).min(axis=1, initial=1.0)
    visible = enter <= leave
    first = start[visible] + enter[visible, None] * step[visible]
    return first, (leave - enter)[visible, None] * step[visible]

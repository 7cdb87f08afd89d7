"""The score card as a figure: confusions, detection over strength, and reliability of probabilities."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping
from functools import partial
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes

from labhil.campaign.proportion import Proportion
from labhil.campaign.trials.card import STRENGTH_BINS, ScoreCard
from labhil.campaign.trials.judge import NONE, OUTSIDE, UNMODELLED
from labhil.campaign.trials.show import sort_key
from labhil.physics.terms import unkeyed
from labhil.report.figure import AFTER, BEFORE, MEASURED, figure_of, finish, save

OTHER_JOINT = "right term, other joint"
WIDEST_BIN = 1.6
"""Upper end over lower end of the range without an upper end, as it is drawn."""

MARKER_OFFSET = 1.015
"""Factor in strength between a range's middle and the markers of its two proportions."""


def plot(card: ScoreCard, path: Path) -> None:
    """Draw a score card to a file.

    Raises:
        UsageError: the file cannot be written, or its format is unknown.
    """
    figure = figure_of((13.0, 8.5))
    panels = figure.subplot_mosaic([["names", "strength"], ["names", "stated"]], width_ratios=[1.6, 1.0])
    _draw_confusion(panels["names"], card)
    _draw_strength(panels["strength"], card)
    _draw_reliability(panels["stated"], card)
    save(figure, path)


def _draw_confusion(axes: Axes, card: ScoreCard) -> None:
    """Draw counts, coloured by share of their row; joints show only as names in the wrong joint."""
    pairs = Counter[tuple[str, str]]()
    for (true, named), n in card.confusion.items():
        pairs[unkeyed(true)[0], _drawn_name(true, named)] += n
    rows, columns = (sorted({pair[k] for pair in pairs}, key=sort_key) or [NONE] for k in (0, 1))
    counts = np.array([[pairs[row, column] for column in columns] for row in rows])
    axes.imshow(
        counts / np.maximum(counts.sum(axis=1, keepdims=True), 1), cmap="Greens", vmax=1.6, aspect="auto"
    )
    for i, j in zip(*np.nonzero(counts), strict=True):
        right = _is_right(rows[i], columns[j])
        axes.text(
            j, i, str(counts[i, j]), ha="center", va="center", color="k" if right else BEFORE, fontsize=8
        )
    axes.set_xticks(range(len(columns)), [_spaced(c) for c in columns], rotation=60, ha="right", fontsize=8)
    axes.set_yticks(range(len(rows)), [_spaced(r) for r in rows], fontsize=8)
    finish(axes, f"{card.rig}, {card.trials} trials: what was there, what was named", "", "")
    axes.grid(visible=False)


def _drawn_name(true: str, named: str) -> str:
    """Label of a name beside the truth."""
    if named.startswith(UNMODELLED):
        return UNMODELLED
    same = unkeyed(true)[0] == unkeyed(named)[0]
    return OTHER_JOINT if same and true != named else unkeyed(named)[0]


def _is_right(true: str, named: str) -> bool:
    """Whether a drawn name is right; an effect outside the catalogue has no name of its own."""
    return true == named or (true == OUTSIDE and named == UNMODELLED)


def _spaced(name: str) -> str:
    return name.replace("_", " ")


def _draw_strength(axes: Axes, card: ScoreCard) -> None:
    upper_ends = [*STRENGTH_BINS[1:-1], STRENGTH_BINS[-2] * WIDEST_BIN]
    middles = dict(
        zip(card.detection, (np.sqrt(np.maximum(STRENGTH_BINS[:-1], 1.0) * upper_ends)), strict=True)
    )
    for shares, colour, label, side in (
        (card.detection, MEASURED, "detected", -1),
        (card.named, AFTER, "one effect, exact", 1),
    ):
        proportions = {middles[name] * MARKER_OFFSET**side: share for name, share in shares.items()}
        _draw_proportions(axes, proportions, colour, label, side)
    axes.set_xscale("log")
    axes.set_xticks(STRENGTH_BINS[1:-1], [f"{strength:g}" for strength in STRENGTH_BINS[1:-1]])
    axes.minorticks_off()
    finish(axes, "Against the strongest effect's strength", "RMSE without it over the noise floor", "share")
    axes.legend(fontsize=8, framealpha=0.8, edgecolor="none")


def _draw_reliability(axes: Axes, card: ScoreCard) -> None:
    axes.plot([0.0, 1.0], [0.0, 1.0], color=MEASURED, lw=0.8)
    _draw_proportions(axes, {row.stated: row.right for row in card.reliability}, AFTER, None)
    title = "Stated probabilities, and how often they were right"
    finish(axes, title, "stated", "right")


def _draw_proportions(
    axes: Axes, shares: Mapping[float, Proportion], colour: str, label: str | None, side: int = 1
) -> None:
    """Draw proportions over x with 95 % limits, and the number of cases on their left (-1) or right (1)."""
    drawn = {x: share for x, share in shares.items() if share.total}
    values = np.array([share.value for share in drawn.values()])
    limits = np.array([share.limits for share in drawn.values()]).reshape(-1, 2).T
    error_bars = np.maximum(np.abs(limits - values), 0.0)
    axes.errorbar(
        list(drawn), values, yerr=error_bars, fmt="o-", color=colour, ms=4, lw=1.0, capsize=2, label=label
    )
    alignment = "left" if side > 0 else "right"
    number = partial(axes.annotate, textcoords="offset points", ha=alignment, fontsize=7, color=colour)
    for x, share in drawn.items():
        number(str(share.total), (x, share.value), (4 * side, -9))
    axes.set_ylim(-0.03, 1.05)

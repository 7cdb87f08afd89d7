"""The score card as tables and lines of text."""

from __future__ import annotations

from collections.abc import Mapping

from rich.console import Console
from rich.table import Table

from labhil.campaign.proportion import Proportion
from labhil.campaign.trials.card import ScoreCard
from labhil.campaign.trials.judge import NONE, UNMODELLED
from labhil.physics.terms import unkeyed


def show(card: ScoreCard, console: Console) -> None:
    """Print a score card; proportions have two-sided 95 % Clopper-Pearson limits in per cent."""
    drawn = "; drawn from a fixed seed: a test, no proof" if card.fixed_seed else ""
    failed = f", {card.failures} diagnoses failed" if card.failures else ""
    console.print(f"{card.rig}: {card.trials} trials{failed}{drawn}\n", highlight=False)
    console.print(_confusion(card))
    console.print(_detection(card))
    console.print(_naming("Exact answers: all effects named and nothing else", card.naming))
    console.print(_naming("The same, without a rival beside any of them", card.naming_unrivalled))
    console.print(_reliability(card))
    for line in lines(card):
        console.print(line, highlight=False, soft_wrap=True)


def lines(card: ScoreCard) -> list[str]:
    """Return a line for each figure that is a single number."""
    after = card.after_over_floor
    error = "–" if after is None else f"median {after[0]:.3f}, 90th percentile {after[1]:.3f}"
    calibration = "–" if card.calibration_error is None else f"{card.calibration_error:.3f}"
    return [
        f"False alarms where nothing was concealed: {card.false_alarms_when_empty}",
        f"False alarms on nulls, effects among them that no oracle sees: {card.false_alarms}",
        f"Single answers, right and alone: {card.unrivalled}",
        f"Left undecided where an oracle decides: {card.undecided}",
        f"Calibration error of stated probabilities: {calibration}",
        f"Modelled (80 % of the excess gone): {card.modelled}",
        f"Regime right (intersection over union at least a half): {card.overlap}",
        *([f"Right joint: {card.right_joints}"] if card.right_joints.total else []),
        f"RMSE after over the noise floor: {error}",
        f"99 % intervals that cover, all effects in the model: {card.coverage}",
        f"99 % intervals that cover, other models: {card.coverage_incomplete}",
        f"Seconds for a diagnosis (median): {card.seconds:.1f}",
    ]


def _confusion(card: ScoreCard, max_columns: int = 6) -> Table:
    """Table of counts; with more names than columns, or with joints, a list of pairs."""
    named = sorted({name for _, name in card.confusion}, key=sort_key)
    if len(named) > max_columns or any(unkeyed(n)[1] is not None for pair in card.confusion for n in pair):
        return _pairs(card)
    table = _table("What is there (rows), what was named (columns)", "")
    for name in named:
        table.add_column(name.replace("_", " "), justify="right")
    for true in sorted({true for true, _ in card.confusion}, key=sort_key):
        counts = [card.confusion.get((true, name), 0) for name in named]
        table.add_row(true, *(str(c) if c else "·" for c in counts))
    return table


def _pairs(card: ScoreCard) -> Table:
    """List of pairs of true and named term."""
    table = _table("What is there, what was named", "there", "named", "trials")
    for true, name in sorted(card.confusion, key=lambda pair: (sort_key(pair[0]), sort_key(pair[1]))):
        table.add_row(true, name, str(card.confusion[true, name]))
    return table


def sort_key(name: str) -> tuple[int, str]:
    """Return the sort key of a label: names of effects first, other labels last."""
    return (name in {NONE, UNMODELLED, "unexplained_mismatch", "not_decidable", "failed"}, name)


def _detection(card: ScoreCard) -> Table:
    table = _table("Strength of the strongest effect", "strength", "detected", "one effect, exact")
    for name, share in card.detection.items():
        if share.total:
            table.add_row(name, str(share), str(card.named[name]))
    return table


def _naming(title: str, naming: Mapping[str, Mapping[str, Proportion]]) -> Table:
    grades = list(next(iter(naming.values())))
    table = _table(title, "", *grades)
    for name, shares in naming.items():
        if shares[grades[0]].total:
            table.add_row(name, *(str(shares[grade]) for grade in grades))
    return table


def _reliability(card: ScoreCard) -> Table:
    table = _table("Stated probabilities", "stated", "mean", "right")
    for row in card.reliability:
        table.add_row(f"{row.low:.1f} to {row.high:.1f}", f"{row.stated:.2f}", str(row.right))
    return table


def _table(title: str, *columns: str) -> Table:
    table = Table(title=title, title_justify="left", title_style="bold", box=None, pad_edge=False)
    for i, column in enumerate(columns):
        table.add_column(column, justify="right" if i else "left")
    return table

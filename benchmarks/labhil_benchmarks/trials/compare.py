"""Score cards side by side, as a table for a page: ``labhil trial compare``."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

from labhil.documents import parse_json
from labhil.errors import UsageError

SCHEMA = "labhil.score/"
Card = Mapping[str, Any]

ROWS: Mapping[str, Callable[[Card], str]] = {
    "trials, half of them drawn as nulls": lambda card: str(card["trials"]),
    "false alarms where nothing was concealed": lambda card: _share(card["false_alarms_with_nothing"]),
    "the same with effects that no oracle sees": lambda card: _share(card["false_alarms"]),
    "one effect, exact, strength 3 or more": lambda card: _share(card["naming"]["one effect"]["full"]),
    "one effect, exact, strength 1.3 or more": lambda card: _share(
        card["naming"]["one effect"]["weak or more"]
    ),
    "one effect, strength 3 or more: right and no rival beside it": lambda card: _share(
        card["single_naming"]["one effect"]["full"]
    ),
    "two effects: both and nothing else": lambda card: _share(card["naming"]["two effects"]["any"]),
    "three effects": lambda card: _share(card["naming"]["three effects"]["any"]),
    "outside the catalogue: not misnamed": lambda card: _share(
        card["naming"]["outside the catalogue"]["any"]
    ),
    "all trials with effects: right and no rival beside any": lambda card: _share(card["single_answers"]),
    "`not_decidable` where an oracle decides": lambda card: _share(card["not_decidable"]),
    "calibration error of stated probabilities": lambda card: _number(card["calibration_error"]),
    "80 % of the excess gone": lambda card: _share(card["modelled"]),
    "held-out RMSE after over noise floor, median; 90th percentile": lambda card: _after(
        card["rmse_after_over_noise_floor"]
    ),
    "99 % intervals that cover, model complete": lambda card: _share(card["interval_coverage"]),
    "the same, model not complete": lambda card: _share(card["interval_coverage_other"]),
    "right joint": lambda card: _share(card["right_joint"]),
    "right regime": lambda card: _share(card["regime_overlap"]),
    "seconds for a diagnosis, median of all trials": lambda card: f"{card['seconds_median']:.1f}",
}
"""The rows of the table, and how each is read from a card."""


def compare_cards(paths: Sequence[Path]) -> str:
    """A Markdown table of score cards, a column each by the file's name.

    Shares with what was counted and two-sided 95 % limits. UsageError for a file that is no score card.
    """
    cards = {path.stem: _read(path) for path in paths}
    head = ["| | " + " | ".join(f"`{name}`" for name in cards) + " |", "|---" * (len(cards) + 1) + "|"]
    rows = [
        f"| {name} | " + " | ".join(tell(card) for card in cards.values()) + " |"
        for name, tell in ROWS.items()
    ]
    return "\n".join([*head, *rows])


def _read(path: Path) -> Card:
    try:
        card = parse_json(path.read_text(encoding="utf-8"))
    except (OSError, ValueError) as error:
        raise UsageError(f"{path}: expected a score card (labhil trial score --json): {error}") from error
    if not isinstance(card, dict) or not str(card.get("schema", "")).startswith(SCHEMA):
        raise UsageError(f"{path}: expected a score card (labhil trial score --json), found another file")
    return card


def _share(share: Mapping[str, Any]) -> str:
    if not share["of"]:
        return "–"
    low, high = (100.0 * limit for limit in share["limits95"])
    return f"{100.0 * share['share']:.0f} % ({share['hits']} of {share['of']}; {low:.0f} to {high:.0f})"


def _number(value: float | None) -> str:
    return "–" if value is None else f"{value:.3f}"


def _after(ratio: Mapping[str, float] | None) -> str:
    return "–" if ratio is None else f"{ratio['median']:.3f}; {ratio['percentile_90']:.3f}"

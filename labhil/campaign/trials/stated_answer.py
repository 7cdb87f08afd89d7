"""The part of a diagnosis that is scored, read from its JSON."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from labhil.campaign.trials.folder import read_json_object
from labhil.errors import UsageError
from labhil.physics.terms import keyed

SCHEMA = "labhil.diagnosis/1"


@dataclass(frozen=True, slots=True)
class NamedEffect:
    """A claimed effect: its key with its stated probability, and those of its rivals."""

    term: str
    probability: float | None
    rivals: tuple[tuple[str, float | None], ...] = ()

    @property
    def names(self) -> tuple[str, ...]:
        """All names that the answer considers possible, the preferred one first."""
        return (self.term, *(name for name, _ in self.rivals))


@dataclass(frozen=True, slots=True)
class Interval:
    """A 99 % interval of a parameter by key; an open end is infinite."""

    key: str
    low: float
    high: float


@dataclass(frozen=True, slots=True)
class ChannelErrors:
    """RMSE of one output under baseline and final model, in its unit."""

    channel: str
    rmse_before: float
    rmse_after: float


@dataclass(frozen=True, slots=True)
class Regime:
    """A range of a coordinate in which a mismatch is reported."""

    coordinate: str
    low: float
    high: float


@dataclass(frozen=True, slots=True)
class StatedAnswer:
    """A diagnosis; ``verdict`` is None where it failed, ``joint`` has the largest mismatch."""

    verdict: str | None
    named: tuple[NamedEffect, ...] = ()
    final_terms: tuple[str, ...] = ()
    intervals: tuple[Interval, ...] = ()
    channel_errors: tuple[ChannelErrors, ...] = ()
    regimes: tuple[Regime, ...] = ()
    joint: int | None = None
    seconds: float = 0.0
    error: str = ""


def read_stated_answer(path: Path) -> StatedAnswer:
    """Read a result file.

    Raises:
        UsageError: it is no diagnosis.
    """
    data = read_json_object(path, SCHEMA)
    try:
        return parse_stated_answer(data)
    except (KeyError, TypeError, ValueError) as error:
        raise UsageError(
            f"{path}: expected a diagnosis of `labhil diagnose --json`, found: {error!r}"
        ) from error


def parse_stated_answer(data: Mapping[str, Any]) -> StatedAnswer:
    """Read the answer in the JSON data of a diagnosis."""
    if data["verdict"] is None:
        return StatedAnswer(None, seconds=float(data["seconds"]), error=str(data.get("error", "")))
    rivals = data["rivals"]
    return StatedAnswer(
        verdict=str(data["verdict"]),
        named=tuple(_named_effect(item, rivals) for item in data["missing"]),
        final_terms=tuple(data["final"]["terms"]),
        intervals=tuple(_interval(row) for row in data["final"]["parameters"]),
        channel_errors=_channel_errors(data["improvement"]),
        regimes=_regimes(data["location"]),
        joint=(data["location"] or {}).get("joint"),
        seconds=float(data["seconds"]),
    )


def _named_effect(item: Mapping[str, Any], rivals: list[Mapping[str, Any]]) -> NamedEffect:
    same = [r for r in rivals if r["instead_of"] == item["term"] and r.get("joint") == item.get("joint")]
    return NamedEffect(
        keyed(item["term"], item.get("joint")),
        item.get("probability"),
        tuple((keyed(r["term"], r.get("joint")), r.get("probability")) for r in same),
    )


def _interval(row: Mapping[str, Any]) -> Interval:
    low, high = row["ci99"] or (None, None)
    return Interval(
        keyed(row["name"], row.get("joint")),
        float("-inf") if low is None else float(low),
        float("inf") if high is None else float(high),
    )


def _channel_errors(data: Mapping[str, Any] | None) -> tuple[ChannelErrors, ...]:
    """Errors by output; of an output with several metrics the first, which is the headline's."""
    channel_errors: dict[str, ChannelErrors] = {}
    for row in (data or {}).get("per_channel") or []:
        channel, before, after = row["channel"], row["rmse_before"], row["rmse_after"]
        if row.get("joint") is not None:
            channel = f"{channel}_{row['joint']}"
        if before is not None and after is not None:
            channel_errors.setdefault(channel, ChannelErrors(channel, float(before), float(after)))
    return tuple(channel_errors.values())


def _regimes(location: Mapping[str, Any] | None) -> tuple[Regime, ...]:
    rows = (location or {}).get("regimes") or []
    return tuple(Regime(r["coordinate"], float(r["low"]), float(r["high"])) for r in rows)

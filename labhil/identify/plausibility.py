"""Check a recording against the physics of its rig before a fit: units, signs, times, swapped columns.

The facts of a recording (``physics.facts``) are compared with their bounds. Where some are violated, each
common mistake (degrees for radians, mm for m, a sign, two columns swapped, …) is tried on all facts together.
A mistake that explains all of them is proposed, with the line of the rig file that corrects it. The recording
itself is never changed.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import combinations
from math import log, pi

import numpy as np
from scipy.ndimage import median_filter

from labhil.physics.facts import TIME, Fact
from labhil.physics.record import Record
from labhil.physics.rigs import rig_model
from labhil.rig import RigFile
from labhil.rig_sections import Channel
from labhil.signals import FloatArray

DEGREE = pi / 180.0
RPM = pi / 30.0
TURN = 2.0 * pi

OTHER_UNITS: Mapping[str, Mapping[str, float]] = {
    "rad": {"degrees": DEGREE, "turns": TURN, "mrad": 1e-3},
    "rad/s": {"rpm": RPM, "degrees/s": DEGREE, "turns/s": TURN},
    "m": {"mm": 1e-3, "cm": 1e-2, "µm": 1e-6},
    "A": {"mA": 1e-3},
    "V": {"mV": 1e-3},
    "N": {"mN": 1e-3, "kN": 1e3},
    "s": {"ms": 1e-3, "µs": 1e-6, "ns": 1e-9, "minutes": 60.0, "days": 86400.0},
}
"""By SI unit the other units that people record in, and the factor that converts them to SI."""


@dataclass(frozen=True, slots=True)
class Mistake:
    """One mistake that may have been made with a channel.

    Attributes:
        channel: Its name.
        factor: By which the channel has to be multiplied to correct it.
        called: What was recorded instead, as text.
    """

    channel: str
    factor: float
    called: str


@dataclass(frozen=True, slots=True)
class Doubt:
    """An implausible recording, with the corrections that would make it plausible.

    Attributes:
        statement: A text for people.
        lines: Lines of ``[channels]`` in the rig file that correct it, the likeliest first; empty where no
            simple mistake explains it.
    """

    statement: str
    lines: tuple[str, ...]


def doubts_of(
    record: Record, rig: RigFile, *, misfit: bool = False, time_column: str = "t"
) -> tuple[Doubt, ...]:
    """Check each recording of a record against the physics of its rig.

    Args:
        record: As it was measured, in what are meant to be SI units.
        rig: Its rig file: known values, and how columns became channels.
        misfit: Whether a model does not explain it. If so, a swap of two columns is also proposed where no
            fact is violated, but more facts can be compared after the swap and all of them hold.
        time_column: Name of the table's column of times, where the rig file does not name it.

    Returns:
        One doubt for each implausible recording; none for plausible data.
    """
    if TIME not in rig.channels:
        rig = rig.model_copy(update={"channels": {**rig.channels, TIME: Channel(column=time_column)}})
    several = len(record.begins) > 1
    doubts = {
        recording.begins[0].number: doubt
        for recording in record.recordings()
        if (doubt := _doubt(recording, rig, misfit)) is not None
    }
    return tuple(
        replace(doubt, statement=f"Recording {number}: {doubt.statement}") if several else doubt
        for number, doubt in doubts.items()
    )


def _doubt(record: Record, rig: RigFile, misfit: bool, *, min_samples: int = 16) -> Doubt | None:
    """The doubt about one recording; None where it is plausible or too short."""
    if len(record) < min_samples or not _is_finite(record):
        return None
    facts = _facts(record, rig)
    violated = [fact for fact in facts if not fact.holds()]
    if not violated and not misfit:
        return None
    reasons = "; ".join(_describe_violation(fact) for fact in violated)
    reasons = (
        reasons or "the model does not explain them as they are, and all that is known fits after a swap"
    )
    explanations = _find_explanations(facts, _units(record, rig), rig)
    only_signs = bool(explanations) and all(mistake.factor < 0.0 for mistake in explanations[0])
    swap = () if only_signs else _find_swap(record, rig, facts)
    if swap:
        # a swap compares signals, which is better evidence than a factor that meets a bound on a size
        named = " and ".join(swap)
        pairs = ((first, _channel(rig, second)) for first, second in (swap, swap[::-1]))
        lines = tuple(_toml_line(name, channel) for name, channel in pairs)
        return Doubt(f"The columns of {named} look swapped. {_advice([lines])} Why: {reasons}.", lines)
    if not violated:
        return None
    if not explanations:
        return Doubt(f"Implausible: {reasons}. Check units, signs and the order of the columns.", ())
    options = [tuple(_line(rig, mistake) for mistake in mistakes) for mistakes in explanations]
    named = ", or ".join(" and ".join(map(_describe_mistake, mistakes)) for mistakes in explanations)
    lines = tuple(dict.fromkeys(line for option in options for line in option))
    return Doubt(f"This looks like {named}. {_advice(options)} Why: {reasons}.", lines)


def _is_finite(record: Record) -> bool:
    """Whether all values are finite and times rise."""
    columns = [record.t, record.inputs, record.outputs]
    return all(bool(np.all(np.isfinite(x))) for x in columns) and bool(np.all(np.diff(record.t) > 0.0))


def _facts(record: Record, rig: RigFile) -> list[Fact]:
    """The facts of a recording that its rig's model can compute."""
    known = {name: value for name in rig.kind.known if (value := rig.known_number(name)) is not None}
    with np.errstate(all="ignore"):
        return rig_model(rig.kind.name).facts_of(
            replace(record, outputs=_without_bursts(record.outputs)), known
        )


def _without_bursts(
    outputs: FloatArray, *, max_samples: int = 3, min_deviation_ratio: float = 10.0
) -> FloatArray:
    """Replace bursts of a few samples in outputs (n, channels) by a running median; other checks report them.

    A burst deviates from the running median by ``min_deviation_ratio`` times the mean deviation.
    """
    window = 2 * max_samples + 1
    median = np.stack([median_filter(column, window, mode="nearest") for column in outputs.T], axis=1)
    deviation = np.abs(outputs - median)
    return np.where(deviation > min_deviation_ratio * np.mean(deviation, axis=0), median, outputs)


def _units(record: Record, rig: RigFile) -> dict[str, str]:
    """Units of the time and of each signal that a record has."""
    columns = {*record.input_names, *record.output_names, *record.auxiliary}
    recorded = {s.name: s.unit for s in rig.kind.signals() if columns.intersection(s.columns())}
    return {TIME: "s", **recorded}


def _possible_mistakes(name: str, unit: str, *, converted: bool) -> Iterator[Mistake]:
    """All single mistakes with a signal; one that was ``converted`` may have been in SI units before."""
    for called, factor in OTHER_UNITS.get(unit, {}).items():
        yield Mistake(name, factor, called)
        if converted:
            yield Mistake(name, 1.0 / factor, f"{unit} that were taken for {called}")
    if name != TIME:
        yield Mistake(name, -1.0, "the wrong sign")


def _find_explanations(
    facts: Sequence[Fact], units: Mapping[str, str], rig: RigFile, *, max_explanations: int = 3
) -> list[tuple[Mistake, ...]]:
    """Find the likeliest mistakes that explain all facts: single ones, else two with different signals.

    More than ``max_explanations`` are no explanation: the data then show that something is wrong, not what.
    """
    involved = {name for fact in facts if not fact.holds() for name in fact.powers}
    single = [
        (mistake,)
        for name, unit in units.items()
        if name in involved
        for mistake in _possible_mistakes(name, unit, converted=_channel(rig, name).scale != 1.0)
    ]
    explanations = _rank(facts, single)
    if not explanations:
        scales = [mistake for (mistake,) in single if mistake.factor > 0.0]
        pairs = [pair for pair in combinations(scales, 2) if pair[0].channel != pair[1].channel]
        explanations = _rank(facts, pairs)
    return explanations if len(explanations) <= max_explanations else []


def _rank(
    facts: Sequence[Fact], options: Sequence[tuple[Mistake, ...]], *, max_difference: float = 0.7
) -> list[tuple[Mistake, ...]]:
    """The options after which all facts hold and are most typical, the best first.

    The cost is Σ|ln(value/typical)|; costs up to ``max_difference`` (a factor of two) above the least count
    as equally good.
    """
    costs = {}
    for mistakes in options:
        factors = {mistake.channel: mistake.factor for mistake in mistakes}
        if all(fact.holds(factors) for fact in facts):
            costs[mistakes] = sum(_log_distance(fact.scaled(factors), fact.typical) for fact in facts)
    least = min(costs.values(), default=0.0)
    return sorted((s for s, cost in costs.items() if cost <= least + max_difference), key=lambda s: costs[s])


def _log_distance(value: float, typical: float | None) -> float:
    """|ln(value/typical)|; 0 where there is no typical value."""
    return abs(log(value / typical)) if typical and value > 0.0 else 0.0


def _find_swap(record: Record, rig: RigFile, facts: Sequence[Fact]) -> tuple[str, str] | tuple[()]:
    """Find the two signals after whose swap no fact is violated; nothing unless exactly one pair is.

    After the swap as many dynamic facts must be computable as before, and more where none was violated.
    """
    if any(record.channel(j)[1] is not None for j in range(len(record.output_names))):
        return ()
    needed = sum(fact.dynamic for fact in facts)
    needed = max(needed + all(fact.holds() for fact in facts), 1)
    swaps = []
    for first, second in combinations([*record.input_names, *record.output_names], 2):
        facts_after = _facts(_swap_columns(record, first, second), rig)
        if sum(fact.dynamic for fact in facts_after) >= needed and all(fact.holds() for fact in facts_after):
            swaps.append((first, second))
    return swaps[0] if len(swaps) == 1 else ()


def _swap_columns(record: Record, first: str, second: str) -> Record:
    """The record with the columns of two signals exchanged."""
    names = [*record.input_names, *record.output_names]
    order = list(range(len(names)))
    i, j = names.index(first), names.index(second)
    order[i], order[j] = j, i
    columns = np.hstack([record.inputs, record.outputs])[:, order]
    m = len(record.input_names)
    return replace(
        record, inputs=np.ascontiguousarray(columns[:, :m]), outputs=np.ascontiguousarray(columns[:, m:])
    )


def _describe_violation(fact: Fact) -> str:
    """The value of a violated fact with its bound, as text."""
    unit = f" {fact.unit}" if fact.unit else ""
    too_high = fact.value > fact.high
    expected = f"at most {fact.high:.3g}{unit}" if too_high else f"more than {fact.low:.3g}{unit}"
    return f"{fact.what} is {fact.value:.4g}{unit}, expected {expected} ({fact.because})"


def _describe_mistake(mistake: Mistake) -> str:
    """A mistake as text."""
    name = "the time" if mistake.channel == TIME else mistake.channel
    return f"{mistake.called} in {name}"


def _advice(options: Sequence[Sequence[str]]) -> str:
    """What to write into the rig file, as text."""
    lines = ", or ".join(" and ".join(option) for option in options)
    return f"Nothing was changed; if so, import again with {lines} in [channels] of the rig file."


def _line(rig: RigFile, mistake: Mistake) -> str:
    """The line of ``[channels]`` that corrects a mistake."""
    channel = _channel(rig, mistake.channel)
    return _toml_line(
        mistake.channel,
        channel.model_copy(
            update={
                "scale": _rescale(channel.scale, mistake.factor),
                "offset": _rescale(channel.offset, mistake.factor),
            }
        ),
    )


def _channel(rig: RigFile, name: str) -> Channel:
    """How a channel is read now: from a column of its own name where the rig file does not name one."""
    return rig.channels.get(name) or Channel(column=name)


def _rescale(value: float | list[float], factor: float) -> float | list[float]:
    """A number, or each of several, times a factor."""
    return [item * factor for item in value] if isinstance(value, list) else value * factor


def _toml_line(name: str, channel: Channel) -> str:
    """A line of the rig file: ``servo_angle = { column = "gamma", scale = 0.017453293 }``."""
    parts = [f"column = {_toml(channel.column)}"] if channel.columns is None else []
    parts += [f"columns = {_toml(channel.columns)}"] if channel.columns is not None else []
    for key, value, neutral in (("scale", channel.scale, 1.0), ("offset", channel.offset, 0.0)):
        if value != neutral:
            parts.append(f"{key} = {_toml(value)}")
    return f"{name} = {{ {', '.join(parts)} }}"


def _toml(value: object) -> str:
    """A value as TOML."""
    if isinstance(value, list):
        return f"[{', '.join(_toml(item) for item in value)}]"
    if isinstance(value, str):
        return '"' + value.replace("\\", "\\\\").replace('"', '\\"') + '"'
    return f"{value:.8g}" if isinstance(value, float) else str(value)


__all__ = ["Doubt", "doubts_of"]

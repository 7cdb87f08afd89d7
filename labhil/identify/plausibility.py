"""Wrong units, signs, times and swapped columns, seen by the physics of the rig before anything is fitted.

The facts of a recording (``physics.facts``) are held against their bounds. Where some are violated, each
single slip that people make (degrees for radians, mm for m, a sign, two columns swapped, …) is tried on all
facts together: one that puts every fact right is proposed, with the line of the rig file that undoes it.
Nothing is ever changed. A recording without a violated fact costs a few regressions and gives no line.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import combinations
from math import log, pi

import numpy as np
from scipy.ndimage import median_filter

from labhil.physics.facts import TIME, Fact
from labhil.physics.model import Record
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
"""What people record in the place of SI units, and the factor that makes SI units of it."""

LIKELY = 0.7
"""Difference in Σ|ln(value/typical)| up to which explanations are about as good: a factor of two."""

FEWEST = 16
"""Samples of which anything is concluded."""

BURST = 3

SPIKE = 10.0
"""Times the mean distance of samples from the median of their neighbours and themselves."""

MOST = 3
"""Explanations beyond which none is worth naming: the data then say that something is wrong, not what."""


@dataclass(frozen=True, slots=True)
class Slip:
    """One thing that may have gone wrong, ``called`` by its name; ``factor`` puts the channel right."""

    channel: str
    factor: float
    called: str


@dataclass(frozen=True, slots=True)
class Doubt:
    """What is implausible in a recording, with what would put it right.

    ``statement`` is a whole text for a person; ``lines`` are those of ``[channels]`` in the rig file that the
    explanations ask for, the likeliest first, none where nothing simple explains it.
    """

    statement: str
    lines: tuple[str, ...]


def doubts_of(
    record: Record, rig: RigFile, *, misfit: bool = False, time_column: str = "t"
) -> tuple[Doubt, ...]:
    """Hold each recording of a record against the physics of its rig.

    Args:
        record: As it was measured, in what are meant to be SI units.
        rig: Its rig file: what is known, and how columns became channels.
        misfit: Whether a model does not explain it: then a swap of two columns is proposed, too, where no
            fact is violated but more can be compared after it, and all of that is as it should be.
        time_column: What the column of the time is called in the table, where the rig file does not say so.

    Returns:
        One doubt for each recording with an implausible figure; none for right data.
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


def _doubt(record: Record, rig: RigFile, misfit: bool) -> Doubt | None:
    if len(record) < FEWEST or not _is_finite(record):
        return None
    facts = _facts(record, rig)
    wrong = [fact for fact in facts if not fact.holds()]
    if not wrong and not misfit:
        return None
    reasons = "; ".join(_complaint(fact) for fact in wrong)
    reasons = (
        reasons or "the model does not explain them as they are, and all that is known fits after a swap"
    )
    explained = _explanations(facts, _units(record, rig), rig)
    only_signs = bool(explained) and all(slip.factor < 0.0 for slip in explained[0])
    swap = () if only_signs else _find_swap(record, rig, facts)
    if swap:
        # many a factor would meet a bound on a size alone, too: signals that are compared are better evidence
        named = " and ".join(swap)
        pairs = ((first, _channel(rig, second)) for first, second in (swap, swap[::-1]))
        lines = tuple(_toml_line(name, channel) for name, channel in pairs)
        return Doubt(f"The columns of {named} look swapped. {_advice([lines])} Why: {reasons}.", lines)
    if not wrong:
        return None
    if not explained:
        return Doubt(f"Implausible: {reasons}. Check units, signs and the order of the columns.", ())
    options = [tuple(_line(rig, slip) for slip in slips) for slips in explained]
    named = ", or ".join(" and ".join(_describe_slip(slip) for slip in slips) for slips in explained)
    lines = tuple(dict.fromkeys(line for option in options for line in option))
    return Doubt(f"This looks like {named}. {_advice(options)} Why: {reasons}.", lines)


def _is_finite(record: Record) -> bool:
    columns = [record.t, record.inputs, record.outputs]
    return all(bool(np.all(np.isfinite(x))) for x in columns) and bool(np.all(np.diff(record.t) > 0.0))


def _facts(record: Record, rig: RigFile) -> list[Fact]:
    known = {name: value for name in rig.kind.known if (value := rig.known_number(name)) is not None}
    with np.errstate(all="ignore"):
        return rig_model(rig.kind.name).facts_of(
            replace(record, outputs=_without_bursts(record.outputs)), known
        )


def _without_bursts(outputs: FloatArray) -> FloatArray:
    """Outputs (n, channels) without bursts of up to three samples: these are a fault of their own."""
    middle = np.stack([median_filter(column, 2 * BURST + 1, mode="nearest") for column in outputs.T], axis=1)
    deviation = np.abs(outputs - middle)
    return np.where(deviation > SPIKE * np.mean(deviation, axis=0), middle, outputs)


def _units(record: Record, rig: RigFile) -> dict[str, str]:
    """Unit of each signal that a record has, and of the time."""
    columns = {*record.input_names, *record.output_names, *record.auxiliary}
    recorded = {s.name: s.unit for s in rig.kind.signals() if columns.intersection(s.columns())}
    return {TIME: "s", **recorded}


def _slips(name: str, unit: str, *, converted: bool) -> Iterator[Slip]:
    """Everything single that may have gone wrong with a signal; one ``converted`` may have been SI before."""
    for called, factor in OTHER_UNITS.get(unit, {}).items():
        yield Slip(name, factor, called)
        if converted:
            yield Slip(name, 1.0 / factor, f"{unit} that were taken for {called}")
    if name != TIME:
        yield Slip(name, -1.0, "the wrong sign")


def _explanations(facts: Sequence[Fact], units: Mapping[str, str], rig: RigFile) -> list[tuple[Slip, ...]]:
    """The likeliest slips that put all facts right: single ones, else two of different signals together."""
    touched = {name for fact in facts if not fact.holds() for name in fact.powers}
    single = [
        (slip,)
        for name, unit in units.items()
        if name in touched
        for slip in _slips(name, unit, converted=_channel(rig, name).scale != 1.0)
    ]
    explanations = _rank(facts, single)
    if not explanations:
        scales = [slip for (slip,) in single if slip.factor > 0.0]
        pairs = [pair for pair in combinations(scales, 2) if pair[0].channel != pair[1].channel]
        explanations = _rank(facts, pairs)
    return explanations if len(explanations) <= MOST else []


def _rank(facts: Sequence[Fact], options: Sequence[tuple[Slip, ...]]) -> list[tuple[Slip, ...]]:
    """Of what puts every fact right those that make it most typical."""
    costs = {}
    for slips in options:
        factors = {slip.channel: slip.factor for slip in slips}
        if all(fact.holds(factors) for fact in facts):
            costs[slips] = sum(_distance(fact.scaled(factors), fact.typical) for fact in facts)
    least = min(costs.values(), default=0.0)
    return sorted((s for s, cost in costs.items() if cost <= least + LIKELY), key=lambda s: costs[s])


def _distance(value: float, typical: float | None) -> float:
    return abs(log(value / typical)) if typical and value > 0.0 else 0.0


def _find_swap(record: Record, rig: RigFile, facts: Sequence[Fact]) -> tuple[str, str] | tuple[()]:
    """The only two signals without a violated fact after a swap; nothing where there is not just one pair.

    As much has to be compared as before, and more where no fact was violated before.
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
    """The record with the columns of two signals in each other's place."""
    names = [*record.input_names, *record.output_names]
    order = list(range(len(names)))
    i, j = names.index(first), names.index(second)
    order[i], order[j] = j, i
    columns = np.hstack([record.inputs, record.outputs])[:, order]
    m = len(record.input_names)
    return replace(
        record, inputs=np.ascontiguousarray(columns[:, :m]), outputs=np.ascontiguousarray(columns[:, m:])
    )


def _complaint(fact: Fact) -> str:
    unit = f" {fact.unit}" if fact.unit else ""
    over = fact.value > fact.high
    wanted = f"at most {fact.high:.3g}{unit}" if over else f"more than {fact.low:.3g}{unit}"
    return f"{fact.what} is {fact.value:.4g}{unit}, expected {wanted} ({fact.because})"


def _describe_slip(slip: Slip) -> str:
    name = "the time" if slip.channel == TIME else slip.channel
    return f"{slip.called} in {name}"


def _advice(options: Sequence[Sequence[str]]) -> str:
    lines = ", or ".join(" and ".join(option) for option in options)
    return f"Nothing was changed; if so, import again with {lines} in [channels] of the rig file."


def _line(rig: RigFile, slip: Slip) -> str:
    """The line of ``[channels]`` that undoes a slip."""
    channel = _channel(rig, slip.channel)
    return _toml_line(
        slip.channel,
        channel.model_copy(
            update={
                "scale": _rescale(channel.scale, slip.factor),
                "offset": _rescale(channel.offset, slip.factor),
            }
        ),
    )


def _channel(rig: RigFile, name: str) -> Channel:
    """How a channel is read now: by its own name where the rig file says nothing."""
    return rig.channels.get(name) or Channel(column=name)


def _rescale(value: float | list[float], factor: float) -> float | list[float]:
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
    if isinstance(value, list):
        return f"[{', '.join(_toml(item) for item in value)}]"
    if isinstance(value, str):
        return '"' + value.replace("\\", "\\\\").replace('"', '\\"') + '"'
    return f"{value:.8g}" if isinstance(value, float) else str(value)


__all__ = ["Doubt", "doubts_of"]

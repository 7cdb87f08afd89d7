"""Faults of the data, looked for before any physics is blamed.

Every test is made for less than one false alarm in 10,000 clean recordings: where no probability can be
stated (how fast may a body move?) it asks for what no body does. What a body may well do is no fault: a
ball that rests, a plunger at its stop, a command that its limits clip.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from enum import StrEnum

import numpy as np

from labhil.diagnose.frozen import clipped, stuck
from labhil.diagnose.jumps import spikes, zero_steps
from labhil.diagnose.lag import partings
from labhil.identify.windows import converter_step, noise_of
from labhil.physics.model import Record
from labhil.signals import FloatArray

LONG_STEP = 1.5
"""A gap is longer than this many usual steps of time …"""

UNEVEN = 8.0
"""… and beyond them by this many robust standard deviations of uneven stamps."""

MOVES = 2.0
"""A channel moves when its standard deviation is this many times its noise."""


class Kind(StrEnum):
    """What may be wrong with data."""

    NOT_FINITE = "not_finite"
    TIME_ORDER = "time_order"
    GAP = "gap"
    STUCK = "stuck"
    SATURATED = "saturated"
    OUTLIER = "outlier"
    ZERO_STEP = "zero_step"
    CLOCK_DRIFT = "clock_drift"
    CLOCK_STEP = "clock_step"
    CLOCK_RATE = "clock_rate"
    NO_DEVICE_CLOCK = "no_device_clock"
    NO_EXCITATION = "no_excitation"


TOLERATED = {
    Kind.NOT_FINITE: 0.0,
    Kind.TIME_ORDER: 0.0,
    Kind.GAP: 0.2,
    Kind.STUCK: 0.01,
    Kind.SATURATED: 0.01,
    Kind.OUTLIER: 0.02,
    Kind.ZERO_STEP: 0.0,
    Kind.CLOCK_DRIFT: 0.0,
    Kind.CLOCK_STEP: 0.0,
}
"""Shares up to which a fault is only reported; what is not listed never makes data unfit by itself."""


@dataclass(frozen=True, slots=True)
class Fault:
    """One fault of one channel (``channel`` "t" for the time itself).

    ``times`` are spans (begin, end) in s of the record; ``share`` is the part of the
    samples (of the time, for gaps) that is affected; ``statement`` says what, where, when, how much and
    what to do about it. Of several recordings ``recording`` is the one, in whose own time ``times`` are.
    """

    kind: Kind
    channel: str
    joint: int | None
    times: tuple[tuple[float, float], ...]
    share: float
    statement: str
    recording: int | None = None


@dataclass(frozen=True, slots=True)
class Usable:
    """What faults leave: whether the record is ``fit`` for a verdict, and which samples (n,) are sound."""

    fit: bool
    sound: np.ndarray


@dataclass(frozen=True, slots=True)
class _Channel:
    """One column with what is known of it.

    ``drive`` (n, m) are the inputs that may move it at once; ``position`` says that it cannot jump,
    ``rests`` that it may be silent at any value.
    """

    name: str
    joint: int | None
    values: FloatArray
    sigma: float
    drive: FloatArray
    position: bool = False
    rests: bool = False

    @property
    def called(self) -> str:
        return self.name if self.joint is None else f"{self.name} of joint {self.joint}"


def faults_of(record: Record) -> tuple[Fault, ...]:
    """All faults of a record that was measured; those of several recordings each by itself."""
    if len(record.begins) == 1:
        return faults(record, noise_of(record))
    return tuple(
        replace(fault, recording=number, statement=f"Recording {number}: {fault.statement}")
        for number, each in enumerate(record.recordings(), 1)
        for fault in faults(each, noise_of(each))
    )


def faults(record: Record, sigma: FloatArray) -> tuple[Fault, ...]:
    """All faults that one recording shows; ``sigma`` (channels,) is the noise of its outputs.

    Give the record as it was measured, not ``Model.prepare``d: a filter hides what is looked for here.
    """
    if len(record) < 2:
        return ()
    found = [*_of_stamps(record), *_time_order(record), *_gaps(record)]
    broken = _not_finite(record)
    if broken:
        return (*found, *broken)
    for channel in _measured(record, sigma):
        found += _of_channel(record, channel)
    return (*found, *_clock_drifts(record), *_no_excitation(record, sigma))


def usable(record: Record, found: Sequence[Fault]) -> Usable:
    """Which samples of a record are sound, and whether enough of them are.

    A record is not fit when some fault affects more than is tolerated of its kind: then the verdict is
    ``data_fault``. Other faults are only reported.
    """
    sound = np.ones(len(record), dtype=bool)
    for number, (each, span) in enumerate(zip(record.recordings(), record.spans, strict=True), 1):
        for fault in (f for f in found if f.recording in (None, number)):
            for begin, end in fault.times if fault.kind not in (Kind.GAP, Kind.NO_EXCITATION) else ():
                sound[slice(*span)] &= (each.t < begin) | (each.t > end)
    fit = all(fault.share <= TOLERATED.get(fault.kind, 1.0) for fault in found)
    return Usable(fit, sound)


def _measured(record: Record, sigma: FloatArray) -> list[_Channel]:
    """Outputs, the other channels, and the inputs where they are measured too (those of an arm's joints)."""
    channels = [
        _Channel(
            *record.channel(j), x, float(sigma[j]), record.inputs, record.output_units[j] in ("m", "rad")
        )
        for j, x in enumerate(record.outputs.T)
    ]
    others = {name: x for name, x in record.auxiliary.items() if not _planned(name)}
    channels += [_Channel(name, None, x, _noise(x), record.inputs, rests=True) for name, x in others.items()]
    if record.output_joints and record.output_joints[0] is not None:
        channels += [
            _Channel(name, None, x, _noise(x), np.delete(record.inputs, j, axis=1), rests=True)
            for j, (name, x) in enumerate(zip(record.input_names, record.inputs.T, strict=True))
        ]
    return channels


def _planned(name: str) -> bool:
    """Whether a channel tells what a controller plans: that may stand still and jump as it likes."""
    return name.startswith("target_") or name.endswith("_command")


def _noise(x: FloatArray) -> float:
    single = Record(np.arange(len(x), dtype=np.float64), x[:, None], x[:, None], ("",), ("",), ("",))
    return float(noise_of(single)[0]) if len(x) > 3 else 0.0


def _of_channel(record: Record, channel: _Channel) -> list[Fault]:
    """Stuck, saturated, spikes and steps of one channel."""
    x, drive = channel.values, channel.drive
    sigma = max(channel.sigma, converter_step(x) / np.sqrt(12.0))
    lone = spikes(x, sigma, drive)
    calm = x.copy()
    calm[lone] = x[lone - 1]
    limits = clipped(calm)
    found = [_saturated(record, channel, limit) for limit in limits]
    runs = stuck(calm, drive, rests=channel.rests)
    runs = runs.chosen(~np.isin(calm[runs.first], limits))
    if len(runs.first):
        found.append(_stuck(record, channel, list(zip(runs.first, runs.last - 1, strict=True))))
    if len(lone):
        found.append(_outliers(record, channel, lone))
    if channel.position:
        # what was stuck jumps when it comes loose
        steps = np.setdiff1d(zero_steps(calm, sigma, drive), runs.last)
        found += [_zero_step(record, channel, int(i)) for i in steps]
    return found


def _saturated(record: Record, channel: _Channel, limit: float) -> Fault:
    at = channel.values == limit
    edges = np.flatnonzero(np.diff(np.r_[False, at, False].astype(np.int8)))
    spans = list(zip(edges[::2], edges[1::2] - 1, strict=True))
    share = float(at.mean())
    return _fault(
        record, channel, Kind.SATURATED, spans, share,
        f"{channel.called} is clipped at {limit:.6g}: {at.sum()} samples ({_percent(share)}) read exactly "
        f"this value{_when(record, spans)}, although its noise should scatter them. Check the sensor's and "
        "the converter's range, or excite less; cut these times out.",
    )  # fmt: skip


def _stuck(record: Record, channel: _Channel, spans: Sequence[tuple[int, int]]) -> Fault:
    longest = max(spans, key=lambda span: span[1] - span[0])
    share = sum(last - first + 1 for first, last in spans) / len(record)
    value = channel.values[longest[0]]
    return _fault(
        record, channel, Kind.STUCK, spans, share,
        f"{channel.called} is stuck{_when(record, spans)} ({_percent(share)} of the samples), the longest "
        f"time at {value:.6g} for {record.t[longest[1]] - record.t[longest[0]]:.3g} s, longer than rest or "
        "rounding explains. Check cable, sensor and converter; cut these times out or record again.",
    )  # fmt: skip


def _outliers(record: Record, channel: _Channel, places: np.ndarray) -> Fault:
    x = channel.values
    heights = np.abs(x[places] - 0.5 * (x[places - 1] + x[places + 1]))
    worst = int(np.argmax(heights))
    share = len(places) / len(record)
    spans = [(int(i), int(i)) for i in places]
    return _fault(
        record, channel, Kind.OUTLIER, spans, share,
        f"{channel.called} has {len(places)} single spike{'s' if len(places) > 1 else ''} ({_percent(share)} "
        f"of the samples), the largest of {heights[worst]:.4g} at {record.t[places[worst]]:.4g} s, "
        f"{heights[worst] / max(channel.sigma, 1e-300):.0f} times the noise. Look for loose contacts and "
        "disturbed transmission; leave these samples out.",
    )  # fmt: skip


def _zero_step(record: Record, channel: _Channel, place: int) -> Fault:
    height = channel.values[place] - channel.values[place - 1]
    share = min(place, len(record) - place) / len(record)
    return _fault(
        record, channel, Kind.ZERO_STEP, [(place - 1, place)], share,
        f"{channel.called} jumps by {height:+.4g} from one sample to the next at {record.t[place]:.4g} s and "
        "stays there: no body does, so the sensor slipped or its zero was set anew. Use one side of it only.",
    )  # fmt: skip


def _of_stamps(record: Record) -> list[Fault]:
    """What is wrong with the clocks. Where the time of analysis is not bent by it, it is only reported."""
    return [
        Fault(
            kind=Kind(fault.kind.value),
            channel="t",
            joint=None,
            times=(),
            share=1.0 if fault.bends_time else 0.0,
            statement=fault.statement[0].upper() + fault.statement[1:],
        )
        for fault in record.begins[0].clock_faults
        if not fault.times or _within(record, fault.times)
    ]


def _within(record: Record, times: Sequence[float]) -> bool:
    """Whether one of the steps, of which ``times`` are the first samples after them, has both sides here."""
    return any(record.t[0] < t <= record.t[-1] for t in times)


def _time_order(record: Record) -> list[Fault]:
    step = np.diff(record.t)
    wrong = np.flatnonzero(~(step > 0.0))
    if not len(wrong):
        return []
    back = int(np.sum(step < 0.0))
    share = len(wrong) / len(record)
    times = [(float(min(record.t[i : i + 2])), float(max(record.t[i : i + 2]))) for i in wrong]
    return [
        Fault(
            Kind.TIME_ORDER, "t", None, tuple(times), share,
            f"The time does not increase at {len(wrong)} samples ({len(wrong) - back} repeat the stamp "
            f"before them, {back} go back), first after {record.t[wrong[0]]:.6g} s. Remove repeated rows, or "
            "record with the device's own clock.",
        )
    ]  # fmt: skip


def _gaps(record: Record) -> list[Fault]:
    step = np.diff(record.t)
    usual = float(np.median(step))
    spread = 1.4826 * float(np.median(np.abs(step - usual)))
    holes = np.flatnonzero(step > LONG_STEP * usual + UNEVEN * spread)
    whole = float(record.t[-1] - record.t[0])
    if not len(holes) or usual <= 0.0:
        return []
    missing = step[holes] - usual
    longest = holes[np.argmax(missing)]
    share = float(missing.sum() / whole)
    times = tuple((float(record.t[i]), float(record.t[i + 1])) for i in holes)
    return [
        Fault(
            Kind.GAP, "t", None, times, share,
            f"{len(holes)} gap{'s' if len(holes) > 1 else ''} in time, {missing.sum():.4g} s in all "
            f"({_percent(share)} of the recording, about {round(missing.sum() / usual)} samples), the "
            f"longest from {record.t[longest]:.4g} to {record.t[longest + 1]:.4g} s. Nothing was filled in; "
            "look at the load of the recording machine and at the link.",
        )
    ]  # fmt: skip


def _not_finite(record: Record) -> list[Fault]:
    columns = [
        *zip(record.input_names, record.inputs.T, strict=True),
        *zip(record.output_names, record.outputs.T, strict=True),
        *record.auxiliary.items(),
    ]
    found = []
    for name, x in columns:
        bad = ~np.isfinite(x)
        if bad.any():
            spans = [(int(i), int(i)) for i in np.flatnonzero(bad)]
            channel = _Channel(name, None, x, 0.0, record.inputs)
            statement = (
                f"{name} is no finite number at {bad.sum()} samples ({_percent(float(bad.mean()))})"
                f"{_when(record, spans)}. Drop these rows where the table is imported."
            )
            found.append(_fault(record, channel, Kind.NOT_FINITE, spans, float(bad.mean()), statement))
    return found


def _clock_drifts(record: Record) -> list[Fault]:
    whole = ((float(record.t[0]), float(record.t[-1])),)
    return [
        Fault(
            Kind.CLOCK_DRIFT, pair.rate, None, whole, 1.0,
            f"{pair.rate} and the derivative of {pair.position} part: the one lags by "
            f"{1e3 * pair.before:.3g} ms at the beginning and by {1e3 * pair.after:.3g} ms at the end. "
            "Stamp both by one clock.",
        )
        for pair in partings(record)
    ]  # fmt: skip


def _no_excitation(record: Record, sigma: FloatArray) -> list[Fault]:
    whole = ((float(record.t[0]), float(record.t[-1])),)
    found = []
    if not np.any(np.ptp(record.inputs, axis=0) > 0.0):
        names = ", ".join(record.input_names)
        say = f"No input changes ({names}): nothing can be learnt of how the rig answers. Excite it."
        found.append(Fault(Kind.NO_EXCITATION, record.input_names[0], None, whole, 1.0, say))
    for j, spread in enumerate(np.std(record.outputs, axis=0)):
        if spread <= MOVES * sigma[j]:
            name, joint = record.channel(j)
            where = name if joint is None else f"{name} of joint {joint}"
            say = (
                f"{where} hardly moves: its standard deviation {spread:.3g} {record.output_units[j]} is "
                f"{spread / max(float(sigma[j]), 1e-300):.2g} times its noise. Excite more."
            )
            found.append(Fault(Kind.NO_EXCITATION, name, joint, whole, 1.0, say))
    return found


def _fault(
    record: Record,
    channel: _Channel,
    kind: Kind,
    spans: Sequence[tuple[int, int]],
    share: float,
    statement: str,
) -> Fault:
    times = tuple((float(record.t[first]), float(record.t[last])) for first, last in spans)
    return Fault(kind, channel.name, channel.joint, times, share, statement)


def _when(record: Record, spans: Sequence[tuple[int, int]]) -> str:
    """ " from 3.1 to 3.4 s", or how often and between which times."""
    first, last = record.t[spans[0][0]], record.t[spans[-1][1]]
    if len(spans) == 1:
        return f" at {first:.4g} s" if first == last else f" from {first:.4g} to {last:.4g} s"
    return f" {len(spans)} times between {first:.4g} and {last:.4g} s"


def _percent(share: float) -> str:
    return f"{100 * share:.2g} %"


__all__ = ["Fault", "Kind", "Usable", "faults", "faults_of", "usable"]

"""Faults of the data, looked for before any physics is blamed.

Every test is made for less than one false alarm in 10,000 clean recordings: where no probability can be
stated (how fast may a body move?) it asks for what no body does. What a body may well do is no fault: a
ball that rests, a plunger at its stop, a command that its limits clip.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from labhil.diagnose.bursts import NO_SPANS, at_ends, bursts, dropouts, within, without
from labhil.diagnose.fault import Channel, Fault, Kind, fault_of, percent, when
from labhil.diagnose.frozen import clipped_values, stuck_runs
from labhil.diagnose.input_faults import spikes_of_commands
from labhil.diagnose.jumps import spikes, zero_steps
from labhil.diagnose.record_faults import clock_drifts, gaps, leads, no_excitation, not_finite, time_order
from labhil.diagnose.wraps import Wraps, wraps_of
from labhil.identify.quantiser import converter_step
from labhil.identify.windows import noise_of
from labhil.physics.measured_input import MEASURED_INPUTS
from labhil.physics.model import UNREAD, Record
from labhil.signals import FloatArray, IntArray

TOLERATED = {
    Kind.NOT_FINITE: 0.0,
    Kind.TIME_ORDER: 0.0,
    Kind.GAP: 0.2,
    Kind.STUCK: 0.01,
    Kind.SATURATED: 0.5,
    Kind.OUTLIER: 0.02,
    Kind.ZERO_STEP: 0.0,
    Kind.CLOCK_DRIFT: 0.0,
    Kind.CLOCK_STEP: 0.0,
    Kind.WRAPPED: 0.0,
    Kind.LEAD: 0.0,
    Kind.UNDERSAMPLED: 0.0,
}
"""Shares up to which a fault is only reported; what is not listed never makes data unfit by itself.

Readings at the end of a range still say "at least this", and count as that in residuals; where they are more
than half of a channel, not even its median is known.
"""

WHOLE = (Kind.GAP, Kind.NO_EXCITATION, Kind.UNDERSAMPLED)
"""Faults of no single samples."""

UNMARKED = 0.01
"""The same of readings at the end of a range that are not marked as censored: they count as readings."""

LITTLE_DRIVEN = 0.1
"""Share of the largest input up to which a plant is as good as not driven."""

FEWEST_AGAINST = 20
"""Samples that are driven the other way, from which a reading of zero is no rest."""


@dataclass(frozen=True, slots=True)
class Usable:
    """What faults leave: whether the record is ``fit`` for a verdict, and which samples (n,) are sound."""

    fit: bool
    sound: np.ndarray


def faults_of(record: Record) -> tuple[Fault, ...]:
    """All faults of a record that was measured; those of several recordings each by itself."""
    if len(record.begins) == 1:
        return faults(record, noise_of(record))
    return tuple(
        replace(fault, recording=number, statement=f"Recording {number}: {fault.statement}")
        for number, recording in enumerate(record.recordings(), 1)
        for fault in faults(recording, noise_of(recording))
    )


def faults(record: Record, sigma: FloatArray) -> tuple[Fault, ...]:
    """All faults that one recording shows; ``sigma`` (channels,) is the noise of its outputs.

    Give the record as it was measured, not ``Model.prepare``d: a filter hides these faults.
    """
    if len(record) < 2:
        return ()
    detected = [*_of_stamps(record), *time_order(record), *gaps(record)]
    broken = not_finite(record)
    if broken:
        return (*detected, *broken)
    for channel in _measured_channels(record, sigma):
        detected += _of_channel(record, channel)
    detected += _of_commands(record)
    return (*detected, *leads(record), *clock_drifts(record), *no_excitation(with_censored(record), sigma))


def with_censored(record: Record) -> Record:
    """Mark the readings of a record that stand at an end of their channel's range while the rig moves on.

    What is marked counts one-sidedly in residuals. The same record where there are none.
    """
    if not len(record) or not np.isfinite(record.outputs).all():
        return record
    marks = np.zeros(record.outputs.shape, dtype=np.int64)
    for recording, span in zip(record.recordings(), record.spans, strict=True):
        for j, x in enumerate(recording.outputs.T):
            for limit in _ends_of_range(recording, x, recording.inputs):
                side = 1 if limit == x.max() else -1
                marks[slice(*span), j][x == limit] = side
    return replace(record, censored=marks) if marks.any() else record


def without_spikes(record: Record) -> Record:
    """A record with a line between both neighbours in the place of each spike, burst or dropout of an output.

    They are marked as unread, so that they leave no residuals. Where there are too many of them the record
    stays as it was measured.
    """
    if not len(record) or not np.isfinite(record.outputs).all():
        return record
    outputs = record.outputs.copy()
    marks = np.zeros(outputs.shape, dtype=np.int64) if record.censored is None else record.censored.copy()
    for recording, span in zip(record.recordings(), record.spans, strict=True):
        sigma = noise_of(recording) if len(recording) > 3 else np.zeros(outputs.shape[1])
        for j, channel in enumerate(_output_channels(recording, sigma)):
            for kind, wrong in _wrong_readings(channel):
                if _samples_in(wrong) <= TOLERATED[kind] * len(recording):
                    outputs[slice(*span), j] = without(outputs[slice(*span), j], wrong)
                    marks[slice(*span), j][within(wrong, len(recording))] = UNREAD
    return replace(record, outputs=outputs, censored=marks) if np.any(marks == UNREAD) else record


def assess_usability(record: Record, detected: Sequence[Fault]) -> Usable:
    """Which samples of a record are sound, and whether enough of them are.

    A record is not fit when some fault affects more than is tolerated of its kind: then the verdict is
    ``data_fault``. Other faults are only reported.
    """
    sound = np.ones(len(record), dtype=bool)
    for number, (recording, span) in enumerate(zip(record.recordings(), record.spans, strict=True), 1):
        for fault in (f for f in detected if f.recording in (None, number)):
            for begin, end in fault.times if fault.kind not in WHOLE else ():
                sound[slice(*span)] &= (recording.t < begin) | (recording.t > end)
    tolerated = TOLERATED if record.censored is not None else {**TOLERATED, Kind.SATURATED: UNMARKED}
    fit = all(fault.share <= tolerated.get(fault.kind, 1.0) for fault in detected)
    return Usable(fit, sound)


def _measured_channels(record: Record, sigma: FloatArray) -> list[Channel]:
    """Outputs, the other channels, and the inputs where they are measured too (those of an arm's joints)."""
    channels = _output_channels(record, sigma)
    auxiliary = {name: x for name, x in record.auxiliary.items() if not _is_planned(name)}
    channels += [
        Channel(name, None, x, _noise(x), record.inputs, rests=True) for name, x in auxiliary.items()
    ]
    arm = bool(record.output_joints and record.output_joints[0] is not None)
    channels += [
        Channel(name, None, x, _noise(x), np.delete(record.inputs, j, axis=1), rests=True)
        for j, (name, x) in enumerate(zip(record.input_names, record.inputs.T, strict=True))
        if (arm and not _is_planned(name)) or name in MEASURED_INPUTS
    ]
    return channels


def _output_channels(record: Record, sigma: FloatArray) -> list[Channel]:
    return [
        Channel(*record.channel(j), x, float(sigma[j]), record.inputs, record.output_units[j] in ("m", "rad"))
        for j, x in enumerate(record.outputs.T)
    ]


def _is_planned(name: str) -> bool:
    """Whether a channel holds the plan of a controller, which may stand still and jump as it likes."""
    return name.startswith("target_") or name.endswith("_command")


def _noise(x: FloatArray) -> float:
    single = Record(np.arange(len(x), dtype=np.float64), x[:, None], x[:, None], ("",), ("",), ("",))
    return float(noise_of(single)[0]) if len(x) > 3 else 0.0


def _wrong_readings(channel: Channel) -> tuple[tuple[Kind, IntArray], tuple[Kind, IntArray]]:
    """First and last samples (k, 2) of spikes and bursts of a channel that does not wrap, and of dropouts."""
    x = channel.values
    sigma = max(channel.sigma, converter_step(x) / np.sqrt(12.0))
    lone = spikes(x, sigma, channel.drive, any_jump=channel.rests)
    single = np.column_stack([lone, lone])
    if channel.rests:
        # a pulse may be intended, an amplifier may have been off, joints of an arm jolt each other
        return (Kind.OUTLIER, single), (Kind.STUCK, NO_SPANS)
    few = bursts(without(x, single), sigma, channel.drive, rate=not channel.position)
    both = np.concatenate([single, few])
    both = np.concatenate([both, at_ends(without(x, both), sigma, channel.drive)])
    both = both[np.argsort(both[:, 0])]
    away = dropouts(without(x, both), sigma, channel.drive, rate=not channel.position)
    return (Kind.OUTLIER, both), (Kind.STUCK, np.column_stack([away.first, away.last - 1]))


def _samples_in(spans: IntArray) -> int:
    return int(np.sum(spans[:, 1] - spans[:, 0] + 1))


def _of_channel(record: Record, channel: Channel) -> list[Fault]:
    """Stuck, saturated, spikes and steps of one channel."""
    drive, wraps = channel.drive, wraps_of(channel.values) if channel.position else None
    detected = [] if wraps is None else [wrap_fault(record, channel.name, channel.joint, wraps)]
    x = channel.values if wraps is None else np.unwrap(channel.values, period=wraps.period)
    sigma = max(channel.sigma, converter_step(x) / np.sqrt(12.0))
    (_, wrong), (_, away) = _wrong_readings(replace(channel, values=x))
    calm = without(without(x, wrong), away)
    limits = _ends_of_range(record, calm, drive)
    detected += [_saturation_fault(record, channel, limit) for limit in limits]
    runs = stuck_runs(calm, drive, rests=channel.rests)
    runs = runs.select(~np.isin(calm[runs.first], limits))
    if len(runs.first):
        detected.append(_stuck_fault(record, channel, list(zip(runs.first, runs.last - 1, strict=True))))
    if len(away):
        detected.append(_dropout_fault(record, channel, away))
    if len(wrong):
        detected.append(_outlier_fault(record, channel, wrong))
    if channel.position:
        # what was stuck jumps when it comes loose
        steps = np.setdiff1d(zero_steps(calm, sigma, drive), runs.last)
        detected += [_zero_step_fault(record, channel, int(i)) for i in steps]
    return detected


def _of_commands(record: Record) -> list[Fault]:
    """Spikes of inputs that are commands, which may stand still, jump and be clipped."""
    measured = {channel.name for channel in _measured_channels(record, np.zeros(record.outputs.shape[1]))}
    detected = []
    for name, u in zip(record.input_names, record.inputs.T, strict=True):
        places = spikes_of_commands(u) if name not in measured else np.empty(0, dtype=np.int64)
        if len(places):
            spans = np.column_stack([places, places])
            detected.append(_outlier_fault(record, Channel(name, None, u, _noise(u), record.inputs), spans))
    return detected


def _ends_of_range(record: Record, x: FloatArray, drive: FloatArray) -> list[float]:
    """Values at which a channel (n,) is clipped; a rig that rests there is no fault."""
    return [limit for limit in clipped_values(x) if not _rests_at(x, limit, drive)]


def _rests_at(x: FloatArray, value: float, drive: FloatArray) -> bool:
    """Whether a rig stands still where its channel (n,) reads ``value``, and so reads no noise.

    It does where nothing drives it. A rate of exactly zero is rest too, as dry friction has it; but a sensor
    that knows one direction only reads zero as well, while the rig is driven the other way as hard as when it
    moves.
    """
    at = x == value
    size = np.abs(drive)
    if bool(np.all(np.quantile(size[at], 0.95, axis=0) <= LITTLE_DRIVEN * size.max(axis=0))):
        return True
    if value != 0.0 or at.all():
        return False
    usual = np.median(drive[~at], axis=0)
    against = -drive[at] * np.sign(usual)
    return not bool(np.any((np.sum(against > np.abs(usual), axis=0) >= FEWEST_AGAINST) & (usual != 0.0)))


def _saturation_fault(record: Record, channel: Channel, limit: float) -> Fault:
    at = channel.values == limit
    edges = np.flatnonzero(np.diff(np.r_[False, at, False].astype(np.int8)))
    spans = list(zip(edges[::2], edges[1::2] - 1, strict=True))
    share = float(at.mean())
    # with_censored marks those of outputs, but not of an arm's
    counts = channel.name in record.output_names and channel.joint is None
    counted = ", and count as that" if counts else ""
    fault = fault_of(
        record, channel, Kind.SATURATED, spans, share,
        f"{channel.called} is clipped at {limit:.6g}: {at.sum()} samples ({percent(share)}) read exactly "
        f"this value{when(record, spans)}, although its noise should scatter them. They say only that it was "
        f"there or beyond{counted}. Check the sensor's and the converter's range, or excite less.",
    )  # fmt: skip
    return replace(fault, mended=counts and share <= TOLERATED[Kind.SATURATED])


def _stuck_fault(record: Record, channel: Channel, spans: Sequence[tuple[int, int]]) -> Fault:
    longest = max(spans, key=lambda span: span[1] - span[0])
    share = sum(last - first + 1 for first, last in spans) / len(record)
    value = channel.values[longest[0]]
    return fault_of(
        record, channel, Kind.STUCK, spans, share,
        f"{channel.called} is stuck{when(record, spans)} ({percent(share)} of the samples), the longest "
        f"time at {value:.6g} for {record.t[longest[1]] - record.t[longest[0]]:.3g} s, longer than rest or "
        "rounding explains. Check cable, sensor and converter; cut these times out or record again.",
    )  # fmt: skip


def _dropout_fault(record: Record, channel: Channel, places: IntArray) -> Fault:
    """Readings that jump to one value, stay there and jump back, in spans of samples (k, 2)."""
    spans = [(int(first), int(last)) for first, last in places]
    longest = max(spans, key=lambda span: span[1] - span[0])
    share = _samples_in(places) / len(record)
    mended = channel.name in record.output_names and share <= TOLERATED[Kind.STUCK]
    advice = "these readings do not count" if mended else "cut these times out or record again"
    fault = fault_of(
        record, channel, Kind.STUCK, spans, share,
        f"{channel.called} drops out to {channel.values[longest[0]]:.6g}{when(record, spans)} "
        f"({percent(share)} of the samples), the longest time for {longest[1] - longest[0] + 1} samples, and "
        f"comes back at once: nothing that moves does. Check cable, sensor and converter; {advice}.",
    )  # fmt: skip
    return replace(fault, mended=mended)


def _outlier_fault(record: Record, channel: Channel, places: IntArray) -> Fault:
    """Spikes and bursts, of which ``places`` (k, 2) are the first and last samples."""
    x, count = channel.values, len(places)
    off = np.abs(x - without(x, places))
    worst = int(np.argmax(off))
    share = _samples_in(places) / len(record)
    widest = int(np.max(places[:, 1] - places[:, 0])) + 1
    what = "single spike" if widest == 1 else f"spike{'s' if count > 1 else ''} of up to {widest} sample"
    plural = "s" if count > 1 or widest > 1 else ""
    mended = channel.name in record.output_names and share <= TOLERATED[Kind.OUTLIER]
    advice = "they do not count" if mended else "leave these samples out"
    fault = fault_of(
        record, channel, Kind.OUTLIER, [(int(a), int(b)) for a, b in places], share,
        f"{channel.called} has {count} {what}{plural} ({percent(share)} "
        f"of the samples), the largest of {off[worst]:.4g} at {record.t[worst]:.4g} s, "
        f"{off[worst] / max(channel.sigma, 1e-300):.0f} times the noise. Look for loose contacts and "
        f"disturbed transmission; {advice}.",
    )  # fmt: skip
    return replace(fault, mended=mended)


def _zero_step_fault(record: Record, channel: Channel, place: int) -> Fault:
    height = channel.values[place] - channel.values[place - 1]
    share = min(place, len(record) - place) / len(record)
    return fault_of(
        record, channel, Kind.ZERO_STEP, [(place - 1, place)], share,
        f"{channel.called} jumps by {height:+.4g} from one sample to the next at {record.t[place]:.4g} s and "
        "stays there: no body does, so the sensor slipped or its zero was set anew. Use one side of it only.",
    )  # fmt: skip


def _of_stamps(record: Record) -> list[Fault]:
    """Faults of the clocks. A fault that does not bend the time of analysis is only reported."""
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
        if not fault.times or _any_inside(record, fault.times)
    ]


def _any_inside(record: Record, times: Sequence[float]) -> bool:
    """Whether one of the steps, of which ``times`` are the first samples after them, has both sides here."""
    return any(record.t[0] < t <= record.t[-1] for t in times)


def wrap_fault(record: Record, name: str, joint: int | None, wraps: Wraps) -> Fault:
    """A position that begins anew, with the key that undoes it."""
    times = tuple((float(record.t[i - 1]), float(record.t[i])) for i in wraps.places)
    where = name if joint is None else f"{name} of joint {joint}"
    count = len(wraps.places)
    say = (
        f"{where} begins anew {count} time{'s' if count > 1 else ''}, by steps of {wraps.period:.7g}, first "
        f"at {times[0][1]:.4g} s: an encoder that wraps. Import the table again with "
        f"`[channels] {name} = {{ …, unwrap = {wraps.period:.7g} }}`."
    )
    return Fault(Kind.WRAPPED, name, joint, times, count / len(record), say)


__all__ = [
    "TOLERATED",
    "Fault",
    "Kind",
    "Usable",
    "assess_usability",
    "faults",
    "faults_of",
    "with_censored",
    "without_spikes",
]

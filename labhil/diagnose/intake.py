"""Checks of a recording before its physics is searched: faults of the data, and the samples that are sound.

Each test aims at fewer than one false alarm in 10,000 clean recordings. Where no probability can be stated
(how fast may a body move?) its limit is beyond what any body does. Normal behaviour is no fault: a ball that
rests, a plunger at its stop, a command that its limits clip. The detectors are in ``bursts``, ``frozen``,
``input_faults``, ``jumps``, ``lag``, ``lead`` and ``wraps`` beside this file; :mod:`labhil.diagnose.timing`
adds the test that needs the rig's model.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from labhil.diagnose.bursts import (
    NO_SPANS,
    detect_bursts,
    detect_bursts_at_ends,
    detect_dropouts,
    interpolate_over,
    span_mask,
)
from labhil.diagnose.channel_faults import (
    dropout_fault,
    outlier_fault,
    samples_in,
    saturation_fault,
    stuck_fault,
    wrap_fault,
    zero_step_fault,
)
from labhil.diagnose.fault import TOLERATED_SHARE, Fault, FaultKind, RecordedChannel
from labhil.diagnose.frozen import detect_clipping_levels, detect_stuck_runs
from labhil.diagnose.input_faults import detect_command_spikes
from labhil.diagnose.jumps import detect_spikes, detect_zero_steps
from labhil.diagnose.record_faults import (
    clock_drift_faults,
    excitation_faults,
    gap_faults,
    lead_faults,
    non_finite_faults,
    time_order_faults,
)
from labhil.diagnose.wraps import detect_wraps
from labhil.identify.quantiser import converter_step
from labhil.identify.windows import noise_of
from labhil.physics.measured_input import MEASURED_INPUTS
from labhil.physics.record import UNREAD, Record
from labhil.signals import BoolArray, FloatArray, IntArray

NOT_OF_SAMPLES = (FaultKind.GAP, FaultKind.NO_EXCITATION, FaultKind.UNDERSAMPLED)
"""Kinds of fault that make no single samples unsound."""


@dataclass(frozen=True, slots=True)
class Usability:
    """What faults leave of a recording.

    Attributes:
        is_usable: whether the data are sound enough for a verdict.
        sound: marks (n,) of the samples that no fault affects.
    """

    is_usable: bool
    sound: BoolArray


def detect_faults(record: Record) -> tuple[Fault, ...]:
    """Find all faults that a measured record shows by itself, each of its recordings by itself.

    Args:
        record: one or several recordings as they were measured. The filters of ``Model.prepare`` hide faults.

    Returns:
        The faults, with the number of the recording where there are several.
    """
    if len(record.begins) == 1:
        return detect_recording_faults(record, noise_of(record))
    return tuple(
        replace(fault, recording=number, statement=f"Recording {number}: {fault.statement}")
        for number, recording in enumerate(record.recordings(), 1)
        for fault in detect_recording_faults(recording, noise_of(recording))
    )


def detect_recording_faults(record: Record, sigma: FloatArray) -> tuple[Fault, ...]:
    """Find all faults that one recording shows.

    Args:
        record: the recording as it was measured. The filters of ``Model.prepare`` hide faults.
        sigma: standard deviation of the noise of each output, (channels,).

    Returns:
        The faults. Where samples are not finite, only those and the faults of the time stamps.
    """
    if len(record) < 2:
        return ()
    faults = [*_clock_faults(record), *time_order_faults(record), *gap_faults(record)]
    non_finite = non_finite_faults(record)
    if non_finite:
        return (*faults, *non_finite)
    for channel in _measured_channels(record, sigma):
        faults += _channel_faults(record, channel)
    faults += _command_faults(record)
    return (
        *faults,
        *lead_faults(record),
        *clock_drift_faults(record),
        *excitation_faults(mark_censored(record), sigma),
    )


def mark_censored(record: Record) -> Record:
    """Mark the readings that stand at an end of their channel's range while the rig moves on.

    Marked readings count one-sidedly in residuals.

    Args:
        record: one or several recordings.

    Returns:
        The record with its marks ``censored`` set; the same object where there is nothing to mark.
    """
    if not len(record) or not np.isfinite(record.outputs).all():
        return record
    marks = np.zeros(record.outputs.shape, dtype=np.int64)
    for recording, span in zip(record.recordings(), record.spans, strict=True):
        for j, x in enumerate(recording.outputs.T):
            for limit in _range_limits(x, recording.inputs):
                side = 1 if limit == x.max() else -1
                marks[slice(*span), j][x == limit] = side
    return replace(record, censored=marks) if marks.any() else record


def replace_outliers(record: Record) -> Record:
    """Replace spikes, bursts and dropouts of outputs by a line between the readings on either side.

    Replaced readings are marked as unread, so that they leave no residuals.

    Args:
        record: one or several recordings.

    Returns:
        The record without these readings. A channel with more of them than is tolerated stays as it was
        measured; the same object where nothing is replaced.
    """
    if not len(record) or not np.isfinite(record.outputs).all():
        return record
    outputs = record.outputs.copy()
    marks = np.zeros(outputs.shape, dtype=np.int64) if record.censored is None else record.censored.copy()
    for recording, span in zip(record.recordings(), record.spans, strict=True):
        sigma = noise_of(recording) if len(recording) > 3 else np.zeros(outputs.shape[1])
        for j, channel in enumerate(_output_channels(recording, sigma)):
            for kind, wrong in _wrong_readings(channel):
                if samples_in(wrong) <= TOLERATED_SHARE[kind] * len(recording):
                    outputs[slice(*span), j] = interpolate_over(outputs[slice(*span), j], wrong)
                    marks[slice(*span), j][span_mask(wrong, len(recording))] = UNREAD
    return replace(record, outputs=outputs, censored=marks) if np.any(marks == UNREAD) else record


def assess_usability(
    record: Record, faults: Sequence[Fault], *, max_share_clipped_unmarked: float = 0.01
) -> Usability:
    """Decide which samples of a record are sound, and whether they suffice for a verdict.

    A record is not usable when some fault affects a larger share than ``TOLERATED_SHARE`` allows for its
    kind. Other faults are only reported.

    Args:
        record: one or several recordings.
        faults: their faults.
        max_share_clipped_unmarked: share of clipped readings up to which a record is usable that has no
            marks of them: there they count as true readings.

    Returns:
        Whether the record is usable, and its sound samples.
    """
    sound = np.ones(len(record), dtype=bool)
    for number, (recording, span) in enumerate(zip(record.recordings(), record.spans, strict=True), 1):
        for fault in (f for f in faults if f.recording in (None, number)):
            for begin, end in fault.times if fault.kind not in NOT_OF_SAMPLES else ():
                sound[slice(*span)] &= (recording.t < begin) | (recording.t > end)
    tolerated = (
        TOLERATED_SHARE
        if record.censored is not None
        else {**TOLERATED_SHARE, FaultKind.SATURATED: max_share_clipped_unmarked}
    )
    is_usable = all(fault.share <= tolerated.get(fault.kind, 1.0) for fault in faults)
    return Usability(is_usable, sound)


def _measured_channels(record: Record, sigma: FloatArray) -> list[RecordedChannel]:
    """Outputs, auxiliary channels, and the inputs that are measured too (those of an arm's joints)."""
    channels = _output_channels(record, sigma)
    auxiliary = {name: x for name, x in record.auxiliary.items() if not _is_planned(name)}
    channels += [
        RecordedChannel(name, None, x, _noise(x), record.inputs, may_rest=True)
        for name, x in auxiliary.items()
    ]
    channels += [
        RecordedChannel(name, None, x, _noise(x), np.delete(record.inputs, j, axis=1), may_rest=True)
        for j, (name, x) in enumerate(zip(record.input_names, record.inputs.T, strict=True))
        if (record.has_joints and not _is_planned(name)) or name in MEASURED_INPUTS
    ]
    return channels


def _output_channels(record: Record, sigma: FloatArray) -> list[RecordedChannel]:
    """The outputs of a recording with their noise."""
    return [
        RecordedChannel(
            *record.channel(j), x, float(sigma[j]), record.inputs, record.output_units[j] in ("m", "rad")
        )
        for j, x in enumerate(record.outputs.T)
    ]


def _is_planned(name: str) -> bool:
    """Whether a channel holds the plan of a controller, which may stand still and jump freely."""
    return name.startswith("target_") or name.endswith("_command")


def _noise(x: FloatArray) -> float:
    """Standard deviation of the noise of one channel (n,); zero where it is too short to estimate."""
    single = Record(np.arange(len(x), dtype=np.float64), x[:, None], x[:, None], ("",), ("",), ("",))
    return float(noise_of(single)[0]) if len(x) > 3 else 0.0


def _wrong_readings(
    channel: RecordedChannel,
) -> tuple[tuple[FaultKind, IntArray], tuple[FaultKind, IntArray]]:
    """First and last samples (k, 2) of spikes and bursts, and of dropouts; the channel may not wrap."""
    x, is_rate = channel.values, not channel.is_position
    sigma = max(channel.sigma, converter_step(x) / np.sqrt(12.0))
    places = detect_spikes(x, sigma, channel.drive, any_jump=channel.may_rest)
    spikes = np.column_stack([places, places])
    if channel.may_rest:
        # a pulse may be intended, an amplifier may have been off, joints of an arm jolt each other
        return (FaultKind.OUTLIER, spikes), (FaultKind.STUCK, NO_SPANS)
    bursts = detect_bursts(interpolate_over(x, spikes), sigma, channel.drive, is_rate=is_rate)
    outliers = np.concatenate([spikes, bursts])
    at_ends = detect_bursts_at_ends(interpolate_over(x, outliers), sigma, channel.drive)
    outliers = np.concatenate([outliers, at_ends])
    outliers = outliers[np.argsort(outliers[:, 0])]
    runs = detect_dropouts(interpolate_over(x, outliers), sigma, channel.drive, is_rate=is_rate)
    dropouts = np.column_stack([runs.start, runs.stop - 1])
    return (FaultKind.OUTLIER, outliers), (FaultKind.STUCK, dropouts)


def _channel_faults(record: Record, channel: RecordedChannel) -> list[Fault]:
    """Wraps, clipping, stuck readings, dropouts, outliers and zero steps of one channel."""
    drive, wraps = channel.drive, detect_wraps(channel.values) if channel.is_position else None
    faults = [] if wraps is None else [wrap_fault(record, channel, wraps)]
    x = channel.values if wraps is None else np.unwrap(channel.values, period=wraps.period)
    sigma = max(channel.sigma, converter_step(x) / np.sqrt(12.0))
    (_, outliers), (_, dropouts) = _wrong_readings(replace(channel, values=x))
    cleaned = interpolate_over(interpolate_over(x, outliers), dropouts)
    limits = _range_limits(cleaned, drive)
    faults += [saturation_fault(record, channel, limit) for limit in limits]
    runs = detect_stuck_runs(cleaned, drive, may_rest=channel.may_rest)
    runs = runs.select(~np.isin(cleaned[runs.start], limits))
    if len(runs.start):
        faults.append(stuck_fault(record, channel, list(zip(runs.start, runs.stop - 1, strict=True))))
    if len(dropouts):
        faults.append(dropout_fault(record, channel, dropouts))
    if len(outliers):
        faults.append(outlier_fault(record, channel, outliers))
    if channel.is_position:
        # a channel that was stuck jumps when it comes loose
        steps = np.setdiff1d(detect_zero_steps(cleaned, sigma, drive), runs.stop)
        faults += [zero_step_fault(record, channel, int(i)) for i in steps]
    return faults


def _command_faults(record: Record) -> list[Fault]:
    """Outliers of the inputs that are commands; these may stand still, jump and be clipped."""
    measured = {channel.name for channel in _measured_channels(record, np.zeros(record.outputs.shape[1]))}
    faults = []
    for name, u in zip(record.input_names, record.inputs.T, strict=True):
        places = detect_command_spikes(u) if name not in measured else np.empty(0, dtype=np.int64)
        if len(places):
            channel = RecordedChannel(name, None, u, _noise(u), record.inputs)
            faults.append(outlier_fault(record, channel, np.column_stack([places, places])))
    return faults


def _range_limits(x: FloatArray, drive: FloatArray) -> list[float]:
    """Values at which a channel (n,) is clipped, without those at which the rig rests."""
    return [limit for limit in detect_clipping_levels(x) if not _rests_at(x, limit, drive)]


def _rests_at(
    x: FloatArray,
    value: float,
    drive: FloatArray,
    *,
    max_share_of_drive: float = 0.1,
    min_samples_reversed: int = 20,
) -> bool:
    """Whether the rig rests while its channel (n,) reads ``value``, so that the reading shows no noise.

    It rests where no input exceeds ``max_share_of_drive`` of its maximum. It may also rest, by dry friction,
    at a rate of exactly zero; but a sensor that measures one direction only reads zero, too, during at least
    ``min_samples_reversed`` samples in which the rig is driven the other way as hard as when it moves.
    """
    at_value = x == value
    size = np.abs(drive)
    if bool(np.all(np.quantile(size[at_value], 0.95, axis=0) <= max_share_of_drive * size.max(axis=0))):
        return True
    if value != 0.0 or at_value.all():
        return False
    usual = np.median(drive[~at_value], axis=0)
    reversed_drive = -drive[at_value] * np.sign(usual)
    n_reversed = np.sum(reversed_drive > np.abs(usual), axis=0)
    return not bool(np.any((n_reversed >= min_samples_reversed) & (usual != 0.0)))


def _clock_faults(record: Record) -> list[Fault]:
    """Faults of the clocks. Those that leave the time of analysis as it is are only reported."""
    return [
        Fault(
            kind=FaultKind(fault.kind.value),
            channel="t",
            joint=None,
            times=(),
            share=1.0 if fault.distorts_time else 0.0,
            statement=fault.statement[0].upper() + fault.statement[1:],
        )
        for fault in record.begins[0].clock_faults
        if not fault.times or _is_any_inside(record, fault.times)
    ]


def _is_any_inside(record: Record, times: Sequence[float]) -> bool:
    """Whether a clock step is inside the record; ``times`` are the first samples (s) behind each step."""
    return any(record.t[0] < t <= record.t[-1] for t in times)


__all__ = [
    "Fault",
    "FaultKind",
    "Usability",
    "assess_usability",
    "detect_faults",
    "detect_recording_faults",
    "mark_censored",
    "replace_outliers",
]


def is_driven(record: Record) -> bool:
    """Whether an input changes in any recording."""
    return any(np.ptp(part.inputs, axis=0).any() for part in record.recordings())


def why_at_rest(record: Record, sigma: FloatArray, least: float) -> str | None:
    """How little the outputs vary where an input changes; None where one of them varies enough.

    Args:
        record: The data, with an input that changes.
        sigma: (c,), noise of the channels.
        least: Standard deviation, in those of the noise, from which an output moves.
    """
    driven = [part for part in record.recordings() if is_driven(part)]
    largest = max(float(np.max(np.std(part.outputs, axis=0) / sigma)) for part in driven)
    if largest > least:
        return None
    return (
        f"expected an output that varies by more than {least:.3g} times its noise, "
        f"found at most {largest:.2g} times"
    )

"""Faults of single channels with their messages: clipped, stuck, dropped out, spikes, zero steps, wraps.

What counts as one of these is decided by the detectors that :mod:`labhil.diagnose.intake` calls.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from labhil.diagnose.bursts import interpolate_over
from labhil.diagnose.fault import (
    TOLERATED_SHARE,
    Fault,
    FaultKind,
    RecordedChannel,
    fault_in_spans,
    format_percent,
    format_spans,
)
from labhil.diagnose.wraps import Wraps
from labhil.physics.record import Record
from labhil.signals import IntArray


def samples_in(spans: IntArray) -> int:
    """Return the number of samples in spans (k, 2) of first and last samples."""
    return int(np.sum(spans[:, 1] - spans[:, 0] + 1))


def saturation_fault(record: Record, channel: RecordedChannel, limit: float) -> Fault:
    """State that a channel is clipped.

    Args:
        record: one recording.
        channel: the channel.
        limit: value at which it is clipped.

    Returns:
        The fault. It is mended where the readings at the limit count as one-sided bounds.
    """
    at_limit = channel.values == limit
    edges = np.flatnonzero(np.diff(np.r_[False, at_limit, False].astype(np.int8)))
    spans = list(zip(edges[::2], edges[1::2] - 1, strict=True))
    share = float(at_limit.mean())
    # mark_censored marks those of outputs, but not of an arm's
    is_censored = channel.name in record.output_names and channel.joint is None
    counted = ", and count as such" if is_censored else ""
    fault = fault_in_spans(
        record, channel, FaultKind.SATURATED, spans, share,
        f"{channel.label} is clipped at {limit:.6g}: {at_limit.sum()} samples ({format_percent(share)}) read "
        f"exactly this value{format_spans(record, spans)}, although its noise should scatter them. They are "
        f"bounds of the true value{counted}. Check the sensor's and the converter's range, or excite "
        "less.",
    )  # fmt: skip
    return replace(fault, mended=is_censored and share <= TOLERATED_SHARE[FaultKind.SATURATED])


def stuck_fault(record: Record, channel: RecordedChannel, spans: Sequence[tuple[int, int]]) -> Fault:
    """State that a channel is stuck.

    Args:
        record: one recording.
        channel: the channel.
        spans: first and last sample of each stretch.

    Returns:
        The fault.
    """
    longest = max(spans, key=lambda span: span[1] - span[0])
    share = sum(last - first + 1 for first, last in spans) / len(record)
    value = channel.values[longest[0]]
    return fault_in_spans(
        record, channel, FaultKind.STUCK, spans, share,
        f"{channel.label} is stuck{format_spans(record, spans)} ({format_percent(share)} of the samples), "
        f"the longest time at {value:.6g} for {record.t[longest[1]] - record.t[longest[0]]:.3g} s, longer "
        "than rest or rounding explains. Check cable, sensor and converter; cut these times out or record "
        "again.",
    )  # fmt: skip


def dropout_fault(record: Record, channel: RecordedChannel, places: IntArray) -> Fault:
    """State that a channel drops out to one value and comes back.

    Args:
        record: one recording.
        channel: the channel.
        places: first and last sample of each dropout (k, 2).

    Returns:
        The fault. It is mended where the readings are replaced and leave no residuals.
    """
    spans = [(int(first), int(last)) for first, last in places]
    longest = max(spans, key=lambda span: span[1] - span[0])
    share = samples_in(places) / len(record)
    mended = _is_replaced(record, channel, FaultKind.STUCK, share)
    advice = "these readings do not count" if mended else "cut these times out or record again"
    fault = fault_in_spans(
        record, channel, FaultKind.STUCK, spans, share,
        f"{channel.label} drops out to {channel.values[longest[0]]:.6g}{format_spans(record, spans)} "
        f"({format_percent(share)} of the samples), the longest time for {longest[1] - longest[0] + 1} "
        "samples, and comes back from one sample to the next, which no motion does. Check cable, sensor and "
        f"converter; {advice}.",
    )  # fmt: skip
    return replace(fault, mended=mended)


def _is_replaced(record: Record, channel: RecordedChannel, kind: FaultKind, share: float) -> bool:
    """Whether wrong readings are replaced: those of outputs, if their share of the samples is tolerated."""
    return channel.name in record.output_names and share <= TOLERATED_SHARE[kind]


def outlier_fault(record: Record, channel: RecordedChannel, places: IntArray) -> Fault:
    """State that a channel has spikes or bursts of wrong readings.

    Args:
        record: one recording.
        channel: the channel.
        places: first and last sample of each spike or burst (k, 2).

    Returns:
        The fault. It is mended where the readings are replaced and leave no residuals.
    """
    x, count = channel.values, len(places)
    height = np.abs(x - interpolate_over(x, places))
    largest = int(np.argmax(height))
    share = samples_in(places) / len(record)
    width = int(np.max(places[:, 1] - places[:, 0])) + 1
    what = "single spike" if width == 1 else f"spike{'s' if count > 1 else ''} of up to {width} sample"
    plural = "s" if count > 1 or width > 1 else ""
    mended = _is_replaced(record, channel, FaultKind.OUTLIER, share)
    advice = "they do not count" if mended else "leave these samples out"
    fault = fault_in_spans(
        record, channel, FaultKind.OUTLIER, [(int(a), int(b)) for a, b in places], share,
        f"{channel.label} has {count} {what}{plural} ({format_percent(share)} "
        f"of the samples), the largest of {height[largest]:.4g} at {record.t[largest]:.4g} s, "
        f"{height[largest] / max(channel.sigma, 1e-300):.0f} times the noise. Look for loose contacts and "
        f"disturbed transmission; {advice}.",
    )  # fmt: skip
    return replace(fault, mended=mended)


def zero_step_fault(record: Record, channel: RecordedChannel, place: int) -> Fault:
    """State that a position jumps and stays, as where a sensor slips.

    Args:
        record: one recording.
        channel: the channel.
        place: first sample behind the jump.

    Returns:
        The fault, of the smaller of both sides.
    """
    height = channel.values[place] - channel.values[place - 1]
    share = min(place, len(record) - place) / len(record)
    return fault_in_spans(
        record, channel, FaultKind.ZERO_STEP, [(place - 1, place)], share,
        f"{channel.label} jumps by {height:+.4g} from one sample to the next at {record.t[place]:.4g} s and "
        "stays there, which no body does: the sensor slipped, or its zero was set again. Use the data on one "
        "side of the jump only.",
    )  # fmt: skip


def wrap_fault(record: Record, channel: RecordedChannel, wraps: Wraps) -> Fault:
    """State that a position wraps, with the key of the rig file that undoes it.

    Args:
        record: one recording.
        channel: the channel.
        wraps: places and period of the wraps.

    Returns:
        The fault.
    """
    times = tuple((float(record.t[i - 1]), float(record.t[i])) for i in wraps.places)
    count = len(wraps.places)
    statement = (
        f"{channel.label} wraps {count} time{'s' if count > 1 else ''}, by {wraps.period:.7g}, first at "
        f"{times[0][1]:.4g} s, as an encoder does that starts again. Import the table again with"
        f" `[channels] {channel.name} = {{ …, unwrap = {wraps.period:.7g} }}`."
    )
    share = count / len(record)
    return Fault(FaultKind.WRAPPED, channel.name, channel.joint, times, share, statement)

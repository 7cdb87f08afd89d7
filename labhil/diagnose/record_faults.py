"""Faults of a recording as a whole: time stamps, non-finite samples, clock drift, late inputs, no excitation.

Faults of single channels, such as spikes, are put into words in :mod:`labhil.diagnose.channel_faults`.
"""

from __future__ import annotations

import numpy as np

from labhil.diagnose.fault import (
    Fault,
    FaultKind,
    RecordedChannel,
    fault_in_spans,
    format_percent,
    format_spans,
)
from labhil.diagnose.lag import detect_lag_changes
from labhil.diagnose.lead import detect_lead
from labhil.identify.sampling import scattering_statement
from labhil.identify.windows import MIN_HOLE_IN_PERIODS
from labhil.physics.record import Record
from labhil.signals import BoolArray, FloatArray


def time_order_faults(record: Record) -> list[Fault]:
    """Report time stamps that repeat the one before them or go back.

    Args:
        record: one recording.

    Returns:
        One fault of the channel "t", or none.
    """
    step = np.diff(record.t)
    wrong = np.flatnonzero(~(step > 0.0))
    if not len(wrong):
        return []
    n_back = int(np.sum(step < 0.0))
    share = len(wrong) / len(record)
    times = [(float(min(record.t[i : i + 2])), float(max(record.t[i : i + 2]))) for i in wrong]
    return [
        Fault(
            FaultKind.TIME_ORDER, "t", None, tuple(times), share,
            f"The time does not increase at {len(wrong)} samples ({len(wrong) - n_back} repeat the stamp "
            f"before them, {n_back} go back), first after {record.t[wrong[0]]:.6g} s. Remove repeated rows, "
            "or record with the device's own clock.",
        )
    ]  # fmt: skip


def gap_faults(
    record: Record, *, min_step_in_periods: float = 1.5, min_excess_in_jitter: float = 8.0
) -> list[Fault]:
    """Report gaps: steps of time that are longer than uneven stamps explain.

    Args:
        record: one recording.
        min_step_in_periods: length of a gap in median steps of time, at least …
        min_excess_in_jitter: … plus this many robust standard deviations of the steps.

    Returns:
        One fault of the channel "t" with all gaps, or none.
    """
    step = np.diff(record.t)
    usual = float(np.median(step))
    # 1.4826 · median absolute deviation is the standard deviation of normal values
    jitter = 1.4826 * float(np.median(np.abs(step - usual)))
    gaps = np.flatnonzero(step > min_step_in_periods * usual + min_excess_in_jitter * jitter)
    duration = float(record.t[-1] - record.t[0])
    if not len(gaps) or usual <= 0.0:
        return []
    missing = step[gaps] - usual
    longest = gaps[np.argmax(missing)]
    total, samples = format_percent(float(missing.sum() / duration)), round(missing.sum() / usual)
    share = _bridged_time(record, missing, step[gaps] > MIN_HOLE_IN_PERIODS * usual) / duration
    times = tuple((float(record.t[i]), float(record.t[i + 1])) for i in gaps)
    return [
        Fault(
            FaultKind.GAP, "t", None, times, share,
            f"{len(gaps)} gap{'s' if len(gaps) > 1 else ''} in time, {missing.sum():.4g} s in all "
            f"({total} of the recording, about {samples} samples), the longest from "
            f"{record.t[longest]:.4g} to {record.t[longest + 1]:.4g} s. Nothing was filled in; look "
            "at the load of the recording machine and at the link.",
        )
    ]  # fmt: skip


def _bridged_time(record: Record, missing: FloatArray, is_long: BoolArray) -> float:
    """How much of the ``missing`` time (s) of each gap windows bridge: they end at long gaps.

    The filters of inverse dynamics bridge all gaps.
    """
    return float(missing.sum() if record.has_joints else missing[~is_long].sum())


def non_finite_faults(record: Record) -> list[Fault]:
    """Report channels with samples that are NaN or infinite.

    Args:
        record: one recording.

    Returns:
        One fault for each such input, output or auxiliary channel.
    """
    columns = [
        *zip(record.input_names, record.inputs.T, strict=True),
        *zip(record.output_names, record.outputs.T, strict=True),
        *record.auxiliary.items(),
    ]
    faults = []
    for name, x in columns:
        bad = ~np.isfinite(x)
        if bad.any():
            spans = [(int(i), int(i)) for i in np.flatnonzero(bad)]
            channel = RecordedChannel(name, None, x, 0.0, record.inputs)
            share = float(bad.mean())
            statement = (
                f"{name} is NaN or infinite at {bad.sum()} samples ({format_percent(share)})"
                f"{format_spans(record, spans)}. Drop these rows where the table is imported."
            )
            faults.append(fault_in_spans(record, channel, FaultKind.NOT_FINITE, spans, share, statement))
    return faults


def clock_drift_faults(record: Record) -> list[Fault]:
    """Report rates whose lag behind their own position changes.

    Args:
        record: one recording.

    Returns:
        One fault for each such pair of a position and its rate.
    """
    span = ((float(record.t[0]), float(record.t[-1])),)
    return [
        Fault(
            FaultKind.CLOCK_DRIFT, pair.rate, None, span, 1.0,
            f"The lag of {pair.rate} behind the derivative of {pair.position} changes from "
            f"{1e3 * pair.before:.3g} ms at the beginning to {1e3 * pair.after:.3g} ms at the end: their "
            "clocks drift apart. Stamp both by one clock.",
        )
        for pair in detect_lag_changes(record)
    ]  # fmt: skip


def excitation_faults(record: Record, sigma: FloatArray, *, min_spread_in_noise: float = 2.0) -> list[Fault]:
    """Report inputs that do not change, and outputs that show no motion.

    Args:
        record: one recording.
        sigma: standard deviation of the noise of each output, (channels,).
        min_spread_in_noise: standard deviation of an output that moves, in that of its noise, at least.

    Returns:
        A fault where no input changes, and one for each output that hardly leaves its noise or that
        scatters from sample to sample more than noise does.
    """
    span = ((float(record.t[0]), float(record.t[-1])),)
    faults = []
    if not np.any(np.ptp(record.inputs, axis=0) > 0.0):
        names = ", ".join(record.input_names)
        statement = f"No input changes ({names}): the response of the rig cannot be estimated. Excite it."
        faults.append(Fault(FaultKind.NO_EXCITATION, record.input_names[0], None, span, 1.0, statement))
    for j, spread in enumerate(np.std(record.outputs, axis=0)):
        name, joint = record.channel(j)
        scattering = scattering_statement(record, j, float(sigma[j]))
        if scattering is not None:
            # an arm's other joints are no worse for it
            share = float(joint is None)
            faults.append(Fault(FaultKind.UNDERSAMPLED, name, joint, span, share, scattering))
        elif spread <= min_spread_in_noise * sigma[j]:
            label = name if joint is None else f"{name} of joint {joint}"
            statement = (
                f"{label} hardly moves: its standard deviation {spread:.3g} {record.output_units[j]} is "
                f"{spread / max(float(sigma[j]), 1e-300):.2g} times its noise. Excite more."
            )
            faults.append(Fault(FaultKind.NO_EXCITATION, name, joint, span, 1.0, statement))
    return faults


def lead_faults(record: Record) -> list[Fault]:
    """Report an output that responds before its input changes.

    Args:
        record: one recording.

    Returns:
        One fault of the most significant such output, or none.
    """
    if np.any(np.diff(record.t) <= 0.0):
        return []
    lead = detect_lead(record)
    if lead is None:
        return []
    span = ((float(record.t[0]), float(record.t[-1])),)
    name, joint = record.channel(lead.output)
    source = record.input_names[lead.input]
    shift = -record.period * max(1, round(lead.samples))
    count = f"{lead.samples:.2g}"
    samples = f"{count} sample{'' if count == '1' else 's'} ({lead.samples * record.period:.3g} s)"
    statement = (
        f"{name} responds to {source} {samples} before {source} changes (p = {lead.p_value:.1g}), which no "
        f"rig does: the stamps of {source} are late. Stamp both by one clock, or import the table again with "
        f"`[channels] {source} = {{ …, shift = {shift:.6g} }}`."
    )
    return [Fault(FaultKind.LEAD, name, joint, span, 1.0, statement)]

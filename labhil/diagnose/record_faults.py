"""Faults of a recording as a whole: its time, numbers that are none, clocks that part, nothing that moves."""

from __future__ import annotations

import numpy as np

from labhil.diagnose.fault import Channel, Fault, Kind, fault_of, percent, when
from labhil.diagnose.lag import partings
from labhil.diagnose.lead import lead_of
from labhil.identify.sampling import scattering_statement
from labhil.identify.windows import MIN_HOLE_IN_PERIODS
from labhil.physics.model import Record
from labhil.signals import FloatArray

LONG_STEP = 1.5
"""A gap is longer than this many usual steps of time …"""

UNEVEN = 8.0
"""… and beyond them by this many robust standard deviations of uneven stamps."""

MOVES = 2.0
"""A channel moves when its standard deviation is this many times its noise."""


def time_order(record: Record) -> list[Fault]:
    """Stamps that repeat the one before them or go back."""
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


def gaps(record: Record) -> list[Fault]:
    """Steps of time that are longer than uneven stamps make them."""
    step = np.diff(record.t)
    usual = float(np.median(step))
    spread = 1.4826 * float(np.median(np.abs(step - usual)))
    holes = np.flatnonzero(step > LONG_STEP * usual + UNEVEN * spread)
    duration = float(record.t[-1] - record.t[0])
    if not len(holes) or usual <= 0.0:
        return []
    missing = step[holes] - usual
    longest = holes[np.argmax(missing)]
    total, samples = percent(float(missing.sum() / duration)), round(missing.sum() / usual)
    share = _bridged(record, missing, step[holes] > MIN_HOLE_IN_PERIODS * usual) / duration
    times = tuple((float(record.t[i]), float(record.t[i + 1])) for i in holes)
    return [
        Fault(
            Kind.GAP, "t", None, times, share,
            f"{len(holes)} gap{'s' if len(holes) > 1 else ''} in time, {missing.sum():.4g} s in all "
            f"({total} of the recording, about {samples} samples), the longest from "
            f"{record.t[longest]:.4g} to {record.t[longest + 1]:.4g} s. Nothing was filled in; look "
            "at the load of the recording machine and at the link.",
        )
    ]  # fmt: skip


def _bridged(record: Record, missing: FloatArray, long: np.ndarray) -> float:
    """How much of the ``missing`` time (s) of gaps windows bridge: they end at ``long`` ones.

    Inverse dynamics filters over all of them.
    """
    arm = bool(record.output_joints and record.output_joints[0] is not None)
    return float(missing.sum() if arm else missing[~long].sum())


def not_finite(record: Record) -> list[Fault]:
    """Channels with samples that are no finite number."""
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
            channel = Channel(name, None, x, 0.0, record.inputs)
            statement = (
                f"{name} is no finite number at {bad.sum()} samples ({percent(float(bad.mean()))})"
                f"{when(record, spans)}. Drop these rows where the table is imported."
            )
            faults.append(fault_of(record, channel, Kind.NOT_FINITE, spans, float(bad.mean()), statement))
    return faults


def clock_drifts(record: Record) -> list[Fault]:
    """Rates whose lag behind their own position changes."""
    span = ((float(record.t[0]), float(record.t[-1])),)
    return [
        Fault(
            Kind.CLOCK_DRIFT, pair.rate, None, span, 1.0,
            f"{pair.rate} and the derivative of {pair.position} part: the one lags by "
            f"{1e3 * pair.before:.3g} ms at the beginning and by {1e3 * pair.after:.3g} ms at the end. "
            "Stamp both by one clock.",
        )
        for pair in partings(record)
    ]  # fmt: skip


def no_excitation(record: Record, sigma: FloatArray) -> list[Fault]:
    """Inputs that do not change, and outputs that hardly leave their noise ``sigma`` (channels,).

    Or that scatter more from sample to sample than noise does.
    """
    span = ((float(record.t[0]), float(record.t[-1])),)
    faults = []
    if not np.any(np.ptp(record.inputs, axis=0) > 0.0):
        names = ", ".join(record.input_names)
        say = f"No input changes ({names}): nothing can be learnt of how the rig answers. Excite it."
        faults.append(Fault(Kind.NO_EXCITATION, record.input_names[0], None, span, 1.0, say))
    for j, spread in enumerate(np.std(record.outputs, axis=0)):
        name, joint = record.channel(j)
        scatters = scattering_statement(record, j, float(sigma[j]))
        if scatters is not None:
            # an arm's other joints are no worse for it
            faults.append(Fault(Kind.UNDERSAMPLED, name, joint, span, float(joint is None), scatters))
        elif spread <= MOVES * sigma[j]:
            where = name if joint is None else f"{name} of joint {joint}"
            say = (
                f"{where} hardly moves: its standard deviation {spread:.3g} {record.output_units[j]} is "
                f"{spread / max(float(sigma[j]), 1e-300):.2g} times its noise. Excite more."
            )
            faults.append(Fault(Kind.NO_EXCITATION, name, joint, span, 1.0, say))
    return faults


def leads(record: Record) -> list[Fault]:
    """Outputs that answer before their input."""
    if np.any(np.diff(record.t) <= 0.0):
        return []
    lead = lead_of(record)
    if lead is None:
        return []
    span = ((float(record.t[0]), float(record.t[-1])),)
    name, joint = record.channel(lead.output)
    source = record.input_names[lead.input]
    shift = -record.period * max(1, round(lead.samples))
    count = f"{lead.samples:.2g}"
    samples = f"{count} sample{'' if count == '1' else 's'} ({lead.samples * record.period:.3g} s)"
    say = (
        f"{name} answers {source} {samples} before {source} changes (p = {lead.p_value:.1g}): no rig does, "
        f"so the stamps of {source} are late. Stamp both by one clock, or import the table again with "
        f"`[channels] {source} = {{ …, shift = {shift:.6g} }}`."
    )
    return [Fault(Kind.LEAD, name, joint, span, 1.0, say)]

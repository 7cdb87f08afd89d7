"""What the samples of a device to which nothing was commanded say: limits, constant channels, sample rate."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from labhil.analysis.motion_check import constant
from labhil.device_check.samples import Samples
from labhil.doctor.finding import Finding, broken, fine, note
from labhil.driver import DriverSpec
from labhil.rig import RigFile
from labhil.rig_sections import Limit
from labhil.service.declared import safe_values
from labhil.service.limits import COMMAND_MARGIN, CommandLimits, SampleLimits
from labhil.signals import Batch, FloatArray, Signal

MAX_RATE_ERROR = 0.05
"""Largest relative error of the sample rate: that of :class:`labhil.testing.DriverContract`."""


def findings_at_rest(samples: Samples, spec: DriverSpec, rig: RigFile) -> Iterator[Finding]:
    """Look at every channel of a device that is not commanded.

    Args:
        samples: What it sent.
        spec: The declaration of its driver.
        rig: Its rig file.
    """
    yield _sample_rate(samples)
    for signal in samples.stream.signals:
        yield _channel(signal, samples, spec, rig)


def sample_rate(samples: Samples) -> tuple[float | None, int]:
    """The rate by the device's clock, Hz (None where it stands still), and how many samples are lost."""
    periods = np.diff(samples.t)
    period = float(np.median(periods)) if len(periods) else 0.0
    if not period > 0.0:
        return None, 0
    return 1.0 / period, int(np.sum(np.rint(periods / period) - 1.0))


def _sample_rate(samples: Samples) -> Finding:
    """Compare the rate by the device's clock with the stated one, and count lost samples."""
    stated = samples.stream.rate
    seen, lost = sample_rate(samples)
    if seen is None:
        return broken(
            "sample rate",
            f"found {len(samples)} samples whose clock does not advance, stated are {stated:g} Hz",
            "see the firmware or the controller: its clock stands still",
        )
    text = f"{seen:.4g} Hz seen in {len(samples)} samples, {stated:g} Hz stated"
    if abs(seen / stated - 1.0) > MAX_RATE_ERROR:
        return broken("sample rate", text, "correct the rate that the device states, or its clock")
    if lost:
        return note("sample rate", f"{text}; {lost} were lost", "see the line and how busy this machine is")
    return fine("sample rate", text)


def _channel(signal: Signal, samples: Samples, spec: DriverSpec, rig: RigFile) -> Finding:
    """The one finding about a channel that matters most."""
    subject = f"{signal.name} [{signal.unit}]" if signal.unit else signal.name
    values = samples.of_signal(signal)
    if not np.isfinite(values).any():
        return note(subject, "the device does not report it", "fits and limits cannot use it")
    found = _range_of(values)
    if not np.isfinite(values).all():
        bad = int(np.sum(~np.isfinite(values).all(axis=1)))
        return broken(subject, f"{found}; {bad} of {len(values)} samples are no numbers", "see its sensor")
    limits = limits_of(signal, rig)
    text = f"{found}, {_describe_limits(limits, rig)}"
    violation = violation_of(samples, spec, limits)
    if violation:
        return broken(
            subject,
            f"{found}: {violation}",
            f"bring it inside, or correct [limits] in {rig.path}: a run would end with its first sample",
        )
    if signal in spec.commands:
        return _command(subject, text, signal, values, spec, rig)
    names = [name for name, flag in zip(signal.columns(), constant(values), strict=True) if flag]
    if names and signal in (*rig.kind.inputs, *rig.kind.outputs):
        which = "" if len(names) == signal.width else f" ({', '.join(names)})"
        return note(
            subject,
            f"{text}; constant in all {len(values)} samples{which}",
            "a step shows whether it is stuck",
        )
    return fine(subject, text)


def _command(
    subject: str, text: str, signal: Signal, values: FloatArray, spec: DriverSpec, rig: RigFile
) -> Finding:
    """A command has to be at its safe value while nobody commands."""
    safe = safe_values(spec)
    bounds = CommandLimits(spec.commands, rig.limits, spec.ranges)
    for column, reading in zip(signal.columns(), np.median(values, axis=0), strict=True):
        low, high = bounds.range_of(column)
        if column in safe and abs(reading - safe[column]) > COMMAND_MARGIN * (high - low):
            return broken(
                subject,
                f"{text}; expected {column} at its safe value {safe[column]:g}, found {reading:.4g}",
                "see whether somebody else commands the device, and its zero in the firmware",
            )
    return fine(subject, f"{text}; commanded, {'at its safe value' if safe else 'holds'}")


def limits_of(signal: Signal, rig: RigFile) -> dict[str, Limit]:
    """The limits that a rig file states for a signal and its columns, by name."""
    return {name: rig.limits[name] for name in (signal.name, *signal.columns()) if name in rig.limits}


def violation_of(samples: Samples, spec: DriverSpec, limits: dict[str, Limit]) -> str:
    """How samples leave limits, as the host of a run would find it; empty where they do not."""
    order = np.arange(len(samples), dtype=np.int64)
    batch = Batch(order, order, order, samples.values)
    return SampleLimits(samples.stream, spec.commands, limits).violation(batch) or ""


def _range_of(values: FloatArray) -> str:
    numbers = values[np.isfinite(values)]
    low, high = float(numbers.min()), float(numbers.max())
    span = f"{low:.4g}" if low == high else f"{low:.4g} to {high:.4g}"
    return span if values.shape[1] == 1 else f"{span} in {values.shape[1]} columns"


def _describe_limits(limits: dict[str, Limit], rig: RigFile) -> str:
    if not limits:
        return f"no limits in {rig.path.name}"
    return "inside " + " and ".join(f"{limit.min:g} to {limit.max:g}" for limit in limits.values())

"""A small step of one command and back, on a bench whose host keeps the limits.

The device is brought to its safe state at the end, however the step ends.
"""

from __future__ import annotations

import time
from collections.abc import Iterator
from dataclasses import dataclass
from math import isfinite

import numpy as np

from labhil.device_check.samples import Samples
from labhil.doctor.finding import Finding, broken, note
from labhil.driver import DriverSpec
from labhil.errors import ConditionError, DeviceSilentError
from labhil.experiment.bench import Bench
from labhil.rig import RigFile
from labhil.service.declared import safe_values
from labhil.service.limits import CommandLimits
from labhil.signals import Signal

STEP_SHARE = 0.05
"""Default size of a step, as a share of the range that the limits allow."""
HOLDING_SHARE = 0.2
"""Share of that for a command whose safe state is to hold, as of an arm: 5 % of ±π are 18°, a fifth is 4°."""
RAMP_TIME = 0.3
"""Time of the way to the target, s: a person sees it begin and can press the stop; an abrupt step is none."""
RAMP_INTERVAL = 0.05
"""Time between two commands of a ramp, s; far below the watchdog's 0.22 s."""
HOLD_TIME = 0.5
"""Time at the start and at the target, s: 50 samples of the slowest bench at each."""
ARRIVAL_TIMEOUT = 10.0
"""Longest time until a command is in effect, s: that of :class:`labhil.testing.DriverContract`. The program
of an arm's controller takes seconds to start."""
ARRIVAL_SHARE = 0.1
"""Largest distance from the target, as a share of the step, at which it is reached."""


@dataclass(frozen=True, slots=True)
class SmallStep:
    """A step of the column ``column`` of the command ``signal`` from ``start`` to ``target``, and back.

    ``ramp`` is the time of either way, s; 0 where the driver makes its way by itself.
    """

    signal: Signal
    column: str
    start: float
    target: float
    ramp: float

    def __str__(self) -> str:
        return f"{self.column} from {self.start:.4g} to {self.target:.4g} {self.signal.unit} and back"

    def has_reached(self, reading: float, level: float) -> bool:
        """Whether a reading of the command is at ``level``, its start or its target."""
        return abs(reading - level) <= ARRIVAL_SHARE * abs(self.target - self.start)


@dataclass(frozen=True, slots=True)
class Answer:
    """What a device sent during a step: ``before`` it, and ``after`` its start until the way back."""

    step: SmallStep
    before: Samples
    after: Samples


def plan_steps(
    spec: DriverSpec, rig: RigFile, rest: Samples, share: float
) -> tuple[list[SmallStep], list[Finding]]:
    """Plan a step of each command of a rig kind, within the limits; the device is not touched.

    Args:
        spec: The declaration of the driver.
        rig: The rig file.
        rest: Samples of the device at rest.
        share: Size of the step as a share of the allowed range, above 0 and up to 1.

    Returns:
        The steps, and why other commands get none.
    """
    kind = {signal.name for signal in rig.kind.signals()}
    bounds = CommandLimits(spec.commands, rig.limits, spec.ranges)
    safe, steps, findings = safe_values(spec), list[SmallStep](), list[Finding]()
    for signal in spec.commands:
        if signal.name not in kind:
            findings.append(note(signal.name, "gets no step: it is a switch of the device, not of the rig"))
            continue
        for column in signal.columns():
            low, high = bounds.range_of(column)
            if not (isfinite(low) and isfinite(high)):
                advice = f"state min and max of {signal.name} in [limits] of {rig.path}"
                findings.append(note(column, "gets no step: it has no limits", advice))
                continue
            start = safe.get(column, float(np.median(rest.column(column))))
            size = (high - low) * share * (1.0 if column in safe else HOLDING_SHARE)
            if not low <= start <= high:
                advice = f"bring it inside, or correct [limits] in {rig.path}"
                findings.append(
                    broken(column, f"is at {start:.4g}, outside its limits, {low:g} to {high:g}", advice)
                )
                continue
            target = start + size if start + size <= high else max(start - size, low)
            ramp = 0.0 if spec.waypoint_rate else RAMP_TIME
            steps.append(SmallStep(signal, column, start, target, ramp))
    return steps, findings


def make_step(bench: Bench, step: SmallStep) -> Answer:
    """Make a step and go back; the device is in its safe state afterwards, also after Ctrl+C.

    Raises:
        ConditionError: The command does not come into effect.
        LimitTrippedError: A sample left the limits; the host has made the device safe.
        CommandRefusedError: The emergency stop was pressed, or somebody else commands the device.
        DeviceSilentError: The device stopped talking.
    """
    try:
        bench.command(hold=HOLD_TIME, **{step.column: step.start})
        bench.received()
        bench.command(hold=HOLD_TIME, **{step.column: step.start})
        before = Samples.received(bench)
        if not len(before):
            raise DeviceSilentError(f"{step.column}: expected samples within {HOLD_TIME:g} s, found none")
        parts = list(_go(bench, step, step.start, step.target))
        bench.command(hold=HOLD_TIME, **{step.column: step.target})
        parts.append(Samples.received(bench))
        for _ in _go(bench, step, step.target, step.start):
            pass
    finally:
        bench.safe()
    return Answer(step, before, Samples.joined(parts))


def _go(bench: Bench, step: SmallStep, start: float, end: float) -> Iterator[Samples]:
    """Go from one level to the other and wait until that is in effect; yields the samples of the way."""
    count = round(step.ramp / RAMP_INTERVAL)
    for number in range(1, count):
        bench.command(hold=RAMP_INTERVAL, **{step.column: start + (end - start) * number / count})
    deadline = time.monotonic() + ARRIVAL_TIMEOUT
    reading = start
    while True:
        bench.command(hold=RAMP_INTERVAL, **{step.column: end})
        samples = Samples.received(bench)
        yield samples
        reading = float(samples.column(step.column)[-1]) if len(samples) else reading
        if step.has_reached(reading, end):
            return
        if time.monotonic() > deadline:
            raise ConditionError(
                f"{step.column}: expected {end:.4g} {step.signal.unit} in effect at the device within "
                f"{ARRIVAL_TIMEOUT:g} s, found {reading:.4g}"
            )

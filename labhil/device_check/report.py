"""The result of a device's check in its JSON (`labhil.device_check/1`), declared once."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from math import isfinite
from typing import Any, Literal

import numpy as np

from labhil.analysis.motion_check import constant
from labhil.analysis.schema.parts import Number, Part
from labhil.device_check.at_rest import limits_of, sample_rate, violation_of
from labhil.device_check.direction import Moved, Says, is_stuck, moved_outputs
from labhil.device_check.samples import Samples
from labhil.device_check.small_step import SmallStep
from labhil.doctor.finding import Finding, State
from labhil.driver import DriverSpec
from labhil.rig import RigFile
from labhil.signals import Signal

SCHEMA = "labhil.device_check/1"

Way = Literal["rises", "falls", "still"]


class RateCheck(Part):
    """The sample rate by the device's clock; ``seen`` is None where that clock does not advance."""

    stated: float
    seen: Number
    samples: int
    lost: int


class ChannelLimit(Part):
    """What ``[limits]`` of the rig file say of a channel or a column; None where they say nothing."""

    name: str
    min: Number
    max: Number
    rate: Number


class ColumnRange(Part):
    """Smallest and largest value of a column at rest; None where the device reports none."""

    column: str
    min: Number
    max: Number
    constant: bool


class ChannelCheck(Part):
    """A channel of the device at rest, and whether a step showed it stuck.

    Attributes:
        channel: Its name.
        unit: Its unit.
        command: Whether it is a command.
        columns: Its range at rest, by column.
        limits: The limits that the rig file states for it.
        within_limits: Whether every sample was inside them; None where there are none, or no number to judge.
        violation: How a sample left them; empty where none did.
        stuck: Whether it never changed in a step while another output moved; None where no step was made or
            none can move it.
    """

    channel: str
    unit: str
    command: bool
    columns: tuple[ColumnRange, ...]
    limits: tuple[ChannelLimit, ...]
    within_limits: bool | None
    violation: str
    stuck: bool | None = None


class Motion(Part):
    """How a column answered a step.

    Attributes:
        channel: Its channel.
        column: Its name.
        unit: Its unit.
        change: Largest change in the direction in which it moved, in ``unit``; 0 where it did not move.
        direction: Where it went.
        expected: Where it should go; None where nothing is expected of it.
        expected_by: What says so: the ``command`` itself or the rig's ``model``; empty where nothing does.
        agrees: Whether it went there; None where nothing is expected of it, or it did not move.
        stuck: Whether it never changed while another output moved.
    """

    channel: str
    column: str
    unit: str
    change: float
    direction: Way
    expected: Literal["rises", "falls"] | None
    expected_by: Says
    agrees: bool | None
    stuck: bool


class StepCheck(Part):
    """A step of a command from ``start`` to ``target``, in ``unit``, and what moved."""

    command: str
    unit: str
    start: float
    target: float
    motions: tuple[Motion, ...]


class DeviceCheck(Part):
    """`labhil.device_check/1`: the check of a device.

    Attributes:
        experiment: Path of the experiment file.
        rig_file: Path of the rig file.
        rig: Rig kind.
        driver: Driver of the device.
        fine: Whether no finding is a fault.
        sample_rate: The sample rate.
        channels: Each channel at rest.
        steps: The steps that were made; none where nothing was moved.
        findings: Everything that was found, in its order, as it is printed.
    """

    experiment: str
    rig_file: str
    rig: str
    driver: str
    fine: bool
    sample_rate: RateCheck
    channels: tuple[ChannelCheck, ...]
    steps: tuple[StepCheck, ...]
    findings: tuple[Finding, ...]

    def to_json(self) -> dict[str, Any]:
        """Return the check as JSON data."""
        return {"schema": SCHEMA, **self.model_dump(mode="json")}


def is_fine(findings: Sequence[Finding]) -> bool:
    """Whether no finding is a fault."""
    return not any(finding.state is State.BROKEN for finding in findings)


def rate_check(samples: Samples) -> RateCheck:
    """The sample rate of a device at rest."""
    seen, lost = sample_rate(samples)
    return RateCheck(stated=samples.stream.rate, seen=seen, samples=len(samples), lost=lost)


def channel_checks(
    samples: Samples, spec: DriverSpec, rig: RigFile, steps: Sequence[StepCheck]
) -> Iterator[ChannelCheck]:
    """Say of each channel what it did at rest, and whether a step showed it stuck.

    Args:
        samples: What the device sent at rest.
        spec: The declaration of its driver.
        rig: Its rig file.
        steps: The steps that were made.
    """
    motions = [motion for step in steps for motion in step.motions]
    for signal in samples.stream.signals:
        limits = limits_of(signal, rig)
        is_judged = bool(limits) and bool(np.isfinite(samples.of_signal(signal)).any())
        violation = violation_of(samples, spec, limits) if is_judged else ""
        stuck = [motion.stuck for motion in motions if motion.channel == signal.name]
        yield ChannelCheck(
            channel=signal.name,
            unit=signal.unit,
            command=signal in spec.commands,
            columns=tuple(_column_ranges(signal, samples)),
            limits=tuple(
                ChannelLimit(name=name, min=_number(one.min), max=_number(one.max), rate=_number(one.rate))
                for name, one in limits.items()
            ),
            within_limits=not violation if is_judged else None,
            violation=violation,
            stuck=any(stuck) if stuck else None,
        )


def _column_ranges(signal: Signal, samples: Samples) -> Iterator[ColumnRange]:
    values = samples.of_signal(signal)
    flags = constant(values)
    for column, flag, numbers in zip(signal.columns(), flags, values.T, strict=True):
        finite = numbers[np.isfinite(numbers)]
        low, high = (float(finite.min()), float(finite.max())) if len(finite) else (None, None)
        yield ColumnRange(column=column, min=low, max=high, constant=bool(flag) and low is not None)


def _number(value: float) -> float | None:
    return value if isfinite(value) else None


def step_check(step: SmallStep, moved: Sequence[Moved]) -> StepCheck:
    """Say of a step which columns moved, in which direction, and in which they should."""
    others = moved_outputs(moved)
    return StepCheck(
        command=step.column,
        unit=step.signal.unit,
        start=step.start,
        target=step.target,
        motions=tuple(_motion(row, is_stuck(row, others)) for row in moved),
    )


def _motion(row: Moved, stuck: bool) -> Motion:
    expected = _way(row.expected)
    return Motion(
        channel=row.channel,
        column=row.column,
        unit=row.unit,
        change=row.change,
        direction=_way(row.change),
        expected=None if expected == "still" else expected,
        expected_by=row.says if row.expected else Says.NOTHING,
        agrees=row.agreement > 0 if row.agreement else None,
        stuck=stuck,
    )


def _way(change: float) -> Way:
    return "rises" if change > 0.0 else "falls" if change < 0.0 else "still"

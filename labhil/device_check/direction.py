"""Whether each channel of a rig moved in a step, in which direction, and whether that is the expected one."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from enum import StrEnum

import numpy as np

from labhil.analysis.motion_check import constant
from labhil.device_check.small_step import ARRIVAL_SHARE, Answer, SmallStep
from labhil.doctor.finding import Finding, broken, fine, note
from labhil.kinds import RigKind
from labhil.signals import FloatArray, Signal

MIN_SHARE_OUTSIDE = 0.2
"""Least share of samples beyond all that were seen before the step that shows a motion. Of n samples of a
channel at rest a share of 1/(n + 1) lies beyond the largest of n earlier ones: 2 % for 50."""
MIN_ONE_WAY = 0.5
"""Least |Σd|/Σ|d| of a change d that a model expects for which it has a direction: three quarters of it then
lie on one side. A change that goes to and fro has none."""


class Says(StrEnum):
    """What says which way a channel should go."""

    COMMAND = "command"
    MODEL = "model"
    NOTHING = ""


@dataclass(frozen=True, slots=True)
class Moved:
    """How a column answered a step.

    Attributes:
        channel: Name of its channel.
        column: Its name.
        unit: Its unit.
        change: Largest change in the direction in which it moved, in ``unit``; 0 where it did not move.
        says: What says in which direction it should move.
        expected: +1 where it should rise, −1 where it should fall, 0 where nothing is expected.
        follows: Whether it measures what was commanded.
        is_output: Whether it is an output of the rig kind.
        is_constant: Whether its reading never changed at all.
    """

    channel: str
    column: str
    unit: str
    change: float
    says: Says
    expected: int
    follows: bool
    is_output: bool
    is_constant: bool

    @property
    def agreement(self) -> int:
        """+1 where it moved as expected, −1 where the other way, 0 where it stood or nothing is expected."""
        return int(np.sign(self.change)) * self.expected


def movements(answer: Answer, kind: RigKind, simulated: Mapping[str, FloatArray]) -> list[Moved]:
    """Judge the channels of a rig kind that a step can move.

    Args:
        answer: What was measured.
        kind: The rig kind.
        simulated: What its model expects the step to change, by column, each as long as ``answer.after``.
    """
    step = answer.step
    commanded = answer.after.column(step.column) - step.start
    active = np.abs(commanded) > ARRIVAL_SHARE * abs(step.target - step.start)
    moved = []
    for signal in _answering(answer, kind):
        column = _column_of(signal, step.signal, step.column)
        before, after = answer.before.column(column), answer.after.column(column)[active]
        change = _change(before, after)
        says, expected = Says.NOTHING, 0
        if signal in kind.inputs and signal.unit in (step.signal.unit, f"{step.signal.unit}/s"):
            says, expected = Says.COMMAND, _direction(commanded)
        elif column in simulated:
            says, expected = Says.MODEL, _direction(simulated[column])
        moved.append(
            Moved(
                signal.name,
                column,
                signal.unit,
                change,
                says,
                expected,
                says is Says.COMMAND and signal.unit == step.signal.unit,
                signal in kind.outputs,
                bool(constant(np.concatenate([before, after])[:, None])[0]),
            )
        )
    return moved


def _answering(answer: Answer, kind: RigKind) -> Iterator[Signal]:
    """Signals of the rig kind that are measured: inputs that follow a command, outputs, auxiliary scalars.

    Of vectors the joint that moves is looked at, and auxiliary ones (plans of a controller) are left out.
    """
    command = answer.step.signal
    present = {signal.name for signal in answer.after.stream.signals} - {command.name}
    scalars = [signal for signal in kind.auxiliary if signal.width == 1]
    for signal in (*kind.inputs, *kind.outputs, *scalars):
        if signal.name in present and signal.width in (1, command.width):
            yield signal


def _column_of(signal: Signal, command: Signal, column: str) -> str:
    return signal.name if signal.width == 1 else signal.columns()[command.columns().index(column)]


def _change(before: FloatArray, after: FloatArray) -> float:
    """The largest change, signed; 0 unless enough samples leave the range that was seen before."""
    above, below = float(np.mean(after > before.max())), float(np.mean(after < before.min()))
    if max(above, below) < MIN_SHARE_OUTSIDE:
        return 0.0
    middle = float(np.median(before))
    return float(after.max() - middle) if above > below else float(after.min() - middle)


def _direction(expected: FloatArray) -> int:
    """+1 or −1 where an expected change goes mostly one way, else 0."""
    whole, size = float(np.sum(expected)), float(np.sum(np.abs(expected)))
    return int(np.sign(whole)) if abs(whole) >= MIN_ONE_WAY * size else 0


def findings_of_step(answer: Answer, moved: Sequence[Moved]) -> Iterator[Finding]:
    """Put the movements of a step into words; channels that are not judged and stand still are left out."""
    step = answer.step
    judged = [row for row in moved if row.is_output and row.agreement]
    all_wrong = len(judged) > 1 and all(row.agreement < 0 for row in judged)
    others = moved_outputs(moved)
    for row in moved:
        if row.change:
            yield _moving(row, step, all_wrong)
        elif row.is_output or row.follows:
            yield _still(row, step, others)


def moved_outputs(moved: Sequence[Moved]) -> set[str]:
    """The columns of outputs that a step moved."""
    return {row.column for row in moved if row.is_output and row.change}


def is_stuck(row: Moved, outputs: set[str]) -> bool:
    """Whether an output never changed at all while others of the ``outputs`` moved."""
    return row.is_output and row.is_constant and bool(outputs - {row.column})


def _moving(row: Moved, step: SmallStep, all_wrong: bool) -> Finding:
    way, other = ("rises", "falls") if row.change > 0.0 else ("falls", "rises")
    when = "rises" if step.target > step.start else "falls"
    text = f"{way} by up to {abs(row.change):.3g} {row.unit} when {step.column} {when}"
    if row.agreement < 0:
        text = f"{text}; by the {row.says} it {other}"
        return broken(row.column, text, _turn(row, step.column, all_wrong))
    if not row.agreement:
        return fine(row.column, f"{text}; no direction is expected of it")
    return fine(row.column, f"{text}, as {'commanded' if row.says is Says.COMMAND else 'the model expects'}")


def _turn(row: Moved, command: str, all_wrong: bool) -> str:
    """Which sign to turn: that of the command where every output answers the wrong way round."""
    if all_wrong:
        return (
            f"every output answers the wrong way round: swap the leads of the drive, or turn the sign of "
            f"{command} in the firmware or the driver; then check again"
        )
    return (
        f"swap the leads of the sensor of {row.column}, or turn its sign in the firmware or the driver; "
        "then check again"
    )


def _still(row: Moved, step: SmallStep, others: set[str]) -> Finding:
    command, size = step.column, abs(step.target - step.start)
    if row.follows:
        return broken(
            row.column,
            f"does not follow {command}, which changed by {size:.3g}",
            "see whether the drive is enabled and supplied, and whether the sensor is connected",
        )
    if is_stuck(row, others):
        return broken(
            row.column,
            f"is stuck: it never changed while {', '.join(sorted(others))} moved",
            "see whether its sensor is connected; dry friction also holds a part: then repeat with --step 20",
        )
    if row.says is Says.MODEL:
        return note(
            row.column,
            f"does not move beyond its noise when {command} changes by {size:.3g}",
            "friction or a preload may hold it: repeat with a larger step, such as --step 20; else see its "
            "sensor",
        )
    return fine(row.column, f"does not move beyond its noise when {command} changes by {size:.3g}")

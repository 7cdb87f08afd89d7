"""Steps that drive one thing along a path: where one ends the next has to begin, and both at rest."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from labhil.driver import DriverSpec
from labhil.errors import ExperimentFileError
from labhil.experiment.excitation.function import Excitation, columns_of
from labhil.experiment.experiment import TimedStep

WITHIN = 0.01
"""s; over which a speed is measured at a step's end."""
NEARLY_STILL = 0.02
"""What a speed may be between two steps (SI units per second)."""


def refuse_jumps(path: Path, spec: DriverSpec, steps: Sequence[TimedStep]) -> None:
    """ExperimentFileError when a command of ``spec.approach`` jumps from one step to the next.

    Such a device goes to where the first step begins by itself, but after that it follows a path. The
    first step may begin moving, and the last may end moving: the driver sees to that.
    """
    for command in spec.commands:
        if command.name not in spec.approach:
            continue
        names = {command.name: command.columns(), **{column: (column,) for column in command.columns()}}
        before: dict[str, tuple[TimedStep, Excitation]] = {}
        for timed in sorted(
            (step for step in steps if step.step.signal in names), key=lambda step: step.start
        ):
            for column, part in zip(names[timed.step.signal], columns_of(timed.make()), strict=False):
                if column in before:
                    _compare(path, column, before[column], (timed, part), spec.approach[command.name])
                before[column] = (timed, part)


def _compare(
    path: Path,
    column: str,
    earlier: tuple[TimedStep, Excitation],
    later: tuple[TimedStep, Excitation],
    near: float,
) -> None:
    (first, leaving), (second, entering) = earlier, later
    place = f"{path}: steps.{second.index}: {column}"
    if second.start < first.end:
        raise ExperimentFileError(
            f"{place} is driven by steps.{first.index} at the same time ({second.start:g} s)"
        )
    duration = first.step.duration
    ends, begins = leaving(duration), entering(0.0)
    if abs(begins - ends) > near:
        raise ExperimentFileError(
            f"{place} begins at {begins:.4g}, but steps.{first.index} ends at {ends:.4g}: a path has no "
            "jumps; give both the same `centre` or `offset`, or make two experiments of them"
        )
    speed = max(abs(ends - leaving(duration - WITHIN)), abs(entering(WITHIN) - begins)) / WITHIN
    if speed > NEARLY_STILL:
        raise ExperimentFileError(
            f"{place} would have to change its speed at once by up to {speed:.3g} per second between "
            f"steps.{first.index} and steps.{second.index}: let both end at rest, for instance "
            "with `fade = 2.0`"
        )

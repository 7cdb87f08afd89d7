"""Continuity of a path across its steps: each begins where the one before ended, at rest."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from labhil.driver import DriverSpec
from labhil.errors import ExperimentFileError
from labhil.experiment.excitation.function import Excitation, columns_of
from labhil.experiment.experiment import TimedStep


def refuse_jumps(path: Path, spec: DriverSpec, steps: Sequence[TimedStep]) -> None:
    """Raise ExperimentFileError where a command of ``spec.approach`` jumps from one step to the next.

    Such a device moves to the start of the first step by itself and then follows a path. The first step may
    begin in motion and the last may end in motion: the driver handles both.

    Args:
        path: The experiment file, for the message.
        spec: The declaration of the device.
        steps: Its steps.
    """
    for command in spec.commands:
        if command.name not in spec.approach:
            continue
        names = {command.name: command.columns(), **{column: (column,) for column in command.columns()}}
        previous: dict[str, tuple[TimedStep, Excitation]] = {}
        for timed in sorted(
            (step for step in steps if step.step.signal in names), key=lambda step: step.start
        ):
            for column, part in zip(names[timed.step.signal], columns_of(timed.make()), strict=False):
                if column in previous:
                    tolerance = spec.approach[command.name]
                    _check_transition(path, column, previous[column], (timed, part), tolerance)
                previous[column] = (timed, part)


def _check_transition(
    path: Path,
    column: str,
    earlier: tuple[TimedStep, Excitation],
    later: tuple[TimedStep, Excitation],
    tolerance: float,
    *,
    max_speed: float = 0.02,
    interval: float = 0.01,
) -> None:
    """Raise ExperimentFileError where a column jumps or moves between two steps.

    Args:
        path: The experiment file, for the message.
        column: Name of the column.
        earlier: One step with its excitation.
        later: The next step.
        tolerance: Largest jump, in the unit of the column.
        max_speed: Largest speed at the transition, unit/s.
        interval: Interval over which the speed is taken, s.
    """
    (first, leaving), (second, entering) = earlier, later
    place = f"{path}: steps.{second.index}: {column}"
    if second.start < first.end:
        raise ExperimentFileError(
            f"{place} is driven by steps.{first.index} at the same time ({second.start:g} s)"
        )
    duration = first.step.duration
    last_value, first_value = leaving(duration), entering(0.0)
    if abs(first_value - last_value) > tolerance:
        raise ExperimentFileError(
            f"{place} begins at {first_value:.4g}, but steps.{first.index} ends at {last_value:.4g}: a path "
            "has no jumps; give both the same `centre` or `offset`, or make two experiments of them"
        )
    change = max(abs(last_value - leaving(duration - interval)), abs(entering(interval) - first_value))
    speed = change / interval
    if speed > max_speed:
        raise ExperimentFileError(
            f"{place} would have to change its speed at once by up to {speed:.3g} per second between "
            f"steps.{first.index} and steps.{second.index}: let both end at rest, for instance "
            "with `fade = 2.0`"
        )

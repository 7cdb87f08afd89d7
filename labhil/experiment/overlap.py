"""Refusal of steps that must not run at the same time."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from labhil.experiment.experiment import TimedStep


def refuse_overlaps(schedule: Sequence[TimedStep]) -> None:
    """Raise ValueError where two steps drive one signal at the same time."""
    for later in schedule:
        for earlier in schedule[: later.index]:
            is_same = (earlier.step.device, earlier.step.signal) == (later.step.device, later.step.signal)
            if is_same and earlier.start < later.end and later.start < earlier.end:
                raise ValueError(
                    f"steps.{later.index}: {later.step.device}.{later.step.signal} is driven by "
                    f"steps.{earlier.index} at the same time ({later.start:g} s)"
                )


def refuse_conditions_beside_others(schedule: Sequence[TimedStep], devices: int) -> None:
    """Raise ValueError for a step with a condition that runs beside another step.

    The condition decides in the run when the step begins or ends and shifts all later steps. A step beside
    it could not be shifted.

    Args:
        schedule: The steps with their starts.
        devices: Number of devices of the experiment.
    """
    for timed in schedule:
        key = "until" if timed.step.until is not None else "when" if timed.step.when is not None else ""
        if not key:
            continue
        if devices > 1:
            raise ValueError(
                f"steps.{timed.index}.{key}: expected an experiment with one device, found {devices}"
            )
        for neighbour in schedule:
            if neighbour is not timed and neighbour.start < timed.end and timed.start < neighbour.end:
                raise ValueError(
                    f"steps.{timed.index}.{key}: expected a step that runs alone, found "
                    f"steps.{neighbour.index} at the same time"
                )

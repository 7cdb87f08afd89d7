"""The setpoints of a device after each of its samples: its excitations, and PD feedback around them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from labhil.errors import ExperimentFileError, UnknownNameError
from labhil.experiment.excitation.function import Excitation, columns_of
from labhil.experiment.experiment import Stabilise, TimedStep
from labhil.signals import Stream


class Derivative:
    """Derivative of a sampled signal through a first-order lag of ``filter_time`` s; zero at first."""

    def __init__(self, filter_time: float) -> None:
        self._filter_time = filter_time
        self._previous: tuple[float, float] | None = None
        self._value = 0.0

    def at(self, t: float, y: float) -> float:
        """Take the sample ``y`` at time ``t`` (s), and return the derivative there."""
        if self._previous is not None:
            elapsed = t - self._previous[0]
            if elapsed > 0:
                slope = (y - self._previous[1]) / elapsed
                self._value += elapsed / (self._filter_time + elapsed) * (slope - self._value)
        self._previous = (t, y)
        return self._value

    def reset(self) -> None:
        """Begin again as at the first sample."""
        self._previous, self._value = None, 0.0


@dataclass(frozen=True, slots=True)
class _Feedback:
    settings: Stabilise
    column: int
    derivative: Derivative

    def output(self, t: float, values: Sequence[float]) -> float:
        y = values[self.column]
        settings = self.settings
        return settings.kp * (y - settings.setpoint) + settings.kd * self.derivative.at(t, y)


@dataclass(frozen=True, slots=True)
class _Drive:
    column: str
    start: float
    end: float
    excitation: Excitation
    feedback: _Feedback | None


class Controller:
    """Computes the setpoints of one device from its samples.

    Outside its steps a signal has its safe value.

    Args:
        steps: The steps of the device.
        stream: Its samples.
        safe: Safe values of its commands, SI units.

    Raises:
        ExperimentFileError: A step stabilises a signal that this device has not.
    """

    def __init__(self, steps: Sequence[TimedStep], stream: Stream, safe: Mapping[str, float]) -> None:
        self._safe = dict(safe)
        self._drives = [drive for timed in steps for drive in _drives(timed, stream)]

    def setpoints(self, t: float, values: Sequence[float], *, waiting: bool = False) -> dict[str, float]:
        """Compute the setpoint of every command after a sample.

        Args:
            t: Time of the steps, s. Call this for every sample, in order: derivatives need all of them.
            values: The sample, SI units.
            waiting: Whether a step waits to begin at ``t``. Its signal then has its safe value less the
                feedback.
        """
        setpoints = dict(self._safe)
        for drive in self._drives:
            feedback = drive.feedback.output(t, values) if drive.feedback is not None else 0.0
            if drive.start <= t < drive.end:
                safe = self._safe.get(drive.column, 0.0)
                setpoints[drive.column] = (safe if waiting else drive.excitation(t - drive.start)) - feedback
        return setpoints

    def reset_derivatives(self) -> None:
        """Forget earlier samples: no derivative may reach across a pause or a jump of the clock."""
        for drive in self._drives:
            if drive.feedback is not None:
                drive.feedback.derivative.reset()


def _drives(timed: TimedStep, stream: Stream) -> list[_Drive]:
    """Return the drive of a scalar command, or one for each column of a vector: ``name_0``, ``name_1``, …"""
    step, feedback = timed.step, None
    if step.stabilise is not None:
        if step.stabilise.on not in stream.names():
            missing = UnknownNameError("signal", step.stabilise.on, stream.names())
            raise ExperimentFileError(
                f"steps.{timed.index}.stabilise.on: {missing}: the device that is there has no such channel"
            )
        column = stream.columns_of(step.stabilise.on).start
        feedback = _Feedback(step.stabilise, column, Derivative(step.stabilise.filter))
    parts = columns_of(timed.make())
    names = (step.signal,) if len(parts) == 1 else [f"{step.signal}_{i}" for i in range(len(parts))]
    return [
        _Drive(name, timed.start, timed.end, part, feedback) for name, part in zip(names, parts, strict=True)
    ]

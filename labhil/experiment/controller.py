"""The setpoints of a device at each of its samples: its steps, and the PD that keeps the plant in range."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from labhil.errors import ExperimentFileError, UnknownNameError
from labhil.experiment.excitation.function import Excitation, columns_of
from labhil.experiment.experiment import Stabilise, TimedStep
from labhil.signals import Stream


class Derivative:
    """d/dt of a sampled signal through a first-order lag of ``filter_time`` s; zero at the first sample."""

    def __init__(self, filter_time: float) -> None:
        self._filter_time = filter_time
        self._before: tuple[float, float] | None = None
        self._value = 0.0

    def at(self, t: float, y: float) -> float:
        """Take the sample ``y`` at time ``t`` (s) in, and return the derivative there."""
        if self._before is not None:
            elapsed = t - self._before[0]
            if elapsed > 0:
                slope = (y - self._before[1]) / elapsed
                self._value += elapsed / (self._filter_time + elapsed) * (slope - self._value)
        self._before = (t, y)
        return self._value

    def forget(self) -> None:
        """Begin anew, as at the first sample."""
        self._before, self._value = None, 0.0


@dataclass(frozen=True, slots=True)
class _Feedback:
    settings: Stabilise
    column: int
    derivative: Derivative

    def effort(self, t: float, values: Sequence[float]) -> float:
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
    """Turns the samples of one device into what is requested of it.

    Outside its steps a signal has its safe value. Times are s of the device's clock since
    the run began. ExperimentFileError for a step that is to follow a channel that is not fitted.
    """

    def __init__(self, steps: Sequence[TimedStep], stream: Stream, safe: Mapping[str, float]) -> None:
        self._safe = dict(safe)
        self._drives = [drive for timed in steps for drive in _drives(timed, stream)]

    def requested(self, t: float, values: Sequence[float], *, waiting: bool = False) -> dict[str, float]:
        """Return the value of every command after the sample ``values`` at time ``t``.

        Every sample is to be shown, in order: derivatives are made of them. While a step is ``waiting`` to
        begin at ``t``, its signal has the safe value, less the effort that keeps the plant in range.
        """
        setpoints = dict(self._safe)
        for drive in self._drives:
            effort = drive.feedback.effort(t, values) if drive.feedback is not None else 0.0
            if drive.start <= t < drive.end:
                safe = self._safe.get(drive.column, 0.0)
                setpoints[drive.column] = (safe if waiting else drive.excitation(t - drive.start)) - effort
        return setpoints

    def forget(self) -> None:
        """Forget what was shown before: samples from before a pause make no derivative."""
        for drive in self._drives:
            if drive.feedback is not None:
                drive.feedback.derivative.forget()


def _drives(timed: TimedStep, stream: Stream) -> list[_Drive]:
    """A drive for the command, or for each column of a vector: ``name_0``, ``name_1``, …"""
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

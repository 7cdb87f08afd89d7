"""The plan of a run, made without touching a device: names are resolved and limits are checked."""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from labhil.driver import DriverSpec, PartlyFittedTwin
from labhil.errors import ExperimentFileError, UnknownNameError
from labhil.experiment.condition import Condition
from labhil.experiment.continuity import refuse_jumps
from labhil.experiment.device_sections import DeviceSection, WithDevices
from labhil.experiment.excitation.function import columns_of, sample_at_rate
from labhil.experiment.excitation.spectrum import Spectrum, spectrum_of
from labhil.experiment.experiment import TWIN, Experiment, Step, TimedStep
from labhil.plugins import load_driver, load_twin
from labhil.rig import RigFile
from labhil.rig_sections import Interlock, Limit
from labhil.service.interlocks import format_thresholds
from labhil.signals import FloatArray, Signal


@dataclass(frozen=True, slots=True)
class DevicePlan:
    """One device of a run: its section in the file, its driver's declaration, its rig file and its steps."""

    name: str
    section: DeviceSection
    spec: DriverSpec
    rig: RigFile
    steps: tuple[TimedStep, ...]


@dataclass(frozen=True, slots=True)
class StepPlan:
    """One step of a run, evaluated.

    Attributes:
        timed: The step with its time.
        unit: Unit of its signal.
        lowest: Lowest value of the excitation, in ``unit``.
        highest: Highest value.
        fastest: Largest change between two samples, ``unit`` per second.
        spectrum: Spectrum of the excitation.
        warnings: What a person should know before the run.
    """

    timed: TimedStep
    unit: str
    lowest: float
    highest: float
    fastest: float
    spectrum: Spectrum
    warnings: tuple[str, ...]


@dataclass(frozen=True, slots=True)
class Plan:
    """The plan of a run; ``duration`` in s of the devices' clocks."""

    experiment: Experiment
    devices: tuple[DevicePlan, ...]
    steps: tuple[StepPlan, ...]
    duration: float

    def warnings(self) -> tuple[str, ...]:
        """Return where the run will differ from the experiment file."""
        return tuple(warning for step in self.steps for warning in step.warnings)

    def describe(self) -> str:
        """Describe the run for a person, in several lines."""
        return "\n".join(self._lines())

    def _lines(self) -> Iterator[str]:
        yield f"{self.experiment.experiment.name}: {self.duration:g} s of the devices' clocks"
        for device in self.devices:
            address = "its simulated device" if device.section.address == TWIN else device.section.address
            speed = device.section.twin.speed if device.section.address == TWIN else 1.0
            speed_text = f", {speed:g} times faster than real time" if speed != 1.0 else ""
            yield f"  {device.name}: {device.section.plugin} at {address}{speed_text}"
            for signal, limit in device.rig.limits.items():
                yield f"    limit {signal}: {_format_limit(limit)}"
            for signal, interlock in device.rig.interlocks.items():
                yield f"    interlock {signal}: {_format_interlock(interlock)}"
            if not device.rig.limits:
                yield "    no limits: the rig file has no [limits], so nothing is clipped and nothing trips"
        for step in self.steps:
            yield f"  {_format_step(step)}"
            yield from (f"    {line}" for line in _format_spectrum(step))
        for check in self.experiment.checks or ():
            yield f"  check {check.at} the steps, within {check.within:g} s: {check.condition}"
        if self.experiment.experiment.hook is not None:
            yield f"  calls {self.experiment.experiment.hook} before and after"
        for warning in self.warnings():
            yield f"  note: {warning}"


def make_plan(experiment: Experiment) -> Plan:
    """Resolve names, read rig files and check every step against the limits; no device is touched.

    Raises:
        ExperimentFileError: A name, a step or a condition is wrong.
        RigFileError: A rig file is wrong.
        UnknownNameError: A driver or simulated device does not exist.
    """
    schedule = experiment.schedule()
    devices = tuple(device_plan(experiment, name, schedule) for name in experiment.devices)
    by_name = {device.name: device for device in devices}
    steps = tuple(_step_plan(experiment.path, timed, by_name[timed.step.device]) for timed in schedule)
    for device in devices:
        refuse_jumps(experiment.path, device.spec, device.steps)
    _refuse_unknown_signals(experiment, devices)
    return Plan(experiment, devices, steps, experiment.duration)


def device_plan(experiment: WithDevices, name: str, schedule: tuple[TimedStep, ...] = ()) -> DevicePlan:
    """Resolve the driver, the rig file and the steps of a device.

    Args:
        experiment: The file.
        name: Name of the device in it.
        schedule: The steps of all devices.

    Raises:
        ExperimentFileError: A name is unknown, or an interlock watches a signal that the device has not.
        RigFileError: The rig file is wrong.
    """
    section = experiment.devices[name]
    try:
        spec = load_driver(section.plugin).spec
        if section.address == TWIN:
            _check_twin(section)
    except UnknownNameError as error:
        raise ExperimentFileError(f"{experiment.path}: devices.{name}: {error}") from error
    rig = experiment.rig_of(name, spec.rig)
    for signal in rig.interlocks:
        if signal not in spec.stream.names():
            unknown = UnknownNameError("signal", signal, spec.stream.names())
            raise ExperimentFileError(
                f"{rig.path}: interlocks.{signal}: {section.plugin} has no such {unknown}"
            )
    return DevicePlan(name, section, spec, rig, tuple(t for t in schedule if t.step.device == name))


def _check_twin(section: DeviceSection) -> None:
    twin = load_twin(section.plugin)
    for key, names, known in (
        ("twin.terms:", section.twin.terms or (), twin.terms()),
        ("twin.set:", section.twin.set, twin.parameters()),
    ):
        for name in names:
            if name not in known:
                raise UnknownNameError(key, name, known)


def _step_plan(path: Path, timed: TimedStep, device: DevicePlan) -> StepPlan:
    step, place = timed.step, f"{path}: steps.{timed.index}"
    commands = {signal.name: signal for signal in _drivable_signals(device.spec)}
    if step.signal not in commands:
        raise ExperimentFileError(f"{place}.signal: {UnknownNameError('command', step.signal, commands)}")
    names = device.spec.stream.names()
    if step.stabilise is not None and step.stabilise.on not in names:
        raise ExperimentFileError(
            f"{place}.stabilise.on: {UnknownNameError('signal', step.stabilise.on, names)}"
        )
    if step.stabilise is not None:
        _refuse_unfitted(f"{place}.stabilise.on", (step.stabilise.on,), device)
    _check_conditions(place, step, device)
    rate, command = device.spec.stream.rate, commands[step.signal]
    values = _values(place, timed, command, rate)
    safe = _safe_values(device.spec, command, values)
    previous = np.vstack([safe, values[:-1]])
    lowest, highest = float(values.min()), float(values.max())
    fastest = float(np.max(np.abs(values - previous))) * rate
    limit = device.rig.limits.get(step.signal) or device.rig.limits.get(_vector_of(step.signal))
    extremes = (lowest, highest, fastest)
    warnings = () if limit is None else _check_limit(place, step.signal, command.unit, extremes, limit)
    _check_range(place, command, lowest, highest, device.spec)
    excursion = _longest_excursion(values, safe) / rate
    if excursion > device.spec.longest_output:
        warnings += (
            f"{place}: {step.signal} is not at its safe value for {excursion:g} s without a break; the "
            f"device ends an output after {device.spec.longest_output:g} s, and the run ends with it",
        )
    return StepPlan(timed, command.unit, *extremes, spectrum_of(values, rate), warnings)


def _check_conditions(place: str, step: Step, device: DevicePlan) -> None:
    """Refuse conditions on unknown signals, and conditions that would interrupt a path."""
    for key, condition in (("when", step.when), ("until", step.until)):
        if condition is None:
            continue
        _check_signals(f"{place}.{key}", condition, device)
        if device.spec.waypoint_rate:
            raise ExperimentFileError(
                f"{place}.{key}: {device.spec.name} follows paths, which cannot be interrupted"
            )


def _check_signals(place: str, condition: Condition, device: DevicePlan) -> None:
    try:
        condition.bind(device.spec.stream.columns())
    except UnknownNameError as error:
        raise ExperimentFileError(f"{place}: {error}") from error
    _refuse_unfitted(place, condition.names, device)


def _refuse_unfitted(place: str, names: Iterable[str], device: DevicePlan) -> None:
    """Raise ExperimentFileError for a signal that a simulated device, as it is described, does not have."""
    if device.section.address != TWIN:
        return
    twin = load_twin(device.section.plugin)
    unfitted = twin.unfitted(device.section.twin.set) if isinstance(twin, PartlyFittedTwin) else {}
    for name in names:
        if name in unfitted:
            raise ExperimentFileError(
                f"{place}: expected a signal that {device.name} has, found {name}, which is not fitted to "
                f"the simulated device: set `{unfitted[name]}`, which is 0, in devices.{device.name}.twin.set"
            )


def _refuse_unknown_signals(experiment: Experiment, devices: tuple[DevicePlan, ...]) -> None:
    for number, check in enumerate(experiment.checks or ()):
        (device,) = [candidate for candidate in devices if check.device in (None, candidate.name)]
        _check_signals(f"{experiment.path}: checks.{number}.condition", check.condition, device)


def _drivable_signals(spec: DriverSpec) -> Iterator[Signal]:
    """Yield the signals that a step can drive: the commands, and each column of a vector command."""
    for signal in spec.commands:
        yield signal
        if signal.width > 1:
            for column in signal.columns():
                yield replace(signal, name=column, width=1)


def _vector_of(column: str) -> str:
    return column.rpartition("_")[0]


def _values(place: str, timed: TimedStep, command: Signal, rate: float) -> FloatArray:
    """Return the excitation at the rate of the device, (n, columns of the command)."""
    try:
        excitation = timed.make()
    except ValueError as error:
        raise ExperimentFileError(f"{place}: {error}") from error
    width = len(columns_of(excitation))
    if width != command.width:
        raise ExperimentFileError(
            f"{place}: {command.name} has {command.width} columns, but the excitation has {width}"
        )
    if command.width > 1 and timed.step.stabilise is not None:
        raise ExperimentFileError(f"{place}.stabilise: only for a plain signal, {command.name} is a vector")
    try:
        return sample_at_rate(excitation, timed.step.duration, rate).reshape(-1, command.width)
    except (ValueError, OverflowError) as error:
        raise ExperimentFileError(f"{place}: the excitation cannot be calculated: {error}") from error


def _safe_values(spec: DriverSpec, command: Signal, values: FloatArray) -> FloatArray:
    """Return the value before the step, (columns,): the safe value, or its first value where it has none."""
    first_values = values[0].tolist()
    return np.array(
        [
            spec.safe.get(column, spec.safe.get(command.name, first))
            for column, first in zip(command.columns(), first_values, strict=True)
        ]
    )


def _longest_excursion(values: FloatArray, safe: FloatArray) -> int:
    """Return the largest number of samples in a row that are not at the safe values."""
    at_rest = np.flatnonzero(np.all(values == safe, axis=1))
    return int(np.diff(np.concatenate([[-1], at_rest, [len(values)]])).max()) - 1


def _check_range(place: str, command: Signal, lowest: float, highest: float, spec: DriverSpec) -> None:
    """Refuse values beyond the range of the device, whatever the limits."""
    low, high = spec.ranges.get(command.name, (-math.inf, math.inf))
    if lowest < low or highest > high:
        allowed = f"{spec.name} takes {low:.4g} to {high:.4g} {command.unit}"
        raise _range_error(place, command.name, command.unit, (lowest, highest), allowed)


def _range_error(
    place: str, signal: str, unit: str, extremes: tuple[float, float], allowed: str
) -> ExperimentFileError:
    lowest, highest = extremes
    return ExperimentFileError(
        f"{place}: the excitation of {signal} reaches from {lowest:.4g} to {highest:.4g} {unit}; {allowed}"
    )


def _check_limit(
    place: str, signal: str, unit: str, extremes: tuple[float, float, float], limit: Limit
) -> tuple[str, ...]:
    """Refuse values beyond min and max; return a warning for a rate that the host will limit."""
    lowest, highest, fastest = extremes
    if lowest < limit.min or highest > limit.max:
        allowed = f"its limits are {limit.min:g} to {limit.max:g} {unit}"
        raise _range_error(place, signal, unit, (lowest, highest), allowed)
    if fastest > limit.rate:
        return (
            f"{place}: {signal} changes by up to {fastest:.4g} {unit}/s and will be slowed to its "
            f"limit of {limit.rate:g} {unit}/s",
        )
    return ()


def _format_limit(limit: Limit) -> str:
    rate = f", {limit.rate:g} per second" if limit.rate != float("inf") else ""
    return f"{limit.min:g} to {limit.max:g}{rate}"


def _format_interlock(interlock: Interlock) -> str:
    return f"{', '.join(format_thresholds(interlock))}; then {interlock.then}"


def _format_step(step: StepPlan) -> str:
    timed, settings = step.timed, step.timed.step
    text = (
        f"{timed.start:g}–{timed.end:g} s: {settings.device}.{settings.signal} {settings.excitation}, "
        f"{step.lowest:.4g} to {step.highest:.4g} {step.unit}, up to {step.fastest:.4g} {step.unit}/s, "
        f"crest factor {step.spectrum.crest_factor:.2f}, RMS {step.spectrum.rms:.4g} {step.unit}"
    )
    if settings.when is not None:
        text = f"{text}; begins once {settings.when}, waits {settings.wait:g} s at most"
    if settings.until is not None:
        text = f"{text}; ends early once {settings.until}"
    if settings.stabilise is None:
        return text
    return f"{text}; kp {settings.stabilise.kp:g}, kd {settings.stabilise.kd:g} on {settings.stabilise.on}"


def _format_spectrum(step: StepPlan) -> Iterator[str]:
    spectrum = step.spectrum
    if spectrum.occupied is None or spectrum.half_power is None:
        return
    low, high = spectrum.edges[0], spectrum.edges[-1]
    yield f"90 % of its power in {spectrum.occupied}; −3 dB {spectrum.half_power}"
    yield f"{low:.2g} Hz |{spectrum.bars()}| {high:.3g} Hz"

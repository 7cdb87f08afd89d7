"""An experiment on one simulated serial bench, step by step: its clock waits for the controller.

The same bench, converter, controller and limits as in a run, in one process and without the wire, the driver,
the bus and the host. A machine that has no time to spare makes this slow, and changes none of its samples.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from labhil.driver import TwinOptions
from labhil.errors import LimitTrippedError, UsageError
from labhil.experiment.attachments import attach_files, run_metadata
from labhil.experiment.controller import Controller
from labhil.experiment.device_sections import TwinSection
from labhil.experiment.experiment import Experiment
from labhil.experiment.plan import DevicePlan, make_plan
from labhil.experiment.result import answer_path, recording_path
from labhil.host_clock import unix_ns
from labhil.plugins import load_twin
from labhil.recording.writer import RecordingWriter, media_type
from labhil.serial_twin.bench import SimulatedRig
from labhil.serial_twin.settings import TwinSettings
from labhil.serial_twin.twin import SerialTwin, write_answer
from labhil.service.limits import CommandLimits, SampleLimits
from labhil.signals import Batch, FloatArray

PROVENANCE = {"clock": "waits for the controller", "left_out": "wire, driver, bus, host"}
"""What a recording states of how it was made."""


def run_stepwise(experiment: Experiment, out_dir: Path) -> Path:
    """Run an experiment with one simulated serial device, and leave its recording.

    Args:
        experiment: The experiment; its device has one command.
        out_dir: Folder of the recording; it is made if need be.

    Returns:
        The recording. What the twin is made of is written beside it, as by a run.

    Raises:
        UsageError: The device is not such a twin.
        LimitTrippedError: A measured signal leaves its limits.
    """
    plan = make_plan(experiment)
    (device,) = plan.devices
    twin = load_twin(device.section.plugin)
    if not isinstance(twin, SerialTwin):
        raise UsageError(f"{device.section.plugin}: expected the twin of a serial device, found another")
    settings = TwinSettings.of(_options(device.section.twin), twin.settable)
    out_dir.mkdir(parents=True, exist_ok=True)
    path = recording_path(experiment, out_dir)
    batch = _SteppedBench(device, twin.make(settings)).run(plan.duration)
    write_answer(answer_path(path, device.name, are_several=False), settings)
    with RecordingWriter(path) as writer:
        for name, content in attach_files(plan).items():
            writer.attach(name, media_type(name), content)
        for name, table in run_metadata(plan, {"simulation": PROVENANCE}).items():
            writer.metadata(name, table)
        writer.write(writer.add_stream(device.name, device.spec.stream, {}), batch)
        return writer.finish("0", "all steps are done")


def _options(section: TwinSection) -> TwinOptions:
    return TwinOptions(seed=section.seed, terms=section.terms, parameters=section.set)


@dataclass(frozen=True, slots=True)
class _SteppedBench:
    """One device with its simulated bench; every sample is answered before the next is taken."""

    device: DevicePlan
    bench: SimulatedRig

    def run(self, duration: float) -> Batch:
        """Return the samples of all steps; LimitTrippedError where one leaves the limits."""
        spec, board, limits = self.device.spec, self.bench.board, self.device.rig.limits
        controller = Controller(self.device.steps, spec.stream, spec.safe)
        command_limits = CommandLimits(spec.commands, limits, spec.ranges)
        sample_limits = SampleLimits(spec.stream, spec.commands, limits)
        (command,), period = spec.commands, 1.0 / board.sample_rate
        scale = board.channels[spec.stream.names().index(command.name)]
        samples = self._empty(round(duration * board.sample_rate))
        self.bench.begin()
        applied, output = spec.safe[command.name], board.safe
        for k in range(len(samples)):
            raw = self.bench.samples(output, 1) if k else self.bench.rest(output, 1)
            samples.values[k] = self._values(raw[0])
            violation = sample_limits.violation(_row(samples, k))
            if violation is not None:
                raise LimitTrippedError(f"{self.device.name}: {violation}")
            setpoint = controller.setpoints(k * period, samples.values[k].tolist())[command.name]
            applied = command_limits.clip(command.name, setpoint, applied, period)
            output = board.allowed(scale.raw(applied))
        return samples

    def _empty(self, n: int) -> Batch:
        """Return n samples at their times of the device's clock, without values."""
        seq = np.arange(n, dtype=np.int64)
        t_ns = np.rint(seq * (1e9 / self.bench.board.sample_rate)).astype(np.int64)
        return Batch(seq, unix_ns() + t_ns, t_ns, np.empty((n, len(self.bench.board.channels))))

    def _values(self, raw: np.ndarray) -> FloatArray:
        channels = self.bench.board.channels
        return np.array([channel.value(int(count)) for channel, count in zip(channels, raw, strict=True)])


def _row(samples: Batch, k: int) -> Batch:
    row = slice(k, k + 1)
    return Batch(samples.seq[row], samples.t_acq_ns[row], samples.t_hw_ns[row], samples.values[row])

"""The short check of a device: it is read without any command, then moved a little if somebody agrees."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path

from labhil.bus.latch import read_latch
from labhil.device_check.at_rest import findings_at_rest
from labhil.device_check.direction import findings_of_step, movements
from labhil.device_check.expected import implausible_sizes, simulated_answer
from labhil.device_check.report import DeviceCheck, StepCheck, channel_checks, is_fine, rate_check, step_check
from labhil.device_check.samples import Samples
from labhil.device_check.small_step import ARRIVAL_TIMEOUT, Answer, SmallStep, make_step, plan_steps
from labhil.doctor.finding import Finding, broken, note
from labhil.errors import CommandRefusedError, MissingExtraError, RunError, UsageError
from labhil.experiment.bench import Bench
from labhil.experiment.device_sections import WithDevices
from labhil.experiment.experiment import load_experiment
from labhil.experiment.plan import DevicePlan, device_plan
from labhil.rig import RigFile

REST_TIME = 1.5
"""Time for which a device is read without a command, s: 150 samples of the slowest bench."""


@dataclass(slots=True)
class Check:
    """A check under way.

    Attributes:
        tell: Is called with every finding.
        agree: Is called with the planned steps; nothing moves unless it returns true.
        share: Size of a step, as a share of the range that the limits allow.
        findings: All findings so far.
    """

    tell: Callable[[Finding], None]
    agree: Callable[[Sequence[SmallStep]], bool]
    share: float
    findings: list[Finding] = field(default_factory=list, init=False)

    def report(self, finding: Finding) -> None:
        """Keep a finding, and tell it."""
        self.findings.append(finding)
        self.tell(finding)


def check_device(experiment: Path, check: Check) -> DeviceCheck:
    """Check the device of an experiment file.

    Args:
        experiment: The file, with one device and its rig file.
        check: Whom to tell, whom to ask, and how far to move.

    Returns:
        What was found, of each channel and of each step.

    Raises:
        UsageError: The file has several devices.
        ConnectError: No device answers.
        DeviceSilentError: It sends no samples.
        CommandRefusedError: The emergency stop is pressed, and something is to move.
    """
    plan = _plan(load_experiment(experiment))
    answers: list[Answer] = []
    with Bench(plan) as bench:
        bench.read(timeout=ARRIVAL_TIMEOUT)  # a device that has just booted takes its time
        bench.received()
        rest = Samples.of(Samples.received(bench).stream, bench.collect(REST_TIME))
        for finding in findings_at_rest(rest, plan.spec, plan.rig):
            check.report(finding)
        for finding in implausible_sizes(rest, plan.rig):
            check.report(finding)
        steps, unmoved = plan_steps(plan.spec, plan.rig, rest, check.share)
        if not is_fine(check.findings):
            check.report(
                note("step", "nothing was moved, as there are faults", "correct them and check again")
            )
        elif check.agree(steps):
            for finding in unmoved:
                check.report(finding)
            answers = _move(bench, steps, check)
    made = list(_judge(answers, plan.rig, check))
    return DeviceCheck(
        experiment=str(experiment),
        rig_file=str(plan.rig.path),
        rig=plan.rig.kind.name,
        driver=plan.spec.name,
        fine=is_fine(check.findings),
        sample_rate=rate_check(rest),
        channels=tuple(channel_checks(rest, plan.spec, plan.rig, made)),
        steps=tuple(made),
        findings=tuple(check.findings),
    )


def _plan(experiment: WithDevices) -> DevicePlan:
    """The plan of its only device; a simulated one runs in real time, as a device does."""
    if len(experiment.devices) != 1:
        raise UsageError(
            f"{experiment.path}: expected one device to check, found {', '.join(experiment.devices)}"
        )
    ((name, section),) = experiment.devices.items()
    twin = section.twin.model_copy(update={"speed": 1.0})
    in_real_time = {name: section.model_copy(update={"twin": twin})}
    return device_plan(experiment.model_copy(update={"devices": in_real_time}), name)


def _move(bench: Bench, steps: Sequence[SmallStep], check: Check) -> list[Answer]:
    """Make the steps one after another; the first that fails is the last."""
    standing = read_latch()
    if standing is not None:
        raise CommandRefusedError(f"{standing.describe()}; release it with `labhil estop --release`")
    answers = []
    for step in steps:
        try:
            answers.append(make_step(bench, step))
        except (RunError, CommandRefusedError) as error:
            advice = "the device was brought to its safe state; remove the cause and check again"
            check.report(broken(step.column, str(error), advice))
            break
    return answers


def _judge(answers: Sequence[Answer], rig: RigFile, check: Check) -> Iterator[StepCheck]:
    """Say of each step which way the channels went; nothing is connected any more."""
    for answer in answers:
        try:
            simulated = simulated_answer(answer, rig)
        except MissingExtraError as missing:
            check.report(note("model", "no direction is expected of outputs", str(missing)))
            simulated = {}
        moved = movements(answer, rig.kind, simulated)
        for finding in findings_of_step(answer, moved):
            check.report(finding)
        for finding in implausible_sizes(answer.after, rig):
            check.report(finding)
        yield step_check(answer.step, moved)

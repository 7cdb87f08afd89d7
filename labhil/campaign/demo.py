"""``labhil demo``: record a simulated rig with concealed physics, diagnose it, and compare with the truth.

The physics is drawn at random. The simulation writes it to a side file, whose SHA-256 is printed before the
analysis begins. The analysis reads the recordings only.
"""

from __future__ import annotations

import importlib.resources
import json
import random
import subprocess
import sys
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path

from rich.console import Console
from rich.table import Table

from labhil.api.diagnosis import Diagnosis, diagnose
from labhil.campaign.stepped_run import run_stepwise
from labhil.campaign.trials.seal import sha256_of
from labhil.errors import DeviceSilentError, LimitTrippedError, RunError, WatchdogError
from labhil.experiment.control import RunState
from labhil.experiment.experiment import Experiment, load_experiment
from labhil.experiment.run import Progress, RunResult, answer_path, run_experiment
from labhil.report.figure import save
from labhil.terminal import terminal

COMPILE = "from labhil.physics.rigs import compile_kernels; compile_kernels()"

SPEEDS = (5.0, 2.5, 1.25)
"""Speeds of the twin relative to real time, one for each attempt. The slowest takes 48 s for a minute."""
SIGNS_OF_A_BUSY_MACHINE = (LimitTrippedError, WatchdogError, DeviceSilentError)
"""What ends a run of a twin whose controller, host or twin gets no time; nothing else can trip its limits."""

Say = Callable[[str], None]
Range = tuple[float, float]

FRICTION: Mapping[str, Range] = {
    "viscous_friction.coefficient": (0.15, 0.35),
    "coulomb_friction.level": (0.06, 0.11),
    "stribeck_friction.level": (0.03, 0.07),
    "stribeck_friction.velocity": (0.01, 0.04),
}
FURTHER_EFFECTS: Mapping[str, Mapping[str, Range]] = {
    "dead_zone": {"dead_zone.left": (0.04, 0.10), "dead_zone.right": (0.04, 0.10)},
    "time_delay": {"time_delay.delay": (0.03, 0.08)},
    "constant_force": {"constant_force.force": (0.01, 0.04)},
    "spring_force": {"spring_force.stiffness": (0.2, 0.6)},
}


@dataclass(frozen=True, slots=True)
class ConcealedPhysics:
    """Names of the effects of a simulated rig, and their parameters (SI)."""

    terms: tuple[str, ...]
    parameters: Mapping[str, float]


def draw_physics(seed: int | None) -> ConcealedPhysics:
    """Draw friction and one further effect; without a seed, from the system's randomness."""
    rng: random.Random = random.SystemRandom() if seed is None else random.Random(seed)
    further_effect = rng.choice(sorted(FURTHER_EFFECTS))
    ranges = {**FRICTION, **FURTHER_EFFECTS[further_effect]}
    values = {name: rng.uniform(low, high) for name, (low, high) in ranges.items()}
    return ConcealedPhysics(
        ("viscous_friction", "coulomb_friction", "stribeck_friction", further_effect), values
    )


def run_demo(out: Path, seed: int | None, say: Say) -> None:
    """Run the demo.

    Args:
        out: folder of the recordings, the plot and the JSON.
        seed: seed of the concealed physics; None for the system's randomness.
        say: is called with a line of text at each stage.

    Raises:
        RunError: a recording fails.
    """
    console = terminal()
    console = console if console.is_terminal else terminal(width=140)
    physics = draw_physics(seed)
    # compiling in this process would delay the controller; a child process fills the cache meanwhile
    with subprocess.Popen([sys.executable, "-P", "-c", COMPILE]) as compiling:

        def wait_for_compiling() -> None:
            # where the machine is busy already, a further attempt must not compete with this
            say("compiling the model")
            compiling.wait()

        recorder = Recorder(out, physics, say, wait_for_compiling)
        identify, test = recorder.record("identify", 1), recorder.record("test", 2)
        wait_for_compiling()
    hashes = {path: sha256_of(answer_path(path, "bench", are_several=False)) for path in (identify, test)}
    console.print(f"Recorded {identify} and {test}.")
    console.print(f"What the twin conceals is sealed: SHA-256 {hashes[identify][:16]}…\n")
    result = diagnose(identify, test=test, progress=say)
    result.show(console)
    stem = identify.with_suffix("")
    result.save(stem.with_suffix(".diagnosis.json"))
    save(result.figure(), stem.with_suffix(".png"))
    _show_truth(answer_path(identify, "bench", are_several=False), hashes[identify], result, console)
    console.print(
        f"\nDrawn: {stem.with_suffix('.png')}; all numbers: {stem.with_suffix('.diagnosis.json')}.\n"
        f"Fit it again yourself: labhil fit {identify} --test {test} "
        f"--terms {','.join(result.final.terms)}"
    )


@dataclass(slots=True)
class Recorder:
    """Runs the shipped experiments on a simulated rig, more slowly where the machine is too busy.

    A busy machine may be too late to hold the ball, or to command it at all. At half the speed it has twice
    the time for each sample; a machine that is too busy for that, too, is given a twin whose clock waits.
    What an attempt recorded that failed so is removed: the folder holds the recordings that are analysed.

    Attributes:
        out: Folder of the recordings.
        physics: What the twin conceals.
        say: Is called with a line of text at each stage.
        before_retry: Is called before each attempt but the first.
        speeds: Speeds relative to real time that have not failed.
    """

    out: Path
    physics: ConcealedPhysics
    say: Say
    before_retry: Callable[[], None]
    speeds: tuple[float, ...] = SPEEDS

    def record(self, role: str, noise_seed: int) -> Path:
        """Record "identify" or "test", and return the path.

        Raises:
            RunError: It failed for another reason than a busy machine.
        """
        while self.speeds:
            speed = self.speeds[0]
            experiment = _experiment(role, self.physics, noise_seed, speed)
            result = run_experiment(experiment, self.out, _progress_printer(role, self.say))
            if result.path is not None and result.exit_status == 0:
                return result.path
            if not isinstance(result.error, SIGNS_OF_A_BUSY_MACHINE):
                raise RunError(f"the {role} recording failed: {_failure_of(result)}")
            _remove_recording(result)
            self.speeds = self.speeds[1:]
            self.before_retry()
            self.say(f"this machine was too busy to hold the ball ({result.error}); {self._next(speed)}")
        self.say(f"recording to {role}: step by step")
        return run_stepwise(_experiment(role, self.physics, noise_seed, 1.0), self.out)

    def _next(self, speed: float) -> str:
        """Return what follows an attempt that failed at a speed."""
        if self.speeds:
            return f"once more, at {self.speeds[0]:g} instead of {speed:g} times real time"
        tried = ", ".join(f"{each:g}" for each in SPEEDS)
        return (
            f"tried at {tried} times real time. Now the bench is simulated step by step, so that its clock "
            "waits: without wire, driver, bus and host. To see these, too, end what keeps the processors "
            "busy (`uptime` shows the load, `top` the processes) and give the command again"
        )


def _remove_recording(result: RunResult) -> None:
    """Remove the recording of an attempt that failed, and what its twin concealed, which lies beside it."""
    if result.path is not None:
        for path in (answer_path(result.path, "bench", are_several=False), result.path):
            path.unlink(missing_ok=True)


def _failure_of(result: RunResult) -> str:
    return str(result.error) if result.error is not None else result.reason


def _experiment(role: str, physics: ConcealedPhysics, noise_seed: int, speed: float) -> Experiment:
    folder = importlib.resources.files("labhil.experiment") / "examples"
    with importlib.resources.as_file(folder) as examples:
        shipped = load_experiment(examples / f"ball_beam_{role}.toml")
    bench = shipped.devices["bench"]
    twin = bench.twin.model_copy(
        update={"speed": speed, "seed": noise_seed, "terms": physics.terms, "set": dict(physics.parameters)}
    )
    return shipped.model_copy(update={"devices": {"bench": bench.model_copy(update={"twin": twin})}})


def _progress_printer(role: str, say: Say) -> Callable[[Progress], None]:
    """Return a callback that prints a line for each state of a run, and for each tenth while it runs."""
    last = [""]

    def print_progress(progress: Progress) -> None:
        line = f"recording to {role}: {progress.state.value}"
        if progress.state is RunState.RUNNING and progress.duration:
            line += f", {10 * int(10 * progress.elapsed / progress.duration)} %"
        if line != last[0]:
            last[0] = line
            say(line)

    return print_progress


def _show_truth(path: Path, expected_hash: str, diagnosis: Diagnosis, console: Console) -> None:
    """Check the hash of the side file, and print the truth beside the estimates."""
    if sha256_of(path) != expected_hash:
        raise RunError(f"{path}: the envelope was changed after it was sealed")
    truth = json.loads(path.read_text(encoding="utf-8"))
    concealed = [name for name in truth["terms"] if name not in diagnosis.baseline.terms]
    missing = [item.term for item in diagnosis.missing]
    console.print(
        f"\nThe envelope is opened. Concealed: {', '.join(concealed)}. Found: {', '.join(missing) or '—'}."
    )
    estimates = {row.name: row for row in diagnosis.final.parameters}
    table = Table(box=None, pad_edge=False)
    table.add_column("parameter")
    for name in ("truth", "estimate", "99 % interval"):
        table.add_column(name, justify="right")
    table.add_column("")
    names = [n for n in truth["parameters"] if n in estimates or n.partition(".")[0] in concealed]
    for name in names:
        value = float(truth["parameters"][name])
        row = estimates.get(name)
        if row is None:
            table.add_row(name, f"{value:.5g}", "—", "", "not found")
            continue
        low, high = row.ci99 or (None, None)
        if row.value is None or low is None or high is None or not row.std_error:
            table.add_row(name, f"{value:.5g}", "—", "", "not known")
            continue
        inside = "covered" if low <= value <= high else f"{abs(row.value - value) / row.std_error:.1f} σ off"
        table.add_row(name, f"{value:.5g}", f"{row.value:.5g}", f"[{low:.5g}, {high:.5g}]", inside)
    console.print(table)

"""The main job without hardware: record a twin that conceals physics, find it, show the better fit.

The physics is drawn at random and written by the twin into a side file that is sealed by its SHA-256
before the analysis begins. The analysis sees the recordings only; afterwards the file is opened and
the truth stands beside the estimates.
"""

from __future__ import annotations

import hashlib
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
from labhil.errors import LimitTrippedError, RunError
from labhil.experiment.experiment import Experiment, load_experiment
from labhil.experiment.run import Progress, RunResult, answer_path, run_experiment
from labhil.report.figure import save
from labhil.terminal import terminal

SPEED = 5.0
"""How much faster than real time the twin runs: a minute of its world in twelve seconds."""

COMPILE = "from labhil.physics.rigs import compile_kernels; compile_kernels()"

Say = Callable[[str], None]
Range = tuple[float, float]

FRICTION: Mapping[str, Range] = {
    "viscous_friction.coefficient": (0.15, 0.35),
    "coulomb_friction.level": (0.06, 0.11),
    "stribeck_friction.level": (0.03, 0.07),
    "stribeck_friction.velocity": (0.01, 0.04),
}
ONE_MORE: Mapping[str, Mapping[str, Range]] = {
    "dead_zone": {"dead_zone.left": (0.04, 0.10), "dead_zone.right": (0.04, 0.10)},
    "time_delay": {"time_delay.delay": (0.03, 0.08)},
    "constant_force": {"constant_force.force": (0.01, 0.04)},
    "spring_force": {"spring_force.stiffness": (0.2, 0.6)},
}


@dataclass(frozen=True, slots=True)
class Secret:
    """What the twin is made of: names of its effects and their parameters (SI)."""

    terms: tuple[str, ...]
    parameters: Mapping[str, float]


def draw_secret(seed: int | None) -> Secret:
    """Draw friction and one more effect; from the system's randomness without a seed."""
    source: random.Random = random.SystemRandom() if seed is None else random.Random(seed)
    extra = source.choice(sorted(ONE_MORE))
    ranges = {**FRICTION, **ONE_MORE[extra]}
    values = {name: source.uniform(low, high) for name, (low, high) in ranges.items()}
    return Secret(("viscous_friction", "coulomb_friction", "stribeck_friction", extra), values)


def run_demo(out: Path, seed: int | None, say: Say) -> None:
    """Record, diagnose, open the envelope; recordings, plot and JSON stay in ``out``."""
    console = terminal()
    console = console if console.is_terminal else terminal(width=140)
    secret = draw_secret(seed)
    # Compiling in this process would keep the controller waiting; a child fills the cache meanwhile.
    with subprocess.Popen([sys.executable, "-P", "-c", COMPILE]) as compiling:
        identify = _record("identify", out, secret, 1, say)
        test = _record("test", out, secret, 2, say)
        say("compiling the model")
        compiling.wait()
    seals = {path: _seal(answer_path(path, "bench", are_several=False)) for path in (identify, test)}
    console.print(f"Recorded {identify} and {test}.")
    console.print(f"What the twin conceals is sealed: SHA-256 {seals[identify][:16]}…\n")
    result = diagnose(identify, test=test, progress=say)
    result.show(console)
    stem = identify.with_suffix("")
    result.save(stem.with_suffix(".diagnosis.json"))
    save(result.figure(), stem.with_suffix(".png"))
    _open_envelope(answer_path(identify, "bench", are_several=False), seals[identify], result, console)
    console.print(
        f"\nDrawn: {stem.with_suffix('.png')}; all numbers: {stem.with_suffix('.diagnosis.json')}.\n"
        f"Fit it again yourself: labhil fit {identify} --test {test} "
        f"--terms {','.join(result.final.terms)}"
    )


def _record(which: str, out: Path, secret: Secret, noise_seed: int, say: Say) -> Path:
    """Run one of the shipped experiments on a twin made of the secret; the recording's path.

    A machine that is busy with other work may answer the twin too late to hold the ball; at half the
    speed it has twice the time.
    """
    for speed in (SPEED, 0.5 * SPEED):
        result = run_experiment(_experiment(which, secret, noise_seed, speed), out, _speaker(which, say))
        if result.path is not None and result.exit_status == 0:
            return result.path
        if not isinstance(result.error, LimitTrippedError):
            break
        say(f"this machine was too busy to hold the ball ({result.error}); once more at half the speed")
    raise RunError(f"the {which} recording failed: {_reason(result)}")


def _reason(result: RunResult) -> str:
    return str(result.error) if result.error is not None else result.reason


def _experiment(which: str, secret: Secret, noise_seed: int, speed: float) -> Experiment:
    folder = importlib.resources.files("labhil.experiment") / "examples"
    with importlib.resources.as_file(folder) as examples:
        shipped = load_experiment(examples / f"ball_beam_{which}.toml")
    bench = shipped.devices["bench"]
    twin = bench.twin.model_copy(
        update={"speed": speed, "seed": noise_seed, "terms": secret.terms, "set": dict(secret.parameters)}
    )
    return shipped.model_copy(update={"devices": {"bench": bench.model_copy(update={"twin": twin})}})


def _speaker(which: str, say: Say) -> Callable[[Progress], None]:
    """Turn a run's progress into lines, one per tenth of the way."""
    last = [""]

    def speak(progress: Progress) -> None:
        tenth = int(10 * progress.elapsed / progress.duration) if progress.duration else 0
        line = f"recording to {which}: {progress.state.value}, {10 * tenth} %"
        if line != last[0]:
            last[0] = line
            say(line)

    return speak


def _seal(path: Path) -> str:
    return hashlib.sha256(path.read_bytes()).hexdigest()


def _open_envelope(path: Path, seal: str, diagnosis: Diagnosis, console: Console) -> None:
    """Show the truth beside the estimates."""
    if _seal(path) != seal:
        raise RunError(f"{path}: the envelope was changed after it was sealed")
    truth = json.loads(path.read_text(encoding="utf-8"))
    concealed = [name for name in truth["terms"] if name not in diagnosis.baseline.terms]
    named = [item.term for item in diagnosis.missing]
    console.print(
        f"\nThe envelope is opened. Concealed: {', '.join(concealed)}. Found: {', '.join(named) or '—'}."
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

"""A trial's rig in time: sample by sample under its controller, or driven open loop."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from labhil.campaign.trials.bench import EXCITATIONS, Bench, Controller, bench_of
from labhil.campaign.trials.draw import Secret
from labhil.campaign.trials.noise import TrueNoise
from labhil.errors import UsageError
from labhil.kinds import KINDS
from labhil.physics.model import Record
from labhil.plants.ball_beam_rig import BallBeamRig
from labhil.plants.rigs import Plant, plant_of
from labhil.signals import FloatArray, Hold, Signal

SLOPE_LAG = 0.03
"""Time constant (s) of the controllers' derivative."""
FINEST_BITS = 16.0
"""Of the ball and beam's converter, which is always there."""
HEADROOM = 1.25
"""Full scale of a converter over the largest value it was expected to see."""


@dataclass(frozen=True, slots=True)
class Walk:
    """What happened: stamps (n,) s, commands (n + 1,) and signals (n,) by name; SI."""

    t: FloatArray
    commands: FloatArray
    signals: Mapping[str, FloatArray]


def signals_of(bench: Bench, auxiliary: bool) -> tuple[Signal, ...]:
    """The signals that a trial records: its input, outputs and, with ``auxiliary``, the further ones."""
    kind = KINDS[bench.kind]
    names = (kind.inputs[0].name, *bench.outputs, *(bench.auxiliary if auxiliary else ()))
    return tuple(signal for signal in kind.signals() if signal.name in names)


def loudness(secret: Secret) -> TrueNoise:
    """Noise and steps of the outputs for the secret's conditions, from a silent rehearsal of the baseline."""
    bench, made = bench_of(secret.kind), secret.conditions
    rehearsed = _walk(bench, secret, 0, _silence(bench))
    measured = [rehearsed.signals[name] for name in bench.outputs]
    level = [float(x.std()) * 10.0 ** (-made.decibels / 20.0) for x in measured]
    reach = [2.0 * HEADROOM * float(np.abs(x).max()) for x in measured]
    if bench.kind == "ball_beam":
        reach = [0.5]
    step = [full / 2**made.bits if made.bits else 0.0 for full in reach]
    return TrueNoise(tuple(level), tuple(step), made.correlation)


def simulate(secret: Secret, noise: TrueNoise, which: int) -> Walk:
    """Record the search (0) or the test (1). UsageError where the plant runs away or leaves its travel."""
    bench = bench_of(secret.kind)
    walk = _walk(bench, secret, which, _measured(bench, secret, noise))
    reached = float(np.abs(walk.signals[bench.outputs[0]]).max())
    if reached > bench.travel:
        raise UsageError(f"{bench.outputs[0]} reached {reached:g}, at most {bench.travel:g} is allowed")
    return walk


def truth_of(secret: Secret, walk: Walk, which: int) -> FloatArray:
    """What the outputs (n, c) of a walk would be without noise and steps: the same commands again."""
    bench = bench_of(secret.kind)
    again = _walk(bench, secret, which, _silence(bench), walk.commands)
    return np.column_stack([again.signals[name] for name in bench.outputs])


def record_of(walk: Walk, secret: Secret) -> Record:
    """The walk as a model sees it."""
    bench = bench_of(secret.kind)
    kinds = {signal.name: signal for signal in KINDS[bench.kind].signals()}
    source = KINDS[bench.kind].inputs[0]
    others = bench.auxiliary if secret.conditions.auxiliary else ()
    return Record(
        t=walk.t,
        inputs=np.ascontiguousarray(walk.signals[source.name][:, None]),
        outputs=np.column_stack([walk.signals[name] for name in bench.outputs]),
        input_names=(source.name,),
        output_names=bench.outputs,
        output_units=tuple(kinds[name].unit for name in bench.outputs),
        input_holds=(source.hold,),
        auxiliary={name: walk.signals[name] for name in others},
        output_joints=(None,) * len(bench.outputs),
    )


def _silence(bench: Bench) -> dict[str, float]:
    fine = {"adc_bits": FINEST_BITS} if bench.kind == "ball_beam" else {}
    return {bench.noise_name(name): 0.0 for name in bench.outputs} | fine


def _measured(bench: Bench, secret: Secret, noise: TrueNoise) -> dict[str, float]:
    """Parameters of the plant that make this noise."""
    given = {bench.noise_name(n): level for n, level in zip(bench.outputs, noise.level, strict=True)}
    given["noise_correlation"] = noise.correlation
    if bench.kind == "ball_beam":
        return given | {"adc_bits": float(secret.conditions.bits) or FINEST_BITS}
    return given | {f"{n}_resolution": step for n, step in zip(bench.outputs, noise.step, strict=True)}


def _walk(
    bench: Bench,
    secret: Secret,
    which: int,
    measured: Mapping[str, float],
    commands: FloatArray | None = None,
) -> Walk:
    """Step through one recording; ``commands`` (n + 1,) take the place of excitation and controller."""
    made, n = secret.conditions, bench.samples[which]
    seed = made.seeds[which]
    jitter = 0.0 if _counts_samples(secret) else made.jitter * bench.period
    given = {**secret.parameters, **measured, "stamp_jitter": jitter}
    plant = plant_of(bench.kind, given, secret.terms, seed, bench.period)
    loop = bench.loops[made.loop]
    t: FloatArray = bench.period * np.arange(n + 1, dtype=np.float64)
    excitation = EXCITATIONS[made.excitation](t, loop, np.random.default_rng([seed, 1]))
    law = Law(loop.controller, bench.period)
    rows: list[Mapping[str, float]] = []
    stamps, sent, seen = np.empty(n + 1), np.empty(n + 1), 0.0
    for k in range(n + 1):
        sent[k] = commands[k] if commands is not None else law.command(float(excitation[k]), seen)
        rows.append(plant.step(float(sent[k])))
        stamps[k] = _clock(plant)
        seen = rows[-1][bench.outputs[0]]
    source = KINDS[bench.kind].inputs[0]
    # a command that is held acts after the sample beside which it stands, another one has just been reached
    acting = sent[1:] if source.hold is Hold.ZERO else sent[:-1]
    signals = {name: np.array([row[name] for row in rows[:-1]]) for name in rows[0]}
    return Walk(stamps[:-1] - stamps[0], sent, {source.name: acting} | signals)


def _counts_samples(secret: Secret) -> bool:
    """Whether the plant cannot have uneven samples: a ball and beam with a delay counts them."""
    return secret.kind == "ball_beam" and "time_delay" in secret.terms


def _clock(plant: Plant) -> float:
    """The plant's own time, s."""
    if isinstance(plant, BallBeamRig):
        return plant.time
    return float(plant.drive.time)  # type: ignore[attr-defined]


class Law:
    """A controller's commands, sample by sample."""

    def __init__(self, controller: Controller, period: float) -> None:
        self._of, self._period = controller, period
        self._forget = float(np.exp(-period / SLOPE_LAG))
        self._before, self._slope, self._sent = 0.0, 0.0, 0.0

    def command(self, excitation: float, seen: float) -> float:
        """The next command, from the excitation and what was measured last."""
        rising = (seen - self._before) / self._period
        self._slope = self._forget * self._slope + (1.0 - self._forget) * rising
        self._before = seen
        wanted = excitation - self._of.kp * seen - self._of.kd * self._slope
        reach = self._of.rate * self._period
        low, high = max(self._sent - reach, self._of.low), min(self._sent + reach, self._of.high)
        self._sent = min(max(wanted, low), high)
        return self._sent

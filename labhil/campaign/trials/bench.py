"""The benches that trials are recorded on: per kind of rig its channels, excitations and controllers."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from labhil.errors import UnknownNameError
from labhil.signals import FloatArray

Range = tuple[float, float]


@dataclass(frozen=True, slots=True)
class Controller:
    """command = excitation − kp·y − kd·dy/dt (through a lag of 0.03 s), within limits and rate (per s)."""

    kp: float
    kd: float
    low: float
    high: float
    rate: float = float("inf")


@dataclass(frozen=True, slots=True)
class Loop:
    """A way to drive a rig: a controller on its first output, and an excitation that suits it.

    The excitation lies within ``centre`` ± ``reach``; ``tones`` (Hz) bound a multisine's frequencies and
    ``dwell`` (s) how long each of a sequence of levels lasts.
    """

    closed: bool
    controller: Controller
    centre: float
    reach: float
    tones: Range
    dwell: Range


@dataclass(frozen=True, slots=True)
class Bench:
    """What a trial of one kind of rig records, and how.

    ``noise`` bounds the power of a channel over its noise, dB; ``spread`` maps parameters that nobody
    knows to the largest factor by which they differ from the plant's defaults; ``at_work`` are numbers of
    the plant other than its defaults; ``warm`` those of a bench that records ``auxiliary`` channels too.
    ``travel`` is the largest first output that the bench allows.
    """

    kind: str
    rig: str
    period: float
    samples: tuple[int, int]
    outputs: tuple[str, ...]
    noise: Range
    spread: Mapping[str, float]
    loops: tuple[Loop, ...]
    auxiliary: tuple[str, ...] = ()
    at_work: Mapping[str, float] | None = None
    warm: Mapping[str, float] | None = None
    travel: float = float("inf")
    noise_names: Mapping[str, str] | None = None

    def noise_name(self, output: str) -> str:
        """The plant's name of the noise of an output."""
        return (self.noise_names or {}).get(output, f"{output}_noise")


def multisine(t: FloatArray, loop: Loop, random: np.random.Generator) -> FloatArray:
    """Two to five sines of random frequency and phase that reach as far together as one would alone."""
    count = int(random.integers(2, 6))
    low, high = np.log(loop.tones)
    frequencies = np.exp(random.uniform(low, high, count))
    phases = random.uniform(0.0, 2.0 * np.pi, count)
    waves = np.sin(2.0 * np.pi * frequencies * t[:, None] + phases).sum(axis=1)
    return np.asarray(loop.centre + loop.reach * np.sqrt(2.0 / count) * waves / 1.4)


def levels(t: FloatArray, loop: Loop, random: np.random.Generator) -> FloatArray:
    """Random levels, each held for a random while."""
    period = t[1] - t[0]
    dwell = max(1, round(float(random.uniform(*loop.dwell)) / period))
    drawn = random.uniform(-loop.reach, loop.reach, -(-len(t) // dwell))
    return np.asarray(loop.centre + np.repeat(drawn, dwell)[: len(t)])


EXCITATIONS = {"multisine": multisine, "levels": levels}

BALL_BEAM = Bench(
    kind="ball_beam",
    rig='[rig]\nkind = "ball_beam"\n[known]\nball_mass = 0.261\nball_radius = 0.02\n'
    "crank_radius = 0.08\nbeam_length = 0.40\n",
    period=0.01,
    samples=(3000, 3000),
    outputs=("ball_position",),
    noise=(40.0, 52.0),
    spread={"viscous_friction.coefficient": 1.6},
    # a ball rolls off any beam that nobody levels: there is no open loop
    loops=(Loop(True, Controller(7.0, 3.0, -1.2, 1.2, 12.0), 0.0, 0.85, (0.1, 0.8), (0.8, 2.5)),),
    travel=0.24,
    noise_names={"ball_position": "position_noise"},
)
DC_MOTOR = Bench(
    kind="dc_motor",
    rig='[rig]\nkind = "dc_motor"\n',
    period=0.01,
    samples=(2000, 2000),
    outputs=("speed", "current"),
    noise=(28.0, 42.0),
    spread={
        "inertia": 1.2, "torque_constant": 1.2, "resistance": 1.2, "inductance": 1.2,
        "viscous_friction.coefficient": 1.6,
    },
    loops=(
        Loop(False, Controller(0.0, 0.0, -8.0, 8.0), 0.0, 5.0, (0.1, 1.5), (0.3, 1.0)),
        Loop(True, Controller(1.5, 0.0, -8.0, 8.0), 0.0, 10.0, (0.1, 1.5), (0.3, 1.0)),
    ),
    auxiliary=("angle", "winding_temperature"),
    # the models say what resistance and friction are at 20 °C
    at_work={"reference_temperature": 20.0},
    warm={"heat_capacity": 3.0},
)  # fmt: skip
AXIS = Bench(
    kind="axis",
    rig='[rig]\nkind = "axis"\n',
    period=0.005,
    samples=(2000, 2000),
    outputs=("position",),
    noise=(50.0, 65.0),
    spread={
        "moving_mass": 1.3, "viscous_friction.coefficient": 1.5, "coulomb_friction.level": 1.5,
        "constant_force.force": 2.0,
    },
    loops=(
        Loop(False, Controller(0.0, 0.0, -150.0, 150.0), 0.0, 80.0, (0.2, 2.0), (0.15, 0.5)),
        Loop(True, Controller(2000.0, 300.0, -150.0, 150.0), 0.0, 300.0, (0.1, 1.0), (0.4, 1.2)),
    ),
    auxiliary=("temperature",),
    at_work={"reference_temperature": 20.0},
    warm={"warming": 0.1, "cooling": 0.05},
)  # fmt: skip
SOLENOID = Bench(
    kind="solenoid",
    rig='[rig]\nkind = "solenoid"\n[known]\nstop_low = 0.0\nstop_high = 0.005\n',
    period=0.001,
    samples=(2000, 2000),
    outputs=("plunger_position",),
    noise=(25.0, 45.0),
    spread={"moving_mass": 1.15, "spring_stiffness": 1.15, "viscous_friction.coefficient": 1.6},
    loops=(Loop(False, Controller(0.0, 0.0, 0.0, 2.0), 1.0, 0.45, (1.0, 12.0), (0.03, 0.15)),),
)

BENCHES: Mapping[str, Bench] = {bench.kind: bench for bench in (BALL_BEAM, DC_MOTOR, AXIS, SOLENOID)}


def bench_of(kind: str) -> Bench:
    """The bench of a kind of rig; UnknownNameError lists those that there are."""
    if kind not in BENCHES:
        raise UnknownNameError("rig with trials", kind, BENCHES)
    return BENCHES[kind]

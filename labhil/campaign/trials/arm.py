"""The bench of a UR5: Fourier trajectories, six noisy currents, effects of a joint or of the whole arm."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from typing import Any

import numpy as np

from labhil.campaign.trials.noise import TrueNoise
from labhil.campaign.trials.secret import DrawnEffect, Secret, SimulatedRun
from labhil.campaign.trials.sizes import draw_factor, draw_size, strength_exponent
from labhil.errors import UsageError
from labhil.experiment.excitation import evaluate_motion, fourier
from labhil.kinds import JOINTS, KINDS
from labhil.physics.model import Model
from labhil.physics.record import Record
from labhil.physics.rigs import rig_model
from labhil.physics.terms import keyed, unkeyed
from labhil.plants.arm import ArmPlant
from labhil.plants.arm.effects import ALL_EFFECTS, BARE_ARM, EFFECTS, HIDDEN, PerJoint, parameters_of
from labhil.signals import FloatArray, Hold, Signal

PLANT_NAMES: Mapping[str, str] = {"torque_constant": "sensor_gain"}
"""The plant's names of terms of the model, where they differ."""

CENTRE = np.array([0.0, -1.57, 1.0, -1.0, -1.57, 0.0])
REACH = np.array([2.0, 1.0, 1.2, 1.5, 1.5, 2.0])
SPEED = np.array([1.2, 0.9, 1.2, 1.6, 1.6, 1.8])
ACCELERATION = np.array([3.0, 2.0, 3.0, 5.0, 5.0, 5.0])
MAX_SPEED_FACTOR = 1.5
"""Largest factor between a trial's speeds and these; accelerations grow with its square."""
DURATIONS = (20.0, 25.0, 30.0)
PERIODS = (0.008, 0.008, 0.008, 0.008, 0.002)
HARMONICS = (5, 9)
RESOLUTIONS = (0.001, 0.001, 0.01)
"""Resolution of the currents, A; the last is coarse compared with the wrists' noise."""
MAX_NOISE_FACTOR = 2.0
"""Largest factor by which the noise of a current differs from the plant's default."""

ENCODERS = {"q_noise": 1e-5, "qd_noise": 1e-4}
"""Noise of angles and velocities, far below the currents' so that the true noise is that of the currents."""

BASELINE: Mapping[str, float] = {
    "viscous_friction.coefficient": 1.6,
    "coulomb_friction.level": 1.6,
    "sensor_offset.offset": 1.6,
}
"""Largest factor by which each joint's parameter differs from the plant's default."""

START_TEMPERATURES = (22.0, 40.0)
"""Range of a joint's temperature at the start where temperatures are recorded, °C."""
WARMING_TIME = 60.0
"""Time constant in which joints warm up where temperatures are recorded, s."""

JOINT_STRENGTHS, ARM_STRENGTHS = (1.1, 25.0), (1.1, 5.0)
"""Target strengths in the current of an effect's joint, and mean target strengths in all six currents.

A strength r in one current alone makes a mean of (r + 5)/6 over the arm: 1.3 is r = 2.8, 3 is r = 13.
"""

KNOWN_PARAMETERS = ("torque_ripple.order",)
"""Parameters known from the gear, like its ratio."""
PATCH_CENTRE_SHARE = 0.3
"""Largest distance of a sticky patch's centre from the centre of motion, as a share of a joint's reach."""
MAX_PAYLOAD_OFFSET = 0.05
"""Largest distance of a payload's centre from the flange's axis, each way, m."""


@dataclass(frozen=True, slots=True)
class ArmConditions:
    """Conditions of a trial of an arm.

    Attributes:
        duration: of each recording, s.
        period: time between samples, s.
        harmonics: number of harmonics of the Fourier series.
        briskness: factor of the speeds.
        level: standard deviation of each current's noise before the converter, A.
        resolution: step of the converter, A.
        correlation: correlation of neighbouring samples' noise.
        jitter: largest deviation of a stamp, in periods.
        temperatures: whether temperatures are recorded.
        seeds: seeds of motion and noise of the search and the test recording.
    """

    duration: float
    period: float
    harmonics: int
    briskness: float
    level: tuple[float, ...]
    resolution: float
    correlation: float
    jitter: float
    temperatures: bool
    seeds: tuple[int, int]


@dataclass(frozen=True, slots=True)
class ArmBench:
    """A UR5 with the manufacturer's links and known torque constants (satisfies ``secret.Bench``)."""

    kind: str = "ur5"
    durations: tuple[float, ...] = DURATIONS

    @property
    def rig(self) -> str:
        """The rig file's text."""
        return f'[rig]\nkind = "ur5"\n[known]\ntorque_constant = {list(_six("torque_constant"))}\n'

    def draw_setup(self, rng: np.random.Generator) -> ArmSetup:
        """Draw the conditions of a trial."""
        conditions = ArmConditions(
            duration=float(rng.choice(self.durations)),
            period=float(rng.choice(PERIODS)),
            harmonics=int(rng.integers(*HARMONICS)),
            briskness=draw_factor(MAX_SPEED_FACTOR, rng),
            level=tuple(level * draw_factor(MAX_NOISE_FACTOR, rng) for level in _six("current_noise")),
            resolution=float(rng.choice(RESOLUTIONS)),
            correlation=float(rng.choice([0.0, rng.uniform(0.3, 0.8)])),
            jitter=float(rng.choice([0.0, rng.uniform(0.02, 0.15)])),
            temperatures=bool(rng.integers(2)),
            seeds=(int(rng.integers(2**31)), int(rng.integers(2**31))),
        )
        return ArmSetup(self, conditions)

    def with_duration(self, seconds: float) -> ArmBench:
        """Return the bench with recordings of this duration, s."""
        return replace(self, durations=(seconds,))


UR5 = ArmBench()


@dataclass(frozen=True, slots=True)
class ArmSetup:
    """The arm under the conditions of one trial (satisfies ``secret.Setup``)."""

    bench: ArmBench
    conditions: ArmConditions

    @property
    def kind(self) -> str:
        """The kind of rig."""
        return self.bench.kind

    @property
    def rig(self) -> str:
        """The rig file's text."""
        return self.bench.rig

    @property
    def period(self) -> float:
        """Time between samples, s."""
        return self.conditions.period

    @property
    def signals(self) -> tuple[Signal, ...]:
        """Angles, velocities, currents and, where they are recorded, temperatures."""
        names = ("actual_q", "actual_qd", "actual_current", *self._auxiliary)
        return tuple(signal for signal in KINDS[self.kind].signals() if signal.name in names)

    def conditions_to_json(self) -> dict[str, Any]:
        """Return the conditions as plain JSON data."""
        return asdict(self.conditions)

    def draw_baseline_parameters(self, rng: np.random.Generator) -> dict[str, float]:
        """Draw friction and offset of every joint about the plant's defaults."""
        drawn = {
            keyed(name, joint): default * draw_factor(factor, rng)
            for name, factor in BASELINE.items()
            for joint, default in enumerate(_six(name))
        }
        if not self.conditions.temperatures:
            return drawn
        warm = {keyed("start_temperature", j): float(rng.uniform(*START_TEMPERATURES)) for j in range(JOINTS)}
        return drawn | warm | {"warming_time": WARMING_TIME}

    def draw_effect(
        self, model: Model, outside: bool, others: Sequence[DrawnEffect], rng: np.random.Generator
    ) -> DrawnEffect:
        """Draw an effect of random kind, joint and size, and its target strength."""
        taken = {*rig_model(model.kind).baseline, *(effect.key for effect in others)}
        choices: dict[str, list[int | None]] = {}
        for term, joint in _hidden_effects() if outside else _nameable_effects(model):
            if term not in taken and keyed(term, joint) not in taken:
                choices.setdefault(term, []).append(joint)
        term = str(rng.choice(list(choices)))
        joint = choices[term][int(rng.integers(len(choices[term])))]
        name = PLANT_NAMES.get(term, term)
        shapes = {f"{name}.{short}" for short in ALL_EFFECTS[name].shapes}
        drawn, powers = {}, {}
        for full, default in parameters_of(name).items():
            key = keyed(full, joint if isinstance(default, tuple) else None)
            drawn[key] = _draw_parameter(full, default, joint, rng)
            powers[key] = 0 if full in shapes else strength_exponent(full)
        low, high = np.log(JOINT_STRENGTHS if joint is not None else ARM_STRENGTHS)
        return DrawnEffect(term, drawn, powers, float(np.exp(rng.uniform(low, high))), joint)

    def draw_carrier(self, dry: DrawnEffect, rng: np.random.Generator) -> DrawnEffect:
        """Refuse: presliding friction has a term in an arm's model and is drawn like any other effect."""
        raise UsageError("--effects bristles: expected a rig that one input drives, found ur5")

    def plant_parameters(self, secret: Secret) -> Mapping[str, float]:
        """Return every parameter of the plant by key, its defaults included."""
        return self._plant(secret, {}, 0).parameters

    def true_noise(self, secret: Secret) -> TrueNoise:
        """Return noise and steps of the currents."""
        conditions = self.conditions
        return TrueNoise(conditions.level, (conditions.resolution,) * JOINTS, conditions.correlation)

    def simulate(self, secret: Secret, noise: TrueNoise, recording_index: int) -> SimulatedRun:
        """Simulate the search (0) or the test (1) recording.

        Raises:
            UsageError: dry friction would drive a joint, which no law of the model does.
        """
        measured = {keyed("current_noise", j): level for j, level in enumerate(noise.level)}
        memory = {"current_noise_memory": noise.correlation, "current_resolution": noise.step[0]}
        run = self._simulate(secret, recording_index, measured | memory)
        self._check_dry_friction(secret, run)
        return run

    def simulate_noiseless(self, secret: Secret, run: SimulatedRun, recording_index: int) -> SimulatedRun:
        """Simulate the same motion again, with currents without noise and steps."""
        return self._simulate(secret, recording_index, {"current_noise": 0.0, "current_resolution": 0.0})

    def to_record(self, run: SimulatedRun) -> Record:
        """Return a run as the record of a model, before it is filtered."""
        kinds = {signal.name: signal for signal in self.signals}
        inputs, output = ("actual_q", "actual_qd"), kinds["actual_current"]
        return Record(
            t=run.t,
            inputs=np.ascontiguousarray(np.hstack([run.signals[name] for name in inputs])),
            outputs=np.ascontiguousarray(run.signals[output.name]),
            input_names=tuple(column for name in inputs for column in kinds[name].columns()),
            output_names=tuple(output.columns()),
            output_units=(output.unit,) * JOINTS,
            input_holds=(Hold.LINEAR,) * (2 * JOINTS),
            auxiliary={
                column: np.ascontiguousarray(values)
                for name in self._auxiliary
                for column, values in zip(kinds[name].columns(), run.signals[name].T, strict=True)
            },
            output_joints=tuple(range(JOINTS)),
        )

    @property
    def _auxiliary(self) -> tuple[str, ...]:
        return ("joint_temperatures",) if self.conditions.temperatures else ()

    def _plant(self, secret: Secret, measured: Mapping[str, float], recording_index: int) -> ArmPlant:
        conditions = self.conditions
        terms = [keyed(PLANT_NAMES.get(name, name), joint) for name, joint in map(unkeyed, secret.terms)]
        parameters = {
            **secret.parameters,
            **ENCODERS,
            **measured,
            "stamp_jitter": conditions.jitter * conditions.period,
        }
        return ArmPlant(parameters, terms, conditions.seeds[recording_index], conditions.period)

    def _simulate(self, secret: Secret, recording_index: int, measured: Mapping[str, float]) -> SimulatedRun:
        conditions = self.conditions
        series = fourier(
            tuple(CENTRE - REACH), tuple(CENTRE + REACH), tuple(SPEED * conditions.briskness),
            tuple(ACCELERATION * conditions.briskness**2), 1.0 / conditions.duration, conditions.duration,
            harmonics=conditions.harmonics, centre=tuple(CENTRE), seed=conditions.seeds[recording_index],
        )  # fmt: skip
        t: FloatArray = conditions.period * np.arange(
            round(conditions.duration / conditions.period), dtype=np.float64
        )
        plan = evaluate_motion(series, t)
        motion_record = self._plant(secret, measured, recording_index).follow(*plan)
        signals = {signal.name: getattr(motion_record, signal.name) for signal in self.signals}
        return SimulatedRun(motion_record.t, plan[0], signals)

    def _check_dry_friction(self, secret: Secret, run: SimulatedRun) -> None:
        numbers = self.plant_parameters(secret)
        for joint in range(JOINTS):
            level = numbers[keyed("coulomb_friction.level", joint)]
            min_level = level + min(numbers.get(keyed("stribeck_friction.level", joint), 0.0), 0.0)
            slope = numbers.get(keyed("position_dependent_friction.slope", joint), 0.0)
            min_level -= abs(slope) * float(np.abs(run.signals["actual_q"][:, joint]).max())
            if min_level < 0.0:
                raise UsageError(f"dry friction of joint {joint} would fall to {min_level:g} N·m")


def _six(name: str) -> tuple[float, ...]:
    """The plant's default of a parameter, joint by joint."""
    effect, dot, short = name.partition(".")
    default = EFFECTS[effect].strengths[short] if dot else BARE_ARM[name]
    assert isinstance(default, tuple)
    return default


def _nameable_effects(model: Model) -> list[tuple[str, int | None]]:
    """Names and joints of effects that both the plant can have and the model can name."""
    terms = [(term.name, term.joint) for term in model.terms.values()]
    return [(name, joint) for name, joint in terms if PLANT_NAMES.get(name, name) in EFFECTS]


def _hidden_effects() -> list[tuple[str, int | None]]:
    """Names and joints of effects that are in no catalogue."""
    effects: list[tuple[str, int | None]] = []
    for name, effect in HIDDEN.items():
        per_joint = any(isinstance(value, tuple) for value in effect.strengths.values())
        effects += [(name, joint) for joint in range(JOINTS)] if per_joint else [(name, None)]
    return effects


def _draw_parameter(
    name: str, default: float | PerJoint, joint: int | None, rng: np.random.Generator
) -> float:
    """Draw the value of one of an effect's parameters."""
    value = default if isinstance(default, float) else default[joint or 0] or max(default)
    if name in KNOWN_PARAMETERS:
        return value
    if name == "hidden_sticky_patch.centre":
        return float(CENTRE[joint or 0] + PATCH_CENTRE_SHARE * REACH[joint or 0] * rng.uniform(-1.0, 1.0))
    if name == "torque_ripple.phase":
        return float(rng.uniform(-np.pi, np.pi))
    if name in ("payload.centre_x", "payload.centre_y"):
        return float(rng.uniform(-MAX_PAYLOAD_OFFSET, MAX_PAYLOAD_OFFSET))
    size = draw_size(name, value, rng)
    # at rest, the dry friction of a UR5 is lower in some joints and higher in others
    return -size if name == "stribeck_friction.level" and rng.integers(2) else size

"""The bench of a UR5: Fourier trajectories, six noisy currents, effects of one joint or of the whole arm."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from typing import Any

import numpy as np

from labhil.campaign.trials.noise import TrueNoise
from labhil.campaign.trials.secret import Drawn, Secret, Walk
from labhil.campaign.trials.sizes import draw_size, power_of, spread
from labhil.errors import UsageError
from labhil.experiment.excitation import evaluate_motion, fourier
from labhil.kinds import JOINTS, KINDS
from labhil.physics.model import Model, Record
from labhil.physics.rigs import rig_model
from labhil.physics.terms import keyed, unkeyed
from labhil.plants.arm import ArmPlant
from labhil.plants.arm.effects import ALL_EFFECTS, BARE_ARM, EFFECTS, HIDDEN, PerJoint, parameters_of
from labhil.signals import FloatArray, Hold, Signal

PLANTS_NAME: Mapping[str, str] = {"torque_constant": "sensor_gain"}
"""What the plant calls a term of the model, where it has another name for it."""

CENTRE = np.array([0.0, -1.57, 1.0, -1.0, -1.57, 0.0])
REACH = np.array([2.0, 1.0, 1.2, 1.5, 1.5, 2.0])
SPEED = np.array([1.2, 0.9, 1.2, 1.6, 1.6, 1.8])
ACCELERATION = np.array([3.0, 2.0, 3.0, 5.0, 5.0, 5.0])
BRISKNESS = 1.5
"""Largest factor by which a trial's speeds differ from these; accelerations go with its square."""
DURATIONS = (20.0, 25.0, 30.0)
PERIODS = (0.008, 0.008, 0.008, 0.008, 0.002)
HARMONICS = (5, 9)
RESOLUTIONS = (0.001, 0.001, 0.01)
"""A; the last is coarse beside the wrists' noise."""
LOUDNESS = 2.0
"""Largest factor by which the noise of a current differs from the plant's default."""

ENCODERS = {"q_noise": 1e-5, "qd_noise": 1e-4}
"""Noise of angles and velocities: far below what the currents' noise makes of a torque, as it should be for
the true noise of a current to be known."""

BASELINE: Mapping[str, float] = {
    "viscous_friction.coefficient": 1.6,
    "coulomb_friction.level": 1.6,
    "sensor_offset.offset": 1.6,
}
"""Largest factor by which each joint's number differs from the plant's default."""

COLD, HOT = 22.0, 40.0
"""°C that a joint may begin with where temperatures are recorded."""
WARMS_IN = 60.0
"""s in which joints of such a bench warm up: within a recording."""

OWN, WHOLE = (1.1, 25.0), (1.1, 5.0)
"""Strengths in the current of the joint that an effect is in, and mean strengths in all six currents.

A strength r in one current alone makes (r + 5)/6 of the arm's headline: 1.3 is r = 2.8, 3 is r = 13.
"""

FIXED = ("torque_ripple.order",)
"""Known of the gear, like its ratio."""
ON_THE_WAY = 0.3
"""Share of a joint's reach within which a sticky patch has its centre."""
OFF_CENTRE = 0.05
"""m, largest distance of a payload from the flange's axis, each way."""


@dataclass(frozen=True, slots=True)
class ArmConditions:
    """How a trial of an arm is recorded.

    ``duration`` and ``period`` in s; ``harmonics`` of the Fourier series and ``briskness``, a factor of the
    usual speeds; ``level`` (A) of each current's noise before a converter of ``resolution`` (A),
    ``correlation`` that of neighbouring samples' noise; ``jitter`` the largest deviation of a stamp in
    periods; ``temperatures`` says whether they are recorded; ``seeds`` fix motion and noise of search and
    test.
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

    def setup(self, random: np.random.Generator) -> ArmSetup:
        """The rig under random conditions."""
        conditions = ArmConditions(
            duration=float(random.choice(self.durations)),
            period=float(random.choice(PERIODS)),
            harmonics=int(random.integers(*HARMONICS)),
            briskness=spread(BRISKNESS, random),
            level=tuple(level * spread(LOUDNESS, random) for level in _six("current_noise")),
            resolution=float(random.choice(RESOLUTIONS)),
            correlation=float(random.choice([0.0, random.uniform(0.3, 0.8)])),
            jitter=float(random.choice([0.0, random.uniform(0.02, 0.15)])),
            temperatures=bool(random.integers(2)),
            seeds=(int(random.integers(2**31)), int(random.integers(2**31))),
        )
        return ArmSetup(self, conditions)

    def lasting(self, seconds: float) -> ArmBench:
        """The same with recordings that are so long, s."""
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
        """The conditions as an answer lists them."""
        return asdict(self.conditions)

    def draw_base(self, random: np.random.Generator) -> dict[str, float]:
        """Friction and offset of every joint, spread about the plant's defaults."""
        drawn = {
            keyed(name, joint): default * spread(factor, random)
            for name, factor in BASELINE.items()
            for joint, default in enumerate(_six(name))
        }
        if not self.conditions.temperatures:
            return drawn
        warm = {keyed("start_temperature", j): float(random.uniform(COLD, HOT)) for j in range(JOINTS)}
        return drawn | warm | {"warming_time": WARMS_IN}

    def draw_effect(
        self, model: Model, outside: bool, others: Sequence[Drawn], random: np.random.Generator
    ) -> Drawn:
        """One effect of random kind, joint and size, with the strength that it is to be scaled to."""
        taken = {*rig_model(model.kind).baseline, *(effect.key for effect in others)}
        choices: dict[str, list[int | None]] = {}
        for term, joint in _hidden_effects() if outside else _nameable_effects(model):
            if term not in taken and keyed(term, joint) not in taken:
                choices.setdefault(term, []).append(joint)
        term = str(random.choice(list(choices)))
        joint = choices[term][int(random.integers(len(choices[term])))]
        name = PLANTS_NAME.get(term, term)
        shapes = {f"{name}.{short}" for short in ALL_EFFECTS[name].shapes}
        drawn, powers = {}, {}
        for full, default in parameters_of(name).items():
            key = keyed(full, joint if isinstance(default, tuple) else None)
            drawn[key] = _size(full, default, joint, random)
            powers[key] = 0 if full in shapes else power_of(full)
        low, high = np.log(OWN if joint is not None else WHOLE)
        return Drawn(term, drawn, powers, float(np.exp(random.uniform(low, high))), joint)

    def draw_carrier(self, dry: Drawn, random: np.random.Generator) -> Drawn:
        """None: an arm's model names presliding friction, so that it is an effect like any other."""
        raise UsageError("--effects bristles: expected a rig that one input drives, found ur5")

    def numbers(self, secret: Secret) -> Mapping[str, float]:
        """Every number of the plant, its defaults included, by key."""
        return self._plant(secret, {}, 0).parameters

    def noise_scale(self, secret: Secret) -> TrueNoise:
        """Noise and steps of the currents."""
        conditions = self.conditions
        return TrueNoise(conditions.level, (conditions.resolution,) * JOINTS, conditions.correlation)

    def walk(self, secret: Secret, noise: TrueNoise, which: int) -> Walk:
        """Record the search (0) or the test (1).

        UsageError where dry friction would drive a joint, which no law of the model does.
        """
        measured = {keyed("current_noise", j): level for j, level in enumerate(noise.level)}
        memory = {"current_noise_memory": noise.correlation, "current_resolution": noise.step[0]}
        walk = self._walk(secret, which, measured | memory)
        self._refuse_drive(secret, walk)
        return walk

    def silent(self, secret: Secret, walk: Walk, which: int) -> Walk:
        """The same motion again, with currents measured without noise and steps."""
        return self._walk(secret, which, {"current_noise": 0.0, "current_resolution": 0.0})

    def record(self, walk: Walk) -> Record:
        """The walk as a model sees it, before it is filtered."""
        kinds = {signal.name: signal for signal in self.signals}
        inputs, output = ("actual_q", "actual_qd"), kinds["actual_current"]
        return Record(
            t=walk.t,
            inputs=np.ascontiguousarray(np.hstack([walk.signals[name] for name in inputs])),
            outputs=np.ascontiguousarray(walk.signals[output.name]),
            input_names=tuple(column for name in inputs for column in kinds[name].columns()),
            output_names=tuple(output.columns()),
            output_units=(output.unit,) * JOINTS,
            input_holds=(Hold.LINEAR,) * (2 * JOINTS),
            auxiliary={
                column: np.ascontiguousarray(values)
                for name in self._auxiliary
                for column, values in zip(kinds[name].columns(), walk.signals[name].T, strict=True)
            },
            output_joints=tuple(range(JOINTS)),
        )

    @property
    def _auxiliary(self) -> tuple[str, ...]:
        return ("joint_temperatures",) if self.conditions.temperatures else ()

    def _plant(self, secret: Secret, measured: Mapping[str, float], which: int) -> ArmPlant:
        conditions = self.conditions
        terms = [keyed(PLANTS_NAME.get(name, name), joint) for name, joint in map(unkeyed, secret.terms)]
        given = {
            **secret.parameters,
            **ENCODERS,
            **measured,
            "stamp_jitter": conditions.jitter * conditions.period,
        }
        return ArmPlant(given, terms, conditions.seeds[which], conditions.period)

    def _walk(self, secret: Secret, which: int, measured: Mapping[str, float]) -> Walk:
        conditions = self.conditions
        series = fourier(
            tuple(CENTRE - REACH), tuple(CENTRE + REACH), tuple(SPEED * conditions.briskness),
            tuple(ACCELERATION * conditions.briskness**2), 1.0 / conditions.duration, conditions.duration,
            harmonics=conditions.harmonics, centre=tuple(CENTRE), seed=conditions.seeds[which],
        )  # fmt: skip
        t: FloatArray = conditions.period * np.arange(
            round(conditions.duration / conditions.period), dtype=np.float64
        )
        plan = evaluate_motion(series, t)
        seen = self._plant(secret, measured, which).follow(*plan)
        signals = {signal.name: getattr(seen, signal.name) for signal in self.signals}
        return Walk(seen.t, plan[0], signals)

    def _refuse_drive(self, secret: Secret, walk: Walk) -> None:
        numbers = self.numbers(secret)
        for joint in range(JOINTS):
            level = numbers[keyed("coulomb_friction.level", joint)]
            least = level + min(numbers.get(keyed("stribeck_friction.level", joint), 0.0), 0.0)
            slope = numbers.get(keyed("position_dependent_friction.slope", joint), 0.0)
            least -= abs(slope) * float(np.abs(walk.signals["actual_q"][:, joint]).max())
            if least < 0.0:
                raise UsageError(f"dry friction of joint {joint} would fall to {least:g} N·m")


def _six(name: str) -> tuple[float, ...]:
    """The plant's default of a parameter, joint by joint."""
    effect, dot, short = name.partition(".")
    default = EFFECTS[effect].strengths[short] if dot else BARE_ARM[name]
    assert isinstance(default, tuple)
    return default


def _nameable_effects(model: Model) -> list[tuple[str, int | None]]:
    """Names and joints of effects that both the plant can have and the model can name."""
    terms = [(term.name, term.joint) for term in model.terms.values()]
    return [(name, joint) for name, joint in terms if PLANTS_NAME.get(name, name) in EFFECTS]


def _hidden_effects() -> list[tuple[str, int | None]]:
    """Names and joints of effects that stand in no list."""
    effects: list[tuple[str, int | None]] = []
    for name, effect in HIDDEN.items():
        per_joint = any(isinstance(value, tuple) for value in effect.strengths.values())
        effects += [(name, joint) for joint in range(JOINTS)] if per_joint else [(name, None)]
    return effects


def _size(name: str, default: float | PerJoint, joint: int | None, random: np.random.Generator) -> float:
    """A random value of one of an effect's parameters."""
    value = default if isinstance(default, float) else default[joint or 0] or max(default)
    if name in FIXED:
        return value
    if name == "hidden_sticky_patch.centre":
        return float(CENTRE[joint or 0] + ON_THE_WAY * REACH[joint or 0] * random.uniform(-1.0, 1.0))
    if name == "torque_ripple.phase":
        return float(random.uniform(-np.pi, np.pi))
    if name in ("payload.centre_x", "payload.centre_y"):
        return float(random.uniform(-OFF_CENTRE, OFF_CENTRE))
    size = draw_size(name, value, random)
    # a UR5's own falls at rest in some joints and rises in others
    return -size if name == "stribeck_friction.level" and random.integers(2) else size

"""What a trial is made of: the bench's conditions, the baseline's numbers, and effects to conceal."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from labhil.campaign.trials.bench import EXCITATIONS, Bench
from labhil.errors import UsageError
from labhil.physics.model import Model
from labhil.physics.rigs import rig_model
from labhil.plants.rigs import WORLDS, effects_of

COUNTS: Mapping[str, tuple[int, ...]] = {"0": (0,), "1": (1,), "2": (2,), "3": (3,), "hidden": (1,)}
MIXTURE = {"0": 0.25, "1": 0.35, "2": 0.2, "3": 0.08, "hidden": 0.12}
"""How often each sort of trial is drawn where nobody asks for one sort."""

STRENGTHS = (1.1, 5.0)
BITS = (0, 0, 8, 10)
"""Bits of the converter; 0 stands for one that is finer than the noise."""
SHAPES = (
    ".velocity", ".order", ".phase", ".second", ".width", ".place", ".from", ".speed", ".share",
    "joint_elasticity.damping", ".spread", ".attraction",
)  # fmt: skip
"""Endings of parameters that say where or how an effect acts, not how strongly."""
NOT_SHIFTED = (".phase", ".second", ".share")
INVERSE = (
    "saturation.limit", "rate_limit.rate", "presliding_friction.stiffness", "maxwell_slip_friction.stiffness",
)  # fmt: skip
"""Parameters of which a smaller value means a stronger effect."""
SIGNED = (
    "constant_force.force", "sensor_gain.gain", "sensor_nonlinearity.cubic", "residual_magnetism.current",
    "friction_asymmetry.coefficient", "position_dependent_friction.slope", "sensor_offset.offset",
)  # fmt: skip
"""Parameters that a rig may have with either sign."""
NEED_DRY = ("presliding_friction", "maxwell_slip_friction", "position_dependent_friction")
"""Effects that change dry friction and do nothing, or drive the part, where there is none."""
DRY = ("coulomb_friction", "stribeck_friction", "load_dependent_friction")
MEASUREMENT = ("quantisation", "pwm_ripple")
"""Effects of a plant that belong to the bench's conditions."""


@dataclass(frozen=True, slots=True)
class Conditions:
    """How a trial is recorded.

    ``loop`` is the bench's loop by number; ``decibels`` the power of each output over its noise,
    ``correlation`` that of neighbouring samples' noise, ``bits`` those of the converter (0: fine),
    ``jitter`` the standard deviation of the samples' times in periods; ``auxiliary`` says whether
    further channels are recorded; ``seeds`` fix excitation and noise of search and test.
    """

    loop: int
    excitation: str
    decibels: float
    correlation: float
    bits: int
    jitter: float
    auxiliary: bool
    seeds: tuple[int, int]


@dataclass(frozen=True, slots=True)
class Drawn:
    """An effect of the plant: its name, parameters (SI, by full name), and the strength it is to have."""

    term: str
    parameters: Mapping[str, float]
    target: float

    def scaled(self, factor: float) -> Drawn:
        """The same effect, stronger by a factor."""
        return replace(self, parameters={k: v * _power(k, factor) for k, v in self.parameters.items()})


@dataclass(frozen=True, slots=True)
class Secret:
    """All that is concealed: the bench's conditions, the baseline's numbers and the effects."""

    kind: str
    conditions: Conditions
    base: Mapping[str, float]
    effects: tuple[Drawn, ...] = ()

    @property
    def terms(self) -> tuple[str, ...]:
        """What the plant is made of."""
        return (*rig_model(self.kind).baseline, *(effect.term for effect in self.effects))

    @property
    def parameters(self) -> dict[str, float]:
        """The plant's numbers other than its defaults, by full name."""
        return dict(self.base) | {k: v for effect in self.effects for k, v in effect.parameters.items()}


def draw_sort(wanted: str, random: np.random.Generator) -> str:
    """One sort of trial: "0" to "3" effects of the catalogue, or "hidden"; UsageError for another word."""
    if wanted == "mixed":
        return str(random.choice(list(MIXTURE), p=list(MIXTURE.values())))
    if wanted not in COUNTS:
        raise UsageError(f"--effects: expected one of {', '.join(COUNTS)}, mixed; found {wanted!r}")
    return wanted


def draw_conditions(bench: Bench, random: np.random.Generator) -> Conditions:
    """Conditions of one trial."""
    return Conditions(
        loop=int(random.integers(len(bench.loops))),
        excitation=str(random.choice(list(EXCITATIONS))),
        decibels=float(random.uniform(*bench.noise)),
        correlation=float(random.choice([0.0, random.uniform(0.3, 0.8)])),
        bits=int(random.choice(BITS)),
        jitter=float(random.choice([0.0, random.uniform(0.02, 0.15)])),
        auxiliary=bool(bench.auxiliary) and bool(random.integers(2)),
        seeds=(int(random.integers(2**31)), int(random.integers(2**31))),
    )


def draw_base(bench: Bench, conditions: Conditions, random: np.random.Generator) -> dict[str, float]:
    """The baseline's numbers, spread about the plant's defaults."""
    world = WORLDS[bench.kind]
    defaults = world.all_parameters()
    spread = {
        name: defaults[name] * float(np.exp(random.uniform(-1.0, 1.0) * np.log(factor)))
        for name, factor in bench.spread.items()
    }
    return spread | dict(bench.at_work or {}) | (dict(bench.warm or {}) if conditions.auxiliary else {})


def candidates(model: Model, outside: bool, others: Sequence[str] = ()) -> tuple[str, ...]:
    """Effects of the plant that the model can name, or those that it cannot, to join ``others``."""
    known = {term.name for term in model.terms.values()}
    there = {*rig_model(model.kind).baseline, *others}
    fitting = [name for name in effects_of(model.kind) if name not in NEED_DRY or there & set(DRY)]
    effects = [name for name in fitting if name not in there]
    if not outside:
        return tuple(name for name in effects if name in known)
    strange = [name for name in effects if name not in known and name not in MEASUREMENT]
    return (*strange, *effects_of(model.kind, hidden=True))


def draw_effect(kind: str, names: Sequence[str], random: np.random.Generator) -> Drawn:
    """One effect of random kind and size, with the strength that it is to be scaled to."""
    term = str(random.choice(list(names)))
    defaults = WORLDS[kind].parameters_of(term)
    low, high = np.log(STRENGTHS)
    drawn = {name: _drawn(name, value, random) for name, value in defaults.items()}
    return Drawn(term, drawn, float(np.exp(random.uniform(low, high))))


def _drawn(name: str, default: float, random: np.random.Generator) -> float:
    """A value about the default; what has no counterpart in a model stays away."""
    if name == "friction_asymmetry.level":
        return 0.0
    if name == "cogging_torque.phase":
        return float(random.uniform(-np.pi, np.pi))
    if name.endswith(NOT_SHIFTED):
        return default
    value = abs(default) if name.endswith("stribeck_friction.level") else default
    value *= float(np.exp(random.uniform(-1.0, 1.0) * np.log(1.6)))
    flipped = name in SIGNED or name.endswith(".place")
    return -value if flipped and random.integers(2) else value


def _power(name: str, factor: float) -> float:
    if name in INVERSE:
        return 1.0 / factor
    return 1.0 if name.endswith(SHAPES) else factor

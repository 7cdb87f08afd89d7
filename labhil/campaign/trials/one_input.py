"""Rigs that one input drives: what their benches record, what can be drawn, and a walk sample by sample."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from typing import Any

import numpy as np

from labhil.campaign.trials.loop import EXCITATIONS, Law, Loop, Range, excitation_of
from labhil.campaign.trials.noise import TrueNoise
from labhil.campaign.trials.secret import Drawn, Secret, Walk
from labhil.campaign.trials.sizes import draw_size, power_of, spread
from labhil.errors import UsageError
from labhil.kinds import KINDS
from labhil.physics.model import Model, Record
from labhil.physics.rigs import rig_model
from labhil.plants.definition import PlantDefinition
from labhil.plants.rigs import PLANT_DEFINITIONS, Plant, effects_of, plant_of
from labhil.signals import FloatArray, Hold, Signal

STRENGTHS = (1.1, 5.0)
BITS = (0, 0, 8, 10)
"""Bits of the converter; 0 stands for one that is finer than the noise."""
NEED_DRY = ("presliding_friction", "maxwell_slip_friction", "position_dependent_friction")
"""Effects that change dry friction and do nothing, or drive the part, where there is none."""
DRY = ("coulomb_friction", "stribeck_friction", "load_dependent_friction")
CARRIERS = ("presliding_friction", "maxwell_slip_friction")
"""What may carry a dry friction in the place of an event-based law."""
MEASUREMENT = ("quantisation", "pwm_ripple")
"""Effects of a plant that belong to the bench's conditions."""
FINEST_BITS = 16.0
"""Of the ball and beam's converter, which is always there."""
BEFORE = 100
"""Samples before a recording, in which the rig stands at the centre of its excitation.

No recording holds what was under way in a delay, a lag or a coil before it began.
"""
HEADROOM = 1.25
"""Full scale of a converter over the largest value it was expected to see."""


@dataclass(frozen=True, slots=True)
class OneInputBench:
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

    def setup(self, random: np.random.Generator) -> OneInputSetup:
        """The rig under random conditions."""
        return OneInputSetup(self, _conditions(self, random))

    def lasting(self, seconds: float) -> OneInputBench:
        """The same with recordings that are so long, s."""
        samples = round(seconds / self.period)
        return replace(self, samples=(samples, samples))


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


def _conditions(bench: OneInputBench, random: np.random.Generator) -> Conditions:
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


@dataclass(frozen=True, slots=True)
class OneInputSetup:
    """A bench under the conditions of one trial (satisfies ``secret.Setup``)."""

    bench: OneInputBench
    conditions: Conditions

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
        return self.bench.period

    @property
    def signals(self) -> tuple[Signal, ...]:
        """The input, the outputs and, where they are recorded, the further channels."""
        kind = KINDS[self.kind]
        names = (kind.inputs[0].name, *self.bench.outputs, *self._auxiliary)
        return tuple(signal for signal in kind.signals() if signal.name in names)

    def conditions_to_json(self) -> dict[str, Any]:
        """The conditions as an answer lists them."""
        return asdict(self.conditions)

    def draw_base(self, random: np.random.Generator) -> dict[str, float]:
        """The baseline's numbers, spread about the plant's defaults."""
        bench, defaults = self.bench, self._world.all_parameters()
        drawn = {name: defaults[name] * spread(factor, random) for name, factor in bench.spread.items()}
        warm = dict(bench.warm or {}) if self.conditions.auxiliary else {}
        return drawn | dict(bench.at_work or {}) | warm

    def draw_effect(
        self, model: Model, outside: bool, others: Sequence[Drawn], random: np.random.Generator
    ) -> Drawn:
        """One effect of random kind and size, with the strength that it is to be scaled to."""
        term = str(random.choice(list(_candidates(model, outside, [effect.term for effect in others]))))
        low, high = np.log(STRENGTHS)
        defaults = self._world.parameters_of(term)
        drawn = {name: draw_size(name, value, random) for name, value in defaults.items()}
        powers = {name: power_of(name) for name in drawn}
        return Drawn(term, drawn, powers, float(np.exp(random.uniform(low, high))))

    def draw_carrier(self, dry: Drawn, random: np.random.Generator) -> Drawn:
        """Bristles or slipping elements that carry a dry friction, as stiff for its level as by default."""
        term = str(random.choice([name for name in CARRIERS if name in effects_of(self.kind)]))
        defaults = self._world.parameters_of(term)
        drawn = {name: draw_size(name, value, random) for name, value in defaults.items()}
        level, usual = (
            abs(parameters[f"{dry.term}.level"])
            for parameters in (dry.parameters, self._world.parameters_of(dry.term))
        )
        by_level = {
            name: value * level / usual for name, value in drawn.items() if not name.endswith(".spread")
        }
        return Drawn(term, drawn | by_level, dict.fromkeys(drawn, 0), dry.target)

    def numbers(self, secret: Secret) -> Mapping[str, float]:
        """Every number of the plant, its defaults included."""
        return self._world.resolve(secret.terms, secret.parameters)

    def noise_scale(self, secret: Secret) -> TrueNoise:
        """Noise and steps of the outputs for these conditions, from a silent rehearsal."""
        bench, conditions = self.bench, self.conditions
        rehearsed = self._walk(secret, 0, self._silent_parameters())
        measured = [rehearsed.signals[name] for name in bench.outputs]
        level = [float(x.std()) * 10.0 ** (-conditions.decibels / 20.0) for x in measured]
        reach = [2.0 * HEADROOM * float(np.abs(x).max()) for x in measured]
        if bench.kind == "ball_beam":
            reach = [0.5]
        step = [full / 2**conditions.bits if conditions.bits else 0.0 for full in reach]
        return TrueNoise(tuple(level), tuple(step), conditions.correlation)

    def walk(self, secret: Secret, noise: TrueNoise, which: int) -> Walk:
        """Record the search (0) or the test (1).

        UsageError where the plant runs away or leaves its travel.
        """
        walk = self._walk(secret, which, self._noise_parameters(noise))
        first, travel = self.bench.outputs[0], self.bench.travel
        reached = float(np.abs(walk.signals[first]).max())
        if reached > travel:
            raise UsageError(f"{first} reached {reached:g}, at most {travel:g} is allowed")
        return walk

    def silent(self, secret: Secret, walk: Walk, which: int) -> Walk:
        """The same commands again, measured without noise and steps."""
        return self._walk(secret, which, self._silent_parameters(), walk.commands)

    def record(self, walk: Walk) -> Record:
        """The walk as a model sees it."""
        kinds = {signal.name: signal for signal in KINDS[self.kind].signals()}
        source, outputs = KINDS[self.kind].inputs[0], self.bench.outputs
        return Record(
            t=walk.t,
            inputs=np.ascontiguousarray(walk.signals[source.name][:, None]),
            outputs=np.column_stack([walk.signals[name] for name in outputs]),
            input_names=(source.name,),
            output_names=outputs,
            output_units=tuple(kinds[name].unit for name in outputs),
            input_holds=(source.hold,),
            auxiliary={name: walk.signals[name] for name in self._auxiliary},
            output_joints=(None,) * len(outputs),
        )

    @property
    def _world(self) -> PlantDefinition:
        return PLANT_DEFINITIONS[self.kind]

    @property
    def _auxiliary(self) -> tuple[str, ...]:
        return self.bench.auxiliary if self.conditions.auxiliary else ()

    def _silent_parameters(self) -> dict[str, float]:
        fine = {"adc_bits": FINEST_BITS} if self.kind == "ball_beam" else {}
        return {self.bench.noise_name(name): 0.0 for name in self.bench.outputs} | fine

    def _noise_parameters(self, noise: TrueNoise) -> dict[str, float]:
        """Parameters of the plant that make this noise."""
        bench = self.bench
        given = {bench.noise_name(n): level for n, level in zip(bench.outputs, noise.level, strict=True)}
        given["noise_correlation"] = noise.correlation
        if self.kind == "ball_beam":
            return given | {"adc_bits": float(self.conditions.bits) or FINEST_BITS}
        return given | {f"{n}_resolution": step for n, step in zip(bench.outputs, noise.step, strict=True)}

    def _walk(
        self, secret: Secret, which: int, measured: Mapping[str, float], commands: FloatArray | None = None
    ) -> Walk:
        """Step through one recording; ``commands`` (BEFORE + n + 1,) replace excitation and controller."""
        bench, conditions, n = self.bench, self.conditions, self.bench.samples[which]
        seed = conditions.seeds[which]
        jitter = 0.0 if _counts_samples(secret) else conditions.jitter * bench.period
        given = {**secret.parameters, **measured, "stamp_jitter": jitter}
        plant = plant_of(bench.kind, given, secret.terms, seed, bench.period)
        loop = bench.loops[conditions.loop]
        t: FloatArray = bench.period * np.arange(n + 1, dtype=np.float64)
        excitation = excitation_of(conditions.excitation, t, loop, np.random.default_rng([seed, 1]))
        excitation = np.r_[np.full(BEFORE, excitation[0]), excitation]
        law = Law(loop.controller, bench.period)
        factor, added = np.ones(len(excitation)), np.zeros(len(excitation))
        if secret.disturbance is not None:
            factor, added = secret.disturbance.sample(len(excitation), bench.period, seed)
        if commands is None and not loop.closed:
            commands = np.array([law.command(value, 0.0) for value in excitation.tolist()])
        if commands is not None:
            return _follow(plant, commands, factor * commands + added, KINDS[bench.kind].inputs[0])
        rows: list[Mapping[str, float]] = []
        sent, stamps, seen = np.empty(len(excitation)), np.empty(len(excitation)), 0.0
        for k, wanted in enumerate(excitation.tolist()):
            sent[k] = law.command(wanted, seen)
            rows.append(plant.step(float(factor[k] * sent[k] + added[k])))
            stamps[k] = plant.time
            seen = rows[-1][bench.outputs[0]]
        source, rows, stamps = KINDS[bench.kind].inputs[0], rows[BEFORE:-1], stamps[BEFORE:-1]
        signals = {name: np.array([row[name] for row in rows]) for name in rows[0]}
        return Walk(stamps - stamps[0], sent, {source.name: _acting_input(sent, source)} | signals)


def _follow(plant: Plant, sent: FloatArray, done: FloatArray, source: Signal) -> Walk:
    """What a plant does at commands (BEFORE + n + 1,) that are known beforehand: as sent, and as they act."""
    for value in done[: BEFORE + 1].tolist():
        plant.step(value)
    run = plant.simulate(_acting_input(done, source))
    return Walk(run.t, sent, {source.name: _acting_input(sent, source), **run.measured})


def _acting_input(sent: FloatArray, source: Signal) -> FloatArray:
    """The input (n,) beside each sample, of the commands (BEFORE + n + 1,).

    A command that is held acts after the sample beside which it stands, another has just been reached.
    """
    return sent[BEFORE + 1 :] if source.hold is Hold.ZERO else sent[BEFORE:-1]


def _counts_samples(secret: Secret) -> bool:
    """Whether the plant cannot have uneven samples: a ball and beam with a delay counts them."""
    return secret.kind == "ball_beam" and "time_delay" in secret.terms


def _candidates(model: Model, outside: bool, others: Sequence[str]) -> tuple[str, ...]:
    """Effects of the plant that the model can name, or those that it cannot, to join ``others``."""
    known = {term.name for term in model.terms.values()}
    taken = {*rig_model(model.kind).baseline, *others}
    fitting = [name for name in effects_of(model.kind) if name not in NEED_DRY or taken & set(DRY)]
    effects = [name for name in fitting if name not in taken]
    if not outside:
        return tuple(name for name in effects if name in known)
    strange = [name for name in effects if name not in known and name not in MEASUREMENT]
    return (*strange, *effects_of(model.kind, hidden=True))

"""Benches of rigs with one input: drawn conditions and effects, and the simulation of a recording.

The benches themselves are in ``one_input_rigs.py``.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from typing import Any

import numpy as np

from labhil.campaign.trials.loop import EXCITATIONS, ControllerState, Loop, Range, make_excitation
from labhil.campaign.trials.noise import TrueNoise
from labhil.campaign.trials.secret import DrawnEffect, Secret, SimulatedRun
from labhil.campaign.trials.sizes import draw_factor, draw_size, strength_exponent
from labhil.errors import UsageError
from labhil.kinds import KINDS
from labhil.physics.model import Model
from labhil.physics.record import Record
from labhil.physics.rigs import rig_model
from labhil.plants.definition import CARRIERS, PlantDefinition
from labhil.plants.rigs import PLANT_DEFINITIONS, Plant, effects_of, plant_of
from labhil.signals import FloatArray, Hold, Signal

STRENGTH_RANGE = (1.1, 5.0)
"""Target strengths of effects, drawn log-uniformly."""
CONVERTER_BITS = (0, 0, 8, 10)
"""Bits of the converter; 0 is one with steps far below the noise."""
REQUIRES_DRY_FRICTION = ("presliding_friction", "maxwell_slip_friction", "position_dependent_friction")
"""Effects that modify dry friction; without one they do nothing, or drive the part."""
DRY_FRICTION_TERMS = ("coulomb_friction", "stribeck_friction", "load_dependent_friction")
MEASUREMENT_EFFECTS = ("quantisation", "pwm_ripple")
"""Effects of a plant that belong to the bench's conditions."""
FINEST_BITS = 16.0
"""Bits of the finest converter of the ball and beam, which always has one."""
LEAD_IN_SAMPLES = 100
"""Samples before a recording, with a constant command.

A recording does not contain the state of a delay, a lag or a coil at its beginning; after these samples it is
at rest.
"""
HEADROOM = 1.25
"""Full scale of a converter over the largest value of a rehearsal."""


@dataclass(frozen=True, slots=True)
class OneInputBench:
    """What a trial of one kind of rig records, and how.

    Attributes:
        kind: the kind of rig.
        rig: text of the rig file.
        period: time between samples, s.
        samples: number of samples of the search and the test recording.
        outputs: names of the outputs.
        noise: smallest and largest power of a channel over its noise, dB.
        parameter_spread: largest factor by which each unknown parameter differs from the plant's default.
        loops: ways to drive the rig.
        auxiliary: further channels that a trial may record.
        at_work: parameters of the plant other than its defaults.
        warm: further ones of a trial that records auxiliary channels.
        travel: largest absolute first output that the bench allows.
        noise_names: the plant's names of the noise of outputs, where they are not ``OUTPUT_noise``.
    """

    kind: str
    rig: str
    period: float
    samples: tuple[int, int]
    outputs: tuple[str, ...]
    noise: Range
    parameter_spread: Mapping[str, float]
    loops: tuple[Loop, ...]
    auxiliary: tuple[str, ...] = ()
    at_work: Mapping[str, float] | None = None
    warm: Mapping[str, float] | None = None
    travel: float = float("inf")
    noise_names: Mapping[str, str] | None = None

    def noise_name(self, output: str) -> str:
        """Return the plant's name of the noise of an output."""
        return (self.noise_names or {}).get(output, f"{output}_noise")

    def draw_setup(self, rng: np.random.Generator) -> OneInputSetup:
        """Draw the conditions of a trial."""
        return OneInputSetup(self, _conditions(self, rng))

    def with_duration(self, seconds: float) -> OneInputBench:
        """Return the bench with recordings of this duration, s."""
        samples = round(seconds / self.period)
        return replace(self, samples=(samples, samples))


@dataclass(frozen=True, slots=True)
class Conditions:
    """Conditions of a trial.

    Attributes:
        loop: index of the bench's loop.
        excitation: a key of ``EXCITATIONS``.
        decibels: power of each output over its noise, dB.
        correlation: correlation of neighbouring samples' noise.
        bits: of the converter, 0 for steps far below the noise.
        jitter: standard deviation of the samples' times, in periods.
        auxiliary: whether auxiliary channels are recorded.
        seeds: seeds of excitation and noise of the search and the test recording.
    """

    loop: int
    excitation: str
    decibels: float
    correlation: float
    bits: int
    jitter: float
    auxiliary: bool
    seeds: tuple[int, int]


def _conditions(bench: OneInputBench, rng: np.random.Generator) -> Conditions:
    return Conditions(
        loop=int(rng.integers(len(bench.loops))),
        excitation=str(rng.choice(list(EXCITATIONS))),
        decibels=float(rng.uniform(*bench.noise)),
        correlation=float(rng.choice([0.0, rng.uniform(0.3, 0.8)])),
        bits=int(rng.choice(CONVERTER_BITS)),
        jitter=float(rng.choice([0.0, rng.uniform(0.02, 0.15)])),
        auxiliary=bool(bench.auxiliary) and bool(rng.integers(2)),
        seeds=(int(rng.integers(2**31)), int(rng.integers(2**31))),
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
        """Return the conditions as plain JSON data."""
        return asdict(self.conditions)

    def draw_baseline_parameters(self, rng: np.random.Generator) -> dict[str, float]:
        """Draw the baseline's parameters about the plant's defaults."""
        bench, defaults = self.bench, self._world.all_parameters()
        drawn = {
            name: defaults[name] * draw_factor(factor, rng) for name, factor in bench.parameter_spread.items()
        }
        warm = dict(bench.warm or {}) if self.conditions.auxiliary else {}
        return drawn | dict(bench.at_work or {}) | warm

    def draw_effect(
        self, model: Model, outside: bool, others: Sequence[DrawnEffect], rng: np.random.Generator
    ) -> DrawnEffect:
        """Draw an effect of random kind and size, and its target strength."""
        term = str(rng.choice(list(_candidates(model, outside, [effect.term for effect in others]))))
        low, high = np.log(STRENGTH_RANGE)
        defaults = self._world.parameters_of(term)
        drawn = {name: draw_size(name, value, rng) for name, value in defaults.items()}
        powers = {name: strength_exponent(name) for name in drawn}
        return DrawnEffect(term, drawn, powers, float(np.exp(rng.uniform(low, high))))

    def draw_carrier(self, dry: DrawnEffect, rng: np.random.Generator) -> DrawnEffect:
        """Draw a bristle law for a dry friction, as stiff for its level as by default."""
        term = str(rng.choice([name for name in CARRIERS if name in effects_of(self.kind)]))
        defaults = self._world.parameters_of(term)
        drawn = {name: draw_size(name, value, rng) for name, value in defaults.items()}
        level, usual = (
            abs(parameters[f"{dry.term}.level"])
            for parameters in (dry.parameters, self._world.parameters_of(dry.term))
        )
        by_level = {
            name: value * level / usual for name, value in drawn.items() if not name.endswith(".spread")
        }
        return DrawnEffect(term, drawn | by_level, dict.fromkeys(drawn, 0), dry.target_strength)

    def plant_parameters(self, secret: Secret) -> Mapping[str, float]:
        """Return every parameter of the plant, its defaults included."""
        return self._world.resolve(secret.terms, secret.parameters)

    def true_noise(self, secret: Secret) -> TrueNoise:
        """Return noise and steps of the outputs for these conditions, from a noiseless simulation."""
        bench, conditions = self.bench, self.conditions
        rehearsal = self._simulate(secret, 0, self._noiseless_parameters())
        measured = [rehearsal.signals[name] for name in bench.outputs]
        level = [float(x.std()) * 10.0 ** (-conditions.decibels / 20.0) for x in measured]
        reach = [2.0 * HEADROOM * float(np.abs(x).max()) for x in measured]
        if bench.kind == "ball_beam":
            reach = [0.5]
        step = [full / 2**conditions.bits if conditions.bits else 0.0 for full in reach]
        return TrueNoise(tuple(level), tuple(step), conditions.correlation)

    def simulate(self, secret: Secret, noise: TrueNoise, recording_index: int) -> SimulatedRun:
        """Simulate the search (0) or the test (1) recording.

        Raises:
            UsageError: the plant diverges or leaves its travel.
        """
        run = self._simulate(secret, recording_index, self._noise_parameters(noise))
        first, travel = self.bench.outputs[0], self.bench.travel
        max_output = float(np.abs(run.signals[first]).max())
        if max_output > travel:
            raise UsageError(f"{first} reached {max_output:g}, at most {travel:g} is allowed")
        return run

    def simulate_noiseless(self, secret: Secret, run: SimulatedRun, recording_index: int) -> SimulatedRun:
        """Simulate the same commands again, with outputs without noise and steps."""
        return self._simulate(secret, recording_index, self._noiseless_parameters(), run.commands)

    def to_record(self, run: SimulatedRun) -> Record:
        """Return a run as the record of a model."""
        kinds = {signal.name: signal for signal in KINDS[self.kind].signals()}
        source, outputs = KINDS[self.kind].inputs[0], self.bench.outputs
        return Record(
            t=run.t,
            inputs=np.ascontiguousarray(run.signals[source.name][:, None]),
            outputs=np.column_stack([run.signals[name] for name in outputs]),
            input_names=(source.name,),
            output_names=outputs,
            output_units=tuple(kinds[name].unit for name in outputs),
            input_holds=(source.hold,),
            auxiliary={name: run.signals[name] for name in self._auxiliary},
            output_joints=(None,) * len(outputs),
        )

    @property
    def _world(self) -> PlantDefinition:
        return PLANT_DEFINITIONS[self.kind]

    @property
    def _auxiliary(self) -> tuple[str, ...]:
        return self.bench.auxiliary if self.conditions.auxiliary else ()

    def _noiseless_parameters(self) -> dict[str, float]:
        fine = {"adc_bits": FINEST_BITS} if self.kind == "ball_beam" else {}
        return {self.bench.noise_name(name): 0.0 for name in self.bench.outputs} | fine

    def _noise_parameters(self, noise: TrueNoise) -> dict[str, float]:
        """Parameters of the plant for this noise."""
        bench = self.bench
        parameters = {bench.noise_name(n): level for n, level in zip(bench.outputs, noise.level, strict=True)}
        parameters["noise_correlation"] = noise.correlation
        if self.kind == "ball_beam":
            return parameters | {"adc_bits": float(self.conditions.bits) or FINEST_BITS}
        return parameters | {
            f"{n}_resolution": step for n, step in zip(bench.outputs, noise.step, strict=True)
        }

    def _simulate(
        self,
        secret: Secret,
        recording_index: int,
        measured: Mapping[str, float],
        commands: FloatArray | None = None,
    ) -> SimulatedRun:
        """Simulate one recording; ``commands`` (lead-in + n + 1,) replace excitation and controller."""
        bench, conditions, n = self.bench, self.conditions, self.bench.samples[recording_index]
        seed = conditions.seeds[recording_index]
        jitter = 0.0 if _needs_even_samples(secret) else conditions.jitter * bench.period
        parameters = {**secret.parameters, **measured, "stamp_jitter": jitter}
        plant = plant_of(bench.kind, parameters, secret.terms, seed, bench.period)
        loop = bench.loops[conditions.loop]
        t: FloatArray = bench.period * np.arange(n + 1, dtype=np.float64)
        excitation = make_excitation(conditions.excitation, t, loop, np.random.default_rng([seed, 1]))
        excitation = np.r_[np.full(LEAD_IN_SAMPLES, excitation[0]), excitation]
        controller = ControllerState(loop.controller, bench.period)
        factor, added = np.ones(len(excitation)), np.zeros(len(excitation))
        if secret.disturbance is not None:
            factor, added = secret.disturbance.sample(len(excitation), bench.period, seed)
        if commands is None and not loop.closed:
            commands = np.array([controller.command(value, 0.0) for value in excitation.tolist()])
        source = KINDS[bench.kind].inputs[0]
        if commands is not None:
            return _follow(plant, commands, factor * commands + added, source)
        return _run_closed_loop(plant, controller, excitation, (factor, added), source, bench.outputs[0])


def _run_closed_loop(
    plant: Plant,
    controller: ControllerState,
    excitation: FloatArray,
    disturbance: tuple[FloatArray, FloatArray],
    source: Signal,
    output: str,
) -> SimulatedRun:
    """Simulate a plant under a controller; ``disturbance`` is the factor and the summand of the commands."""
    factor, added = disturbance
    rows: list[Mapping[str, float]] = []
    sent, stamps, measured = np.empty(len(excitation)), np.empty(len(excitation)), 0.0
    for k, setpoint in enumerate(excitation.tolist()):
        sent[k] = controller.command(setpoint, measured)
        rows.append(plant.step(float(factor[k] * sent[k] + added[k])))
        stamps[k] = plant.time
        measured = rows[-1][output]
    rows, stamps = rows[LEAD_IN_SAMPLES:-1], stamps[LEAD_IN_SAMPLES:-1]
    signals = {name: np.array([row[name] for row in rows]) for name in rows[0]}
    return SimulatedRun(stamps - stamps[0], sent, {source.name: _acting_input(sent, source)} | signals)


def _follow(plant: Plant, sent: FloatArray, acting: FloatArray, source: Signal) -> SimulatedRun:
    """Simulate a plant with known commands (lead-in + n + 1,): as they were sent, and as they act."""
    for value in acting[: LEAD_IN_SAMPLES + 1].tolist():
        plant.step(value)
    run = plant.simulate(_acting_input(acting, source))
    return SimulatedRun(run.t, sent, {source.name: _acting_input(sent, source), **run.measured})


def _acting_input(sent: FloatArray, source: Signal) -> FloatArray:
    """Return the input (n,) that is recorded with each sample, of the commands (lead-in + n + 1,).

    A held command acts after its sample; an interpolated one has been reached at it.
    """
    return sent[LEAD_IN_SAMPLES + 1 :] if source.hold is Hold.ZERO else sent[LEAD_IN_SAMPLES:-1]


def _needs_even_samples(secret: Secret) -> bool:
    """Whether the plant needs even samples: a ball and beam with a delay counts them."""
    return secret.kind == "ball_beam" and "time_delay" in secret.terms


def _candidates(model: Model, outside: bool, others: Sequence[str]) -> tuple[str, ...]:
    """Names of effects to draw from beside ``others``: those in the model's catalogue, or outside it."""
    known = {term.name for term in model.terms.values()}
    taken = {*rig_model(model.kind).baseline, *others}
    possible = [
        name
        for name in effects_of(model.kind)
        if name not in REQUIRES_DRY_FRICTION or taken & set(DRY_FRICTION_TERMS)
    ]
    effects = [name for name in possible if name not in taken]
    if not outside:
        return tuple(name for name in effects if name in known)
    outside_effects = [name for name in effects if name not in known and name not in MEASUREMENT_EFFECTS]
    return (*outside_effects, *effects_of(model.kind, hidden=True))

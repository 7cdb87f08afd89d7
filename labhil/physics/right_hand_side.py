"""Models of third parties, defined by the right-hand side of ẋ = f(t, x, u, p).

A package registers a ``labhil.kinds.RigKind`` under the entry point ``labhil.rigs`` and a
:class:`RightHandSide` of the same name under ``labhil.models``; windows, estimators, statistics and reports
then work for it. The functions are vectorised: all windows are integrated together, so plain numpy is fast
enough.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field

import numpy as np

from labhil.errors import UsageError
from labhil.physics.model import Metric, index_of
from labhil.physics.record import Record, Windows
from labhil.physics.terms import CharacteristicScale, Parameter, Term
from labhil.rig import RigFile
from labhil.signals import FloatArray, Hold

Values = Mapping[str, float]
"""Parameter values by name."""
Derivative = Callable[[FloatArray, FloatArray, FloatArray, Values], FloatArray]
Output = Callable[[FloatArray, FloatArray, Values], FloatArray]
Guess = Callable[[FloatArray, FloatArray], FloatArray]


@dataclass(frozen=True)
class RightHandSide:
    """The model of a third party's rig kind; everything in SI units.

    Attributes:
        states: Names of the states and typical errors of a guess; names that end in ``_velocity`` are zero at
            rest.
        derivative: ``derivative(t, x, u, p)`` gives ẋ (states, k) for k windows at once, at times ``t`` (k,),
        s,
            states ``x`` (states, k), inputs ``u`` (inputs, k) and parameter values ``p`` by name.
        output: ``output(x, u, p)`` gives the outputs (channels, k).
        guess: ``guess(t, y)`` gives the state (states,) at the first of samples ``y`` (n, channels) at times
            ``t`` (n,).
        parameters: Parameters of the rig itself.
        horizon: Scored horizon of the windowed simulation, s.
        terms: Terms that may be added; they vanish at zero.
        baseline: Terms from which a diagnosis starts.
        general: Terms of a fit by default.
        substeps: Runge-Kutta steps (classical, fourth order) between samples; f should be smooth there.
        fading_memory: Whether the effect of the initial state decays.
        unobservable_terms: Terms that no recording can identify, each with the reason.
    """

    states: Mapping[str, float]
    derivative: Derivative
    output: Output
    guess: Guess
    parameters: tuple[Parameter, ...]
    horizon: float
    terms: tuple[Term, ...] = ()
    baseline: tuple[str, ...] = ()
    general: tuple[str, ...] = ()
    substeps: int = 1
    fading_memory: bool = False
    unobservable_terms: Mapping[str, str] = field(default_factory=dict)

    def __call__(self, rig: RigFile, record: Record | None = None) -> RightHandSideModel:
        """The model of one rig."""
        return RightHandSideModel(self, rig)


class RightHandSideModel:
    """White-box model of a third party's rig (implements ``physics.model.Model``)."""

    metric = Metric.WINDOWED_SIMULATION

    def __init__(self, stated: RightHandSide, rig: RigFile) -> None:
        self.stated = stated
        self.fading_memory = stated.fading_memory
        self.kind = rig.kind.name
        self.state_names = tuple(stated.states)
        # units of the states are not known here
        self.coordinate_units: Mapping[str, str] = dict.fromkeys(self.state_names, "")
        self.state_scale = np.array(list(stated.states.values()))
        self.terms: Mapping[str, Term] = {term.key: term for term in stated.terms}
        self.unobservable_terms = stated.unobservable_terms
        self.horizon = rig.metric.horizon or stated.horizon
        self.fixed = {n: v for n in rig.kind.known if (v := rig.known_number(n)) is not None}
        estimated = tuple(p for p in stated.parameters if p.name not in self.fixed)
        self.parameters = estimated + tuple(p for term in stated.terms for p in term.parameters)
        self._index = index_of(self.parameters)

    def horizon_at(self, theta: FloatArray) -> float:
        """Scored horizon, s; it does not depend on ``theta``."""
        return self.horizon

    def prepare(self, record: Record) -> Record:
        """Return the record unchanged: nothing is filtered."""
        return record

    def initial_states(self, record: Record, windows: Windows) -> FloatArray:
        """Guess the state at the first sample of each window, (w, states)."""
        states = [
            self.stated.guess(record.t[a:b], record.outputs[a:b])
            for a, b in zip(windows.first, windows.last, strict=True)
        ]
        return np.array(states, dtype=np.float64).reshape(len(windows), len(self.state_names))

    def simulate(self, theta: FloatArray, record: Record, windows: Windows, states: FloatArray) -> FloatArray:
        """Simulate the outputs of all windows, (N, channels)."""
        values = self._values(theta)
        x = self._trajectories(values, record, windows, states)
        return np.ascontiguousarray(self.stated.output(x, record.inputs[windows.rows].T, values).T)

    def coordinates(
        self, theta: FloatArray, record: Record, windows: Windows, states: FloatArray
    ) -> Mapping[str, FloatArray]:
        """States and inputs along the simulation, each (N,)."""
        x = self._trajectories(self._values(theta), record, windows, states)
        inputs = dict(zip(record.input_names, record.inputs[windows.rows].T, strict=True))
        return dict(zip(self.state_names, x, strict=True)) | inputs

    def drive_coordinates(
        self, theta: FloatArray, record: Record, windows: Windows, along: Mapping[str, FloatArray]
    ) -> Mapping[str, FloatArray]:
        """Nothing: effects of the input path are part of the right-hand side."""
        return {}

    def generalised_force(self, theta: FloatArray, coordinates: Mapping[str, FloatArray]) -> FloatArray:
        """Derivative of the last state at these coordinates, (N,)."""
        x = np.array([coordinates[name] for name in self.state_names])
        u = np.array([values for name, values in coordinates.items() if name not in self.state_names])
        return self.stated.derivative(np.zeros(x.shape[1]), x, u, self._values(theta))[-1]

    def characteristic_scales(self, record: Record) -> Mapping[CharacteristicScale, float]:
        """Characteristic scales: only those of the input are known here."""
        largest = float(np.abs(record.inputs).max()) or 1.0
        rate = float(np.abs(np.gradient(record.inputs[:, 0], record.t)).max()) or 1.0
        return dict.fromkeys(CharacteristicScale, 1.0) | {
            CharacteristicScale.INPUT: largest,
            CharacteristicScale.INPUT_RATE: rate,
        }

    def _values(self, theta: FloatArray) -> Values:
        return {**self.fixed, **{key: float(theta[i]) for key, i in self._index.items()}}

    def _trajectories(
        self, values: Values, record: Record, windows: Windows, states: FloatArray
    ) -> FloatArray:
        """States of all windows, (states, N); windows may have different lengths."""
        lengths = windows.last - windows.first
        begins = np.r_[0, np.cumsum(lengths)[:-1]]
        out = np.empty((len(self.state_names), len(windows.rows)))
        x = states.T.astype(np.float64)
        active = np.arange(len(windows))
        for i in range(int(lengths.max())):
            out[:, begins[active] + i] = x
            continues = lengths[active] > i + 1
            active, x = active[continues], x[:, continues]
            if len(active):
                x = self._step(values, record, windows.first[active] + i, x)
        return out

    def _step(self, values: Values, record: Record, rows: np.ndarray, x: FloatArray) -> FloatArray:
        """Integrate from the samples ``rows`` (k,) to the next ones."""
        t, h = record.t[rows], (record.t[rows + 1] - record.t[rows]) / self.stated.substeps
        held = np.array([hold is Hold.ZERO for hold in record.input_holds])[:, None]
        before, after = record.inputs[rows].T, record.inputs[rows + 1].T
        after = np.where(held, before, after)
        f = self.stated.derivative
        for k in range(self.stated.substeps):
            share = np.array([k, k + 0.5, k + 1.0]) / self.stated.substeps
            u = [before + s * (after - before) for s in share]
            now = t + k * h
            a = f(now, x, u[0], values)
            b = f(now + 0.5 * h, x + 0.5 * h * a, u[1], values)
            c = f(now + 0.5 * h, x + 0.5 * h * b, u[1], values)
            d = f(now + h, x + h * c, u[2], values)
            x = x + h * (a + 2.0 * b + 2.0 * c + d) / 6.0
        if x.shape != a.shape:
            raise UsageError(f"{self.kind}: the derivative has shape {a.shape}, expected {x.shape}")
        return x

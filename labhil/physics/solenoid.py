"""White-box model of a solenoid: measured coil current in, plunger position out.

m·ẍ = F(i, x) − k·x − k₃·x³ + F₀ − friction between two stops, with moving mass m (kg), position x (m),
current i (A), magnetic force F (N), stiffness k (N/m), hardening k₃ (N/m³) and constant force F₀ (N).
Equations 4.10 and 4.11 of the reference text, where F is a third-order polynomial in current and position.
The text gives no coefficients: the default map is our own (0 N without current, about 70 N at 2.7 A), and
[known] force_map replaces it by a table (``physics.force_map``). Eddy currents and hysteresis act between
current and force.

Since the measured current is the input, effects of the amplifier on the command (lag, backlash, dead zone,
limits) cannot be seen in a recording: a lag behind the measured current belongs to the field, a backlash to
the iron. The terms ``AMPLIFIER_TERMS`` are therefore left out.
"""

from __future__ import annotations

import copy
from collections.abc import Mapping

import numpy as np

from labhil.physics import input_path, sliding
from labhil.physics.driven import InputPath
from labhil.physics.extra_force import ExtraForce, MovedPart
from labhil.physics.force_map import read_force_map
from labhil.physics.friction_terms import friction_terms, load_dependent_friction
from labhil.physics.guesses import states_from_line_fit
from labhil.physics.measured_input import without_noise
from labhil.physics.model import Metric
from labhil.physics.path_terms import input_terms, offset_term, output_terms
from labhil.physics.record import Record, Windows
from labhil.physics.terms import CharacteristicScale, Enters, Parameter, Term
from labhil.physics.values import Values, horizon_of, known_numbers, limit_horizon
from labhil.rig import RigFile
from labhil.signals import FloatArray

DEFAULT_STROKE = 5e-3
"""Stroke of the default force map, m."""

DEFAULT_FORCE_MAP = {(1, 0): 8.0, (1, 1): 2.0, (1, 2): -3.0, (2, 0): 12.0, (2, 1): 1.5, (3, 0): -2.0}
"""Default magnetic force: coefficient of i^a·(x/5 mm)^b by (a, b), N, with i in A."""

HORIZON_PERIODS = 5.0
HORIZON_DECAY_TIMES = 3.0
"""Scored horizon: the larger of so many periods of mass and spring, and decay times 1/(ζω)."""

INITIAL_STATE_SPAN = 2e-3
"""Span of the line fit that gives the initial state of a window, s."""

TYPICAL_MASS, TYPICAL_STIFFNESS = 0.05, 5000.0
"""Sizes where nothing is known, kg and N/m."""

AMPLIFIER_TERMS = ("actuator_lag", "backlash", "dead_zone", "rate_limit", "saturation")
"""Input terms whose effect lies before the measured current."""

MAGNETISATION_PARAMETERS = ("residual_magnetism.current", "magnetic_saturation.coefficient")


def default_map() -> FloatArray:
    """Coefficients C[a, b] of i^a·x^b of the default force, (4, 4), in N, A and m."""
    table = np.zeros((sliding.N_POWERS, sliding.N_POWERS))
    for (a, b), factor in DEFAULT_FORCE_MAP.items():
        table[a, b] = factor / DEFAULT_STROKE**b
    return table


def oscillation_horizon(stiffness: float, mass: float) -> float:
    """``HORIZON_PERIODS`` periods 2π·√(m/k) of a mass on a spring, s; 0 without a spring."""
    return HORIZON_PERIODS * 2.0 * float(np.pi * np.sqrt(mass / stiffness)) if stiffness > 0.0 else 0.0


def catalogue(level: float, speed: float) -> dict[str, Term]:
    """Terms of a solenoid, by key; ``level`` (N) and ``speed`` (m/s) are a typical friction and speed."""
    constant = Term(
        "constant_force", Enters.FORCE, "a constant push (tilt, pressure)", "F = F_0", "standard",
        "motion both ways; a spring's preload looks the same away from the stops",
        (Parameter("constant_force.force", "N", level),),
    )  # fmt: skip
    input_path_terms = tuple(term for term in input_terms("A") if term.key not in AMPLIFIER_TERMS)
    terms = friction_terms("N", "m", level, speed) + _mechanical_terms(level)
    terms += _magnetic_terms() + input_path_terms
    terms += (constant, load_dependent_friction("the magnet's force (its side pull)"))
    terms += (
        *output_terms("plunger_position", "m", DEFAULT_STROKE),
        offset_term("plunger_position", "m", 1e-4),
    )
    return {term.key: term for term in terms}


def _mechanical_terms(level: float) -> tuple[Term, ...]:
    """Effects of the spring and the stops."""
    return (
        Term(
            "spring_preload",
            Enters.FORCE,
            "a spring that pushes already at rest",
            "F = −F_0",
            "standard",
            "lift-off from the rest stop",
            (Parameter("spring_preload.force", "N", level),),
        ),
        Term(
            "spring_hardening",
            Enters.FORCE,
            "a spring that stiffens along the stroke",
            "F = −k₃·x³",
            "Duffing",
            "motion over the whole stroke",
            (Parameter("spring_hardening.coefficient", "N/m³", level / DEFAULT_STROKE**3),),
        ),
        Term(
            "end_stop_contact",
            Enters.FORCE,
            "a plunger that bounces at its stops",
            "v⁺ = −e·v⁻",
            "Newton's impact law",
            "meeting a stop at speed",
            (Parameter("end_stop_contact.restitution", "1", 0.2, 0.0, 0.95, starts=(0.3,)),),
        ),
    )


def _magnetic_terms() -> tuple[Term, ...]:
    """Effects between current and magnetic force."""
    return (
        Term(
            "eddy_current", Enters.MAGNETIC, "a field that lags behind the current (eddy currents)",
            "τ·i̇_eff + i_eff = i", "diffusion of the field, first mode", "fast changes of the current",
            (Parameter("eddy_current.time_constant", "s", 0.002, 0.0, 0.1, starts=(0.002,)),),
        ),
        Term(
            "magnetic_hysteresis", Enters.MAGNETIC, "a field that remembers where the current turned",
            "i_eff = play operator of width w on i", "play hysteron", "turning points at different currents",
            (
                Parameter(
                    "magnetic_hysteresis.width", "A", 0.1, 0.0, starts=(0.05,), of=CharacteristicScale.INPUT
                ),
            ),
        ),
        Term(
            "magnetic_saturation", Enters.MAGNETIC, "iron that saturates at large currents",
            "i_eff = i/(1 + s·|i|)", "first-order knee", "large and small currents",
            (Parameter("magnetic_saturation.coefficient", "1/A", 0.05, -0.2, 2.0, starts=(0.05,)),),
        ),
        Term(
            "residual_magnetism", Enters.MAGNETIC, "a field that stays without current", "i_eff = i + i_0",
            "remanence", "small currents",
            (Parameter("residual_magnetism.current", "A", 0.1, -1.0, 1.0),),
        ),
    )  # fmt: skip


class SolenoidModel:
    """White-box model of one solenoid (implements ``physics.model.Model``).

    The input is the measured ``coil_current``, the output is ``plunger_position``. Moving mass and spring
    stiffness are estimated unless the rig file states them; stops that it does not state are taken from the
    range of the recording.

    Args:
        rig: The rig file.
        record: The recording that typical sizes are taken from; None for default sizes.
    """

    kind = "solenoid"
    coordinate_units: Mapping[str, str] = {
        "plunger_position": "m",
        "plunger_velocity": "m/s",
        "coil_current": "A",
        "coil_current_rate": "A/s",
    }
    releases_interpreter = True
    metric = Metric.WINDOWED_SIMULATION
    fading_memory = True
    state_names = ("plunger_position", "plunger_velocity")
    force_unit = "N"
    moved = (MovedPart("plunger_position", "plunger_velocity"),)
    _extra: ExtraForce | None = None
    unobservable_terms: Mapping[str, str] = {
        "motional_emf": "the current is measured: a voltage that the motion induces changes nothing else",
        **dict.fromkeys(
            AMPLIFIER_TERMS, "the current is measured: what the amplifier does to it comes before"
        ),
    }

    def __init__(self, rig: RigFile, record: Record | None = None) -> None:
        known = known_numbers(rig)
        x = record.outputs[:, 0] if record is not None else np.array([0.0, DEFAULT_STROKE])
        self.low = known.pop("stop_low", min(0.0, float(np.quantile(x, 0.001))))
        self.high = known.pop("stop_high", max(DEFAULT_STROKE, float(x.max())))
        self.fixed = known
        table = rig.known_file("force_map")
        self.map = default_map()
        self.table = None if table is None else read_force_map(table)
        self.notes = self._notes(record)
        middle = 0.5 * (self.low + self.high)
        self.force = sliding.drive_force(self._strongest(record), middle, self._magnet(1.0))
        self.speed = self._speed(record)
        self.terms: Mapping[str, Term] = catalogue(0.05 * abs(self.force), self.speed)
        typical_sizes = {"moving_mass": ("kg", TYPICAL_MASS), "spring_stiffness": ("N/m", self._stiffness())}
        self.parameters = tuple(
            Parameter(n, unit, size, 1e-2 * size, 1e2 * size, starts=(size,))
            for n, (unit, size) in typical_sizes.items()
            if n not in self.fixed
        ) + tuple(p for term in self.terms.values() for p in term.parameters)
        self.state_scale = np.array([0.02 * (self.high - self.low), 0.2 * self.speed])
        self._values = Values(self.fixed, self.parameters)
        self._stated = rig.metric.horizon
        typical = max(
            oscillation_horizon(self.fixed.get("spring_stiffness", TYPICAL_STIFFNESS), TYPICAL_MASS), 0.1
        )
        self.horizon = horizon_of(self._stated, typical, record)
        self._path = InputPath()

    def with_force(self, force: ExtraForce) -> SolenoidModel:
        """Copy of the solenoid with an additional force on the plunger, N."""
        other = copy.copy(self)
        other._extra = force
        return other

    def _magnet(self, mass: float) -> sliding.Drive:
        """Magnetic force over the moving mass, in the form that kernels take."""
        return sliding.table_from_array(self.map / mass) if self.table is None else self.table.over(mass)

    def _notes(self, record: Record | None) -> list[str]:
        """Notes for the user on a given force map."""
        if self.table is None or record is None:
            return []
        return self.table.notes(record.inputs[:, 0], record.outputs[:, 0])

    @staticmethod
    def _strongest(record: Record | None) -> float:
        """Largest current but for 1 % of the samples, A."""
        return 2.0 if record is None else float(np.quantile(np.abs(record.inputs[:, 0]), 0.99)) or 1.0

    @staticmethod
    def _speed(record: Record | None) -> float:
        """RMS velocity of the plunger, m/s."""
        if record is None:
            return 0.05
        speeds = []
        for recording in record.recordings():
            stride = max(1, int(0.005 / recording.period))
            speeds.append(np.diff(recording.outputs[::stride, 0]) / np.diff(recording.t[::stride]))
        return float(np.sqrt(np.mean(np.concatenate(speeds) ** 2))) or 0.05

    def _stiffness(self) -> float:
        """Typical stiffness: a quarter of the largest force over half of the stroke, N/m."""
        return max(abs(self.force) / (0.5 * (self.high - self.low)) * 0.25, 1.0)

    def horizon_at(self, theta: FloatArray) -> float:
        """Scored horizon: the larger of 3/(ζω) and 5 periods of mass and spring, s.

        ζω = c/2m holds without a spring too; with neither spring nor damping it is the typical horizon.
        """
        if self._stated:
            return self._stated
        mass, k = self._values.of(theta, "moving_mass"), self._values.of(theta, "spring_stiffness")
        damping = 0.5 * self._values.of(theta, "viscous_friction.coefficient") / mass
        longest = max(oscillation_horizon(k, mass), HORIZON_DECAY_TIMES / damping if damping > 0.0 else 0.0)
        return limit_horizon(longest or self.horizon, self.horizon)

    def prepare(self, record: Record) -> Record:
        """Smooth the input if it is a sensor reading with white noise."""
        return without_noise(record)

    def initial_states(self, record: Record, windows: Windows) -> FloatArray:
        """Position and velocity of a straight line through the first samples of each window, (w, 2)."""
        return states_from_line_fit(record, windows, INITIAL_STATE_SPAN)

    def simulate(self, theta: FloatArray, record: Record, windows: Windows, states: FloatArray) -> FloatArray:
        """Simulate the measured position, (N, 1), m."""
        x = self._trajectory(theta, record, windows, states)[:, 0]
        return self._values.apply_sensor(theta, record, windows, x)[:, None]

    def coordinates(
        self, theta: FloatArray, record: Record, windows: Windows, states: FloatArray
    ) -> Mapping[str, FloatArray]:
        """Position, velocity, current and its rate along the simulation, each (N,)."""
        motion = self._trajectory(theta, record, windows, states)
        i = record.inputs[:, 0]
        along = {
            "plunger_position": motion[:, 0],
            "plunger_velocity": motion[:, 1],
            "coil_current": i[windows.rows],
            "coil_current_rate": np.gradient(i, record.t)[windows.rows],
        }
        return {**along, **self.drive_coordinates(theta, record, windows, along)}

    def drive_coordinates(
        self, theta: FloatArray, record: Record, windows: Windows, along: Mapping[str, FloatArray]
    ) -> Mapping[str, FloatArray]:
        """Effective current that gives the magnetic force (A), and bend of the bristles, each (N,)."""
        nodes, current = self._field(theta, record)
        return {
            "field_current": np.interp(record.t[windows.rows], nodes, current),
            "bend": self._values.bends(theta, windows, along["plunger_position"], along["plunger_velocity"]),
        }

    def generalised_force(self, theta: FloatArray, coordinates: Mapping[str, FloatArray]) -> FloatArray:
        """Force on the plunger at these coordinates, (N,), N; zero where it is at rest."""
        x, v, i = (coordinates[n] for n in ("plunger_position", "plunger_velocity", "field_current"))
        mass = self._values.of(theta, "moving_mass")
        part, law = self._part(theta), self._values.friction_law(theta, mass)
        bend = coordinates["bend"]
        force = sliding.accelerations(i, x, v, bend, self._magnet(mass), part, law) * mass
        return np.asarray(force - self._values.added_drag(theta, v))

    def characteristic_scales(self, record: Record) -> Mapping[CharacteristicScale, float]:
        """Characteristic scales of this recording."""
        i = record.inputs[:, 0]
        return {
            CharacteristicScale.UNIT: 1.0,
            CharacteristicScale.INPUT: float(np.abs(i).max()) or 1.0,
            CharacteristicScale.INPUT_RATE: float(np.quantile(np.abs(np.gradient(i, record.t)), 0.98)) or 1.0,
            CharacteristicScale.DRIVE: 0.2 * abs(self.force),
            CharacteristicScale.SPEED: self.speed,
        }

    def _part(self, theta: FloatArray) -> sliding.Part:
        mass = self._values.of(theta, "moving_mass")
        preload = self._values.of(theta, "spring_preload.force")
        return sliding.Part(
            force=(self._values.of(theta, "constant_force.force") - preload) / mass,
            spring=self._values.of(theta, "spring_stiffness") / mass,
            hardening=self._values.of(theta, "spring_hardening.coefficient") / mass,
            cogging_sine=0.0,
            cogging_cosine=0.0,
            cogging_order=0.0,
            low=self.low,
            high=self.high,
            restitution=self._values.of(theta, "end_stop_contact.restitution"),
        )

    def _field(self, theta: FloatArray, record: Record) -> input_path.Nodes:
        """Nodes of the effective current behind hysteresis, eddy currents, remanence and saturation."""
        t, i = self._path.nodes(record, 0, lambda name: self._values.of(theta, name))
        if width := self._values.of(theta, "magnetic_hysteresis.width"):
            t, i = input_path.backlash(t, i, width)
        if time_constant := self._values.of(theta, "eddy_current.time_constant"):
            t, i = input_path.lag_in_lines(t, i, time_constant, 1)
        residual, knee = (self._values.of(theta, name) for name in MAGNETISATION_PARAMETERS)
        i = i + residual if residual else i
        return t, i / (1.0 + knee * np.abs(i)) if knee else i

    def _trajectory(
        self, theta: FloatArray, record: Record, windows: Windows, states: FloatArray
    ) -> FloatArray:
        """Position and velocity of all windows, (N, 2)."""
        nodes, current = self._field(theta, record)
        mass = self._values.of(theta, "moving_mass")
        out = np.empty((len(windows.rows), 3))
        given = (
            record.t, nodes, current, windows.first, windows.last, states, self._magnet(mass),
            self._part(theta), self._values.friction_law(theta, mass), np.ones(len(record)),
        )  # fmt: skip
        additional = self._values.additional_force(theta, mass, self._extra, record)
        if additional is None:
            sliding.simulate(*given, out)
        else:
            sliding.simulate_with_force(*given, *additional, out)
        return out[:, :2]

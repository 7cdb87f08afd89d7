"""White-box model of a ball on a beam: servo or beam angle in, ball position out.

(M + J/R²)·ẍ + (J/R)·β̈ = M·g·sin β + M·x·β̇² − friction + forces, with ball position x (m), mass M (kg),
radius R (m), inertia J = (2/5)·M·R² of a solid ball (kg·m²), gravity g (m/s²) and beam angle β (rad), sin β =
(crank_radius/beam_length)·sin γ for a servo angle γ (rad). Equations 4.13 to 4.18 of the reference text. The
kernel is ``physics.rolling``.
"""

from __future__ import annotations

import copy
from collections.abc import Iterator, Mapping

import numpy as np

from labhil.physics import input_path, rolling
from labhil.physics.driven import InputPath, lag_without_jumps
from labhil.physics.extra_force import ExtraForce, MovedPart
from labhil.physics.friction_terms import friction_terms
from labhil.physics.guesses import states_from_line_fit
from labhil.physics.measured_input import without_noise
from labhil.physics.model import Metric, start_values
from labhil.physics.path_terms import input_terms, offset_term, output_terms
from labhil.physics.record import Record, Windows
from labhil.physics.terms import CharacteristicScale, Enters, Parameter, Term
from labhil.physics.values import Values, known_numbers
from labhil.rig import RigFile
from labhil.signals import FloatArray

GRAVITY = 9.81
"""m/s²."""

SOLID_BALL_INERTIA = 0.4
"""J/(M·R²) of a solid ball."""

SOLID_BALL_ACCELERATION = GRAVITY / (1.0 + SOLID_BALL_INERTIA)
"""Acceleration of a solid ball per sine of the slope, m/s²."""

DEFAULT_HORIZON = 4.0
"""Scored horizon where the rig file states none, s."""

TYPICAL_SPEED = 0.2
TYPICAL_SPAN = 0.2
"""Typical speed of the ball, m/s, and range of its position, m."""

INITIAL_STATE_SPAN = 0.15
"""Span of the line fit that gives the initial state of a window, s."""

LINKAGE = ("crank_radius", "beam_length")

RIG_PARAMETERS = {
    "ball_mass": Parameter("ball_mass", "kg", 0.1, 1e-3, 10.0, starts=(0.2,)),
    "ball_radius": Parameter("ball_radius", "m", 0.01, 1e-3, 0.1, starts=(0.02,)),
    "crank_radius": Parameter("crank_radius", "m", 0.05, 1e-3, 1.0, starts=(0.05,)),
    "beam_length": Parameter("beam_length", "m", 0.2, 1e-2, 3.0, starts=(0.4,)),
    "linkage_ratio": Parameter("linkage_ratio", "1", 0.2, 1e-3, 1.0, starts=(0.2,)),
    "acceleration_per_radian": Parameter(
        "acceleration_per_radian", "m/s²", 5.0, 1e-3, 50.0, starts=(SOLID_BALL_ACCELERATION,)
    ),
}
PER_SERVO_RADIAN = Parameter(
    "acceleration_per_radian",
    "m/s²",
    1.0,
    1e-3,
    SOLID_BALL_ACCELERATION,
    starts=(0.2 * SOLID_BALL_ACCELERATION,),
)
"""With a linkage of unknown ratio: the beam turns at most as far as the servo, and often a fifth of that."""


def catalogue(per_unit_mass: bool) -> dict[str, Term]:
    """Terms of a ball and beam, by name; with ``per_unit_mass`` forces are in m/s² instead of N."""
    force, level = ("m/s²", 0.3) if per_unit_mass else ("N", 0.1)
    loads = (
        Term(
            "constant_force",
            Enters.FORCE,
            "a constant push along the beam (a tilted base, an angle offset)",
            "F = F_0",
            "standard",
            "rest and motion both ways",
            (Parameter("constant_force.force", force, level),),
        ),
        Term(
            "spring_force",
            Enters.FORCE,
            "a pull back towards the pivot in proportion to position (a cable)",
            "F = −k·x",
            "Hooke",
            "motion over the whole range",
            (Parameter("spring_force.stiffness", f"{force}/m", level / TYPICAL_SPAN),),
        ),
        Term(
            "spring_hardening",
            Enters.FORCE,
            "a pull back towards the pivot that stiffens with position",
            "F = −k₃·x³",
            "Duffing",
            "motion over the whole range",
            (Parameter("spring_hardening.coefficient", f"{force}/m³", level / TYPICAL_SPAN**3),),
        ),
    )
    inertia = Term(
        "added_inertia",
        Enters.FORCE,
        "more (or less) inertia than a solid ball of the known mass (a groove, a hollow ball)",
        "(M + J/R² + m_a)·ẍ = …",
        "rolling radius of a grooved beam",
        "fast motion with friction known",
        (Parameter("added_inertia.mass", "kg", 0.05, -0.2),),
    )
    terms = friction_terms(force, "m", level, TYPICAL_SPEED) + loads + input_terms("rad")
    offset = offset_term(
        "ball_position",
        "m",
        1e-3,
        "fast rotation of the beam: the centrifugal force depends on the distance from the pivot",
    )
    terms += (*output_terms("ball_position", "m", TYPICAL_SPAN), offset) + (
        () if per_unit_mass else (inertia,)
    )
    return {term.name: term for term in terms}


class BallBeamModel:
    """White-box model of one ball-and-beam rig (implements ``physics.model.Model``).

    The input is ``servo_angle`` or ``beam_angle``, the output is ``ball_position``. Parameters that the rig
    file does not state are estimated; without ``ball_mass`` all forces are per unit of mass.

    Args:
        rig: The rig file.
        record: The recording, which decides on the input; None for the servo angle.
    """

    kind = "ball_beam"
    coordinate_units: Mapping[str, str] = {
        "ball_position": "m",
        "ball_velocity": "m/s",
        "servo_angle": "rad",
        "beam_angle": "rad",
        "servo_angle_rate": "rad/s",
        "beam_angle_rate": "rad/s",
    }
    state_names = ("ball_position", "ball_velocity")
    moved = (MovedPart("ball_position", "ball_velocity"),)
    _extra: ExtraForce | None = None
    state_scale = np.array([0.01, 0.05])
    releases_interpreter = True
    metric = Metric.WINDOWED_SIMULATION
    fading_memory = False
    unobservable_terms: Mapping[str, str] = {}

    def __init__(self, rig: RigFile, record: Record | None = None) -> None:
        self.linkage = record is None or record.input_names[0] == "servo_angle"
        self.per_unit_mass = rig.known_number("ball_mass") is None
        self.terms: Mapping[str, Term] = catalogue(self.per_unit_mass)
        self.horizon = rig.metric.horizon or DEFAULT_HORIZON
        self.fixed = known_numbers(rig)
        of_terms = (p for term in self.terms.values() for p in term.parameters)
        self.parameters: tuple[Parameter, ...] = (*self._estimated(), *of_terms)
        self._values = Values(self.fixed, self.parameters)
        self._input_path = InputPath(lag=lag_without_jumps)

    @property
    def force_unit(self) -> str:
        """Unit of forces: N, or m/s² per unit of mass."""
        return "m/s²" if self.per_unit_mass else "N"

    def with_force(self, force: ExtraForce) -> BallBeamModel:
        """Copy of the ball with an additional force along the beam."""
        other = copy.copy(self)
        other._extra = force
        return other

    @property
    def _linkage_unknown(self) -> bool:
        """Whether a servo turns the beam by a linkage of which the rig file says nothing."""
        return self.linkage and not any(name in self.fixed for name in LINKAGE)

    @property
    def _gain_per_servo_radian(self) -> bool:
        """Whether the gain holds mass and linkage: of neither the rig file says anything."""
        return self.per_unit_mass and self._linkage_unknown

    def _estimated(self) -> Iterator[Parameter]:
        """The rig's own parameters that its file does not state.

        Without a linkage an unknown radius counts as zero: where the beam's own angle is recorded, often
        slowly, the coupling of its turning to the ball's is not determined, and an undetermined parameter
        would widen all other intervals.
        """
        if self.linkage and "ball_radius" not in self.fixed:
            yield RIG_PARAMETERS["ball_radius"]
        if self._gain_per_servo_radian:
            yield PER_SERVO_RADIAN
            return
        if self.per_unit_mass:
            yield RIG_PARAMETERS["acceleration_per_radian"]
        if self._linkage_unknown:
            yield RIG_PARAMETERS["linkage_ratio"]
        elif self.linkage:
            yield from (RIG_PARAMETERS[name] for name in LINKAGE if name not in self.fixed)

    def horizon_at(self, theta: FloatArray) -> float:
        """Scored horizon, s; it does not depend on ``theta``."""
        return self.horizon

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
        """Ball position and velocity, and the input with its rate, along the simulation, each (N,)."""
        motion = self._trajectory(theta, record, windows, states)
        u = record.inputs[:, 0]
        along = {
            "ball_position": motion[:, 0],
            "ball_velocity": motion[:, 1],
            record.input_names[0]: u[windows.rows],
            f"{record.input_names[0]}_rate": np.gradient(u, record.t)[windows.rows],
        }
        return {**along, **self.drive_coordinates(theta, record, windows, along)}

    def drive_coordinates(
        self, theta: FloatArray, record: Record, windows: Windows, along: Mapping[str, FloatArray]
    ) -> Mapping[str, FloatArray]:
        """Sine and rate (rad/s) of the beam behind the input path, and bend of the bristles, each (N,)."""
        nodes, angle = self._effective_angle(theta, record)
        sine = self._ratio(theta) * np.sin(np.interp(record.t, nodes, angle))
        rate = np.gradient(np.arcsin(np.clip(sine, -1.0, 1.0)), record.t)
        return {
            "beam_sine": sine[windows.rows],
            "beam_rate": rate[windows.rows],
            "bend": self._values.bends(theta, windows, along["ball_position"], along["ball_velocity"]),
        }

    def generalised_force(self, theta: FloatArray, coordinates: Mapping[str, FloatArray]) -> FloatArray:
        """Acceleration of the ball times its effective mass, (N,), N (m/s² per unit of mass)."""
        k = self._kernel(theta)
        x, v = coordinates["ball_position"], coordinates["ball_velocity"]
        sine, rate, bend = (coordinates[name] for name in ("beam_sine", "beam_rate", "bend"))
        a = rolling.accelerations(x, v, bend, sine, rate, k)
        return np.asarray(a * self._effective_mass(theta) - self._values.added_drag(theta, v))

    def characteristic_scales(self, record: Record) -> Mapping[CharacteristicScale, float]:
        """Characteristic scales of this recording."""
        u, t = record.inputs[:, 0], record.t
        largest = float(np.abs(u).max()) or 1.0
        speed = np.diff(record.outputs[:: self._stride(record), 0]) / np.diff(t[:: self._stride(record)])
        ratio = self._ratio(start_values(self.parameters)) if self.linkage else 1.0
        return {
            CharacteristicScale.UNIT: 1.0,
            CharacteristicScale.INPUT: largest,
            CharacteristicScale.INPUT_RATE: float(np.quantile(np.abs(np.gradient(u, t)), 0.98)) or 1.0,
            CharacteristicScale.DRIVE: GRAVITY
            * self.fixed.get("ball_mass", 0.5)
            * ratio
            * np.sin(min(largest, 1.5)),
            CharacteristicScale.SPEED: float(np.sqrt(np.mean(speed**2))) or TYPICAL_SPEED,
        }

    @staticmethod
    def _stride(record: Record) -> int:
        return max(1, int(0.1 / record.period))

    def _effective_mass(self, theta: FloatArray) -> float:
        """M + J/R² + added inertia, kg; 1 per unit of mass."""
        if self.per_unit_mass:
            return 1.0
        return (1.0 + SOLID_BALL_INERTIA) * self.fixed["ball_mass"] + self._values.of(
            theta, "added_inertia.mass"
        )

    def _kernel(self, theta: FloatArray) -> FloatArray:
        """Coefficients over the effective mass, (17,), in the order of ``physics.rolling``."""
        m_eff = self._effective_mass(theta)
        if self._gain_per_servo_radian:
            share = SOLID_BALL_ACCELERATION / GRAVITY
        elif self.per_unit_mass:
            share = self._values.of(theta, "acceleration_per_radian") / GRAVITY
        else:
            share = self.fixed["ball_mass"] / m_eff
        gain = share * GRAVITY
        k = np.zeros(rolling.SIZE)
        k[rolling.GRAVITY], k[rolling.CENTRIFUGAL] = gain, share
        if "ball_radius" in self._values:
            k[rolling.ROLLING] = SOLID_BALL_INERTIA * self._values.of(theta, "ball_radius") * share
        for place, name in KERNEL_PLACES.items():
            k[place] = self._values.of(theta, name) / m_eff
        k[rolling.STRIBECK_VELOCITY] = self._values.of(theta, "stribeck_friction.velocity")
        if k[list(rolling.DRY)].any():
            k[rolling.PRESLIDING_LENGTH] = self._values.of(theta, "presliding_friction.length")
            k[rolling.BRISTLE_TIME] = self._values.of(theta, "presliding_friction.time_constant")
        return k

    def _trajectory(
        self, theta: FloatArray, record: Record, windows: Windows, states: FloatArray
    ) -> FloatArray:
        """Position and velocity of all windows, (N, 2)."""
        nodes, angle = self._effective_angle(theta, record)
        out = np.empty((len(windows.rows), 2))
        k = self._kernel(theta)
        additional = self._values.additional_force(theta, self._effective_mass(theta), self._extra, record)
        if additional is not None:
            k = rolling.with_force(k, *additional)
        rolling.simulate(
            record.t, nodes, angle, self._ratio(theta), windows.first, windows.last, states, k, out
        )
        return out

    def _effective_angle(self, theta: FloatArray, record: Record) -> input_path.Nodes:
        """Nodes of the input angle behind the effects of the input path."""
        return self._input_path.nodes(record, 0, lambda name: self._values.of(theta, name))

    def _ratio(self, theta: FloatArray) -> float:
        """Sine of the beam's angle per sine of the input angle.

        A linkage of which nothing is known has the ratio that gives a solid ball its acceleration: the beam
        turns less than the servo, and sine and centrifugal force are those of the beam.
        """
        if self._gain_per_servo_radian:
            return self._values.of(theta, "acceleration_per_radian") / SOLID_BALL_ACCELERATION
        if not self.linkage:
            return 1.0
        if self._linkage_unknown:
            return self._values.of(theta, "linkage_ratio")
        return self._values.of(theta, "crank_radius") / self._values.of(theta, "beam_length")


KERNEL_PLACES = {
    rolling.VISCOUS: "viscous_friction.coefficient",
    rolling.COULOMB: "coulomb_friction.level",
    rolling.STATIC: "static_friction.level",
    rolling.STRIBECK: "stribeck_friction.level",
    rolling.QUADRATIC: "quadratic_viscous_friction.coefficient",
    rolling.CUBIC: "cubic_viscous_friction.coefficient",
    rolling.ASYMMETRIC_VISCOUS: "friction_asymmetry.coefficient",
    rolling.DRY_SLOPE: "position_dependent_friction.slope",
    rolling.CONSTANT: "constant_force.force",
    rolling.SPRING: "spring_force.stiffness",
    rolling.HARDENING: "spring_hardening.coefficient",
}

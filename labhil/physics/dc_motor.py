"""The DC motor as it is fitted: rig parameters, terms, and their way into the winding kernel.

Equations 4.1 to 4.9 of the reference text. From voltage and speed alone resistance and inductance times a,
inertia and torques divided by a, change nothing; the model does not hide that, the statistics tell it.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from labhil.physics import winding
from labhil.physics.driven import DrivenPath
from labhil.physics.friction_terms import friction_terms
from labhil.physics.model import Metric, Record, Windows
from labhil.physics.path_terms import input_terms, output_terms
from labhil.physics.terms import Enters, Parameter, Term, Yardstick
from labhil.physics.values import Values, known_numbers, near
from labhil.rig import RigFile
from labhil.signals import FloatArray

COPPER = 0.0039
"""Relative rise of copper's resistance per kelvin."""

TIME_CONSTANTS = 3.0
"""Scored horizon in mechanical time constants."""

TYPICAL_SPEED = 3.0
TYPICAL_VOLTAGE = 5.0
TYPICAL_TIME_CONSTANT = 1.0
BRUSH_WIDTH = 0.01
"""Share of the largest current over which the brushes' drop changes its sign."""


class Sizes:
    """What a recording says of the motor's size before anything is fitted (SI).

    A first-order regression ω̇ = (g·U − ω)/τ − d·sgn ω gives gain and time constant; back-EMF and
    resistance follow with the current, or with a typical one.
    """

    def __init__(self, record: Record | None) -> None:
        self.voltage, self.speed = TYPICAL_VOLTAGE, TYPICAL_SPEED
        self.gain, self.time_constant, self.current = 1.0, TYPICAL_TIME_CONSTANT, 1.0
        if record is None:
            return
        u = record.inputs[:, 0]
        self.voltage = float(np.sqrt(np.mean(u**2))) or TYPICAL_VOLTAGE
        if "current" in record.output_names:
            i = record.outputs[:, record.output_names.index("current")]
            self.current = float(np.sqrt(np.mean(i**2))) or 1.0
        if "speed" in record.output_names:
            w = record.outputs[:, record.output_names.index("speed")]
            self.speed = float(np.sqrt(np.mean(w**2))) or TYPICAL_SPEED
            self._first_order(record.t, u, w)

    def _first_order(self, t: FloatArray, u: FloatArray, w: FloatArray) -> None:
        """Changes of ω over short blocks in motion, regressed on the integrals of U, ω and sgn ω."""
        edges = np.arange(0, len(t), max(4, len(t) // 600))
        h = np.r_[0.0, np.diff(t)]
        slow = 0.05 * float(np.abs(w).max())
        moving = np.minimum.reduceat(np.abs(w), edges)[:-1] > slow
        if np.count_nonzero(moving) < 12:
            self.gain = self.speed / self.voltage
            return
        integrals = [np.add.reduceat(h * x, edges)[:-1][moving] for x in (u, w, np.sign(w))]
        design = np.column_stack(integrals)
        by_voltage, by_speed, _ = np.linalg.lstsq(design, np.diff(w[edges])[moving], rcond=None)[0]
        if by_speed < 0.0 < by_voltage:
            self.time_constant = float(np.clip(-1.0 / by_speed, 1e-3, 100.0))
            self.gain = float(-by_voltage / by_speed)
        else:
            self.gain = self.speed / self.voltage

    @property
    def constant(self) -> float:
        """Torque constant if half of the voltage went into back-EMF, N·m/A."""
        return 0.5 / max(self.gain, 1e-9)

    @property
    def resistance(self) -> float:
        """Resistance if the other half drove the current, Ω."""
        return 0.5 * self.voltage / self.current

    @property
    def inertia(self) -> float:
        """Inertia that has the time constant with half of the damping from the winding, kg·m²."""
        return 2.0 * self.time_constant * self.constant**2 / self.resistance

    @property
    def torque(self) -> float:
        """Torque at the typical current, N·m."""
        return self.constant * self.current


def own_parameters(s: Sizes) -> dict[str, Parameter]:
    """The motor's own parameters with starts and scales of its size."""
    typical = {
        "inertia": ("kg·m²", s.inertia),
        "torque_constant": ("N·m/A", s.constant),
        "inductance": ("H", 0.05 * s.time_constant * s.resistance),
        "resistance": ("Ω", s.resistance),
    }
    return {
        name: Parameter(
            name, unit, size, 1e-4 * size, (30.0 if name == "inductance" else 1e3) * size, (size,)
        )
        for name, (unit, size) in typical.items()
    }


def catalogue(s: Sizes) -> dict[str, Term]:
    """All terms, their scales of the motor's size."""
    level = 0.1 * s.torque
    loads = (
        Term(
            "constant_force",
            Enters.FORCE,
            "a constant load torque",
            "T = T_0",
            "standard",
            "motion both ways",
            (Parameter("constant_force.force", "N·m", level),),
        ),
        Term(
            "cogging_torque",
            Enters.FORCE,
            "a torque that repeats with the angle (cogging of the magnets)",
            "T = a·sin kθ + b·cos kθ",
            "slots per turn",
            "slow turning",
            (
                Parameter("cogging_torque.sine", "N·m", level, starts=(0.05 * s.torque,)),
                Parameter("cogging_torque.cosine", "N·m", level, starts=(0.05 * s.torque,)),
                Parameter("cogging_torque.order", "1", 12.0, 1.0, 400.0, starts=(12.0,), shape=True),
            ),
            needs=("angle",),
        ),
        Term(
            "spring_force",
            Enters.FORCE,
            "a torque back to the angle zero",
            "T = k·θ",
            "Hooke",
            "motion over the whole range",
            (Parameter("spring_force.stiffness", "N·m/rad", level),),
            needs=("angle",),
        ),
        Term(
            "temperature_dependent_friction",
            Enters.FORCE,
            "viscous friction that falls as the motor warms",
            "c(T) = c·exp(−α·(T − T_0)), T_0 the first sample's",
            "viscosity of grease",
            "long runs that warm the motor",
            (Parameter("temperature_dependent_friction.rate", "1/K", 0.02, -0.2, 0.2),),
            needs=("winding_temperature",),
        ),
    )
    electrical = (
        Term(
            "brush_drop",
            Enters.ELECTRICAL,
            "a voltage that the brushes take, whatever the current",
            "U_b = V_b·sgn i",
            "standard",
            "small currents both ways; needs the current to be told from dry friction",
            (Parameter("brush_drop.voltage", "V", 0.1 * s.voltage, 0.0, starts=(0.05 * s.voltage,)),),
        ),
        Term(
            "supply_sag",
            Enters.ELECTRICAL,
            "a supply that gives way under load",
            "U_eff = U·(1 − s·|U|)",
            "inner resistance of the supply, to first order",
            "large and small voltages",
            (Parameter("supply_sag.coefficient", "1/V", 0.1 / s.voltage, 0.0, 0.5 / s.voltage),),
        ),
        Term(
            "thermal_resistance",
            Enters.ELECTRICAL,
            "a winding whose resistance rises with its temperature",
            "R(T) = R·(1 + α·(T − T_0)), T_0 the first sample's; copper: 0.0039/K",
            "copper",
            "long runs with large currents",
            (Parameter("thermal_resistance.coefficient", "1/K", COPPER, 0.0, 0.05, starts=(COPPER,)),),
            needs=("winding_temperature",),
        ),
    )
    terms = friction_terms("N·m", "rad", level, s.speed) + loads + electrical + input_terms("V")
    terms = tuple(term for term in terms if term.name != "position_dependent_friction")
    terms += output_terms("speed", "rad/s", s.speed)
    return {term.key: term for term in terms}


class DcMotorModel:
    """The white-box model of one DC motor (satisfies ``physics.model.Model``).

    Driven by ``voltage``; simulates ``speed``, ``current`` or both. Parameters that the rig file does not
    know are estimated. States are speed, current and, as an offset that nobody fits, the angle.
    """

    kind = "dc_motor"
    metric = Metric.WINDOWED_SIMULATION
    forgets = True
    state_names = ("shaft_velocity", "current")

    def __init__(self, rig: RigFile, record: Record | None = None) -> None:
        self.sizes = Sizes(record)
        self.outputs = record.output_names if record is not None else ("speed", "current")
        there = set(record.auxiliary) if record is not None else {"angle", "winding_temperature"}
        everything = catalogue(self.sizes)
        self.terms: Mapping[str, Term] = {k: t for k, t in everything.items() if set(t.needs) <= there}
        self.never_seen: Mapping[str, str] = {
            k: f"needs {', '.join(t.needs)}" for k, t in everything.items() if k not in self.terms
        }
        self.fixed = known_numbers(rig)
        own = tuple(p for n, p in own_parameters(self.sizes).items() if n not in self.fixed)
        self.parameters = own + tuple(p for term in self.terms.values() for p in term.parameters)
        self.state_scale = np.array([0.05 * self.sizes.speed, 0.1 * self.sizes.current])
        self._values = Values(self.fixed, self.parameters)
        self._stated = rig.metric.horizon
        self.horizon = self._stated or TIME_CONSTANTS * self.sizes.time_constant
        self._path = DrivenPath()

    def horizon_at(self, theta: FloatArray) -> float:
        """Three mechanical time constants J/(c + K²/R), s."""
        if self._stated:
            return self._stated
        value = self._values.of
        damping = value(theta, "viscous_friction.coefficient")
        damping += value(theta, "torque_constant") ** 2 / value(theta, "resistance")
        return near(TIME_CONSTANTS * value(theta, "inertia") / damping, self.horizon)

    def prepare(self, record: Record) -> Record:
        """The record itself."""
        return record

    def initial_states(self, record: Record, windows: Windows) -> FloatArray:
        """Mean of the first samples of each window; a channel that is not there is guessed from the other."""
        states = np.zeros((len(windows), 2))
        count = max(2, min(5, int(0.02 * self.sizes.time_constant / record.period)))
        constant = self.fixed.get("torque_constant", self.sizes.constant)
        resistance = self.fixed.get("resistance", self.sizes.resistance)
        for w, (first, last) in enumerate(zip(windows.first, windows.last, strict=True)):
            rows = slice(first, min(first + count, last))
            seen = dict(zip(self.outputs, record.outputs[rows].mean(axis=0), strict=True))
            u = float(record.inputs[first, 0])
            speed = seen.get("speed")
            current = seen.get("current")
            if speed is None:
                speed = (u - resistance * float(current or 0.0)) / constant
            if current is None:
                current = (u - constant * speed) / resistance
            states[w] = speed, current
        return states

    def simulate(self, theta: FloatArray, record: Record, windows: Windows, states: FloatArray) -> FloatArray:
        """Speed in rad/s and current in A, those that the record has, (N, channels)."""
        motion = self._trajectory(theta, record, windows, states)
        columns = {
            "speed": self._values.sensed(theta, record, windows, motion[:, 0]),
            "current": motion[:, 1],
        }
        return np.column_stack([columns[name] for name in self.outputs])

    def coordinates(
        self, theta: FloatArray, record: Record, windows: Windows, states: FloatArray
    ) -> Mapping[str, FloatArray]:
        """Speed, current and voltage along the simulation."""
        motion = self._trajectory(theta, record, windows, states)
        u = record.inputs[:, 0]
        return {
            "shaft_velocity": motion[:, 0],
            "shaft_angle": motion[:, 2],
            "current": motion[:, 1],
            "voltage": u[windows.rows],
            "voltage_rate": np.gradient(u, record.t)[windows.rows],
        }

    def effort(self, theta: FloatArray, coordinates: Mapping[str, FloatArray]) -> FloatArray:
        """Torque on the rotor at these coordinates, N·m; zero where it rests."""
        i, angle, w = (coordinates[name] for name in ("current", "shaft_angle", "shaft_velocity"))
        inertia = self._values.of(theta, "inertia")
        law = self._values.friction_law(theta, inertia)
        return np.asarray(winding.accelerations(i, angle, w, self._motor(theta), law) * inertia)

    def yardsticks(self, record: Record) -> Mapping[Yardstick, float]:
        """What starts are fractions of, from this recording."""
        u = record.inputs[:, 0]
        steps = np.abs(np.diff(u)) / np.diff(record.t)
        return {
            Yardstick.UNIT: 1.0,
            Yardstick.INPUT: float(np.abs(u).max()) or 1.0,
            Yardstick.INPUT_RATE: float(np.quantile(steps, 0.98)) or 1.0,
            Yardstick.DRIVE: self.sizes.torque,
            Yardstick.SPEED: self.sizes.speed,
        }

    def _motor(self, theta: FloatArray) -> winding.Motor:
        inertia = self._values.of(theta, "inertia")
        return winding.Motor(
            inertia=inertia,
            constant=self._values.of(theta, "torque_constant"),
            resistance=self._values.of(theta, "resistance"),
            inductance=self._values.of(theta, "inductance"),
            brush_drop=self._values.of(theta, "brush_drop.voltage"),
            brush_width=BRUSH_WIDTH * self.sizes.current,
            load=self._values.of(theta, "constant_force.force") / inertia,
            spring=self._values.of(theta, "spring_force.stiffness") / inertia,
            cogging_sine=self._values.of(theta, "cogging_torque.sine") / inertia,
            cogging_cosine=self._values.of(theta, "cogging_torque.cosine") / inertia,
            cogging_order=self._values.of(theta, "cogging_torque.order"),
        )

    def _trajectory(
        self, theta: FloatArray, record: Record, windows: Windows, states: FloatArray
    ) -> FloatArray:
        """ω, i and angle of all windows, (N, 3)."""
        node_t, voltage = self._path.nodes(record, 0, lambda name: self._values.of(theta, name))
        sag = self._values.of(theta, "supply_sag.coefficient")
        gain = 1.0 - sag * np.abs(record.inputs[:, 0])
        begun = np.zeros((len(windows), 3))
        begun[:, :2] = states
        if "angle" in record.auxiliary:
            begun[:, 2] = record.auxiliary["angle"][windows.first]
        out = np.empty((len(windows.rows), 3))
        inertia = self._values.of(theta, "inertia")
        winding.simulate(
            record.t,
            node_t,
            voltage,
            gain,
            windows.first,
            windows.last,
            begun,
            self._motor(theta),
            self._values.friction_law(theta, inertia),
            self._warm(theta, record),
            self._viscous_change(theta, record),
            out,
        )
        return out

    def _warm(self, theta: FloatArray, record: Record) -> FloatArray:
        coefficient = self._values.of(theta, "thermal_resistance.coefficient")
        if not coefficient:
            return np.ones(len(record))
        warmth = record.auxiliary["winding_temperature"]
        return np.asarray(1.0 + coefficient * (warmth - warmth[0]))

    def _viscous_change(self, theta: FloatArray, record: Record) -> FloatArray:
        rate = self._values.of(theta, "temperature_dependent_friction.rate")
        if not rate:
            return np.ones(len(record))
        warmth = record.auxiliary["winding_temperature"]
        return np.asarray(np.exp(-rate * (warmth - warmth[0])))

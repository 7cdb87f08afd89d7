"""What a DC motor's recording says of its size, and the terms that its model may have."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from scipy.signal import lfilter

from labhil.physics.friction_terms import friction_terms, load_dependent_friction
from labhil.physics.model import Record
from labhil.physics.path_terms import input_terms, offset_term, output_terms
from labhil.physics.terms import Enters, Parameter, Term
from labhil.signals import FloatArray

COPPER = 0.0039
"""Relative rise of copper's resistance per kelvin."""

REFERENCE = 20.0
"""Temperature (°C) at which resistance and viscous friction have their stated values."""

TYPICAL_SPEED = 3.0
TYPICAL_VOLTAGE = 5.0
TYPICAL_TIME_CONSTANT = 1.0

LARGEST_CONSTANT = 1.5
"""Times RMS voltage over RMS speed: no back-EMF is larger than the voltage for long."""

FEWEST_BLOCKS = 12
"""In motion, for a regression to mean anything."""


class Sizes:
    """What a recording says of the motor's size before anything is fitted (SI).

    Short blocks in motion are integrated, so that no derivative of a noisy signal is needed. With speed and
    current both balances, of voltages and of torques, are solved by linear least squares; with speed alone
    a first order, ω̇ = (g·U_lagged − ω)/τ − d·sgn ω, gives back-EMF, inertia and inductance for a typical
    current, the lag of U being the one that fits best.
    """

    def __init__(self, record: Record | None) -> None:
        self.voltage, self.speed, self.current = TYPICAL_VOLTAGE, TYPICAL_SPEED, 1.0
        self.constant, self.time_constant = TYPICAL_VOLTAGE / TYPICAL_SPEED, TYPICAL_TIME_CONSTANT
        if record is not None:
            self.voltage = _rms(record.inputs[:, 0]) or TYPICAL_VOLTAGE
        channels = {} if record is None else dict(zip(record.output_names, record.outputs.T, strict=True))
        if "current" in channels:
            self.current = _rms(channels["current"]) or 1.0
        self.resistance = 0.5 * self.voltage / self.current
        if "speed" in channels:
            self.speed = _rms(channels["speed"]) or TYPICAL_SPEED
            self.constant = self.voltage / self.speed
        self.inductance = self.inertia = 0.0
        if record is not None and "speed" in channels:
            begins = [begin.row for begin in record.begins]
            blocks = Blocks(record.t, record.inputs[:, 0], channels["speed"], begins)
            self._first_order(blocks)
            if "current" in channels:
                self._both_balances(blocks, channels["current"])
        self.inductance = self.inductance or 0.05 * self.time_constant * self.resistance
        self.inertia = self.inertia or self.time_constant * self.constant**2 / self.resistance

    def _first_order(self, blocks: Blocks) -> None:
        smallest = np.inf
        for lag in blocks.lags:
            factors, error = blocks.solve(
                blocks.rise(blocks.w), blocks.lagged_volts(lag), blocks.turned, blocks.rubbed
            )
            if error < smallest and factors[1] < 0.0 < factors[0]:
                smallest, self.inductance = error, lag * self.resistance
                self.time_constant = float(np.clip(-1.0 / factors[1], 1e-3, 100.0))
                largest = LARGEST_CONSTANT * self.voltage / self.speed
                self.constant = float(np.clip(-factors[1] / factors[0], 1e-2 * largest, largest))

    def _both_balances(self, blocks: Blocks, i: FloatArray) -> None:
        """∫U = R·∫i + L·Δi + K·∫ω, then K·∫i = J·Δω + c·∫ω + T·∫sgn ω."""
        charge = blocks.integral(i)
        electrical, error = blocks.solve(blocks.volts, charge, blocks.rise(i), blocks.turned)
        if not np.isfinite(error) or min(electrical) <= 0.0:
            return
        self.resistance, self.inductance, self.constant = (float(x) for x in electrical)
        torque, error = blocks.solve(
            self.constant * charge, blocks.rise(blocks.w), blocks.turned, blocks.rubbed
        )
        if np.isfinite(error) and torque[0] > 0.0:
            self.inertia = float(torque[0])
            damping = max(float(torque[1]), 0.0) + self.constant**2 / self.resistance
            self.time_constant = float(np.clip(self.inertia / damping, 1e-3, 100.0))

    @property
    def torque(self) -> float:
        """Torque at the typical current, N·m."""
        return self.constant * self.current


class Blocks:
    """Integrals of held voltage, speed and its sign over short blocks in which the shaft turns.

    None reaches from one recording into the next; these begin at the samples ``begins``.
    """

    def __init__(self, t: FloatArray, u: FloatArray, w: FloatArray, begins: Sequence[int] = (0,)) -> None:
        self.w, self._u = w, u
        self._edges = np.arange(0, len(t), max(4, len(t) // 200))
        self._h = np.diff(t)
        self._period = float(np.median(self._h))
        slow = 0.05 * float(np.abs(w).max())
        self._moving = np.minimum.reduceat(np.abs(w), self._edges)[:-1] > slow
        crossed = np.searchsorted(self._edges, begins[1:]) - 1
        self._moving[crossed[crossed < len(self._moving)]] = False
        self.volts = self._over(self._h * u[:-1])
        self.turned, self.rubbed = self.integral(w), self.integral(np.sign(w))

    @property
    def lags(self) -> FloatArray:
        """Electrical time constants worth trying, s."""
        return np.r_[0.0, self._period * np.geomspace(0.3, 30.0, 11)]

    def lagged_volts(self, lag: float) -> FloatArray:
        """Integrals of the held voltage behind a first-order lag (s) that begins settled."""
        if lag <= 0.0:
            return self.volts
        share = 1.0 - np.exp(-self._period / lag)
        behind = np.r_[
            self._u[0], lfilter([share], [1.0, share - 1.0], self._u[:-1] - self._u[0]) + self._u[0]
        ]
        # what is lost on the way, ∫(u − y), is the lag times the rise of y
        return self.volts - lag * self.rise(behind)

    def integral(self, x: FloatArray) -> FloatArray:
        """Over each block."""
        return self._over(0.5 * self._h * (x[1:] + x[:-1]))

    def rise(self, x: FloatArray) -> FloatArray:
        """From each block's begin to its end."""
        return np.diff(x[self._edges])[self._moving]

    def _over(self, pieces: FloatArray) -> FloatArray:
        return np.diff(np.r_[0.0, np.cumsum(pieces)][self._edges])[self._moving]

    def solve(self, y: FloatArray, *columns: FloatArray) -> tuple[FloatArray, float]:
        """Least-squares factors of ``columns`` in ``y``, and their error, infinite where too little moves."""
        if np.count_nonzero(self._moving) < FEWEST_BLOCKS:
            return np.zeros(len(columns)), np.inf
        design = np.column_stack(columns)
        factors = np.asarray(np.linalg.lstsq(design, y, rcond=None)[0])
        return factors, float(np.sum((y - design @ factors) ** 2))


def _rms(x: FloatArray) -> float:
    return float(np.sqrt(np.mean(x**2)))


def own_parameters(s: Sizes) -> dict[str, Parameter]:
    """The motor's own parameters with starts and scales of its size."""
    typical = {
        "inertia": ("kg·m²", s.inertia),
        "torque_constant": ("N·m/A", s.constant),
        "inductance": ("H", s.inductance),
        "resistance": ("Ω", s.resistance),
    }
    return {
        name: Parameter(
            name, unit, size, 1e-4 * size, (30.0 if name == "inductance" else 1e3) * size, (size,)
        )
        for name, (unit, size) in typical.items()
    }


def catalogue(s: Sizes, outputs: Sequence[str], inertia_known: bool) -> dict[str, Term]:
    """All terms of a motor with these ``outputs``, their scales of the motor's size."""
    level = 0.1 * s.torque
    terms = friction_terms("N·m", "rad", level, s.speed) + _load_terms(s, level)
    terms += _electrical_terms(s) + input_terms("V")
    terms += (load_dependent_friction("the motor's torque (a gear)"), *sensor_terms(outputs, s))
    if inertia_known:
        terms += (added_inertia(s),)
    # where along a turn a motor stands is known from its angle only
    needing = {"position_dependent_friction": ("angle",)}
    return {term.key: replace(term, needs=needing.get(term.name, term.needs)) for term in terms}


def _load_terms(s: Sizes, level: float) -> tuple[Term, ...]:
    """Torques on the shaft but friction; ``level`` is a typical one, N·m."""
    return (
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
                Parameter(
                    "cogging_torque.order",
                    "1",
                    12.0,
                    1.0,
                    400.0,
                    starts=(12.0,),
                    shape=True,
                    waves_over="shaft_angle",
                ),
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
            "c(T) = c·exp(−α·(T − 20 °C))",
            "viscosity of grease",
            "long runs that warm the motor",
            (Parameter("temperature_dependent_friction.rate", "1/K", 0.02, -0.2, 0.2),),
            needs=("winding_temperature",),
        ),
    )


def _electrical_terms(s: Sizes) -> tuple[Term, ...]:
    """Effects between supply and winding."""
    return (
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
            "R(T) = R·(1 + α·(T − 20 °C)); copper: 0.0039/K",
            "copper",
            "long runs with large currents",
            (Parameter("thermal_resistance.coefficient", "1/K", COPPER, 0.0, 0.05, starts=(COPPER,)),),
            needs=("winding_temperature",),
        ),
    )


def added_inertia(s: Sizes) -> Term:
    """The term of a motor whose own inertia is known."""
    return Term(
        "added_inertia",
        Enters.FORCE,
        "more inertia than is known (a load on the shaft)",
        "(J + J_a)·ω̇ = …",
        "standard",
        "acceleration",
        (Parameter("added_inertia.mass", "kg·m²", 0.1 * s.inertia, -0.5 * s.inertia),),
    )


def sensor_terms(outputs: Sequence[str], s: Sizes) -> tuple[Term, ...]:
    """Effects of the first output's sensor; where the current is the second, its offset and gain as well."""
    units = {"speed": ("rad/s", s.speed), "current": ("A", s.current)}
    first = outputs[0]
    terms = (*output_terms(first, *units[first]), offset_term(first, units[first][0], 0.1 * units[first][1]))
    if len(outputs) == 1:
        return terms
    of_current = {
        "sensor_offset": Parameter("sensor_offset.current_offset", "A", 0.1 * s.current),
        "sensor_gain": Parameter("sensor_gain.current_gain", "1", 0.1, -0.9),
    }
    return tuple(
        replace(term, parameters=(*term.parameters, of_current[term.name]))
        if term.name in of_current
        else term
        for term in terms
    )

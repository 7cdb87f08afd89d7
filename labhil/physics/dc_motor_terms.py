"""First estimates of a DC motor's parameters from a recording, and the terms that its model may contain.

The symbols are those of ``physics.winding``; ``physics.dc_motor`` is the model.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from scipy.signal import lfilter

from labhil.physics.friction_terms import friction_terms, load_dependent_friction
from labhil.physics.path_terms import input_terms, offset_term, output_terms
from labhil.physics.record import Record
from labhil.physics.terms import Enters, Parameter, Term
from labhil.physics.warming import warming_friction
from labhil.signals import FloatArray

COPPER_COEFFICIENT = 0.0039
"""Temperature coefficient of the resistance of copper, 1/K."""

TYPICAL_SPEED = 3.0
TYPICAL_VOLTAGE = 5.0
TYPICAL_TIME_CONSTANT = 1.0
"""Sizes without a recording: rad/s, V, s."""

MAX_TORQUE_CONSTANT = 1.5
"""Largest torque constant over (RMS voltage/RMS speed): the back-EMF exceeds the voltage only briefly."""


class Sizes:
    """First estimates of the motor's parameters before a fit (SI), for starts and scales.

    The equations are integrated over short blocks in motion, so no noisy signal is differentiated. With speed
    and current, the balances of voltages and torques are solved by linear least squares. With speed alone, a
    first-order model ω̇ = (g·U_lagged − ω)/τ − d·sgn ω gives torque constant, inertia and inductance for a
    typical current; the lag of U is chosen by the least error.
    """

    def __init__(self, record: Record | None) -> None:
        self.voltage, self.speed, self.current = TYPICAL_VOLTAGE, TYPICAL_SPEED, 1.0
        self.constant, self.time_constant = TYPICAL_VOLTAGE / TYPICAL_SPEED, TYPICAL_TIME_CONSTANT
        if record is not None:
            self.voltage = _rms(record.inputs[:, 0]) or TYPICAL_VOLTAGE
        largest = 0.0 if record is None else float(np.max(np.abs(record.inputs[:, 0])))
        self.largest_voltage = largest or TYPICAL_VOLTAGE
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
        """Estimate from voltage and speed: inductance, time constant and torque constant."""
        smallest = np.inf
        for lag in blocks.lags:
            factors, error = blocks.solve(
                blocks.rise(blocks.w), blocks.lagged_volts(lag), blocks.rotation, blocks.direction
            )
            if error < smallest and factors[1] < 0.0 < factors[0]:
                smallest, self.inductance = error, lag * self.resistance
                self.time_constant = float(np.clip(-1.0 / factors[1], 1e-3, 100.0))
                largest = MAX_TORQUE_CONSTANT * self.voltage / self.speed
                self.constant = float(np.clip(-factors[1] / factors[0], 1e-2 * largest, largest))

    def _both_balances(self, blocks: Blocks, i: FloatArray) -> None:
        """Estimate by ∫U = R·∫i + L·Δi + K·∫ω, then K·∫i = J·Δω + c·∫ω + T·∫sgn ω."""
        charge = blocks.integral(i)
        electrical, error = blocks.solve(blocks.volts, charge, blocks.rise(i), blocks.rotation)
        if not np.isfinite(error) or min(electrical) <= 0.0:
            return
        self.resistance, self.inductance, self.constant = (float(x) for x in electrical)
        torque, error = blocks.solve(
            self.constant * charge, blocks.rise(blocks.w), blocks.rotation, blocks.direction
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

    No block extends from one recording into the next; recordings start at the samples ``begins``.
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
        self.rotation, self.direction = self.integral(w), self.integral(np.sign(w))

    @property
    def lags(self) -> FloatArray:
        """Candidate electrical time constants, s."""
        return np.r_[0.0, self._period * np.geomspace(0.3, 30.0, 11)]

    def lagged_volts(self, lag: float) -> FloatArray:
        """Integrals of the held voltage behind a first-order lag (s) that begins settled."""
        if lag <= 0.0:
            return self.volts
        share = 1.0 - np.exp(-self._period / lag)
        behind = np.r_[
            self._u[0], lfilter([share], [1.0, share - 1.0], self._u[:-1] - self._u[0]) + self._u[0]
        ]
        # T·ẏ = u − y, so ∫(u − y) is the lag T times the rise of y
        return self.volts - lag * self.rise(behind)

    def integral(self, x: FloatArray) -> FloatArray:
        """Integral of a signal over each block, by the trapezoidal rule."""
        return self._over(0.5 * self._h * (x[1:] + x[:-1]))

    def rise(self, x: FloatArray) -> FloatArray:
        """Change of a signal from the start to the end of each block."""
        return np.diff(x[self._edges])[self._moving]

    def _over(self, pieces: FloatArray) -> FloatArray:
        """Sums over the blocks in motion."""
        return np.diff(np.r_[0.0, np.cumsum(pieces)][self._edges])[self._moving]

    def solve(self, y: FloatArray, *columns: FloatArray, min_blocks: int = 12) -> tuple[FloatArray, float]:
        """Fit ``y`` by ``columns`` in the least-squares sense.

        Returns:
            Coefficients, and the sum of squared errors; infinite with fewer than ``min_blocks`` in motion.
        """
        if np.count_nonzero(self._moving) < min_blocks:
            return np.zeros(len(columns)), np.inf
        design = np.column_stack(columns)
        factors = np.asarray(np.linalg.lstsq(design, y, rcond=None)[0])
        return factors, float(np.sum((y - design @ factors) ** 2))


def _rms(x: FloatArray) -> float:
    return float(np.sqrt(np.mean(x**2)))


def motor_parameters(s: Sizes) -> dict[str, Parameter]:
    """Parameters of the motor itself, by name, with starts and scales of its size."""
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
    """Terms of a motor, by key.

    Args:
        s: Sizes that give the scales.
        outputs: Outputs that the recording has.
        inertia_known: Whether the rig file states the inertia; only then added inertia is identifiable.

    Returns:
        The terms.
    """
    level = 0.1 * s.torque
    terms = friction_terms("N·m", "rad", level, s.speed) + _load_terms(s, level)
    terms += _electrical_terms(s) + input_terms("V")
    terms += (load_dependent_friction("the motor's torque (a gear)"), *sensor_terms(outputs, s))
    if inertia_known:
        terms += (added_inertia(s),)
    # position-dependent friction needs the angle
    needing = {"position_dependent_friction": ("angle",)}
    return {term.key: replace(term, needs=needing.get(term.name, term.needs)) for term in terms}


def _load_terms(s: Sizes, level: float) -> tuple[Term, ...]:
    """Torques on the shaft other than friction; ``level`` is a typical one, N·m."""
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
        warming_friction("the motor", "winding_temperature"),
    )


def _electrical_terms(s: Sizes) -> tuple[Term, ...]:
    """Effects between the supply and the winding."""
    return (
        Term(
            "brush_drop",
            Enters.ELECTRICAL,
            "a voltage that the brushes take, whatever the current",
            "U_b = V_b·sgn i",
            "standard",
            "small currents both ways; a recorded current, to distinguish it from dry friction",
            # brushes that take more than the largest voltage let no current flow
            (
                Parameter(
                    "brush_drop.voltage", "V", 0.1 * s.voltage, 0.0, s.largest_voltage, (0.05 * s.voltage,)
                ),
            ),
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
            (
                Parameter(
                    "thermal_resistance.coefficient",
                    "1/K",
                    COPPER_COEFFICIENT,
                    0.0,
                    0.05,
                    starts=(COPPER_COEFFICIENT,),
                ),
            ),
            needs=("winding_temperature",),
        ),
    )


def added_inertia(s: Sizes) -> Term:
    """Added inertia, for a motor whose own inertia is known."""
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
    """Sensor terms of the first output, and offset and gain of the current where it is the second."""
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

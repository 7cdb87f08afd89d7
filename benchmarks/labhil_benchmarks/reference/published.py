"""Chapter 5 of the reference text as plain data: what its tables print, digit for digit.

Symbols are the text's (sub- and superscripts flattened), units ours where its are slips (torques in N·m, not
N). What the text calls MSE with the unit of a root is kept as printed.
"""

from __future__ import annotations

from dataclasses import dataclass

INERTIA, CONSTANT, INDUCTANCE, RESISTANCE = "inertia", "torque_constant", "inductance", "resistance"
MASS, STIFFNESS = "moving_mass", "spring_stiffness"
COULOMB, STRIBECK = "coulomb_friction.level", "stribeck_friction.level"
VELOCITY = "stribeck_friction.velocity"
VISCOUS = "viscous_friction.coefficient"
QUADRATIC = "quadratic_viscous_friction.coefficient"
CUBIC = "cubic_viscous_friction.coefficient"
DELAY, LEFT, RIGHT = "time_delay.delay", "dead_zone.left", "dead_zone.right"

BREAK_AWAY = (COULOMB, STRIBECK)
"""Our levels add up: the text's static level is the sum of the Coulomb and the Stribeck level."""


@dataclass(frozen=True, slots=True)
class Parameter:
    """One row of a table of parameters.

    ``keys`` are the parameters of our model whose sum it is. ``real`` is the text's true value where it has
    one, ``errors`` are its own figures (%) for PSO and NLSE as printed, ``interval`` its confidence
    interval. ``joint`` counts from 0.
    """

    symbol: str
    unit: str
    keys: tuple[str, ...]
    pso: float
    nlse: float
    real: float | None = None
    errors: tuple[str, str] | None = None
    interval: tuple[float, float] | None = None
    joint: int | None = None


@dataclass(frozen=True, slots=True)
class Quality:
    """One row of a table of errors: ``mse`` as printed, ``r2`` in %; ``joint`` counts from 0."""

    model: str
    mse: float
    r2: float
    joint: int | None = None


@dataclass(frozen=True, slots=True)
class ParameterTable:
    """A table of parameters with its number in the text."""

    number: str
    title: str
    rows: tuple[Parameter, ...]


@dataclass(frozen=True, slots=True)
class QualityTable:
    """A table of errors with its number; ``printed_unit`` is the unit that the text gives to its MSE."""

    number: str
    title: str
    printed_unit: str
    rows: tuple[Quality, ...]


MODELS = ("PSO", "NLSE")

TABLE_5_1 = QualityTable(
    "5.1",
    "DC motor, case one: linear and nonlinear models",
    "rad/s",
    (
        Quality("transfer function", 0.0216, 78.8),
        Quality("state space", 0.0086, 82.61),
        Quality("NLSE", 0.0049, 91.3),
        Quality("PSO", 0.0015, 97.1),
    ),
)

TABLE_5_3 = ParameterTable(
    "5.3",
    "DC motor, case two: every nonlinearity there",
    (
        Parameter("J", "kg·m²", (INERTIA,), 0.095, 0.112, 0.1, ("5", "12")),
        Parameter("K", "N·m/A", (CONSTANT,), 0.19, 0.164, 0.2, ("5", "18")),
        Parameter("L", "H", (INDUCTANCE,), 0.099, 0.07, 0.1, ("1", "30")),
        Parameter("R", "Ω", (RESISTANCE,), 1.485, 1.68, 1.5, ("1", "12")),
        Parameter("T_s", "N·m", BREAK_AWAY, 0.095, 0.067, 0.1, ("5", "33")),
        Parameter("T_c", "N·m", (COULOMB,), 0.19, 0.23, 0.2, ("5", "15")),
        Parameter("T_v1", "N·m·s/rad", (VISCOUS,), 0.05, 0.055, 0.05, ("0", "11")),
        Parameter("T_v2", "N·m·s²/rad²", (QUADRATIC,), 0.05, 0.041, 0.05, ("0", "18")),
        Parameter("T_v3", "N·m·s³/rad³", (CUBIC,), 0.019, 0.061, 0.02, ("5", "41")),
        Parameter("ω_s", "rad/s", (VELOCITY,), 0.01, 0.007, 0.01, ("0", "23")),
    ),
)
TABLE_5_4 = QualityTable(
    "5.4",
    "DC motor, case two: errors on the test signal",
    "rad/s",
    (Quality("PSO", 0.006, 97.1), Quality("NLSE", 0.019, 88.6)),
)

TABLE_5_5 = ParameterTable(
    "5.5",
    "DC motor, case three: no viscous nonlinearity",
    (
        Parameter("J", "kg·m²", (INERTIA,), 0.1, 0.138, 0.1, ("0", "18")),
        Parameter("K", "N·m/A", (CONSTANT,), 0.19, 0.18, 0.2, ("5", "10")),
        Parameter("L", "H", (INDUCTANCE,), 0.1, 0.121, 0.1, ("0", "21")),
        Parameter("R", "Ω", (RESISTANCE,), 1.52, 1.92, 1.5, ("1.3", "28")),
        Parameter("T_s", "N·m", BREAK_AWAY, 0.1, 0.138, 0.1, ("0", "38")),
        Parameter("T_c", "N·m", (COULOMB,), 0.2, 0.27, 0.2, ("0", "33")),
        Parameter("T_v1", "N·m·s/rad", (VISCOUS,), 0.05, 0.037, 0.05, ("0", "26")),
        Parameter("T_v2", "N·m·s²/rad²", (QUADRATIC,), 10e-7, 0.075, 0.0, ("≈0", "<100")),
        Parameter("T_v3", "N·m·s³/rad³", (CUBIC,), 10e-9, 0.029, 0.0, ("≈0", "<100")),
        Parameter("ω_s", "rad/s", (VELOCITY,), 0.01, 0.0131, 0.01, ("0", "31")),
    ),
)
TABLE_5_6 = QualityTable(
    "5.6",
    "DC motor, case three: errors on the test signal",
    "rad/s",
    (Quality("PSO", 0.007, 96.32), Quality("NLSE", 0.01, 87.41)),
)

TABLE_5_8 = ParameterTable(
    "5.8",
    "Solenoid actuator",
    (
        Parameter("k_s", "N/m", (STIFFNESS,), 6966, 7161, 6850, ("1.6", "4.54")),
        Parameter("m_s", "kg", (MASS,), 0.05504, 0.022476, 0.064, ("14.5", "65.62")),
        Parameter("F_c", "N", (COULOMB,), 1.7747, 8.5638, 2, ("11.26", "<100")),
        Parameter("F_s", "N", BREAK_AWAY, 3.5153, 6.3546, 4, ("12.11", "58.75")),
        Parameter("F_v", "N·s/m", (VISCOUS,), 4.5546, 8.9847, 5, ("8.9", "79.6")),
        Parameter("ẋ_s", "m/s", (VELOCITY,), 0.10097, 2.8344, 0.1, ("≈0", "<100")),
    ),
)
TABLE_5_9 = QualityTable(
    "5.9",
    "Solenoid actuator: errors on the test signal",
    "m",
    (Quality("PSO", 6e-5, 94.7), Quality("NLSE", 1.8e-4, 89.1)),
)


def _ball(values: tuple[tuple[float, float, float, float], ...]) -> tuple[Parameter, ...]:
    """Rows of a ball and beam from (PSO, NLSE, ends of the interval); the delay is from the text's prose."""
    named = (
        ("F_c", "N", (COULOMB,)),
        ("F_s", "N", BREAK_AWAY),
        ("F_v1", "N·s/m", (VISCOUS,)),
        ("F_v2", "N·s²/m²", (QUADRATIC,)),
        ("F_v3", "N·s³/m³", (CUBIC,)),
        ("ẋ_s", "m/s", (VELOCITY,)),
        ("U_l", "rad", (LEFT,)),
        ("U_r", "rad", (RIGHT,)),
    )
    rows = tuple(
        Parameter(symbol, unit, keys, pso, nlse, interval=(low, high))
        for (symbol, unit, keys), (pso, nlse, low, high) in zip(named, values, strict=True)
    )
    return (*rows, Parameter("T_d", "s", (DELAY,), 0.05, 0.05))


TABLE_5_10 = ParameterTable(
    "5.10",
    "Ball and beam, case one: bare beam",
    _ball(
        (
            (0.09, 2.58, 0.053, 0.127),
            (0.15, 0.93, 0.14, 0.169),
            (0.26, 1.19, 0.251, 0.278),
            (4.6e-5, 0.21, -1.58e-4, 2.5e-4),
            (4.6e-5, 0.13, -1.58e-4, 2.5e-4),
            (0.0017, 1.18, 5.7e-7, 2.5e-4),
            (3.8e-5, 0.04, -1.4e-4, 2.4e-4),
            (4.6e-5, 0.04, -1.5e-4, 2.5e-4),
        )
    ),
)
TABLE_5_11 = QualityTable(
    "5.11",
    "Ball and beam, case one: errors on the test signal",
    "m",
    (Quality("PSO", 1.18e-5, 96.7), Quality("NLSE", 1.04e-4, 91.9)),
)
TABLE_5_12 = ParameterTable(
    "5.12",
    "Ball and beam, case two: paper tape on the beam",
    _ball(
        (
            (0.15, 5.26, 0.13, 0.17),
            (0.84, 3.14, 0.82, 0.86),
            (0.16, 0.18, 0.14, 0.18),
            (2.4e-5, 0.3, -1.32e-4, 2.34e-4),
            (2.4e-5, 0.06, -1.32e-4, 2.34e-4),
            (0.001, 3.07, 5.4e-7, 0.004),
            (2e-5, 0.08, -2.2e-4, 2.6e-4),
            (8e-5, 0.07, -1.5e-4, 5.7e-4),
        )
    ),
)
TABLE_5_13 = QualityTable(
    "5.13",
    "Ball and beam, case two: errors on the test signal",
    "m",
    (Quality("PSO", 6.47e-5, 95.3), Quality("NLSE", 8.38e-4, 88.4)),
)

JOINT_ROWS = (
    ("τ_s", "N·m", BREAK_AWAY),
    ("τ_c", "N·m", (COULOMB,)),
    ("τ_v1", "N·m·s/rad", (VISCOUS,)),
    ("τ_v2", "N·m·s²/rad²", (QUADRATIC,)),
    ("τ_v3", "N·m·s³/rad³", (CUBIC,)),
    ("q̇_s", "rad/s", (VELOCITY,)),
)
JOINTS = (
    (
        (0.64, 8.3, 0.6, 0.67),
        (0.91, -14.1, 0.88, 0.93),
        (0.9, 4.49, 0.88, 0.92),
        (1.6e-8, -0.41, -9.8e-6, 9.8e-6),
        (2.4e-8, -0.79, -1.1e-5, 1.2e-6),
        (0.045, 3.77, 0.029, 0.062),
    ),
    (
        (0.5, 9.08, 0.46, 0.53),
        (0.95, 1.6, 0.37, 0.44),
        (0.4, -4.008, 0.37, 0.44),
        (1.7e-6, -6.42, -9.9e-5, 1.2e-4),
        (1.8e-6, -0.56, -1e-4, 1.05e-4),
        (0.039, 48.9, 0.024, 0.055),
    ),
    (
        (0.54, 5.94, 0.5, 0.5),
        (0.59, 1.02, 0.55, 0.63),
        (0.89, 0.15, 0.87, 0.91),
        (1.1e-8, -8.7, -8.1e-6, 8.2e-6),
        (3.2e-14, 6.81, -1.3e-8, 1.3e-8),
        (0.04, 8.42, 0.03, 0.06),
    ),
    (
        (0.23, 2.69, 0.19, 0.26),
        (0.2, 38.53, 0.17, 0.24),
        (0.16, -79.85, 0.14, 0.19),
        (2.9e-13, -20.9, -4.2e-8, 4.2e-8),
        (2.8e-12, -0.35, -1.3e-7, 1.3e-7),
        (0.025, 4.8, 0.013, 0.037),
    ),
    (
        (0.2, 0.25, 0.17, 0.24),
        (0.17, -8.51, 0.14, 0.2),
        (0.17, 3.089, 0.14, 0.20),
        (7.3e-4, -0.024, -1.3e-3, 2.8e-3),
        (1.1e-12, 1.5e-3, -8.1e-8, 8.1e-8),
        (0.04, 1.5e-3, 0.03, 0.062),
    ),
    (
        (0.29, 0.23, 0.26, 0.33),
        (0.2, 5.58, 0.17, 0.24),
        (0.12, 6.29, 0.097, 0.148),
        (3e-3, 0.31, -1.2e-3, 7.3e-3),
        (2.2e-14, 0.37, -1.1e-8, 1.1e-8),
        (0.033, 4.18, 0.019, 0.047),
    ),
)
"""(PSO, NLSE, ends of the interval) of each row of each joint."""

TABLE_5_14 = ParameterTable(
    "5.14",
    "UR5: friction of six joints",
    tuple(
        Parameter(
            symbol,
            unit,
            tuple(f"{key}[{joint}]" for key in keys),
            pso,
            nlse,
            interval=(low, high),
            joint=joint,
        )
        for joint, rows in enumerate(JOINTS)
        for (symbol, unit, keys), (pso, nlse, low, high) in zip(JOINT_ROWS, rows, strict=True)
    ),
)
QUALITY_OF_JOINTS = (
    (3.13, 97.55, 19.98, 90.27),
    (5.43, 97.47, 12.6, 90.49),
    (2.19, 96.81, 13.32, 88.99),
    (0.64, 87.28, 0.84, 83.05),
    (0.24, 93.53, 0.68, 87.97),
    (0.57, 88.25, 0.96, 83.91),
)
TABLE_5_15 = QualityTable(
    "5.15",
    "UR5: errors of the torques on the test motion",
    "N·m",
    tuple(
        Quality(model, mse, r2, joint)
        for joint, (pso_mse, pso_r2, nlse_mse, nlse_r2) in enumerate(QUALITY_OF_JOINTS)
        for model, mse, r2 in (("PSO", pso_mse, pso_r2), ("NLSE", nlse_mse, nlse_r2))
    ),
)

NUMBERS = ("5.1", "5.3", "5.4", "5.5", "5.6", "5.8", "5.9", "5.10", "5.11", "5.12", "5.13", "5.14", "5.15")
"""All tables of results; 5.2 and 5.7 are settings of the swarm, which the studies use."""

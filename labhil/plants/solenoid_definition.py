"""Parameters and effects of the simulated solenoid (see :mod:`labhil.plants.definition`)."""

from __future__ import annotations

from labhil.plants.definition import (
    FRICTION,
    OUTPUT_EFFECTS,
    POSITIVE,
    SAMPLING,
    Effect,
    PlantDefinition,
    with_sizes,
)

STROKE = 0.005
COPPER = 0.0039

FORCE_MAP = {
    "force_map_10": 8.0, "force_map_11": 2.0, "force_map_12": -3.0,
    "force_map_20": 12.0, "force_map_21": 1.5, "force_map_30": -2.0,
}  # fmt: skip
"""Our own magnet: ``force_map_ab`` is the factor, N, of i^a·(x/5 mm)^b with i in A."""

SOLENOID = PlantDefinition(
    bare={
        "moving_mass": 0.064,  # kg
        "spring_stiffness": 6850.0,  # N/m
        "stop_low": 0.0,  # m
        "stop_high": STROKE,  # m
        **FORCE_MAP,
        "coil_resistance": 4.0,  # Ω
        "coil_inductance": 0.02,  # H
        "loop_time": 0.001,  # s, by which the current is behind the setpoint of the current loop
        "heat_capacity": 30.0,  # J/K, of the coil
        "heat_resistance": 5.0,  # K/W, from the coil to the air
        "ambient": 25.0,  # °C, where the coil begins
        "reference_temperature": 25.0,  # °C, at which the coil's resistance has the stated value
        "plunger_position_noise": 1e-5,  # m
        "coil_current_noise": 0.0,  # A
        "coil_voltage_noise": 0.0,  # V
        "magnetic_force_noise": 0.1,  # N
        "plunger_position_resolution": 0.0,  # m
        "coil_current_resolution": 0.0,  # A
        **SAMPLING,
    },
    effects={
        **with_sizes(
            FRICTION,
            {
                "viscous_friction": {"coefficient": 5.0},
                "coulomb_friction": {"level": 2.0},
                "stribeck_friction": {"level": 2.0, "velocity": 0.1},
                "static_friction": {"level": 1.0},
                "quadratic_viscous_friction": {"coefficient": 20.0},
                "cubic_viscous_friction": {"coefficient": 100.0},
                "friction_asymmetry": {"coefficient": 1.0, "level": 0.0},
                "position_dependent_friction": {"slope": 100.0},
                "load_dependent_friction": {"coefficient": 0.1},
                "presliding_friction": {"stiffness": 2e5, "damping": 20.0},
                "maxwell_slip_friction": {"stiffness": 2e5, "damping": 20.0, "attraction": 1e3},
            },
        ),
        "constant_force": Effect("a constant push, N", {"force": 1.0}),
        "spring_preload": Effect("a spring that pushes already at rest, N", {"force": 2.0}),
        "spring_hardening": Effect("a spring that stiffens, N/m³", {"coefficient": 5e7}),
        "end_stop_contact": Effect("a plunger that bounces at its stops", {"restitution": 0.4}),
        "eddy_current": Effect("a field that lags behind the current, s", {"time_constant": 0.003}),
        "magnetic_hysteresis": Effect("a field that remembers where the current turned, A", {"width": 0.1}),
        "magnetic_saturation": Effect("iron that saturates, 1/A", {"coefficient": 0.05}),
        "residual_magnetism": Effect("a field that stays without current, A", {"current": 0.08}),
        "motional_emf": Effect(
            "a moving plunger induces a voltage: this share of (∂F/∂i)·v", {"share": 1.0}
        ),
        "thermal_resistance": Effect(
            "a coil whose resistance rises with warmth, 1/K", {"coefficient": COPPER}
        ),
        "pwm_ripple": Effect(
            "the amplifier's switching on current (A) and voltage (V), Hz",
            {"current": 0.02, "voltage": 0.5, "frequency": 20013.0},
        ),
        # no other input effects: the input is the coil's current itself, which the current loop controls
        "time_delay": Effect("the position is seen later than the current, s", {"delay": 0.002}),
        **with_sizes(
            OUTPUT_EFFECTS,
            {
                "sensor_offset": {"offset": 1e-4},
                "sensor_nonlinearity": {"cubic": 2e3},
                "sensor_lag": {"time_constant": 0.002},
                "quantisation": {"step": 2e-5},
            },
        ),
    },
    positive=POSITIVE
    | {
        "moving_mass", "coil_resistance", "coil_inductance", "heat_capacity",
        "heat_resistance", "hidden_latch.width", "hidden_sticky_patch.width",
    },
    hidden={
        "hidden_latch": Effect("a latch at one place", {"pull": 3.0, "place": 0.002, "width": 3e-4}),
        "hidden_leak": Effect("oil that is pressed out near the far stop, N·s/m", {"damping": 20.0}),
        "hidden_sticky_patch": Effect(
            "a place in the guide that rubs harder", {"level": 3.0, "place": 0.0015, "width": 3e-4}
        ),
    },
)  # fmt: skip

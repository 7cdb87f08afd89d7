"""Parameters and effects of the simulated DC motor (see :mod:`labhil.plants.definition`)."""

from __future__ import annotations

from labhil.plants.definition import (
    FRICTION,
    INPUT_EFFECTS,
    OUTPUT_EFFECTS,
    POSITIVE,
    SAMPLING,
    Effect,
    PlantDefinition,
    with_sizes,
)

COPPER = 0.0039

MOTOR = PlantDefinition(
    bare={
        "inertia": 0.1,  # kg·m²
        "torque_constant": 0.2,  # N·m/A
        "resistance": 1.5,  # Ω
        "inductance": 0.1,  # H
        "heat_capacity": 60.0,  # J/K, of the winding
        "heat_resistance": 4.0,  # K/W, from the winding to the air
        "ambient": 25.0,  # °C, where the winding begins
        "reference_temperature": 25.0,  # °C, at which resistance and viscous friction are as stated
        "speed_noise": 0.03,  # rad/s
        "current_noise": 0.03,  # A
        "angle_noise": 0.0,  # rad
        "winding_temperature_noise": 0.05,  # K
        "speed_resolution": 0.0,  # rad/s, of an encoder
        "current_resolution": 0.0,  # A
        "angle_resolution": 0.0,  # rad
        **SAMPLING,
    },
    effects={
        **with_sizes(
            FRICTION,
            {
                "viscous_friction": {"coefficient": 0.05},
                "coulomb_friction": {"level": 0.2},
                "stribeck_friction": {"level": -0.1, "velocity": 0.01},
                "static_friction": {"level": 0.1},
                "quadratic_viscous_friction": {"coefficient": 0.05},
                "cubic_viscous_friction": {"coefficient": 0.02},
                "friction_asymmetry": {"coefficient": 0.02, "level": 0.0},
                "position_dependent_friction": {"slope": 0.005},
                "load_dependent_friction": {"coefficient": 0.1},
                "presliding_friction": {"stiffness": 40.0, "damping": 0.2},
                "maxwell_slip_friction": {"stiffness": 40.0, "damping": 0.2, "attraction": 20.0},
            },
        ),
        "temperature_dependent_friction": Effect("viscous friction that falls with warmth", {"rate": 0.02}),
        "constant_force": Effect("a constant load torque, N·m", {"force": 0.05}),
        "cogging_torque": Effect(
            "a torque that repeats with the angle, with a second harmonic, N·m",
            {"amplitude": 0.05, "order": 12.0, "phase": 0.0, "second": 0.0},
        ),
        "spring_force": Effect("a torsion spring, N·m/rad", {"stiffness": 0.02}),
        "added_inertia": Effect("inertia on the shaft, kg·m²", {"mass": 0.02}),
        "brush_drop": Effect("a voltage that the brushes take, V", {"voltage": 0.3}),
        "supply_sag": Effect("a supply that gives way, 1/V", {"coefficient": 0.02}),
        "thermal_resistance": Effect("resistance that rises with warmth, 1/K", {"coefficient": COPPER}),
        **with_sizes(
            INPUT_EFFECTS,
            {
                "dead_zone": {"left": 0.4, "right": 0.5},
                "saturation": {"limit": 4.0},
                "backlash": {"gap": 0.5},
                "rate_limit": {"rate": 60.0},
            },
        ),
        **with_sizes(
            OUTPUT_EFFECTS,
            {
                "sensor_gain": {"current_gain": 0.0},
                "sensor_offset": {"offset": 0.05, "current_offset": 0.0},
                "sensor_nonlinearity": {"cubic": 0.01},
                "quantisation": {"step": 0.05},
            },
        ),
    },
    positive=POSITIVE
    | {
        "inertia", "torque_constant", "resistance", "inductance", "heat_capacity", "heat_resistance",
        "hidden_magnet.width", "hidden_drag.speed", "hidden_sticky_patch.width",
    },
    hidden={
        "hidden_magnet": Effect("a magnet that grips the rotor at one angle", {"pull": 0.1, "width": 0.3}),
        "hidden_drag": Effect("a loose cable that drags at low speed only", {"level": 0.05, "speed": 0.5}),
        "hidden_sticky_patch": Effect(
            "a place on every turn that rubs harder", {"level": 0.1, "place": 1.0, "width": 0.4}
        ),
    },
)  # fmt: skip

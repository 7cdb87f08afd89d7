"""Parameters and effects of the simulated ball and beam (see :mod:`labhil.plants.definition`)."""

from __future__ import annotations

from collections.abc import Mapping

from labhil.errors import UsageError
from labhil.plants.definition import CARRIERS, POSITIVE, SAMPLING, Effect, PlantDefinition

BARE_RIG: Mapping[str, float] = {
    "ball_mass": 0.261,  # kg
    "ball_radius": 0.02,  # m
    "crank_radius": 0.08,  # m
    "beam_length": 0.40,  # m, pivot to the linkage's joint
    "stop": 0.25,  # m, end stops at ± this
    "restitution": 0.3,  # speed after a bounce on a stop over speed before
    "start_position": 0.0,  # m, where a hand puts the ball
    "position_noise": 0.0004,  # m, standard deviation before the converter
    "adc_bits": 10.0,
    "adc_range": 0.5,  # m, full scale, centred
}
"""The rig without any effect: parameters and their defaults (SI)."""

EFFECTS: Mapping[str, Effect] = {
    "viscous_friction": Effect("resistance c·v, N·s/m", {"coefficient": 0.26}),
    "coulomb_friction": Effect("dry friction of constant level, N", {"level": 0.09}),
    "stribeck_friction": Effect(
        "dry friction that falls from level to zero with speed, N and m/s", {"level": 0.06, "velocity": 0.02}
    ),
    "static_friction": Effect("extra hold at rest, N", {"level": 0.05}),
    "quadratic_viscous_friction": Effect("resistance c·v|v|, N·s²/m²", {"coefficient": 0.5}),
    "cubic_viscous_friction": Effect("resistance c·v³, N·s³/m³", {"coefficient": 2.0}),
    "friction_asymmetry": Effect(
        "resistance c·|v| (N·s/m) and a dry level (N) that is added forwards and taken off backwards",
        {"coefficient": 0.1, "level": 0.02},
    ),
    "position_dependent_friction": Effect("dry friction that grows along the beam, N/m", {"slope": 0.3}),
    "presliding_friction": Effect(
        "dry friction carried by bristles: stiffness N/m, damping N·s/m (needs a dry friction to carry)",
        {"stiffness": 2000.0, "damping": 10.0},
    ),
    "maxwell_slip_friction": Effect(
        "dry friction shared by elements that stick and slip one after the other: stiffness N/m and damping"
        " N·s/m of all, spread of the stiffest over the softest, attraction N/s of what slips to its level"
        " (needs a dry friction to carry)",
        {"stiffness": 2000.0, "damping": 10.0, "spread": 10.0, "attraction": 10.0},
    ),
    "constant_force": Effect("a force along the beam, N", {"force": 0.03}),
    "spring_force": Effect("a spring towards the pivot, N/m", {"stiffness": 0.5}),
    "added_inertia": Effect("mass that is moved but not pulled by gravity, kg", {"mass": 0.05}),
    "time_delay": Effect("the beam follows the servo angle later, s", {"delay": 0.05}),
    "dead_zone": Effect(
        "servo angles between −left and right do nothing, rad", {"left": 0.06, "right": 0.08}
    ),
    "saturation": Effect("the servo goes no further than ± limit, rad", {"limit": 0.7}),
    "backlash": Effect("play of full width gap in the gear, rad", {"gap": 0.08}),
    "actuator_lag": Effect("the servo follows with a first-order lag, s", {"time_constant": 0.08}),
    "rate_limit": Effect("the servo turns no faster than rate, rad/s", {"rate": 1.5}),
    "sensor_nonlinearity": Effect("measured = x + c·x³, 1/m²", {"cubic": 1.0}),
    "sensor_gain": Effect("measured = (1 + gain)·x", {"gain": 0.05}),
    "sensor_offset": Effect("measured = x + offset, m", {"offset": 0.005}),
    "sensor_lag": Effect("the sensor follows with a first-order lag, s", {"time_constant": 0.05}),
}
"""All effects by name; a plant has those alone that it names."""

HIDDEN: Mapping[str, Effect] = {
    "hidden_magnet": Effect(
        "a magnet under the beam: pull N at its strongest, place and width m",
        {"pull": 0.05, "place": 0.05, "width": 0.02},
    ),
    "hidden_sticky_patch": Effect(
        "a place on the beam that holds the ball harder, N, m", {"level": 0.05, "place": -0.05, "width": 0.01}
    ),
    "hidden_cable": Effect(
        "a cable that pulls the ball back beyond a place, N/m", {"stiffness": 1.0, "from": 0.05}
    ),
}
"""Effects that no list contains, for trials with unmodelled physics."""

DRY = ("coulomb_friction", "stribeck_friction", "friction_asymmetry", "position_dependent_friction")
LONGEST_DELAY = 2.0


def check(values: Mapping[str, float], terms: tuple[str, ...]) -> None:
    """Raise UsageError for sizes, a converter, a delay or effects that do not fit together."""
    if values["crank_radius"] >= values["beam_length"]:
        raise UsageError(
            f"crank_radius ({values['crank_radius']:g} m) must be smaller than beam_length"
            f" ({values['beam_length']:g} m), or the linkage turns over"
        )
    if values["adc_bits"] not in range(4, 17):
        raise UsageError(f"adc_bits must be a whole number from 4 to 16, found {values['adc_bits']:g}")
    if not abs(values["start_position"]) <= values["stop"]:
        raise UsageError(f"start_position must lie within ±stop ({values['stop']:g} m)")
    if not 0.0 <= values.get("time_delay.delay", 0.0) <= LONGEST_DELAY:
        raise UsageError(f"time_delay.delay must lie between 0 and {LONGEST_DELAY:g} s")
    for carrier in CARRIERS:
        if carrier in terms and not set(DRY) & set(terms):
            raise UsageError(f"{carrier} needs a dry friction to carry; add one of: {', '.join(DRY)}")


BALL_BEAM = PlantDefinition(
    bare={**BARE_RIG, **SAMPLING},
    effects=EFFECTS,
    positive=POSITIVE
    | {
        "ball_mass",
        "ball_radius",
        "crank_radius",
        "beam_length",
        "stop",
        "adc_bits",
        "adc_range",
        "hidden_magnet.width",
        "hidden_sticky_patch.width",
    },
    hidden=HIDDEN,
    check=check,
)

"""The benches of the rigs that one input drives."""

from __future__ import annotations

from labhil.campaign.trials.loop import Controller, Loop
from labhil.campaign.trials.one_input import OneInputBench

BALL_BEAM = OneInputBench(
    kind="ball_beam",
    rig='[rig]\nkind = "ball_beam"\n[known]\nball_mass = 0.261\nball_radius = 0.02\n'
    "crank_radius = 0.08\nbeam_length = 0.40\n",
    period=0.01,
    samples=(3000, 3000),
    outputs=("ball_position",),
    noise=(40.0, 52.0),
    parameter_spread={"viscous_friction.coefficient": 1.6},
    # a ball rolls off any beam that nobody levels: there is no open loop
    loops=(Loop(True, Controller(7.0, 3.0, -1.2, 1.2, 12.0), 0.0, 0.85, (0.1, 0.8), (0.8, 2.5)),),
    travel=0.24,
    noise_names={"ball_position": "position_noise"},
)
DC_MOTOR = OneInputBench(
    kind="dc_motor",
    rig='[rig]\nkind = "dc_motor"\n',
    period=0.01,
    samples=(2000, 2000),
    outputs=("speed", "current"),
    noise=(28.0, 42.0),
    parameter_spread={
        "inertia": 1.2, "torque_constant": 1.2, "resistance": 1.2, "inductance": 1.2,
        "viscous_friction.coefficient": 1.6,
    },
    loops=(
        Loop(False, Controller(0.0, 0.0, -8.0, 8.0), 0.0, 5.0, (0.1, 1.5), (0.3, 1.0)),
        Loop(True, Controller(1.5, 0.0, -8.0, 8.0), 0.0, 10.0, (0.1, 1.5), (0.3, 1.0)),
    ),
    auxiliary=("angle", "winding_temperature"),
    # the models say what resistance and friction are at 20 °C
    at_work={"reference_temperature": 20.0},
    warm={"heat_capacity": 3.0},
)  # fmt: skip
AXIS = OneInputBench(
    kind="axis",
    rig='[rig]\nkind = "axis"\n',
    period=0.005,
    samples=(2000, 2000),
    outputs=("position",),
    noise=(50.0, 65.0),
    parameter_spread={
        "moving_mass": 1.3, "viscous_friction.coefficient": 1.5, "coulomb_friction.level": 1.5,
        "constant_force.force": 2.0,
    },
    loops=(
        Loop(False, Controller(0.0, 0.0, -150.0, 150.0), 0.0, 80.0, (0.2, 2.0), (0.15, 0.5)),
        Loop(True, Controller(2000.0, 300.0, -150.0, 150.0), 0.0, 300.0, (0.1, 1.0), (0.4, 1.2)),
    ),
    auxiliary=("temperature",),
    at_work={"reference_temperature": 20.0},
    warm={"warming": 0.1, "cooling": 0.05},
)  # fmt: skip
SOLENOID = OneInputBench(
    kind="solenoid",
    rig='[rig]\nkind = "solenoid"\n[known]\nstop_low = 0.0\nstop_high = 0.005\n',
    period=0.001,
    samples=(2000, 2000),
    outputs=("plunger_position",),
    noise=(25.0, 45.0),
    parameter_spread={"moving_mass": 1.15, "spring_stiffness": 1.15, "viscous_friction.coefficient": 1.6},
    loops=(Loop(False, Controller(0.0, 0.0, 0.0, 2.0), 1.0, 0.45, (1.0, 12.0), (0.03, 0.15)),),
)

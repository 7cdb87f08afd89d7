"""Terms of the input path (command to mechanism) and of sensors (mechanism to sample), for every rig.

u is the command, u_eff what acts on the mechanism, x the true output and y its reading. The functions that
simulate them are in ``physics.input_path``.
"""

from __future__ import annotations

from labhil.physics.terms import CharacteristicScale, Enters, Parameter, Term


def input_terms(unit: str) -> tuple[Term, ...]:
    """Make the terms of the input path: delay, dead zone, backlash, limits and lag.

    Args:
        unit: Unit of the command.

    Returns:
        The terms; their starts are fractions of the largest input.
    """
    return (
        Term(
            "time_delay",
            Enters.INPUT,
            "a delay: the command acts later than it is recorded",
            "u_eff(t) = u(t − T_d)",
            "reference text, section 4.3",
            "any input that changes; several frequencies, to distinguish it from a lag",
            (Parameter("time_delay.delay", "s", 0.05, 0.0, 1.0, starts=(0.05,), step=0.04),),
        ),
        *_play_terms(unit),
        *_limit_terms(unit),
        Term(
            "actuator_lag",
            Enters.INPUT,
            "an actuator that follows as a first-order lag",
            "T·u̇_eff + u_eff = u",
            "standard",
            "several frequencies: its gain falls with frequency, that of a delay does not",
            (Parameter("actuator_lag.time_constant", "s", 0.05, 0.0, 2.0, starts=(0.05,)),),
        ),
    )


def _play_terms(unit: str) -> tuple[Term, ...]:
    """Dead zone and backlash: commands without effect around zero, or after a reversal."""
    return (
        Term(
            "dead_zone",
            Enters.INPUT,
            "a dead zone: small commands have no effect, larger ones are shortened",
            "u_eff = u − U_r above U_r, u + U_l below −U_l, 0 between",
            "eq. 4.18 of the reference text",
            "passages of the command through zero",
            (
                Parameter("dead_zone.left", unit, 0.1, 0.0, starts=(0.07,), of=CharacteristicScale.INPUT),
                Parameter("dead_zone.right", unit, 0.1, 0.0, starts=(0.07,), of=CharacteristicScale.INPUT),
            ),
        ),
        Term(
            "backlash",
            Enters.INPUT,
            "play: after a reversal the mechanism waits until a gap is crossed",
            "u_eff = play operator of width gap",
            "Prandtl's play",
            "reversals of the command at different amplitudes",
            (Parameter("backlash.gap", unit, 0.1, 0.0, starts=(0.1, 0.3), of=CharacteristicScale.INPUT),),
        ),
    )


def _limit_terms(unit: str) -> tuple[Term, ...]:
    """Saturation and rate limit: commands larger or faster than the actuator allows."""
    return (
        Term(
            "saturation",
            Enters.INPUT,
            "saturation: large commands are cut off",
            "u_eff = clip(u, ±1/s)",
            "standard",
            "large amplitudes",
            (
                Parameter(
                    "saturation.inverse_limit",
                    f"1/{unit}",
                    1.0,
                    0.0,
                    starts=(1.2, 1.7),
                    of=CharacteristicScale.INPUT,
                    power=-1,
                ),
            ),
        ),
        Term(
            "rate_limit",
            Enters.INPUT,
            "a rate limit: the actuator follows no faster than its top speed",
            "|du_eff/dt| ≤ 1/r",
            "standard",
            "large and fast commands",
            (
                Parameter(
                    "rate_limit.inverse_rate",
                    f"s/{unit}",
                    1.0,
                    0.0,
                    starts=(1.2, 2.0),
                    of=CharacteristicScale.INPUT_RATE,
                    power=-1,
                ),
            ),
        ),
    )


def offset_term(
    channel: str, unit: str, size: float, revealed_by: str = "rest at a known place, or motion both ways"
) -> Term:
    """Make the offset of the sensor of ``channel``, for a channel with a defined zero.

    Args:
        channel: The output.
        unit: Its unit.
        size: Typical offset in that unit.
        revealed_by: The excitation that shows it.

    Returns:
        The term.
    """
    return Term(
        "sensor_offset",
        Enters.OUTPUT,
        f"an offset of the sensor of {channel}",
        "y = x + y_0",
        "standard",
        revealed_by,
        (Parameter("sensor_offset.offset", unit, size),),
    )


def output_terms(channel: str, unit: str, span: float) -> tuple[Term, ...]:
    """Make the terms of a sensor: nonlinearity, gain error and lag.

    Args:
        channel: The output.
        unit: Its unit.
        span: Typical range of its values in that unit.

    Returns:
        The terms.
    """
    return (
        Term(
            "sensor_nonlinearity",
            Enters.OUTPUT,
            f"a nonlinear sensor of {channel}",
            "y = x + c·x³",
            "odd static curve, first term",
            "motion over the whole range",
            (Parameter("sensor_nonlinearity.cubic", f"1/{unit}²", 0.1 / span**2),),
        ),
        Term(
            "sensor_gain",
            Enters.OUTPUT,
            f"a gain error of the sensor of {channel}",
            "y = (1 + g)·x",
            "standard",
            "any motion",
            (Parameter("sensor_gain.gain", "1", 0.1, -0.9),),
        ),
        Term(
            "sensor_lag",
            Enters.OUTPUT,
            f"a sensor of {channel} that follows as a first-order lag",
            "T·ẏ + y = x",
            "standard",
            "fast motion",
            (Parameter("sensor_lag.time_constant", "s", 0.05, 0.0, 2.0, starts=(0.05,)),),
        ),
    )

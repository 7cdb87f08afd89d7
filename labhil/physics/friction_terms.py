"""Friction terms of a moving part; only the units of force and velocity differ between rigs.

F = c·v + [F_c + F_st·exp(−|v|/v_s)]·sgn v + …, with velocity v, viscous coefficient c, Coulomb level F_c,
Stribeck level F_st and Stribeck velocity v_s (Coulomb 1785; Stribeck 1902). Levels add up: F_st is the
friction at creeping speed above the Coulomb level (negative where that is the larger one, as of the motor in
the reference text), and ``static_friction`` is the break-away force above both. The same laws as compiled
functions are in ``physics.friction``.
"""

from __future__ import annotations

from labhil.physics.friction_law import laws
from labhil.physics.terms import CharacteristicScale, Enters, Parameter, Term

SOURCE = "eq. 4.17 of the reference text, its Stribeck exponent with the minus sign"


def load_dependent_friction(drive: str) -> Term:
    """Dry friction proportional to the force of the drive, which ``drive`` names for the user."""
    return Term(
        "load_dependent_friction",
        Enters.FORCE,
        f"dry friction that grows with {drive}",
        "F = μ·|F_drive|·sgn v",
        "Coulomb's law where the drive itself presses the surfaces (gears, belts, side pull)",
        "small and large drives at the same speeds",
        (Parameter("load_dependent_friction.coefficient", "1", 0.1, 0.0, 0.9, starts=(0.05,)),),
    )


def friction_terms(force: str, length: str, level: float, speed: float) -> tuple[Term, ...]:
    """Make the friction terms of one moving part, user-defined laws included.

    Args:
        force: Unit of force, "N" or "N·m".
        length: Unit of position, "m" or "rad".
        level: A typical friction force in ``force``, which gives scales and starts.
        speed: A typical speed in ``length``/s.

    Returns:
        The terms.
    """
    slope = level / speed
    return (
        _viscous(force, length, slope),
        _coulomb(force, level),
        _static(force, level),
        _stribeck(force, length, level, speed),
        _presliding(length, speed),
        *_drag(force, length, level, speed),
        *_direction_and_position(force, length, level, speed),
        *(law.term(force, length, level, speed) for law in laws()),
    )


def _viscous(force: str, length: str, slope: float) -> Term:
    """Linear viscous friction."""
    return Term(
        "viscous_friction",
        Enters.FORCE,
        "friction that grows in proportion to velocity",
        "F = c·v",
        SOURCE,
        "motion at several speeds",
        (Parameter("viscous_friction.coefficient", f"{force}·s/{length}", slope, 0.0),),
    )


def _coulomb(force: str, level: float) -> Term:
    """Coulomb friction."""
    return Term(
        "coulomb_friction",
        Enters.FORCE,
        "dry friction: a force of constant size against the motion, which also holds at rest",
        "F = F_c·sgn v",
        SOURCE,
        "motion in both directions, reversals",
        (
            Parameter(
                "coulomb_friction.level", force, level, 0.0, starts=(0.2,), of=CharacteristicScale.DRIVE
            ),
        ),
    )


def _static(force: str, level: float) -> Term:
    """Break-away force above Coulomb and Stribeck friction."""
    return Term(
        "static_friction",
        Enters.FORCE,
        "a hold at rest beyond the friction of creeping motion",
        "|F| ≤ F_c + F_st + F_hold at v = 0",
        "Coulomb's stiction as an event",
        "slow reversals with stops",
        (
            # a held input is constant between samples, so the instant of break-away changes in steps
            Parameter(
                "static_friction.level",
                force,
                level,
                0.0,
                starts=(0.1,),
                of=CharacteristicScale.DRIVE,
                step=0.05,
                in_steps=True,
            ),
        ),
    )


def _stribeck(force: str, length: str, level: float, speed: float) -> Term:
    """Stribeck friction."""
    return Term(
        "stribeck_friction",
        Enters.FORCE,
        "dry friction that falls from its break-away value as motion sets in",
        "F = F_st·exp(−|v|/v_s)·sgn v",
        SOURCE,
        "creeping motion and reversals",
        (
            Parameter(
                "stribeck_friction.level",
                force,
                level,
                -10.0 * level,
                10.0 * level,
                starts=(0.1,),
                of=CharacteristicScale.DRIVE,
            ),
            Parameter(
                "stribeck_friction.velocity",
                f"{length}/s",
                0.1 * speed,
                5e-4 * speed,
                10.0 * speed,
                starts=(0.2, 0.05, 0.8),
                of=CharacteristicScale.SPEED,
                shape=True,
            ),
        ),
        with_terms=("coulomb_friction",),
        narrow="static_friction",
        statement_if_negative="dry friction that is smaller as motion sets in and rises to its full value",
    )


def _presliding(length: str, speed: float) -> Term:
    """Dry friction that turns over a short way after a reversal."""
    return Term(
        "presliding_friction",
        Enters.FORCE,
        "dry friction that turns over a short way after a reversal (bristles)",
        "b + τ·db/dt in the place of sgn v, db = (dx − b·|dx|)/ℓ",
        "LuGre (Canudas de Wit et al. 1995): ℓ is level over stiffness, τ damping over stiffness",
        "reversals",
        (
            Parameter(
                "presliding_friction.length",
                length,
                1e-4 * speed,
                1e-7 * speed,
                0.1 * speed,
                starts=(1e-4, 1e-3),
                of=CharacteristicScale.SPEED,
            ),
            Parameter("presliding_friction.time_constant", "s", 5e-3, 0.0, 0.1, starts=(2e-3,)),
        ),
        with_terms=("coulomb_friction",),
    )


def _drag(force: str, length: str, level: float, speed: float) -> tuple[Term, ...]:
    """Drag of second and third order in velocity."""
    slope = level / speed
    return (
        Term(
            "quadratic_viscous_friction",
            Enters.FORCE,
            "friction that grows with the square of velocity (drag)",
            "F = c₂·v·|v|",
            SOURCE,
            "fast motion",
            (
                Parameter(
                    "quadratic_viscous_friction.coefficient", f"{force}·s²/{length}²", slope / speed, 0.0
                ),
            ),
        ),
        Term(
            "cubic_viscous_friction",
            Enters.FORCE,
            "friction that grows with the cube of velocity",
            "F = c₃·v³",
            SOURCE,
            "fast motion",
            (
                Parameter(
                    "cubic_viscous_friction.coefficient", f"{force}·s³/{length}³", slope / speed**2, 0.0
                ),
            ),
        ),
    )


def _direction_and_position(force: str, length: str, level: float, speed: float) -> tuple[Term, ...]:
    """Friction that depends on direction or position."""
    slope = level / speed
    return (
        Term(
            "friction_asymmetry",
            Enters.FORCE,
            "friction that differs with the direction of motion",
            "F = c_a·|v|",
            "even part of a friction curve; its constant part is the same as a constant force",
            "several speeds both ways",
            (Parameter("friction_asymmetry.coefficient", f"{force}·s/{length}", slope),),
        ),
        Term(
            "position_dependent_friction",
            Enters.FORCE,
            "dry friction that changes along the way",
            "F = s·x·sgn v",
            "first-order expansion of F_c(x)",
            "the same speeds at different places",
            (Parameter("position_dependent_friction.slope", f"{force}/{length}", level / 0.2),),
        ),
    )

"""Definition of a simulated rig: its parameters, the effects it can have, and which of them can be combined.

Each rig has one (``dc_motor_definition``, ``solenoid_definition``, …); the effects common to all are here.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass

from labhil.errors import UnknownNameError, UsageError

NOT_NEGATIVE = (
    "_noise", "_resolution", "stamp_jitter", "stamp_error", "warming", "cooling", ".delay", ".gap", ".left",
    ".right", ".damping", ".time_constant", ".compliance", "quantisation.step", "magnetic_hysteresis.width",
    "spring_stiffness",
)  # fmt: skip
"""Endings of the names of parameters that are not negative."""

CARRIERS = ("presliding_friction", "maxwell_slip_friction")
"""Effects that replace the event-based law of dry friction."""


@dataclass(frozen=True, slots=True)
class Effect:
    """An effect of a simulated rig; ``parameters`` maps short names to defaults (SI)."""

    about: str
    parameters: Mapping[str, float]


def _accept(_values: Mapping[str, float], _terms: tuple[str, ...]) -> None:
    """Accept any parameters."""


@dataclass(frozen=True, slots=True)
class PlantDefinition:
    """Parameters and effects of a simulated rig.

    Attributes:
        bare: Parameters of the rig without effects, with their defaults, SI.
        effects: Effects by name.
        positive: Names of parameters that must be larger than zero.
        hidden: Effects that no list contains, for trials with unmodelled physics.
        check: Raises UsageError for parameters and effects of this rig that do not fit together.
    """

    bare: Mapping[str, float]
    effects: Mapping[str, Effect]
    positive: frozenset[str]
    hidden: Mapping[str, Effect]
    check: Callable[[Mapping[str, float], tuple[str, ...]], None] = _accept

    def parameters_of(self, effect: str) -> dict[str, float]:
        """Return the parameters of an effect by full name (``effect.parameter``) with their defaults.

        Raises:
            UnknownNameError: No effect has this name; the message lists those that are not hidden.
        """
        definition = self.effects.get(effect) or self.hidden.get(effect)
        if definition is None:
            raise UnknownNameError("effect", effect, self.effects)
        return {f"{effect}.{name}": value for name, value in definition.parameters.items()}

    def all_parameters(self) -> dict[str, float]:
        """Return all parameters with their defaults (SI), those of hidden effects included."""
        named = [self.parameters_of(effect) for effect in (*self.effects, *self.hidden)]
        return dict(self.bare) | {name: value for group in named for name, value in group.items()}

    def resolve(self, terms: Iterable[str], overrides: Mapping[str, float]) -> dict[str, float]:
        """Return the parameters of the rig with some effects.

        Args:
            terms: Names of the effects.
            overrides: Values by parameter name, SI.

        Returns:
            Values of all parameters, SI.

        Raises:
            UnknownNameError: An effect or a parameter does not exist.
            UsageError: A parameter belongs to an effect that is not in ``terms``, or a value is out of range.
        """
        chosen = tuple(terms)
        values = dict(self.bare)
        for term in chosen:
            values |= self.parameters_of(term)
        for name, value in overrides.items():
            if name not in values:
                self._refuse(name, chosen)
            values[name] = float(value)
        for name, value in values.items():
            self._check(name, value)
        if set(CARRIERS) <= set(chosen):
            raise UsageError(f"{' and '.join(CARRIERS)} both carry the dry friction; choose one of them")
        self.check(values, chosen)
        low, high = values.get("stop_low", -math.inf), values.get("stop_high", math.inf)
        if low >= high:
            raise UsageError(f"stop_high must lie above stop_low ({low:g}), found {high:g}")
        return values

    def _refuse(self, name: str, chosen: tuple[str, ...]) -> None:
        known = self.all_parameters()
        effect = name.partition(".")[0]
        if name not in known:
            listed = [key for key in known if key.partition(".")[0] not in self.hidden]
            raise UnknownNameError("parameter", name, listed)
        raise UsageError(
            f"{name} belongs to {effect}, which is not among the terms: {', '.join(chosen) or 'none'}"
        )

    def _check(self, name: str, value: float) -> None:
        if name in self.positive:
            fits, kind = 0.0 < value < math.inf, "be a positive number"
        elif name == "noise_correlation":
            fits, kind = abs(value) < 1.0, "lie between −1 and 1"
        elif name.endswith(".restitution"):
            fits, kind = 0.0 <= value <= 1.0, "be at least 0 and at most 1"
        elif name.endswith(NOT_NEGATIVE):
            fits, kind = 0.0 <= value < math.inf, "be a finite number that is not negative"
        else:
            fits, kind = abs(value) < math.inf, "be a finite number"
        if not fits:
            raise UsageError(f"{name} must {kind}, found {value:g}")


SAMPLING: Mapping[str, float] = {
    "noise_correlation": 0.0,  # of neighbouring samples, every channel's
    "stamp_jitter": 0.0,  # s, standard deviation of samples and commands from an even clock
    "stamp_error": 0.0,  # s, standard deviation of time stamps from the true times
}
"""Parameters of the sampling, common to all rigs."""

POSITIVE = frozenset(
    {
        "stribeck_friction.velocity", "presliding_friction.stiffness", "saturation.limit", "rate_limit.rate",
        "actuator_lag.time_constant", "sensor_lag.time_constant", "maxwell_slip_friction.stiffness",
        "maxwell_slip_friction.spread", "maxwell_slip_friction.attraction",
    }
)  # fmt: skip
"""Parameters of the effects below that must be larger than zero."""

FRICTION: Mapping[str, Effect] = {
    "viscous_friction": Effect("resistance c·v", {"coefficient": 1.0}),
    "coulomb_friction": Effect("dry friction of constant level", {"level": 1.0}),
    "stribeck_friction": Effect(
        "dry friction that falls from level to zero with speed", {"level": 1.0, "velocity": 0.1}
    ),
    "static_friction": Effect("extra hold at rest", {"level": 1.0}),
    "quadratic_viscous_friction": Effect("resistance c·v|v|", {"coefficient": 1.0}),
    "cubic_viscous_friction": Effect("resistance c·v³", {"coefficient": 1.0}),
    "friction_asymmetry": Effect(
        "resistance c·|v| and a dry level that is added forwards and taken off backwards",
        {"coefficient": 1.0, "level": 0.0},
    ),
    "position_dependent_friction": Effect("dry friction that grows along the way", {"slope": 1.0}),
    "load_dependent_friction": Effect(
        "dry friction that grows with the size of the drive's force", {"coefficient": 0.05}
    ),
    "presliding_friction": Effect(
        "dry friction carried by bristles (LuGre)", {"stiffness": 1.0, "damping": 1.0}
    ),
    "maxwell_slip_friction": Effect(
        "dry friction shared by elements that stick and slip one after the other, with a spread of the"
        " stiffest over the softest and an attraction per second to the level (generalised Maxwell-slip)",
        {"stiffness": 1.0, "damping": 1.0, "spread": 10.0, "attraction": 100.0},
    ),
}
"""Friction laws of all moving parts; each rig has its own defaults."""

INPUT_EFFECTS: Mapping[str, Effect] = {
    "time_delay": Effect("the command acts later, s", {"delay": 0.02}),
    "dead_zone": Effect("commands between −left and right do nothing", {"left": 1.0, "right": 1.0}),
    "saturation": Effect("the command goes no further than ± limit", {"limit": 1.0}),
    "backlash": Effect("play of full width gap", {"gap": 1.0}),
    "actuator_lag": Effect("the command acts through a first-order lag, s", {"time_constant": 0.02}),
    "rate_limit": Effect("the command changes no faster than rate per second", {"rate": 1.0}),
}
"""Effects of the input path; parameters in the unit of the command."""

OUTPUT_EFFECTS: Mapping[str, Effect] = {
    "sensor_gain": Effect("measured = (1 + gain)·x", {"gain": 0.05}),
    "sensor_offset": Effect("measured = x + offset", {"offset": 0.01}),
    "sensor_nonlinearity": Effect("measured = x + c·x³", {"cubic": 0.01}),
    "sensor_lag": Effect("the sensor follows with a first-order lag, s", {"time_constant": 0.02}),
    "quantisation": Effect("a sensor that counts in steps", {"step": 0.01}),
}
"""Effects of the first sensor."""


def with_sizes(effects: Mapping[str, Effect], sizes: Mapping[str, Mapping[str, float]]) -> dict[str, Effect]:
    """Replace the general defaults of effects by those of a rig."""
    return {
        name: Effect(effect.about, {**effect.parameters, **sizes.get(name, {})})
        for name, effect in effects.items()
    }

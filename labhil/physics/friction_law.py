"""User-defined friction laws: any function of speed, added as a term to every moving part.

``F = c·g(|v|, s)·sgn v`` against the motion, with an estimated coefficient c and an optional shape parameter
s. A law is defined once, in Python (:func:`add_law`) or by a package with an entry point of the group
``labhil.terms``. Fits, diagnoses and plots of every rig, arms and simulators included, then have it. Kernels
hold such laws as one table over speed (see ``physics.extra_force``), so nothing is compiled for a law.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field

import numpy as np

from labhil.errors import UnknownNameError, UsageError
from labhil.physics.quantity import Quantity
from labhil.physics.terms import Enters, Parameter, Term
from labhil.plugins import installed_terms
from labhil.signals import FloatArray

SLOWEST_POWER, FASTEST_POWER, PER_OCTAVE = -20, 13, 12
SLOWEST, FASTEST = 2.0**SLOWEST_POWER, 2.0**FASTEST_POWER
"""Range of speeds (m/s or rad/s) of the table of a law, with ``PER_OCTAVE`` nodes to an octave."""

_OCTAVES = 2.0 ** np.arange(SLOWEST_POWER, FASTEST_POWER)
GRID: FloatArray = np.concatenate(
    [[0.0], np.outer(_OCTAVES, 1.0 + np.arange(PER_OCTAVE) / PER_OCTAVE).ravel(), [FASTEST]]
)
"""Speeds (398,) at which a law is tabulated. Linear interpolation of √|v| has a relative error of 3e-4."""

SUFFIX = "_friction"
LABHIL = "labhil"
"""Provider of the built-in terms."""

BUILT_IN = frozenset(
    f"{name}{SUFFIX}"
    for name in (
        "viscous", "coulomb", "static", "stribeck", "quadratic_viscous", "cubic_viscous",
        "position_dependent", "load_dependent", "temperature_dependent", "presliding",
    )
)  # fmt: skip
"""Names of the built-in friction terms, which a law must not take."""


@dataclass(frozen=True, slots=True)
class FrictionLaw:
    """A friction law ``F = c·g(|v|, s)·sgn v``, added to every catalogue by :func:`add_law`.

    Attributes:
        name: Name of the term; ends in ``_friction``.
        g: Function of speeds (n,) in m/s or rad/s, 0 included, and of the shape parameter s if ``shape`` has
            one; returns (n,) numbers.
        unit: Unit of the coefficient c, with ``{force}`` and ``{length}`` for the units of the part (N and m,
            or N·m and rad).
        statement: The effect in a few plain words.
        equation: The equation in text.
        source: Where the law is from.
        revealed_by: The motion that shows it.
        shape: The shape parameter s by name; at most one.

    Raises:
        UsageError: The name is invalid or taken, or ``g`` does not return finite numbers.

    Example:
        >>> import labhil as lh, numpy as np
        >>> law = lh.FrictionLaw(
        ...     "sqrt_friction",
        ...     lambda v: np.sqrt(v),
        ...     unit="{force}·√s/√{length}",
        ...     statement="friction that grows with the square root of speed",
        ...     equation="F = c·√|v|·sgn v",
        ...     source="this example",
        ...     revealed_by="motion at several speeds",
        ... )
        >>> law.force_at(0.25, 2.0)
        1.0
    """

    name: str
    g: Callable[..., FloatArray]
    unit: str
    statement: str
    equation: str
    source: str
    revealed_by: str = "motion at several speeds"
    shape: Mapping[str, Quantity] = field(default_factory=dict)

    def __post_init__(self) -> None:
        if not self.name.isidentifier() or not self.name.endswith(SUFFIX) or self.name in BUILT_IN:
            raise UsageError(
                f"friction law: expected a name of letters, digits and _ that ends in {SUFFIX} and is not "
                f"one of labhil's own ({', '.join(sorted(BUILT_IN))}), found {self.name!r}"
            )
        if len(self.shape) > 1:
            raise UsageError(
                f"friction law {self.name!r}: shape: expected one parameter at most, found "
                f"{', '.join(self.shape)}"
            )
        try:
            self.unit.format(force="N", length="m")
        except (KeyError, IndexError, ValueError) as error:
            raise UsageError(
                f"friction law {self.name!r}: unit: expected a text with {{force}} and {{length}} at most in "
                f"braces, found {self.unit!r}"
            ) from error
        for quantity in self.shape.values() or [Quantity(0.0, "1", 0.0, 0.0)]:
            for value in {quantity.start, *quantity.bounds}:
                self._check_values(value)

    @property
    def coefficient(self) -> str:
        """Name of the coefficient c."""
        return f"{self.name}.coefficient"

    @property
    def shaped_by(self) -> str | None:
        """Name of the shape parameter s; None if there is none."""
        return next((f"{self.name}.{name}" for name in self.shape), None)

    @property
    def shape_start(self) -> float:
        """Start of the shape parameter s in a fit; 0 if there is none."""
        return next((quantity.start for quantity in self.shape.values()), 0.0)

    def values(self, speeds: FloatArray, shape: float) -> FloatArray:
        """Evaluate g at speeds (n,); the result (n,) may contain values that are not finite."""
        with np.errstate(all="ignore"):  # callers check for values that are not finite
            return np.asarray(self.g(speeds, shape) if self.shape else self.g(speeds), dtype=float)

    def _check_values(self, shape: float) -> None:
        """Raise UsageError unless g gives a finite number at every tabulated speed."""
        try:
            forces = self.values(GRID, shape)
        except (TypeError, ValueError, ArithmeticError, LookupError, AttributeError) as error:
            raise UsageError(
                f"friction law {self.name!r}: expected g to take speeds (n,)"
                f"{' and a shape' * bool(self.shape)}, found that it raises {type(error).__name__}: {error}"
            ) from error
        if forces.shape == GRID.shape and np.isfinite(forces).all():
            return
        at = f" and {self.shaped_by} {shape:g}" if self.shape else ""
        what = f"the shape {forces.shape}" if forces.shape != GRID.shape else "some that are none"
        raise UsageError(
            f"friction law {self.name!r}: expected g to give a finite number for each of {GRID.shape} speeds "
            f"from 0 to {FASTEST:g}{at}, found {what}"
        )

    def force_at(self, speed: float, coefficient: float, shape: float | None = None) -> float:
        """Friction force at one speed, in the unit of force of the part."""
        at = self.shape_start if shape is None else shape
        return float(coefficient * self.values(np.array([abs(speed)]), at)[0])

    def term(self, force: str, length: str, level: float, speed: float, joint: int | None = None) -> Term:
        """Make the term of one moving part.

        Args:
            force: Unit of force of the part, "N" or "N·m".
            length: Unit of its position, "m" or "rad".
            level: A typical friction force in ``force``.
            speed: A typical speed in ``length``/s.
            joint: Joint of an arm, from 0.

        Returns:
            The term, with the scale of the coefficient such that it gives ``level`` at ``speed``.
        """
        typical = abs(float(self.values(np.array([speed]), self.shape_start)[0])) or 1.0
        scale = level / typical
        unit = self.unit.format(force=force, length=length)
        parameters = [
            Parameter(
                self.coefficient, unit, scale, 0.0, starts=(scale,), linear=joint is not None, joint=joint
            )
        ]
        for name, quantity in self.shape.items():
            parameters.append(quantity.parameter(f"{self.name}.{name}", shape=True, joint=joint))
        return Term(
            self.name, Enters.FORCE, self.statement, self.equation, self.source, self.revealed_by,
            tuple(parameters), joint=joint,
        )  # fmt: skip

    def force(self, speeds: FloatArray, values: Callable[[str], float]) -> FloatArray:
        """Friction force (n,) at speeds (n,); ``values`` gives a parameter by name."""
        coefficient = values(self.coefficient)
        if not coefficient:
            return np.zeros_like(speeds)
        shape = values(self.shaped_by) if self.shaped_by else 0.0
        return coefficient * self.values(speeds, shape)


_ADDED: dict[str, FrictionLaw] = {}


def add_law(law: FrictionLaw) -> FrictionLaw:
    """Add a friction law to the terms of every rig and simulator in this process.

    A law of the same name is replaced. To have a law on the command line and in every process, install it as
    a package: see docs/how-to/add-a-law.md.

    Args:
        law: The law.

    Returns:
        The same law.

    Raises:
        UsageError: ``law`` is not a FrictionLaw.

    Example:
        >>> import labhil as lh, numpy as np
        >>> law = lh.FrictionLaw(
        ...     "sqrt_friction",
        ...     lambda v: np.sqrt(v),
        ...     unit="{force}·√s/√{length}",
        ...     statement="friction that grows with the square root of speed",
        ...     equation="F = c·√|v|·sgn v",
        ...     source="this example",
        ... )
        >>> _ = lh.add_law(law)
        >>> lh.model("axis").terms["sqrt_friction"].parameters[0].unit
        'N·√s/√m'
        >>> _ = lh.remove_law(law.name)
    """
    if not isinstance(law, FrictionLaw):
        raise UsageError(f"law: expected a labhil.FrictionLaw, found {type(law).__name__}")
    _ADDED[law.name] = law
    return law


def remove_law(name: str) -> FrictionLaw:
    """Remove a law that :func:`add_law` added; models made afterwards do not have it.

    Args:
        name: Name of the law.

    Returns:
        The removed law.

    Raises:
        UnknownNameError: No law of that name was added.

    Example:
        >>> import labhil as lh
        >>> lh.remove_law("sqrt_friction")
        Traceback (most recent call last):
        labhil.errors.UnknownNameError: added law 'sqrt_friction' does not exist; known: none
    """
    if name not in _ADDED:
        raise UnknownNameError("added law", name, _ADDED)
    return _ADDED.pop(name)


def laws() -> tuple[FrictionLaw, ...]:
    """List all user-defined friction laws.

    Returns:
        Laws of installed packages, then those of :func:`add_law`, which replace others of the same name.

    Raises:
        UsageError: An entry point of a package does not provide a FrictionLaw.
    """
    installed = {law.name: law for law in _installed().values()}
    return tuple({**installed, **_ADDED}.values())


def _installed() -> dict[str, FrictionLaw]:
    """Laws of installed packages by "package: entry point"."""
    by_place = {}
    for place, law in installed_terms():
        if not isinstance(law, FrictionLaw):
            raise UsageError(
                f"entry point {place} of the group labhil.terms: expected a labhil.FrictionLaw, found "
                f"{type(law).__name__}"
            )
        by_place[place] = law
    return by_place


def provider(name: str) -> str:
    """Provider of a term: "added in Python", the entry point of a package, or "labhil"."""
    if name in _ADDED:
        return "added in Python"
    places = {law.name: place for place, law in _installed().items()}
    return places.get(name, LABHIL)

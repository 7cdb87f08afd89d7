"""Friction laws of one's own: any function of speed, offered to every moving part as a term.

``F = c·g(|v|, s)`` against the motion, c estimated and s a shape parameter that g may have. A law is stated
once, in Python (:func:`add_law`) or by a package with an entry point of the group ``labhil.terms``, and is
then offered, fitted, diagnosed and plotted for every rig, arms and simulators included. The kernels of moving
parts hold such laws as one table over speed (see ``physics.extra_force``): nothing is compiled for a law.
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
"""Speeds (m/s or rad/s) between which the table of a law has nodes."""

_OCTAVES = 2.0 ** np.arange(SLOWEST_POWER, FASTEST_POWER)
GRID: FloatArray = np.concatenate(
    [[0.0], np.outer(_OCTAVES, 1.0 + np.arange(PER_OCTAVE) / PER_OCTAVE).ravel(), [FASTEST]]
)
"""Speeds (398,) at which a law is tabulated: 0, then 12 to an octave; √|v| is straight in between to 3e-4."""

SUFFIX = "_friction"
LABHIL = "labhil"
"""Who provides what labhil has itself."""

BUILT_IN = frozenset(
    f"{name}{SUFFIX}"
    for name in (
        "viscous", "coulomb", "static", "stribeck", "quadratic_viscous", "cubic_viscous",
        "position_dependent", "load_dependent", "temperature_dependent", "presliding",
    )
)  # fmt: skip
"""Terms of this form that labhil has itself."""


@dataclass(frozen=True, slots=True)
class FrictionLaw:
    """A friction law ``F = c·g(|v|, s)·sgn v``, to be added to every catalogue by :func:`add_law`.

    ``g`` takes speeds (n,) in m/s or rad/s, 0 included, and where ``shape`` names a parameter its value too;
    it returns as many numbers. The coefficient c has the unit ``unit``, in which ``{force}`` and ``{length}``
    stand for those of the part (N and m, N·m and rad). ``source`` is where the law is from, ``revealed_by``
    the motion that shows it.

    Raises:
        UsageError: The name is taken or none, or ``g`` does not give finite numbers.

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
        """Name of the parameter c."""
        return f"{self.name}.coefficient"

    @property
    def shaped_by(self) -> str | None:
        """Name of the parameter s, where there is one."""
        return next((f"{self.name}.{name}" for name in self.shape), None)

    @property
    def shape_start(self) -> float:
        """Where a fit of s starts."""
        return next((quantity.start for quantity in self.shape.values()), 0.0)

    def values(self, speeds: FloatArray, shape: float) -> FloatArray:
        """g (n,) at speeds (n,)."""
        with np.errstate(all="ignore"):  # what is no number then is the business of whoever asks
            return np.asarray(self.g(speeds, shape) if self.shape else self.g(speeds), dtype=float)

    def _check_values(self, shape: float) -> None:
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
        """The friction at one speed, in the unit of force."""
        at = self.shape_start if shape is None else shape
        return float(coefficient * self.values(np.array([abs(speed)]), at)[0])

    def term(self, force: str, length: str, level: float, speed: float, joint: int | None = None) -> Term:
        """The term of one moving part.

        ``force`` and ``length`` are its units, ``level`` and ``speed`` a typical friction and velocity in
        them; ``joint`` is the joint of an arm that it is.
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
        """Friction (n,) at speeds (n,), for parameters by name; zeros where the coefficient is zero."""
        coefficient = values(self.coefficient)
        if not coefficient:
            return np.zeros_like(speeds)
        shape = values(self.shaped_by) if self.shaped_by else 0.0
        return coefficient * self.values(speeds, shape)


_ADDED: dict[str, FrictionLaw] = {}


def add_law(law: FrictionLaw) -> FrictionLaw:
    """Offer a friction law to every rig and simulator of this process; one of the same name takes its place.

    What is offered on the command line and to everybody is an installed package's, see
    docs/how-to/add-a-law.md.

    Args:
        law: The law.

    Returns:
        The law.

    Raises:
        UsageError: It is none.

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
    """Take back what :func:`add_law` added; models that are made from here on do not have it.

    Args:
        name: The law's name.

    Returns:
        The law that was there.

    Raises:
        UnknownNameError: None of that name was added.

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
    """All laws that were added, those of installed packages first.

    Raises UsageError where what a package provides is no law.
    """
    installed = {law.name: law for law in _installed().values()}
    return tuple({**installed, **_ADDED}.values())


def _installed() -> dict[str, FrictionLaw]:
    """Laws of installed packages, by package and name of the entry point."""
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
    """Who provides a term: a package, "added in Python", or labhil."""
    if name in _ADDED:
        return "added in Python"
    places = {law.name: place for place, law in _installed().items()}
    return places.get(name, LABHIL)

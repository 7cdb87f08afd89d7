"""A parameter that a user states: the start of its fit, its unit and its bounds."""

from __future__ import annotations

from dataclasses import dataclass

from labhil.physics.terms import Parameter

BOUND_FACTOR = 1e3
"""Default bounds are the start over and times this factor."""


@dataclass(frozen=True, slots=True)
class Quantity:
    """A parameter of a simulator or of a friction law.

    Attributes:
        start: Value from which a fit starts.
        unit: Its unit.
        lower: Lower bound; without bounds, the value may change by a factor of 1000 and keeps its sign.
        upper: Upper bound.

    Example:
        >>> from labhil import Quantity
        >>> Quantity(0.02, "kg·m²").bounds
        (2e-05, 20.0)
    """

    start: float
    unit: str = "1"
    lower: float | None = None
    upper: float | None = None

    @property
    def bounds(self) -> tuple[float, float]:
        """Lower and upper bound of a fit."""
        ends = sorted((self.start / BOUND_FACTOR, self.start * BOUND_FACTOR)) if self.start else (-1e6, 1e6)
        low = ends[0] if self.lower is None else self.lower
        return low, ends[1] if self.upper is None else self.upper

    def parameter(self, name: str, *, shape: bool = False, joint: int | None = None) -> Parameter:
        """Convert to a parameter of a model, as a ``shape`` if it has no meaning at level zero."""
        scale = abs(self.start) or 1.0
        return Parameter(name, self.unit, scale, *self.bounds, starts=(self.start,), shape=shape, joint=joint)

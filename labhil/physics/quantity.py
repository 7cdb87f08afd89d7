"""A number that its user states: where a fit of it starts, and what it may be."""

from __future__ import annotations

from dataclasses import dataclass

from labhil.physics.terms import Parameter

DECADES = 1e3


@dataclass(frozen=True, slots=True)
class Quantity:
    """A parameter of a simulator or of a law: where a fit starts, its unit, and what it may be.

    Without bounds a positive start may change by a factor of 1000 both ways and keeps its sign.

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
        """The least and the largest value that a fit may find."""
        ends = sorted((self.start / DECADES, self.start * DECADES)) if self.start else (-1e6, 1e6)
        low = ends[0] if self.lower is None else self.lower
        return low, ends[1] if self.upper is None else self.upper

    def parameter(self, name: str, *, shape: bool = False, joint: int | None = None) -> Parameter:
        """As fits take it; as a ``shape`` it is nothing while the level of its term is zero."""
        scale = abs(self.start) or 1.0
        return Parameter(name, self.unit, scale, *self.bounds, starts=(self.start,), shape=shape, joint=joint)

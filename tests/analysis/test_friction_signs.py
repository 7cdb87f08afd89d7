"""Signs of friction: what a term's statement says of it holds for each of its values."""

from __future__ import annotations

import pytest

from labhil.physics.friction_terms import friction_terms


@pytest.mark.parametrize("name", ["coulomb_friction", "stribeck_friction", "static_friction"])
def test_a_level_of_dry_friction_is_not_negative(name: str) -> None:
    """Beside Coulomb friction a negative Stribeck level fits a drag that levels off, which it is not."""
    (term,) = [term for term in friction_terms("N", "m", 1.0, 1.0) if term.name == name]
    (level,) = [parameter for parameter in term.parameters if parameter.key == f"{name}.level"]
    assert level.lower == 0.0

"""For those who bring physics: friction laws, and models of rigs of their own.

A friction law holds for every rig (``docs/how-to/add-a-law.md``); a :class:`RightHandSide` is the model of a
kind of rig that labhil does not know (``docs/how-to/add-a-twin-and-a-rig.md``). A simulator that you have is
not physics to write anew: see :func:`labhil.simulator`, :func:`labhil.mujoco_simulator` and
:func:`labhil.fmu_simulator`. labhil's own models are in the modules of this package, one per rig.

Example:
    >>> from labhil.physics import Parameter, RightHandSide
    >>> tank = RightHandSide(
    ...     states={"level": 0.05},  # m, with the typical error of a guess
    ...     derivative=lambda t, x, u, p: (p["gain"] * u - 0.01 * x) / p["area"],
    ...     output=lambda x, u, p: x,
    ...     guess=lambda t, y: y[0],
    ...     parameters=(
    ...         Parameter("area", "m²", scale=0.1, lower=1e-3, upper=10.0, starts=(0.2,)),
    ...         Parameter("gain", "m³/(V·s)", scale=0.01, lower=1e-4, upper=1.0, starts=(0.02,)),
    ...     ),
    ...     horizon=10.0,  # s
    ... )
    >>> [parameter.name for parameter in tank.parameters]
    ['area', 'gain']
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from labhil.physics.friction_law import FrictionLaw, add_law, remove_law
    from labhil.physics.quantity import Quantity
    from labhil.physics.right_hand_side import RightHandSide
    from labhil.physics.terms import Enters, Parameter, Term

__all__ = [
    "Enters",
    "FrictionLaw",
    "Parameter",
    "Quantity",
    "RightHandSide",
    "Term",
    "add_law",
    "remove_law",
]

_MODULE_OF = {
    "Enters": "terms",
    "FrictionLaw": "friction_law",
    "Parameter": "terms",
    "Quantity": "quantity",
    "RightHandSide": "right_hand_side",
    "Term": "terms",
    "add_law": "friction_law",
    "remove_law": "friction_law",
}


def __getattr__(name: str) -> Any:
    """Import a public name when it is first used: a twin needs one module of this package, not all."""
    if name not in _MODULE_OF:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(import_module(f"{__name__}.{_MODULE_OF[name]}"), name)

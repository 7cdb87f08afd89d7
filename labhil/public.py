"""Where the names of ``import labhil`` are defined, and how two of them share a name with a package of ours.

``labhil.recording`` and ``labhil.diagnose`` are packages, and what people call are the functions of that
name. Python binds a package to its parent when it is first imported; as a :class:`CallablePackage` it
answers a call with the function, whichever of the two was there first.
"""

from __future__ import annotations

from importlib import import_module
from types import ModuleType
from typing import Any

WHERE = {
    "labhil.analysis.schema": (
        "ExcludedEffect",
        "Improvement",
        "Location",
        "MissingEffect",
        "Parameter",
        "Rival",
        "Score",
    ),
    "labhil.api.acquisition": ("Experiment", "connect", "run"),
    "labhil.api.comparison": ("Comparison", "compare"),
    "labhil.api.diagnosis": ("Diagnosis", "diagnose"),
    "labhil.api.fit": ("Fit", "fit"),
    "labhil.api.model": ("Model", "Terms", "model"),
    "labhil.api.arrays": ("recording",),
    "labhil.api.recording": ("Recording", "read"),
    "labhil.api.saved": ("load",),
    "labhil.api.simulation": ("Simulation",),
    "labhil.api.verification": ("Verification", "verify"),
    "labhil.experiment.bench": ("Bench",),
    "labhil.experiment.hooks": ("RunContext",),
    "labhil.physics.friction_law": ("FrictionLaw", "add_law", "remove_law"),
    "labhil.physics.quantity": ("Quantity",),
    "labhil.simulators.arm": ("ArmSimulator",),
    "labhil.simulators.columns": ("SimulatedOutput", "simulated_output"),
    "labhil.simulators.fmu": ("fmu_simulator",),
    "labhil.simulators.mjcf": ("mujoco_simulator",),
    "labhil.simulators.several_columns": ("SimulatedOutputs", "simulated_outputs"),
    "labhil.simulators.simulator": ("Coordinate", "Simulator", "simulator"),
}
MODULE_OF = {name: module for module, names in WHERE.items() for name in names}
MODULES = ("devices", "errors", "physics", "testing")


def public(name: str) -> Any:
    """The function, class or module that people know by this name; KeyError where there is none."""
    if name in MODULES:
        return import_module(f"labhil.{name}")
    return getattr(import_module(MODULE_OF[name]), name)


class CallablePackage(ModuleType):
    """A package that is called, and described, as the public function of its name."""

    def _function(self) -> Any:
        return public(self.__name__.rpartition(".")[2])

    def __call__(self, *arguments: Any, **options: Any) -> Any:
        """Call the function."""
        return self._function()(*arguments, **options)

    @property
    def __doc__(self) -> str | None:  # type: ignore[override]
        return public(self.__name__.rpartition(".")[2]).__doc__

    @property
    def __signature__(self) -> Any:
        import inspect

        return inspect.signature(self._function())

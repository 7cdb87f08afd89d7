"""labhil: record a rig and its simulation, find where they disagree, and name the missing physics.

Three lines from a file to a printed fit::

    import labhil as lh
    fit = lh.fit("run.mcap")
    print(fit)

Public are the names of ``labhil.__all__`` and those of the modules :mod:`labhil.errors`,
:mod:`labhil.devices` (for drivers of your own), :mod:`labhil.testing` (the suite that such a driver passes)
and :mod:`labhil.physics` (for laws and models of your own). Everything else is private: it may change from
one version to the next. Nothing is imported before it is used.
"""

from __future__ import annotations

from labhil.version import __version__ as __version__

# `typing` would be the first thing that the command imports, before it can answer Ctrl+C
TYPE_CHECKING = False
if TYPE_CHECKING:
    from typing import Any

    from labhil import devices, errors, physics
    from labhil.analysis.schema import (
        ExcludedEffect,
        Improvement,
        Location,
        MissingEffect,
        Parameter,
        Rival,
        Score,
    )
    from labhil.api.acquisition import Experiment, connect, run
    from labhil.api.arrays import recording
    from labhil.api.comparison import Comparison, compare
    from labhil.api.diagnosis import Diagnosis, diagnose
    from labhil.api.fit import Fit, fit
    from labhil.api.model import Model, Terms, model
    from labhil.api.recording import Recording, read
    from labhil.api.saved import load
    from labhil.api.simulation import Simulation
    from labhil.api.verification import Verification, verify
    from labhil.experiment.bench import Bench
    from labhil.experiment.hooks import RunContext
    from labhil.physics.friction_law import FrictionLaw, add_law, remove_law
    from labhil.physics.quantity import Quantity
    from labhil.simulators.arm import ArmSimulator
    from labhil.simulators.columns import SimulatedOutput, simulated_output
    from labhil.simulators.fmu import fmu_simulator
    from labhil.simulators.mjcf import mujoco_simulator
    from labhil.simulators.several_columns import SimulatedOutputs, simulated_outputs
    from labhil.simulators.simulator import Coordinate, Simulator, simulator

__all__ = [
    "ArmSimulator",
    "Bench",
    "Comparison",
    "Coordinate",
    "Diagnosis",
    "ExcludedEffect",
    "Experiment",
    "Fit",
    "FrictionLaw",
    "Improvement",
    "Location",
    "MissingEffect",
    "Model",
    "Parameter",
    "Quantity",
    "Recording",
    "Rival",
    "RunContext",
    "Score",
    "SimulatedOutput",
    "SimulatedOutputs",
    "Simulation",
    "Simulator",
    "Terms",
    "Verification",
    "add_law",
    "compare",
    "connect",
    "devices",
    "diagnose",
    "errors",
    "fit",
    "fmu_simulator",
    "load",
    "model",
    "mujoco_simulator",
    "physics",
    "read",
    "recording",
    "remove_law",
    "run",
    "simulated_output",
    "simulated_outputs",
    "simulator",
    "verify",
]


def __getattr__(name: str) -> Any:
    from labhil.public import MODULE_OF, MODULES, public

    if name not in MODULE_OF and name not in MODULES:
        from difflib import get_close_matches

        near = get_close_matches(name, __all__, n=1)
        hint = f"; did you mean {near[0]!r}?" if near else ""
        raise AttributeError(f"module 'labhil' has no attribute {name!r}{hint}")
    attribute = public(name)
    # a package of that name that was imported on the way stays: it can be called, and its modules are found
    return globals().setdefault(name, attribute)


def __dir__() -> list[str]:
    return sorted({*__all__, "testing", "__version__", "__doc__"})

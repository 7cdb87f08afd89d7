"""The public names of ``import labhil``: which they are, and that the example of each is true."""

from __future__ import annotations

import doctest
import inspect
from importlib import import_module
from pathlib import Path

import pytest

import labhil as lh
from labhil.public import MODULE_OF, MODULES, public

ROOT = Path(__file__).parents[2]

NAMES = [
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
WITH_A_DEVICE = ("Bench", "Experiment", "connect", "run")
"""Their examples start simulated devices; they are run in tests/run."""
OF_SECONDS = ("ArmSimulator", "Comparison", "diagnose", "recording", "simulated_output")
"""Their examples diagnose, or compile a simulator."""

PIECES = [name for name in NAMES if name not in MODULES]


def test_these_names_are_public_and_no_others():
    assert lh.__all__ == NAMES
    assert sorted(MODULE_OF) == sorted(PIECES)
    assert set(NAMES) <= set(dir(lh))


@pytest.mark.parametrize("name", NAMES)
def test_each_is_there_and_described_with_an_example(name):
    piece = public(name)
    text = inspect.getdoc(piece)
    assert text is not None
    assert ">>> " in text, name
    if inspect.isfunction(piece):
        for section in ("Args:", "Returns:", "Raises:", "Example:"):
            assert section in text, f"{name}: {section}"


@pytest.mark.parametrize(
    "name",
    [
        pytest.param(name, marks=pytest.mark.extended if name in OF_SECONDS else ())
        for name in NAMES
        if name not in WITH_A_DEVICE
    ],
)
def test_the_example_is_true(name, monkeypatch):
    monkeypatch.chdir(ROOT)
    assert failures(name) == ""


@pytest.mark.parametrize("name", [name for name in PIECES if inspect.isclass(public(name))])
def test_every_public_method_is_described(name):
    kind = public(name)
    fields = set(inspect.get_annotations(kind))
    own = [member for member in list(vars(kind)) if not member.startswith("_") and member not in fields]
    for member in own:
        if callable(getattr(kind, member)) or isinstance(vars(kind)[member], property):
            assert inspect.getdoc(getattr(kind, member)), f"{name}.{member}"


def test_a_misspelt_name_is_answered_with_the_right_one():
    with pytest.raises(AttributeError, match="did you mean 'diagnose'"):
        lh.diagnos  # noqa: B018


def test_packages_that_share_a_name_with_a_function_are_called_as_that_function():
    reader = import_module("labhil.recording.reader")
    import_module("labhil.diagnose.answer")
    for name in ("diagnose", "recording"):
        assert inspect.signature(getattr(lh, name)) == inspect.signature(public(name))
        assert inspect.getdoc(getattr(lh, name)) == inspect.getdoc(public(name))
    assert import_module("labhil").recording.reader is reader
    with pytest.raises(lh.errors.UsageError, match="rig"):
        lh.recording([0.0, 1.0], {}, {}, rig="no such rig")


def failures(name: str) -> str:
    """Run the example of a public name; what it printed where it went wrong."""
    piece = public(name)
    found = doctest.DocTestParser().get_doctest(inspect.getdoc(piece) or "", {}, name, None, 0)
    told: list[str] = []
    doctest.DocTestRunner(optionflags=doctest.NORMALIZE_WHITESPACE).run(found, out=told.append)
    return "".join(told)

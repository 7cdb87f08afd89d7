"""An FMU is a rig: FMI 2 and 3, model exchange and co-simulation, built here from C with the real headers."""

from __future__ import annotations

import shutil
import sys
import zipfile
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from fmpy.validation import validate_fmu

import labhil as lh
from labhil.errors import MissingExtraError, RecordingError, UsageError
from labhil.physics.model import start_values
from labhil.physics.record import Windows
from labhil.physics.rigs import model_for, record_of
from labhil.simulators.fmu import _unit
from labhil.simulators.model import SimulatorModel

sys.path.insert(0, str(Path(__file__).parent))
sys.path.insert(0, str(Path(__file__).parents[2] / "examples" / "fmu"))
from pendulum_fmu import built
from pendulum_plant import swung, torques

pytestmark = pytest.mark.skipif(
    shutil.which("cc") is None, reason="no C compiler here to build an FMU with: apt install gcc libc6-dev"
)

EVERY = [(2, "me cs"), (2, "cs"), (3, "me cs"), (3, "cs")]


def swing(rig: lh.Simulator | Path, *, seconds: float, dry: float = 0.0, late: int = 0) -> lh.Recording:
    random = np.random.default_rng(5)
    t = np.arange(0.0, seconds, 0.01)
    u = torques(t, random)
    angle = swung(t, u, dry=dry, late=late) + 1e-3 * random.standard_normal(len(t))
    return lh.recording(t, {"torque": u}, {"angle": angle}, rig=rig)


@pytest.mark.parametrize(("version", "kinds"), EVERY)
def test_an_fmu_tells_what_it_is(tmp_path: Path, version: int, kinds: str) -> None:
    path = built(tmp_path, version=version, kinds=kinds)
    assert validate_fmu(str(path)) == []
    rod = lh.fmu_simulator(path)
    assert rod.name == "rod"
    assert rod.inputs == {"torque": "N·m"}
    assert rod.outputs == {"angle": "rad"}
    assert rod.states == {"angle": "rad", "rate": "rad/s"}
    inertia = rod.parameters["inertia"]
    assert (inertia.start, inertia.unit, inertia.bounds) == (0.02, "kg·m²", (1e-4, 20.0))
    assert {"inertia", "gravity_torque", "drag", "bearing_width"} <= set(rod.parameters)
    assert len(lh.model(rod).terms) >= 20
    assert lh.model(path).kind == "rod"


@pytest.mark.parametrize(
    ("unit", "shown"),
    [("N.m/rad", "N·m/rad"), ("kg.m2", "kg·m²"), ("s-1", "s⁻¹"), ("m10", "m¹⁰"), ("2.m", "2·m"), ("1", "1")],
)
def test_exponents_of_an_fmus_units_are_raised(unit: str, shown: str) -> None:
    assert _unit(SimpleNamespace(unit=unit)) == shown


@pytest.mark.extended
@pytest.mark.parametrize(
    ("version", "kinds"),
    [pytest.param(*each, marks=pytest.mark.extended if each == (2, "cs") else ()) for each in EVERY],
)
def test_what_is_fitted_is_what_the_fmu_does(tmp_path: Path, version: int, kinds: str) -> None:
    """The kernel beside the FMU's own steps, and a formula that knows neither."""
    rod = lh.fmu_simulator(built(tmp_path, version=version, kinds=kinds))
    assert rod.stepped is not None
    at = np.array([0.3, -1.0]), np.array([0.4, 2.0]), np.array([0.1, -0.2])
    own = rod.stepped.acceleration_at([0.025, 0.45, 0.012, 0.3])(*at)
    exact = (at[2] - 0.45 * np.sin(at[0]) - 0.012 * at[1]) / 0.025
    assert own == pytest.approx(exact, rel=1e-12 if kinds != "cs" else 2e-3)
    recording = swing(rod, seconds=4.0)
    record = record_of(recording.file, rod.kind)
    model = model_for(rod.rig_file, record)
    assert isinstance(model, SimulatorModel)
    windows, states = Windows.of([(0, 150), (200, 350)]), np.array([[0.2, 0.0], [-0.1, 0.5]])
    fitted = model.simulate(start_values(model.parameters), record, windows, states)[:, 0]
    nodes = model._path.nodes(record, 0, lambda name: 0.0)
    starts = [quantity.start for quantity in rod.parameters.values()]
    itself = rod.stepped.roll_out(starts, record, nodes, windows, states)[:, 0]
    assert np.max(np.abs(itself - fitted)) < (1e-5 if kinds != "cs" else 2e-3) * np.ptp(itself)


@pytest.mark.extended
@pytest.mark.parametrize(
    ("version", "kinds"),
    [pytest.param(*each, marks=pytest.mark.long if each[1] == "cs" else ()) for each in EVERY],
)
def test_a_fit_finds_the_plant(tmp_path: Path, version: int, kinds: str) -> None:
    rod = lh.fmu_simulator(built(tmp_path, version=version, kinds=kinds))
    fit = lh.fit(swing(rod, seconds=8.0), rod, terms=["coulomb_friction"])
    found = {each.name: each.value for each in fit.parameters}
    assert found["inertia"] == pytest.approx(0.025, rel=0.01)
    assert found["gravity_torque"] == pytest.approx(0.45, rel=0.01)
    assert found["drag"] == pytest.approx(0.012, rel=0.05)
    notes = "\n".join(fit.to_dict()["notes"])
    assert "bearing_width changes nothing" in notes
    assert ("angle_start" in notes) == (kinds == "cs")  # what only starts model exchange is no parameter


@pytest.mark.long
def test_a_diagnosis_from_a_rig_file_names_what_the_fmu_lacks(tmp_path: Path) -> None:
    path = built(tmp_path, version=3)
    rig = tmp_path / "rig.toml"
    rig.write_text(
        f'[model]\nfmu = "{path.name}"\ninputs = {{ torque = "torque" }}\noutputs = {{ angle = "angle" }}\n',
        encoding="utf-8",
    )
    found = lh.diagnose(swing(rig, seconds=20.0, dry=0.06), rig)
    assert "coulomb_friction" in {effect.term for effect in found.missing}


def test_an_output_that_is_the_position_may_be_another_variable(tmp_path: Path) -> None:
    path = built(tmp_path, version=2, rate="speed")
    rod = lh.fmu_simulator(path, inputs={"drive": "torque"}, outputs={"tacho": "speed"}, name="my rod")
    assert rod.name == "my_rod"
    assert rod.inputs == {"drive": "N·m"}
    assert rod.outputs == {"tacho": "rad/s"}
    assert tuple(rod.states) == ("angle", "tacho")


AT = np.array([0.3, -1.0]), np.array([0.4, 2.0]), np.array([0.1, -0.2])


def exact_acceleration() -> np.ndarray:
    """That of the pendulum's equations, at ``AT``."""
    return (AT[2] - 0.45 * np.sin(AT[0]) - 0.012 * AT[1]) / 0.025


@pytest.mark.parametrize("version", [2, 3])
def test_a_solver_of_coarse_euler_steps_is_used_with_a_note(tmp_path: Path, version: int) -> None:
    """It makes steps of 20 ms and no others; its accelerations are exact all the same."""
    rod = lh.fmu_simulator(built(tmp_path, version=version, kinds="cs", step=0.02))
    assert rod.stepped is not None
    own = rod.stepped.acceleration_at([0.025, 0.45, 0.012, 0.3])(*AT)
    assert own == pytest.approx(exact_acceleration(), rel=1e-9)
    (note,) = rod.notes
    assert "its solver makes Euler's steps of 0.02 s, which are coarse" in note


def test_a_coarse_solver_of_another_method_is_used_with_a_note_of_its_error(tmp_path: Path) -> None:
    rod = lh.fmu_simulator(built(tmp_path, version=3, kinds="cs", step=0.05, heun=True))
    assert rod.stepped is not None
    own = rod.stepped.acceleration_at([0.025, 0.45, 0.012, 0.3])(*AT)
    assert own == pytest.approx(exact_acceleration(), rel=0.2)
    (note,) = rod.notes
    assert "its solver is coarse: in steps of 0.05 s the rate of its position is off by" in note
    assert "Export it with shorter steps" in note
    assert not lh.fmu_simulator(built(tmp_path, version=3, kinds="cs", step=0.001, heun=True)).notes


def test_steps_that_an_fmu_neither_makes_nor_states_are_listed(tmp_path: Path) -> None:
    path, odd = built(tmp_path, version=2, kinds="cs", step=0.03), tmp_path / "odd.fmu"
    with zipfile.ZipFile(path) as whole, zipfile.ZipFile(odd, "w") as packed:
        text = whole.read("modelDescription.xml").decode()
        packed.writestr("modelDescription.xml", text.replace('<DefaultExperiment stepSize="0.03"/>', ""))
        for name in set(whole.namelist()) - {"modelDescription.xml"}:
            packed.writestr(name, whole.read(name))
    with pytest.raises(
        UsageError, match=r"makes steps of one length out of 0\.001, 0\.01, 0\.0001 s, or that states its own"
    ):
        lh.fmu_simulator(odd)


@pytest.mark.extended
@pytest.mark.parametrize("step", [0.01, 0.02])
def test_a_fit_of_a_coarse_solver_finds_the_plant(tmp_path: Path, step: float) -> None:
    """With samples 10 ms apart: an FMU that makes steps of 20 ms cannot go from one to the next by itself."""
    rod = lh.fmu_simulator(built(tmp_path, version=3, kinds="cs", step=step))
    fit = lh.fit(swing(rod, seconds=8.0), rod, terms=["coulomb_friction"])
    found = {each.name: each.value for each in fit.parameters}
    assert found["inertia"] == pytest.approx(0.025, rel=0.01)
    assert found["gravity_torque"] == pytest.approx(0.45, rel=0.01)
    assert found["drag"] == pytest.approx(0.012, rel=0.05)
    assert any("Euler's steps" in note for note in fit.to_dict()["notes"])


def test_dry_friction_inside_an_fmu_is_refused_with_what_to_do(tmp_path: Path) -> None:
    rod = lh.fmu_simulator(built(tmp_path, version=2, kinds="me", dry=True))
    with pytest.raises(UsageError, match="smooth in its velocity, found one with a corner or a jump"):
        lh.fit(swing(rod, seconds=4.0), rod)


def test_what_does_not_fit_is_named_with_what_the_fmu_has(tmp_path: Path) -> None:
    path = built(tmp_path, version=2)
    with pytest.raises(
        UsageError, match=r"no input 'torqe' \(did you mean 'torque'\?\); inputs of the FMU: t"
    ):
        lh.fmu_simulator(path, inputs={"torque": "torqe"})
    with pytest.raises(UsageError, match="expected the position or the velocity, found 'drag'"):
        lh.fmu_simulator(path, outputs={"angle": "drag"})
    with pytest.raises(UsageError, match=r"expected the FMU .*none\.fmu, found none"):
        lh.fmu_simulator(tmp_path / "none.fmu")
    (tmp_path / "text.fmu").write_text("no archive", encoding="utf-8")
    with pytest.raises(UsageError, match="expected an FMU that fmpy reads, found File is not a zip file"):
        lh.fmu_simulator(tmp_path / "text.fmu")
    bare = tmp_path / "bare.fmu"
    with zipfile.ZipFile(path) as whole, zipfile.ZipFile(bare, "w") as packed:
        packed.writestr("modelDescription.xml", whole.read("modelDescription.xml"))
    with pytest.raises(UsageError, match=r"expected a binary that runs here .*Cannot find shared library"):
        lh.fmu_simulator(bare)


def test_an_fmu_that_fails_says_at_which_question(tmp_path: Path) -> None:
    rod = lh.fmu_simulator(built(tmp_path, version=2))
    assert rod.stepped is not None
    point = np.zeros(1), np.zeros(1), np.zeros(1)
    with pytest.raises(UsageError, match=r"initialised anew with its parameters, found fmi2EnterInit.*error"):
        rod.stepped.acceleration_at([-0.02, 0.5, 0.01, 0.3])(*point)
    assert np.isfinite(rod.stepped.acceleration_at([0.02, 0.5, 0.01, 0.3])(*point)).all()


def test_an_input_that_cannot_be_set_is_said_so(tmp_path: Path) -> None:
    """Its description gives the input a reference that the binary does not know."""
    path, odd = built(tmp_path, version=2), tmp_path / "odd.fmu"
    with zipfile.ZipFile(path) as whole, zipfile.ZipFile(odd, "w") as packed:
        text = whole.read("modelDescription.xml").decode()
        text = text.replace('name="torque" valueReference="2"', 'name="torque" valueReference="42"')
        packed.writestr("modelDescription.xml", text)
        for name in set(whole.namelist()) - {"modelDescription.xml"}:
            packed.writestr(name, whole.read(name))
    with pytest.raises(UsageError, match="input torque can be set, found fmi2SetReal failed"):
        lh.fmu_simulator(odd)


@pytest.mark.extended
def test_a_recording_does_not_run_the_fmu_of_its_author(tmp_path: Path) -> None:
    path = built(tmp_path, version=2)
    rig = tmp_path / "rig.toml"
    rig.write_text(f'[model]\nfmu = "{path.name}"\n', encoding="utf-8")
    swing(rig, seconds=2.0).save(tmp_path / "run.mcap")
    with pytest.raises(RecordingError, match="a simulator of its author's, which is not loaded from there"):
        lh.fit(tmp_path / "run.mcap")


def test_without_fmpy_the_extra_is_named(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setitem(sys.modules, "fmpy", None)
    with pytest.raises(MissingExtraError, match="fmu"):
        lh.fmu_simulator(tmp_path / "rod.fmu")

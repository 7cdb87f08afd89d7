"""A MuJoCo file is a rig: what it has is known by name, and what is fitted is what MuJoCo solves."""

from __future__ import annotations

import sys
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import mujoco
import numpy as np
import pytest

import labhil as lh
from labhil.analysis.dataset import load_dataset
from labhil.analysis.study import reference_values
from labhil.errors import RecordingError, RigFileError, UsageError
from labhil.physics.model import start_values
from labhil.physics.record import Windows
from labhil.physics.rigs import model_for, record_of
from labhil.simulators.mjcf import read_mechanism
from labhil.simulators.model import SimulatorModel

sys.path.insert(0, str(Path(__file__).parent))
from pendulum_file import FILE, RIG, bench, recorded

CART = """<mujoco model="cart">
  <worldbody>
    <body name="slide">
      <joint name="rail" type="slide" axis="1 0 0" stiffness="4" springref="0.1" armature="0.2" damping="1"/>
      <geom type="box" size="0.1 0.05 0.05"/>
      <body name="tool" pos="0 0 0.1"><geom type="sphere" size="0.03" mass="0.3"/></body>
    </body>
  </worldbody>
  <actuator><position name="servo" joint="rail" kp="30" kv="2"/></actuator>
  <sensor><jointvel name="tacho" joint="rail"/><jointpos name="scale" joint="rail"/></sensor>
</mujoco>
"""
TWO = FILE.replace(
    "</body>\n  </w", '</body><body name="b"><joint name="j" type="slide"/><geom size="1"/></body>\n  </w'
)
LAGGED = FILE.replace(
    '<motor name="motor" joint="hinge"/>',
    '<general name="motor" joint="hinge" dyntype="filter" dynprm="0.1"/>',
)


def test_a_file_is_offered_the_catalogue_and_begins_with_its_own_friction(tmp_path: Path) -> None:
    (tmp_path / "cart.xml").write_text(CART, encoding="utf-8")
    cart = lh.mujoco_simulator(tmp_path / "cart.xml")
    assert cart.inputs == {"servo": "1"}
    assert cart.outputs == {"scale": "m", "tacho": "m/s"}
    assert set(cart.parameters) == {
        "stiffness", "springref", "slide_mass", "tool_mass", "armature", "gear", "kp", "kv",
    }  # fmt: skip
    assert cart.parameters["slide_mass"].start == pytest.approx(2.0)
    model = lh.model(cart)
    assert len(model.terms) >= 20
    assert model.terms["coulomb_friction"].parameters[0].unit == "N"
    assert cart.nominal["viscous_friction.coefficient"] == 1.0


@pytest.mark.extended
def test_values_of_the_file_are_the_reference_of_several_recordings_too(tmp_path: Path) -> None:
    (tmp_path / "cart.xml").write_text(CART, encoding="utf-8")
    cart = lh.mujoco_simulator(tmp_path / "cart.xml")
    t = np.arange(0.0, 4.0, 0.01)
    recordings = [
        lh.recording(
            t,
            {"servo": np.sin(rate * t)},
            {"scale": 0.3 * np.sin(rate * t), "tacho": 0.3 * rate * np.cos(rate * t)},
            rig=cart,
        )
        for rate in (3.0, 5.0)
    ]
    for chosen in (recordings[:1], recordings):
        dataset = load_dataset([recording.file for recording in chosen])
        values = reference_values(dataset, None)
        assert values is not None
        assert values["stiffness"] == 4.0
        assert values["slide_mass"] == pytest.approx(2.0)


def test_the_file_stands_for_a_rig_wherever_one_is_named(tmp_path: Path) -> None:
    rig = bench(tmp_path)
    assert lh.model(rig).kind == "rod"
    assert lh.model(tmp_path / "rod.xml").kind == "rod"
    rig.write_text(f"{RIG}[known]\nrod_mass = 0.459\n", encoding="utf-8")
    assert lh.model(rig).known == {"rod_mass": 0.459}


@pytest.mark.extended
@pytest.mark.parametrize("file", [FILE, CART], ids=["pendulum", "servo"])
def test_what_is_fitted_is_what_mujoco_solves(tmp_path: Path, file: str) -> None:
    """Against MuJoCo's Runge-Kutta steps of 0.1 ms; its friction is left out, which it smooths."""
    path = tmp_path / "file.xml"
    path.write_text(file.replace(' damping="1"', ""), encoding="utf-8")
    described = read_mechanism(path)
    rig = described.simulator
    t = np.arange(0.0, 4.0, 0.01)
    u = 0.1 * np.sin(3.0 * t) + 0.05 * np.sin(8.0 * t)
    outputs = dict(zip(rig.outputs, (0.3 * np.sin(3.0 * t), 0.9 * np.cos(3.0 * t)), strict=False))
    recording = lh.recording(t, {next(iter(rig.inputs)): u}, outputs, rig=rig)
    record = record_of(recording.file, rig.kind)
    model = model_for(rig.rig_file, record)
    assert isinstance(model, SimulatorModel)
    windows = Windows.of([(0, 150), (200, 350)])
    states = np.array([[0.2, 0.0], [-0.1, 0.5]])
    theta = start_values(model.parameters)
    fitted = np.column_stack(list(model.coordinates(theta, record, windows, states).values()))[:, :2]
    whole = described.mechanism._model
    whole.opt.timestep, whole.opt.integrator = 1e-4, mujoco.mjtIntegrator.mjINT_RK4
    nodes = model._path.nodes(record, 0, lambda name: 0.0)
    numbers = [quantity.start for quantity in rig.parameters.values()]
    itself = described.mechanism.roll_out(numbers, record, nodes, windows, states)
    assert np.ptp(itself[:, 0]) > 0.1
    assert np.max(np.abs(itself - fitted)) < 1e-5


def test_every_value_that_may_be_fitted_reaches_the_simulation(tmp_path: Path) -> None:
    """Masses of bodies on a slide as well, whose inertia MuJoCo keeps as a constant."""
    path = tmp_path / "cart.xml"
    path.write_text(CART, encoding="utf-8")
    described = read_mechanism(path)
    starts = [quantity.start for quantity in described.simulator.parameters.values()]
    point = np.array([0.3]), np.array([0.4]), np.array([0.1])
    base = float(described.mechanism.acceleration_at(starts)(*point)[0])
    for k, name in enumerate(described.simulator.parameters):
        moved = list(starts)
        moved[k] *= 1.1
        assert float(described.mechanism.acceleration_at(moved)(*point)[0]) != base, name
    assert float(described.mechanism.acceleration_at(starts)(*point)[0]) == base


def test_accelerations_at_other_values_do_not_change_each_other_in_threads(tmp_path: Path) -> None:
    path = tmp_path / "cart.xml"
    path.write_text(CART, encoding="utf-8")
    described = read_mechanism(path)
    starts = np.array([quantity.start for quantity in described.simulator.parameters.values()])
    random = np.random.default_rng(1)
    points = tuple(random.uniform(-0.5, 0.5, (3, 2000)))
    factors = np.linspace(0.8, 1.2, 16)

    def accelerations(factor: float) -> np.ndarray:
        return described.mechanism.acceleration_at(list(factor * starts))(*points)

    one_by_one = [accelerations(factor) for factor in factors]
    with ThreadPoolExecutor(4) as executor:
        at_once = list(executor.map(accelerations, factors))
    np.testing.assert_array_equal(at_once, one_by_one)


@pytest.mark.parametrize(
    ("file", "stated", "expected"),
    [
        (
            FILE,
            {"inputs": {"torque": "motr"}},
            r"no actuator or joint 'motr' \(did you mean 'motor'\?\); joi",
        ),
        (FILE, {"outputs": {"angle": "tacho"}}, "sensors of position or velocity: encoder"),
        (FILE, {"inputs": {}}, "expected one signal, found none"),
        (TWO, {}, "expected one hinge or slide joint, or several hinges, found 2 .*joints: hinge, j;"),
        (LAGGED, {}, "expected actuators without a state of their own"),
        ("<mujoco><worldbody>", {}, "expected a file that MuJoCo loads .*XML"),
    ],
)
def test_what_does_not_fit_is_named_with_what_the_file_has(
    tmp_path: Path, file: str, stated: dict[str, dict[str, str]], expected: str
) -> None:
    path = tmp_path / "rod.xml"
    path.write_text(file, encoding="utf-8")
    with pytest.raises(UsageError, match=expected):
        lh.mujoco_simulator(path, **stated)  # type: ignore[arg-type]


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ('mujoco = "rad.xml"', "model.mujoco: expected the MuJoCo file .*rad.xml, found none"),
        ('mujoko = "rod.xml"', "model.mujoko: unknown key .did you mean 'mujoco'"),
        ('mujoco = "rod.xml"\npython = "bench.py:rod"', "give either python"),
        (
            'python = "bench.py:rod"\ninputs = { torque = "motor" }',
            "inputs and outputs are for mujoco and f",
        ),
    ],
)
def test_a_rig_file_says_what_is_wrong_with_its_model(tmp_path: Path, text: str, expected: str) -> None:
    rig = bench(tmp_path)
    rig.write_text(f"[model]\n{text}\n", encoding="utf-8")
    with pytest.raises(RigFileError, match=expected):
        lh.model(rig)


@pytest.mark.extended
def test_other_names_of_the_signals_are_put_together_in_a_proposal(tmp_path: Path) -> None:
    run = recorded(bench(tmp_path), seed=1, seconds=4.0)
    with pytest.raises(RecordingError) as refused:
        lh.fit(run, tmp_path / "rod.xml")
    assert "expected the signals encoder, motor of rod.xml, found torque, angle" in str(refused.value)
    assert 'inputs = { torque = "motor" }\noutputs = { angle = "encoder" }' in str(refused.value)


@pytest.mark.extended
def test_a_value_that_mujoco_never_reads_is_said_so(tmp_path: Path) -> None:
    file = FILE.replace("<option", '<option><flag spring="disable"/></option><option').replace(
        'axis="0 1 0"', 'axis="0 1 0" stiffness="0.3"'
    )
    rig = bench(tmp_path, file)
    fit = lh.fit(recorded(rig, seed=5, seconds=4.0), rig, terms=["viscous_friction"])
    notes = fit.to_dict()["notes"]
    assert any("stiffness changes nothing" in note and "never" in note for note in notes)
    assert any("gear stays at 1 as in the file" in note for note in notes)
    assert {"stiffness", "gear"}.isdisjoint(each.name for each in fit.parameters)


@pytest.mark.extended
def test_a_fit_finds_the_plant_with_its_dry_friction(tmp_path: Path) -> None:
    rig = bench(tmp_path)
    run = recorded(rig, seed=5, seconds=12.0, dry=0.05)
    fit = lh.fit(run, rig, terms=["viscous_friction", "coulomb_friction", "added_inertia"])
    found = {each.name: each.value for each in fit.parameters}
    assert found["rod_mass"] == pytest.approx(0.45 / 0.981, rel=0.01)
    assert found["coulomb_friction.level"] == pytest.approx(0.05, rel=0.03)


@pytest.mark.extended
@pytest.mark.parametrize(
    ("concealed", "missing"),
    [
        ({}, set()),
        pytest.param({"dry": 0.06}, {"coulomb_friction"}, marks=pytest.mark.long),
        pytest.param({"late": 5}, {"time_delay"}, marks=pytest.mark.long),
    ],
)
def test_a_diagnosis_names_what_the_plant_conceals(
    tmp_path: Path, concealed: dict[str, float], missing: set[str]
) -> None:
    rig = bench(tmp_path, FILE.replace('mass="0.4"', 'mass="0.45872"'))
    run = recorded(rig, seed=11, seconds=20.0, **concealed)  # type: ignore[arg-type]
    found = lh.diagnose(run, rig)
    assert {effect.term for effect in found.missing} - {"added_inertia"} == missing
    changed = {each.name: each.before for each in found.changed}
    assert changed["viscous_friction.coefficient"] == 0.0
    assert "coulomb_friction.level" not in changed  # the file has none: it is missing, not changed


class Old:
    """What no compiler knows."""

    def __init__(self, angle: float, rate: float) -> None:
        self.angle, self.rate = angle, rate


def step(x: object, u: object, p: object, dt: float) -> tuple[float, float]:
    body = Old(x.angle, x.rate)  # type: ignore[attr-defined]
    for _ in range(4):
        pull = u.torque - p.gravity * np.sin(body.angle)  # type: ignore[attr-defined]
        body.rate += 0.25 * dt * pull / p.inertia  # type: ignore[attr-defined]
        body.angle += 0.25 * dt * body.rate
    return body.angle, body.rate


def stepped(f: object = step) -> lh.Simulator:
    return lh.simulator(
        f,  # type: ignore[arg-type]
        kind="step",
        name="stepped",
        states={"angle": "rad", "rate": "rad/s"},
        inputs={"torque": "N·m"},
        parameters={"inertia": lh.Quantity(0.02, "kg·m²"), "gravity": lh.Quantity(0.5, "N·m")},
    )


@pytest.mark.extended
def test_a_python_step_is_tabulated_likewise(tmp_path: Path) -> None:
    run = lh.read(recorded(bench(tmp_path), seed=5, seconds=6.0))
    fit = lh.fit(run, stepped(), terms=["viscous_friction"])
    found = {each.name: each.value for each in fit.parameters}
    assert found["inertia"] == pytest.approx(0.025, rel=0.01)
    assert found["gravity"] == pytest.approx(0.45, rel=0.01)
    assert found["viscous_friction.coefficient"] == pytest.approx(0.012, rel=0.05)


@pytest.mark.extended
def test_a_step_with_a_jump_is_refused(tmp_path: Path) -> None:
    def rubbing(x: object, u: object, p: object, dt: float) -> tuple[float, float]:
        angle, rate = step(x, u, p, dt)
        return angle, rate - dt * 3.0 * float(np.sign(x.rate))  # type: ignore[attr-defined]

    run = lh.read(recorded(bench(tmp_path), seed=5, seconds=4.0))
    with pytest.raises(UsageError, match="smooth in its velocity"):
        lh.fit(run, stepped(rubbing))
    with pytest.raises(UsageError, match="kind: expected rates or step or rollout"):
        lh.simulator(
            step, kind="stride", name="s", states={"a": "1", "b": "1"}, inputs={"u": "1"}, parameters={}
        )  # type: ignore[arg-type]


@pytest.mark.extended
def test_a_term_that_the_files_own_values_stand_for_is_not_asked_for_by_default(tmp_path: Path) -> None:
    """A DC motor's back-EMF is damping: with mass and gear free, more of it cannot be told."""
    motor = '<dcmotor name="motor" joint="hinge" motorconst="0.3" resistance="2"/>'
    rig = bench(tmp_path, FILE.replace('<motor name="motor" joint="hinge"/>', motor))
    run = recorded(rig, seed=5, seconds=4.0)
    model = lh.fit(run, rig)
    assert "viscous_friction" not in model.to_dict()["terms"]
    with pytest.raises(UsageError, match="viscous_friction: this recording cannot show it"):
        lh.fit(run, rig, terms=["viscous_friction"])

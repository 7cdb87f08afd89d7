"""A repaired simulator in Python: its starts are the identified ones, and the functions keep the promise."""

from __future__ import annotations

import json
import math
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

import labhil as lh
from labhil.analysis.patch import MAX_ERROR_RATIO
from labhil.analysis.patch_check import rest_velocity
from labhil.errors import UsageError
from labhil.python_file import module_of, object_of
from labhil.simulators.companion import Usage, companion_text, sort_effects
from labhil.simulators.python_text import PythonText

sys.path.insert(0, str(Path(__file__).parent))
from pendulum_plant import DRAG, GRAVITY, INERTIA, swung, torques

DRY, LATE, PERIOD = 0.03, 3, 0.01
HEAD = """# a pendulum, with its comments
import math
import numpy as np
import labhil as lh

INERTIA = 2.0e-2
STARTS = dict(inertia=lh.Quantity(INERTIA, "kg·m²"), gravity_torque=lh.Quantity(0.5, "N·m"), drag=0.01)


def rates(t, x, u, p):
    return x.rate, (u.torque - p.gravity_torque * math.sin(x.angle) - p.drag * x.rate) / p.inertia


def step(x, u, p, dt):
    angle, rate, parts = x.angle, x.rate, 4
    for _ in range(parts):
        rate += dt / parts * (u.torque - p.gravity_torque * math.sin(angle) - p.drag * rate) / p.inertia
        angle += dt / parts * rate
    return angle, rate


def rollout(p, t, u, x0):
    motion = [tuple(x0)]
    for k in range(len(t) - 1):
        angle, rate = motion[-1]
        parts = 20
        dt = (t[k + 1] - t[k]) / parts
        for _ in range(parts):
            rate += dt * (u.torque[k] - p.gravity_torque * math.sin(angle) - p.drag * rate) / p.inertia
            angle += dt * rate
        motion.append((angle, rate))
    return np.array(motion)


"""
SIGNALS = 'states={"angle": "rad", "rate": "rad/s"}, inputs={"torque": "N·m"}'
COORDINATE = 'coordinates={"angle": lh.Coordinate("rate", inertia="inertia", force="N·m")}'
KINDS = {
    "rates": f'rates, name="pendulum", {SIGNALS}, parameters=STARTS',
    "rates by inertia": f'rates, name="rod", {SIGNALS}, parameters=STARTS, {COORDINATE}',
    "step": f'step, name="stepped", {SIGNALS}, parameters=STARTS, kind="step"',
    "step by inertia": f'step, name="steps", {SIGNALS}, parameters=STARTS, kind="step", {COORDINATE}',
    "rollout": f'rollout, name="rolled", {SIGNALS}, parameters=STARTS, kind="rollout"',
}
EXPECTED = {"inertia": INERTIA, "gravity_torque": GRAVITY, "drag": DRAG}


def written(folder: Path, kind: str) -> tuple[Path, lh.Simulator]:
    path = folder / "bench.py"
    path.write_text(f"{HEAD}pendulum = lh.simulator({KINDS[kind]})\n", encoding="utf-8")
    simulator = object_of("bench.py:pendulum", folder)
    assert isinstance(simulator, lh.Simulator)
    return path, simulator


def recorded(rig: lh.Simulator, *, seconds: float = 12.0) -> lh.Recording:
    random = np.random.default_rng(5)
    t = np.arange(0.0, seconds, PERIOD)
    u = torques(t, random)
    angle = swung(t, u, dry=DRY, late=LATE) + 1e-3 * random.standard_normal(len(t))
    return lh.recording(t, {"torque": u}, {"angle": angle}, rig=rig)


def fitted(rig: lh.Simulator, folder: Path) -> lh.Fit:
    recorded(rig).save(folder / "run.mcap")
    return lh.fit(lh.read(folder / "run.mcap"), rig, terms=["coulomb_friction", "time_delay"])


@pytest.mark.extended
@pytest.mark.parametrize("kind", [*list(KINDS)[:-1], pytest.param("rollout", marks=pytest.mark.long)])
def test_the_repaired_file_and_its_functions_keep_the_promise(tmp_path: Path, kind: str) -> None:
    path, rig = written(tmp_path, kind)
    text = path.read_text(encoding="utf-8")
    fit = fitted(rig, tmp_path)
    found = fit.patch(f"{path}:pendulum", tmp_path / "fixed.py")
    assert found.attempts[-1].ratio <= MAX_ERROR_RATIO
    assert found.before > 5.0 * found.attempts[-1].rmse
    assert found.run_by == "Python"
    assert path.read_text(encoding="utf-8") == text
    fixed = object_of("fixed.py:pendulum", tmp_path)
    assert isinstance(fixed, lh.Simulator)
    assert pytest.approx(EXPECTED, rel=0.05) == {n: q.start for n, q in fixed.parameters.items()}
    assert [change.before for change in found.changes] == ["INERTIA", "0.5", "0.01"]
    changed = (tmp_path / "fixed.py").read_text(encoding="utf-8").splitlines()
    assert sum(a != b for a, b in zip(text.splitlines(), changed, strict=True)) == 1
    functions = module_of(tmp_path / "fixed_effects.py")
    assert simulated_error(fixed, functions) < 0.1 * simulated_error(rig, None)
    assert not list(tmp_path.glob("__pycache__"))


@pytest.mark.extended
def test_a_result_takes_the_simulator_or_the_model_that_it_was_found_with(tmp_path: Path) -> None:
    """A known value of the model is used as it is in a rig file: it goes into the repaired file."""
    path, rig = written(tmp_path, "rates")
    found = fitted(rig, tmp_path).patch(f"{path}:pendulum", tmp_path / "fixed.py", rig=rig)
    assert found.attempts[-1].ratio <= MAX_ERROR_RATIO
    model = lh.model(rig, known={"gravity_torque": GRAVITY})
    fit = lh.fit(tmp_path / "run.mcap", model, terms=["coulomb_friction", "time_delay"])
    assert "gravity_torque" not in fit.parameters
    known = fit.patch(f"{path}:pendulum", tmp_path / "known.py", rig=model)
    assert known.attempts[-1].ratio <= MAX_ERROR_RATIO
    assert f"{GRAVITY:g}" in {change.after for change in known.changes}


@pytest.mark.extended
def test_a_recording_that_was_never_saved_serves_as_well_until_the_result_is_loaded(tmp_path: Path) -> None:
    path, rig = written(tmp_path, "rates")
    fit = lh.fit(recorded(rig), rig, terms=["coulomb_friction", "time_delay"])
    found = fit.patch(f"{path}:pendulum", tmp_path / "fixed.py", rig=rig)
    assert "run by Python itself: RMSE" in str(found)
    assert found.attempts[-1].ratio <= MAX_ERROR_RATIO
    fit.save(tmp_path / "fit.json")
    loaded = lh.load(tmp_path / "fit.json")
    assert isinstance(loaded, lh.Fit)
    with pytest.raises(UsageError, match="names the recording arrays, which is not there"):
        loaded.patch(f"{path}:pendulum", tmp_path / "again.py", rig=rig)


def simulated_error(rig: lh.Simulator, functions: object) -> float:
    """RMS error, rad, of a program of a user's that calls the functions, beside the plant without noise."""
    p = {name: quantity.start for name, quantity in rig.parameters.items()}
    t, parts = np.arange(0.0, 6.0, PERIOD), 40
    u = torques(t, np.random.default_rng(8))
    exact, angles, angle, rate, dt = swung(t, u, dry=DRY, late=LATE), [0.2], 0.2, 0.0, PERIOD / parts
    command = functions.Command(float(u[0])) if functions else lambda u, dt: u
    for drive in u[:-1].tolist():
        for _ in range(parts):
            torque = command(drive, dt)
            if functions:
                torque += functions.force(angle, rate)
            rate += dt * (torque - p["gravity_torque"] * math.sin(angle) - p["drag"] * rate) / p["inertia"]
            angle += dt * rate
        angles.append(angle)
    return float(np.sqrt(np.mean((np.array(angles) - exact) ** 2)))


@pytest.mark.extended
def test_the_command_takes_the_file_without_a_name_and_tells_what_it_did(tmp_path: Path) -> None:
    path, rig = written(tmp_path, "rates")
    fitted(rig, tmp_path).save(tmp_path / "fit.json")
    command = [
        sys.executable,
        "-P",
        "-m",
        "labhil",
        "patch",
        "fit.json",
        "--into",
        "bench.py",
        "-o",
        "new.py",
    ]
    done = subprocess.run([*command, "--json"], cwd=tmp_path, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    result = json.loads(done.stdout)
    assert result["companion"] == "new_effects.py"
    assert sorted(result["left"]) == ["coulomb_friction.level", "time_delay.delay"]
    assert "-STARTS" in result["diff"]
    assert path.exists()
    again = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, check=False)
    assert again.returncode == 2
    assert "new.py: expected a new file, found one there" in again.stderr


def test_a_file_with_no_place_for_the_starts_is_refused(tmp_path: Path) -> None:
    (tmp_path / "made.py").write_text("pendulum = make(parameters=read('starts.json'))\n", encoding="utf-8")
    with pytest.raises(
        UsageError, match=r"expected the starts of pendulum as a dictionary.*for drag, inertia"
    ):
        PythonText.read(tmp_path / "made.py", "pendulum", ["inertia", "drag"])
    (tmp_path / "latin.py").write_text("# coding: latin-1\nname = 'é'\n", encoding="latin-1")
    with pytest.raises(UsageError, match="expected a Python file in UTF-8"):
        PythonText.read(tmp_path / "latin.py", "pendulum", ["inertia", "drag"])


CALL = "rig = lh.simulator(f, parameters="
TWO = 'T = {"a": 0, "é": 0}\nP = {"a": 1, "é": 2}\n'


@pytest.mark.parametrize(
    ("before", "after"),
    [
        (CALL + '{"a": 1.0, "é": lh.Quantity(-2e3)})', CALL + '{"a": 7, "é": lh.Quantity(8)})'),
        (TWO + "rig: S = lh.simulator(f, parameters=P)", '\nP = {"a": 7, "é": 8}\n'),
        (
            'rig = make({"a": Quantity(start=1 / 3, unit="m"), "é": 2})  # ü',
            'rig = make({"a": Quantity(start=7, unit="m"), "é": 8})  # ü',
        ),
        (
            "rig = make(\n  dict(\n    a=Quantity(\n      1,\n      m),\n    é=2))",
            "rig = make(\n  dict(\n    a=Quantity(\n      7,\n      m),\n    é=8))",
        ),
        ('P = {"a": one(), "é": 2}\n' + CALL + "P)", None),
        (TWO + "rig = make(P)", None),
        ('rig = make({"a": Quantity(*numbers), "é": 2})', None),
        ('rig = make({**others, "é": 2})', None),
    ],
    ids=["call", "name", "only one", "dict", "not a number", "two", "starred", "merged"],
)
def test_starts_are_found_where_they_are_written(tmp_path: Path, before: str, after: str | None) -> None:
    path = tmp_path / "file.py"
    path.write_bytes(before.encode())
    if after is None:
        with pytest.raises(UsageError, match="nothing is written"):
            PythonText.read(path, "rig", ["a", "é"])
        return
    text = PythonText.read(path, "rig", ["a", "é"])
    text.set("é", "8", "")
    text.set("a", "7", "")
    assert after in text.changed().decode()


def test_a_file_is_run_as_it_is_now(tmp_path: Path) -> None:
    """The time of a file is known to a second: two contents of a length within one are two."""
    path = tmp_path / "numbers.py"
    for number in "123":
        path.write_text(f"NUMBER = {number}\n", encoding="utf-8")
        assert object_of("numbers.py:NUMBER", tmp_path) == int(number)
    assert not (tmp_path / "__pycache__").exists()


@pytest.fixture
def own_law() -> Iterator[lh.FrictionLaw]:
    law = lh.FrictionLaw(
        "sqrt_friction", lambda v, offset: offset + np.sqrt(v), unit="{force}", statement="of this test",
        equation="F = c·(s + √|v|)·sgn v", source="this test", shape={"offset": lh.Quantity(0.5)},
    )  # fmt: skip
    yield lh.add_law(law)
    lh.remove_law(law.name)


def test_a_law_of_ones_own_is_a_table_that_gives_the_same_force(
    tmp_path: Path, own_law: lh.FrictionLaw
) -> None:
    values = {"sqrt_friction.coefficient": 0.3, "sqrt_friction.offset": 0.2, "coulomb_friction.level": 1.0}
    effects = sort_effects(values)
    assert not effects.unknown
    usage = Usage.of_step("torque", "torque += force(angle, rate{drive})", 1e-3)
    path = tmp_path / "effects.py"
    path.write_text(companion_text(effects, "rod.py", usage, at_rest=1e-9), encoding="utf-8")
    assert "labhil." not in path.read_text(encoding="utf-8")
    assert len(path.read_text(encoding="utf-8").splitlines()) < 60
    force = module_of(path).force
    for speed in np.geomspace(1e-6, 1e3, 400).tolist():
        expected = 1.0 + own_law.force_at(speed, 0.3, 0.2)
        assert force(0.0, speed) == pytest.approx(-expected, rel=3e-3)
        assert force(0.0, -speed) == pytest.approx(expected, rel=3e-3)
    assert force(0.0, 0.0) == 0.0
    assert rest_velocity(values, 1e-3, 0.02) == pytest.approx(2e-3 * (1.0 + 0.3 * 0.2) / 0.02)

"""A repaired FMU: its starts are the identified ones, and the functions beside it keep the promise."""

from __future__ import annotations

import shutil
import sys
import zipfile
from pathlib import Path
from types import ModuleType

import fmpy
import numpy as np
import pytest
from fmpy.validation import validate_fmu

import labhil as lh
from labhil.analysis.fmu_patching import INTEGRATED
from labhil.analysis.patch import MAX_ERROR_RATIO
from labhil.errors import UsageError
from labhil.python_file import module_of
from labhil.simulators.fmu_patches import patch_fmu, read_description, with_description

sys.path.insert(0, str(Path(__file__).parent))
sys.path.insert(0, str(Path(__file__).parents[2] / "examples" / "fmu"))
from pendulum_fmu import built
from pendulum_plant import DRAG, GRAVITY, INERTIA, swung, torques

pytestmark = pytest.mark.skipif(
    shutil.which("cc") is None, reason="no C compiler here to build an FMU with: apt install gcc libc6-dev"
)
DRY, LATE, PERIOD = 0.03, 3, 0.01


def recorded(rig: lh.Simulator, path: Path, *, seconds: float, noise: float = 1e-3) -> lh.Recording:
    random = np.random.default_rng(5)
    t = np.arange(0.0, seconds, PERIOD)
    u = torques(t, random)
    angle = swung(t, u, dry=DRY, late=LATE) + noise * random.standard_normal(len(t))
    recording = lh.recording(t, {"torque": u}, {"angle": angle}, rig=rig)
    recording.save(path)
    return lh.read(path)


@pytest.mark.parametrize("version", [2, 3])
def test_only_the_starts_of_a_description_change(tmp_path: Path, version: int) -> None:
    path = built(tmp_path, version=version)
    text = read_description(path)
    found = patch_fmu(text, {"inertia": 0.02, "drag": 0.01}, {"inertia": 0.025, "drag": 0.01, "a.b": 0.0})
    assert found.starts == {"inertia": 0.025}
    assert not found.remaining
    assert text.changed() == text.content.replace(b'start="0.02"', b'start="0.025"')
    new = tmp_path / "new.fmu"
    new.write_bytes(with_description(path, text.changed()))
    assert validate_fmu(str(new)) == []
    assert lh.fmu_simulator(new).parameters["inertia"].start == 0.025
    with zipfile.ZipFile(path) as before, zipfile.ZipFile(new) as after:
        assert before.namelist() == after.namelist()
        binary = before.namelist()[1]
        assert before.read(binary) == after.read(binary)


def test_extra_friction_at_rest_is_part_of_the_dry_friction(tmp_path: Path) -> None:
    values = {"coulomb_friction.level": 0.03, "static_friction.level": 0.01}
    found = patch_fmu(read_description(built(tmp_path, version=2)), {}, values)
    assert found.remaining == {"coulomb_friction.level": 0.04, "static_friction.level": 0.01}


@pytest.mark.extended
@pytest.mark.parametrize(
    ("version", "kinds", "noise"),
    [(2, "me cs", 1e-3), pytest.param(3, "cs", 3e-3, marks=pytest.mark.long)],
)
def test_the_repaired_fmu_keeps_the_promise_and_fmpy_runs_it(
    tmp_path: Path, version: int, kinds: str, noise: float
) -> None:
    """Co-simulation makes Euler's steps, whose error of 0.5 mrad would show beside a noise of 1 mrad."""
    path = built(tmp_path, version=version, kinds=kinds)
    before = path.read_bytes()
    rod = lh.fmu_simulator(path)
    recording = recorded(rod, tmp_path / "run.mcap", seconds=12.0, noise=noise)
    fit = lh.fit(recording, rod, terms=["coulomb_friction", "time_delay"])
    fixed = tmp_path / "fixed.fmu"
    found = fit.patch(path, fixed)
    assert found.attempts[-1].ratio <= MAX_ERROR_RATIO
    assert found.before > 5.0 * found.attempts[-1].rmse
    assert path.read_bytes() == before
    assert found.run_by == "the FMU"
    assert found.companion == tmp_path / "fixed_effects.py"
    functions = module_of(found.companion)
    expected = {"inertia": INERTIA, "gravity_torque": GRAVITY, "drag": DRAG}
    assert pytest.approx(expected, rel=0.05) == functions.PARAMETERS
    assert rms_of_fmpy(fixed, functions) < 0.2 * rms_of_fmpy(path, None)
    with pytest.raises(UsageError, match="expected a new file, found one there"):
        fit.patch(path, fixed)
    with pytest.raises(UsageError, match=r"new\.xml: expected a new file that ends in \.fmu"):
        fit.patch(path, tmp_path / "new.xml")


@pytest.mark.extended
@pytest.mark.timeout(600)
def test_where_the_own_solver_is_coarse_its_accelerations_keep_the_promise(tmp_path: Path) -> None:
    """Euler's steps of 10 ms, whose error is far beyond the noise: the attempts say so."""
    path = built(tmp_path, version=3, kinds="cs", step=PERIOD)
    rod = lh.fmu_simulator(path)
    recording = recorded(rod, tmp_path / "run.mcap", seconds=8.0)
    fit = lh.fit(recording, rod, terms=["coulomb_friction", "time_delay"])
    found = fit.patch(path, tmp_path / "fixed.fmu", rig=rod)
    assert found.attempts[-1].beside.startswith(INTEGRATED)
    assert found.attempts[-1].ratio <= MAX_ERROR_RATIO
    functions = module_of(tmp_path / "fixed_effects.py")
    expected = {"inertia": INERTIA, "gravity_torque": GRAVITY, "drag": DRAG}
    assert pytest.approx(expected, rel=0.05) == functions.PARAMETERS


def rms_of_fmpy(path: Path, functions: ModuleType | None) -> float:
    """RMS error, rad, of an FMU that fmpy steps by co-simulation, beside the plant without noise."""
    description = fmpy.read_model_description(str(path))
    fmu = fmpy.instantiate_fmu(fmpy.extract(str(path)), description, fmi_type="CoSimulation")
    references = {v.name: v.valueReference for v in description.modelVariables}
    third = description.fmiVersion.startswith("3")
    write, read = (fmu.setFloat64, fmu.getFloat64) if third else (fmu.setReal, fmu.getReal)
    parameters = {} if functions is None else functions.PARAMETERS
    if not third:
        fmu.setupExperiment(startTime=0.0)
    fmu.enterInitializationMode()
    for name, value in {**parameters, "angle": 0.2, "rate": 0.0}.items():
        write([references[name]], [value])
    fmu.exitInitializationMode()
    t = np.arange(0.0, 6.0, PERIOD)
    u = torques(t, np.random.default_rng(8))
    exact, angles, parts = swung(t, u, dry=DRY, late=LATE), [0.2], 16
    step = PERIOD / parts
    command = None if functions is None else functions.Command(float(u[0]))
    for k in range(len(t) - 1):
        for part in range(parts):
            acting = float(u[k]) if command is None else command(float(u[k]), step)
            if functions is not None:
                acting += functions.force(*read([references["angle"], references["rate"]]))
            write([references["torque"]], [acting])
            fmu.doStep(t[k] + part * step, step)
        angles.append(read([references["angle"]])[0])
    fmu.terminate()
    return float(np.sqrt(np.mean((np.array(angles) - exact) ** 2)))

"""A DC motor of MuJoCo: its values are parameters, its cogging is an effect and is written back."""

from __future__ import annotations

import sys
from pathlib import Path

import mujoco
import numpy as np
import pytest

from labhil.errors import UsageError
from labhil.simulators.dc_motor_file import COSINE, ORDER, SINE, cogging_numbers, read_cogging
from labhil.simulators.mjcf import read_mechanism
from labhil.simulators.patches import patch_mjcf
from labhil.simulators.xml_text import XmlText

sys.path.insert(0, str(Path(__file__).parent))
from motor_file import FILE, rig_of, with_motor


def written(tmp_path: Path, text: str) -> Path:
    path = tmp_path / "motor.xml"
    path.write_text(text, encoding="utf-8")
    return path


def test_its_constant_and_resistance_are_parameters_and_its_input_is_a_voltage(tmp_path: Path) -> None:
    rig = rig_of(written(tmp_path, FILE))
    assert rig.inputs == {"voltage": "V"}
    assert rig.parameters["motorconst"].start == 0.03
    assert rig.parameters["resistance"].start == 1.5
    assert ORDER not in rig.nominal
    assert rig_of(written(tmp_path, with_motor('cogging="0.002 7 0.4"'))).nominal[ORDER] == 7.0


@pytest.mark.parametrize("gear", [1.0, 3.0, -2.0])
def test_its_cogging_is_the_effect_of_the_catalogue_and_is_written_as_it_was(
    tmp_path: Path, gear: float
) -> None:
    path = written(tmp_path, with_motor(f'gear="{gear:g}" cogging="0.002 7 0.4"'))
    file = read_mechanism(path)
    values = read_cogging(file.model, 0)
    data = mujoco.MjData(file.model)
    for x in (0.1, 0.5, 1.3):
        data.qpos[0] = x
        mujoco.mj_forward(file.model, data)
        expected = -values[SINE] * np.sin(values[ORDER] * x) - values[COSINE] * np.cos(values[ORDER] * x)
        assert data.qfrc_actuator[0] == pytest.approx(expected)
        smooth = file.mechanism.acceleration_at([q.start for q in file.simulator.parameters.values()])
        assert smooth(np.array([x]), np.zeros(1), np.zeros(1))[0] == pytest.approx(0.0)
    text = XmlText.read(path)
    assert not patch_mjcf(file, text, values | {"viscous_friction.coefficient": 2e-6}).remaining
    again = mujoco.MjModel.from_xml_string(text.changed().decode())
    np.testing.assert_allclose(again.actuator_biasprm[0][:3], [0.002, 7.0, 0.4], rtol=1e-5)


def test_cogging_that_a_result_does_without_is_taken_out(tmp_path: Path) -> None:
    path = written(tmp_path, with_motor('cogging="0.002 7 0.4"'))
    text = XmlText.read(path)
    patch_mjcf(read_mechanism(path), text, {"motorconst": 0.031, "resistance": 1.6})
    model = mujoco.MjModel.from_xml_string(text.changed().decode())
    assert model.actuator_biasprm[0][0] == 0.0
    np.testing.assert_allclose(model.actuator_gainprm[0][:2], [1.6, 0.031])


@pytest.mark.parametrize("attribute", ['lugre="30 0.001 0.0006 0.0008 0.5"', 'inductance="0.001 0"'])
def test_a_motor_with_a_state_of_its_own_is_refused_with_a_remedy(tmp_path: Path, attribute: str) -> None:
    with pytest.raises(UsageError, match="leave inductance, thermal and lugre out"):
        rig_of(written(tmp_path, with_motor(attribute)))


@pytest.mark.parametrize(("order", "poles"), [(11.9999, 12.0), (24.01, 24.0), (12.3, 12.3), (-11.9999, 12.0)])
def test_a_motor_has_a_whole_number_of_poles(order: float, poles: float) -> None:
    gear = -1.0 if order < 0.0 else 1.0
    assert cogging_numbers({SINE: 1e-3, COSINE: 0.0, ORDER: abs(order)}, gear)[1] == poles

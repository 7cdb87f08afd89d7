"""What one compiled joint cannot hold of a MuJoCo file is refused or named; a late sensor is held."""

from __future__ import annotations

import sys
from pathlib import Path

import mujoco
import numpy as np
import pytest

import labhil as lh
from labhil.errors import UsageError
from labhil.physics.model import start_values
from labhil.physics.record import Windows
from labhil.physics.rigs import model_for, record_of
from labhil.simulators.mjcf import read_mechanism
from labhil.simulators.model import SimulatorModel

sys.path.insert(0, str(Path(__file__).parent))
from pendulum_file import FILE, bench, recorded

MOTOR = '<motor name="motor" joint="hinge"/>'
ENCODER = '<jointpos name="encoder" joint="hinge"/>'
END = "</mujoco>"


def of_joint(text: str) -> str:
    return FILE.replace('axis="0 1 0"/>', f'axis="0 1 0" {text}/>')


@pytest.mark.extended
@pytest.mark.parametrize(
    ("file", "expected"),
    [
        (of_joint('armature="-0.001"'), "armature: expected 0 or more, found -0.001, which takes inertia"),
        (of_joint('damping="-0.1"'), "damping: expected 0 or more, found -0.1, which pushes the joint on"),
        (of_joint('frictionloss="-0.1"'), "frictionloss: expected 0 or more, found -0.1"),
        (
            FILE.replace(END, '<equality><joint joint1="hinge"/></equality></mujoco>'),
            "expected no equality constraint, found 1 that hold the only joint",
        ),
        (
            FILE.replace(
                END,
                '<tendon><fixed frictionloss="1"><joint joint="hinge" coef="1"/></fixed></tendon></mujoco>',
            ),
            "tendons without dry friction and limits, found 1 with",
        ),
        (
            FILE.replace(MOTOR, '<motor name="motor" joint="hinge" gear="0"/>'),
            "expected motor to push the jo",
        ),
        (
            FILE.replace("<option", '<option><flag actuation="disable"/></option><option'),
            "actuation that a flag of the file switches off",
        ),
        (
            of_joint('actuatorfrcrange="-1 1"').replace(
                MOTOR, '<position name="motor" joint="hinge" kp="3"/>'
            ),
            "actuatorfrcrange at an actuator whose force is in proportion",
        ),
        (
            FILE.replace(
                ENCODER,
                '<jointpos name="encoder" joint="hinge" delay="0.02" nsample="30"/>'
                '<jointvel name="rate" joint="hinge"/>',
            ),
            "sensors of all outputs to be late by the same, found 0 s, 0.02 s",
        ),
    ],
)
def test_what_cannot_be_held_is_refused_before_anything_is_fitted(
    tmp_path: Path, file: str, expected: str
) -> None:
    (tmp_path / "rod.xml").write_text(file, encoding="utf-8")
    with pytest.raises(UsageError, match=expected):
        lh.mujoco_simulator(tmp_path / "rod.xml")


@pytest.mark.extended
def test_what_matters_only_in_places_is_named_in_the_notes(tmp_path: Path) -> None:
    file = FILE.replace(
        '<body name="rod">',
        '<geom name="wall" type="plane" pos="0.15 0 0" zaxis="-1 0 0" size="1 1 1"/><body name="rod">'
        '<geom name="bob" type="sphere" size="0.05" pos="0 0 -0.2" mass="0"/>',
    )
    file = file.replace(MOTOR, f'{MOTOR}<motor name="brake" joint="hinge"/>')
    file = file.replace(ENCODER, '<jointpos name="encoder" joint="hinge" cutoff="1"/>')
    rig = bench(tmp_path, file)
    fit = lh.fit(recorded(rig, seed=5, seconds=4.0), rig, terms=["viscous_friction"])
    notes = "\n".join(fit.to_dict()["notes"])
    assert "actuator brake is not the recorded input: it is held at 0" in notes
    assert "sensor encoder: it reads no more than ±1 in the file" in notes
    assert "bob and wall touch between -2.583" in notes
    assert "-0.5236 rad of the joint: the fitted model has no contacts" in notes


def test_limits_and_friction_that_the_file_switches_off_are_off(tmp_path: Path) -> None:
    file = of_joint('range="-30 30" damping="0.1" frictionloss="0.2" actuatorfrcrange="-3 2"')
    (tmp_path / "rod.xml").write_text(file, encoding="utf-8")
    held = read_mechanism(tmp_path / "rod.xml")
    assert held.mechanism.non_smooth.stops == pytest.approx((-np.pi / 6, np.pi / 6))
    assert held.mechanism.non_smooth.clip == pytest.approx((-3.0, 2.0))
    assert held.simulator.nominal["coulomb_friction.level"] == 0.2
    flags = '<option><flag constraint="disable" damper="disable"/></option><option'
    (tmp_path / "rod.xml").write_text(file.replace("<option", flags), encoding="utf-8")
    off = read_mechanism(tmp_path / "rod.xml")
    assert off.mechanism.non_smooth.stops == (-np.inf, np.inf)
    assert "coulomb_friction.level" not in off.simulator.nominal
    assert off.simulator.nominal["viscous_friction.coefficient"] == 0.0


def test_only_a_servo_has_the_values_of_one(tmp_path: Path) -> None:
    general = '<general name="motor" joint="hinge" gainprm="2" biastype="affine" biasprm="0 -5 -0.1"/>'
    (tmp_path / "rod.xml").write_text(FILE.replace(MOTOR, general), encoding="utf-8")
    assert set(lh.mujoco_simulator(tmp_path / "rod.xml").parameters) == {"rod_mass", "gear"}


@pytest.mark.extended
def test_a_late_sensor_is_read_as_mujoco_reads_it(tmp_path: Path) -> None:
    """Against the sensor's own readings, stepped by MuJoCo alone."""
    late = '<jointpos name="encoder" joint="hinge" delay="0.05" nsample="60" interp="linear"/>'
    path = tmp_path / "rod.xml"
    path.write_text(FILE.replace(ENCODER, late), encoding="utf-8")
    model = mujoco.MjModel.from_xml_path(str(path))
    data, read = mujoco.MjData(model), []
    t = np.arange(0.0, 6.0, 0.01)
    torque = 0.1 * np.sin(3.0 * t) + 0.05 * np.sin(8.0 * t)
    for u in torque:
        data.ctrl[0] = u
        mujoco.mj_forward(model, data)
        read.append(float(data.sensordata[0]))
        mujoco.mj_step(model, data, 10)
    described = read_mechanism(path)
    rig = described.simulator
    assert described.mechanism.non_smooth.delay == pytest.approx(0.05)
    assert described.mechanism.input_delay == 0.0
    recording = lh.recording(t, {"motor": torque}, {"encoder": np.array(read)}, rig=rig)
    record = record_of(recording.file, rig.kind)
    built = model_for(rig.rig_file, record)
    assert isinstance(built, SimulatorModel)
    windows = Windows.of([(100, 250), (300, 450)])
    rate = np.gradient(np.array(read), t)
    states = np.column_stack([record.outputs[[100, 300], 0], rate[[100, 300]]])
    fitted = built.simulate(start_values(built.parameters), record, windows, states)[:, 0]
    measured = record.outputs[windows.rows, 0]
    assert np.max(np.abs(fitted - measured)) < 0.02 * np.ptp(measured)
    nodes = built._path.nodes(record, 0, lambda name: 0.0)
    numbers = [quantity.start for quantity in rig.parameters.values()]
    itself = described.mechanism.roll_out(numbers, record, nodes, windows, states)[:, 0]
    assert np.max(np.abs(itself - fitted)) < 0.01 * np.ptp(measured)

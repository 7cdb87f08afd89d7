"""A recording whose sign or unit is not the simulator's is said so, before anything is searched."""

from __future__ import annotations

import math
import sys
from pathlib import Path

import numpy as np
import pytest

import labhil as lh
from labhil.physics.rigs import model_for, record_of

sys.path.insert(0, str(Path(__file__).parent))
from bare_pendulum import pendulum
from pendulum_plant import swung, torques

PENDULUM = pendulum(name="agreed")


def notes(of_angle: float = 1.0, of_torque: float = 1.0, *, driven: bool = True) -> list[str]:
    """What is said of a recording whose columns are scaled so."""
    random = np.random.default_rng(2)
    t = np.arange(0.0, 20.0, 0.01)
    torque = torques(t, random) * driven
    angle = swung(t, torque, dry=0.02) + 1e-3 * random.standard_normal(len(t))
    recording = lh.recording(t, {"torque": of_torque * torque}, {"angle": of_angle * angle}, rig=PENDULUM)
    model = model_for(PENDULUM.rig_file, record_of(recording.file, PENDULUM.kind))
    return [note for note in model.notes if " moves " in note]


def test_nothing_is_said_where_values_alone_differ() -> None:
    assert notes() == []
    assert notes(of_torque=3.0) == []
    assert notes(-1.0, -1.0) == []
    assert notes(0.0) == []  # a sensor that says nothing


@pytest.mark.parametrize(("of_angle", "of_torque"), [(-1.0, 1.0), (1.0, -1.0)])
def test_a_motion_the_other_way_is_said_so(of_angle: float, of_torque: float) -> None:
    (note,) = notes(of_angle, of_torque)
    assert note.startswith("angle moves the other way than that of agreed under the same torque")


@pytest.mark.parametrize(
    ("of_angle", "of_torque"), [(180.0 / math.pi, 1.0), (1000.0, 1.0), (1.0, 1000.0)], ids=str
)
def test_units_that_are_others_are_asked_for(of_angle: float, of_torque: float) -> None:
    (note,) = notes(of_angle, of_torque)
    times = float(note.split(" moves ")[1].split(" times")[0])
    # the plant's inertia is 1.25 times the simulator's
    assert times == pytest.approx(of_angle / of_torque / 1.25, rel=0.1)

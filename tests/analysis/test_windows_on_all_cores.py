"""A long simulation is shared out among cores by its windows, and is the same to the bit."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from labhil.identify import problem as module
from labhil.identify.problem import Problem
from labhil.physics.model import index_of, start_values
from labhil.physics.record import Record, Windows
from labhil.physics.rigs import model_for
from labhil.rig import default_rig

N = 20_000


@given(st.lists(st.integers(1, 9), min_size=1, max_size=30), st.integers(1, 40))
def test_parts_are_all_windows_in_their_order(lengths: list[int], count: int) -> None:
    ends = np.cumsum(lengths).tolist()
    windows = Windows.of(list(zip([0, *ends[:-1]], ends, strict=True)))
    parts = windows.split(count)
    assert 1 <= len(parts) <= min(count, len(windows))
    assert np.concatenate([part.first for _, part in parts]).tolist() == windows.first.tolist()
    assert np.concatenate([part.rows for _, part in parts]).tolist() == windows.rows.tolist()
    assert [len(part) for _, part in parts] == [len(windows.first[place]) for place, _ in parts]
    even, longest = len(windows.rows) / count, max(lengths)
    assert all(len(part.rows) < even + 2 * longest for _, part in parts)


@pytest.mark.parametrize("rig", ["axis", "dc_motor", "solenoid", "ball_beam"])
def test_windows_on_several_cores_are_simulated_as_on_one(rig: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(module, "cores", lambda: 3)
    t = 1e-3 * np.arange(N)
    names = {
        "axis": ("drive_force", "position", "m"),
        "dc_motor": ("voltage", "speed", "rad/s"),
        "solenoid": ("coil_current", "plunger_position", "m"),
        "ball_beam": ("servo_angle", "ball_position", "m"),
    }
    drive, output, unit = names[rig]
    u = np.sin(3.0 * t) + 0.5 * np.sin(17.0 * t)
    record = Record(t, u[:, None], 1e-3 * np.cos(3.0 * t)[:, None], (drive,), (output,), (unit,))
    model = model_for(default_rig(rig), record)
    theta, places = start_values(model.parameters), index_of(model.parameters)
    theta[places["coulomb_friction.level"]] = 0.1
    edges = np.linspace(0, N, 38, dtype=int).tolist()
    windows = Windows.of(list(pairwise(edges)))
    free = np.array([places["coulomb_friction.level"]])
    shared = Problem(model, record, windows, free, theta, np.array([1e-4]))
    part = shared.select_windows(np.arange(5, 30))
    assert (len(shared._parts), len(part._parts)) == (3, 2)
    results = [
        (p.residuals(p.start()), p.linearise(p.start(), p.residuals(p.start()))) for p in (shared, part)
    ]
    monkeypatch.setattr(module, "cores", lambda: 1)
    alone = Problem(model, record, windows, free, theta, np.array([1e-4]))
    assert not alone._parts
    for p, (residuals, lin) in zip((alone, alone.select_windows(np.arange(5, 30))), results, strict=True):
        np.testing.assert_array_equal(p.residuals(p.start()), residuals)
        np.testing.assert_array_equal(p.linearise(p.start(), residuals).by_states, lin.by_states)

"""A busy machine invents no physics: a run beside processes that compute, fitted with the true terms."""

import sys
from pathlib import Path
from subprocess import DEVNULL, Popen

import numpy as np
import pytest

from labhil.analysis.dataset import load_dataset
from labhil.analysis.study import fit_study
from labhil.experiment.experiment import parse_experiment
from labhil.experiment.run import run_experiment
from labhil.recording.clock_faults import ClockFaultKind
from labhil.recording.reader import read_recording
from labhil.recording.stamps import HOST_CLOCK

TRUTH = {"viscous_friction.coefficient": 0.26, "coulomb_friction.level": 0.09}
RIG = """
[rig]
kind = "ball_beam"
[known]
ball_mass = 0.261
ball_radius = 0.02
crank_radius = 0.08
beam_length = 0.40
"""
EXPERIMENT = """
[experiment]
name = "busy"
[devices.bench]
plugin = "ball_beam"
address = "twin"
rig = "rig.toml"
[devices.bench.twin]
speed = 1.0
seed = 3
terms = ["viscous_friction", "coulomb_friction"]
set = { viscous_friction.coefficient = 0.26, coulomb_friction.level = 0.09 }
[[steps]]
device = "bench"
signal = "servo_angle"
excitation = "two_sine"
frequencies = [0.23, 0.31]
amplitude = 0.6
stabilise = { on = "ball_position", kp = 7.0, kd = 3.0 }
duration = 20.0
"""


@pytest.mark.extended
@pytest.mark.timeout(300)
def test_a_run_beside_busy_processes_is_fitted_with_what_the_twin_is_made_of(tmp_path: Path) -> None:
    (tmp_path / "rig.toml").write_text(RIG, encoding="utf-8")
    burn = "import time\nend = time.monotonic() + 120\nwhile time.monotonic() < end: pass"
    busy = [Popen([sys.executable, "-c", burn], stdout=DEVNULL) for _ in range(3)]
    try:
        result = run_experiment(parse_experiment(EXPERIMENT, tmp_path / "e.toml"), tmp_path)
    finally:
        for process in busy:
            process.kill()
            process.wait()
    assert result.exit_status == 0, result.reason
    assert result.path is not None
    recording = read_recording(result.path)
    data = recording.stream_with("ball_position")
    assert HOST_CLOCK in data.metadata
    assert np.diff(data.t) == pytest.approx(0.01, abs=1e-9)
    assert [fault.kind for fault in data.clock_faults if fault.distorts_time] == []
    # a step that is not there can only be a world that paused; the run says what the reader finds
    of_clocks = [warning for warning in result.warnings if "the disk is slow" not in warning]
    assert bool(of_clocks) == bool(data.clock_faults)
    assert all(fault.kind is not ClockFaultKind.NO_CLOCK for fault in data.clock_faults)
    if data.clock.drift_error is not None and not data.clock.steps:
        assert data.clock.drift == pytest.approx(50e-6, abs=max(5.0 * data.clock.drift_error, 20e-6))
    found = fit_study(load_dataset(result.path), terms=("viscous_friction", "coulomb_friction")).fit
    rows = {row.name: row for row in found.estimates}
    for name, truth in TRUTH.items():
        assert abs(rows[name].value - truth) < 4.0 * rows[name].std_error, name
    (channel,) = found.test.channels
    assert channel.rmse < 1.3 * channel.noise_floor

"""Three devices at once, each behind its own driver and process, in one recording."""

from importlib.resources import as_file, files

import numpy as np
import pytest

from labhil.experiment.experiment import load_experiment
from labhil.experiment.run import run_experiment
from labhil.recording.reader import read_recording

STREAMS = {
    "beam": {"ball_position", "servo_angle"},
    "coil": {"coil_current", "plunger_position", "coil_voltage", "magnetic_force", "coil_current_command"},
    "motor": {"speed", "current", "angle", "voltage"},
}


@pytest.mark.extended
def test_three_rigs_move_together_into_one_recording(tmp_path):
    with as_file(files("labhil.experiment") / "examples") as examples:
        shipped = load_experiment(examples / "three_rigs.toml")
        steps = tuple(step.model_copy(update={"duration": 6.0}) for step in shipped.steps)
        result = run_experiment(shipped.model_copy(update={"steps": steps}), tmp_path)
    assert (result.exit_status, result.reason) == (0, "all steps are done")
    recording = read_recording(result.path)
    states = {data.device: data for data in recording.streams if data.stream.name == "state"}
    assert {device: set(data.stream.names()) for device, data in states.items()} == STREAMS
    moved = {"beam": "ball_position", "coil": "plunger_position", "motor": "speed"}
    for device, data in states.items():
        assert data.lost == 0
        assert data.clock.device_clock
        assert np.ptp(data.t) > 5.0
        assert np.ptp(data[moved[device]]) > 0.0
    # the devices are prepared side by side, and the recording begins when all are ready: none idles in it
    assert np.ptp([data.t_acq_ns[0] for data in states.values()]) < 1e9
    assert np.ptp([data.t[-1] for data in states.values()]) < 1.0

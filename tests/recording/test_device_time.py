"""Recordings whose host was set or stood still: every stream and event in the device's own time."""

import numpy as np
import pytest

from labhil.diagnose.intake import FaultKind, assess_usability, detect_faults
from labhil.kinds import kind_named
from labhil.physics.rigs import record_of
from labhil.recording import RecordingWriter, read_recording
from labhil.recording.stamps import HOST_CLOCK
from labhil.signals import Batch, Direction, Signal, Stream

START = 1_790_000_000_000_000_000
STATE = Stream(
    "state",
    (Signal("servo_angle", "rad", Direction.INPUT), Signal("ball_position", "m", Direction.OUTPUT)),
    100.0,
)
COMMAND = Stream("command", (Signal("servo_angle_applied", "rad", Direction.REQUESTED),), 100.0)
SAMPLES = 1000


def values(seq):
    t = seq / 100.0
    noise = 1e-4 * np.random.default_rng(1).standard_normal(len(seq))
    return np.column_stack([0.3 * np.sin(2.0 * t), 0.1 * np.cos(1.3 * t) + noise])


def write_state(writer, device, host, phase=0.0, own_clock=True, **metadata):
    """Write samples that came in at ``host`` (s) and that the device stamped by its own clock, or by none."""
    seq = np.arange(len(host))
    t_hw_ns = (seq * 10_000_000 + round(phase * 1e9)) * own_clock
    channel = writer.add_stream(device, STATE, metadata)
    t_acq_ns = START + np.rint(host * 1e9).astype(np.int64)
    writer.write(channel, Batch(seq, t_acq_ns, t_hw_ns, values(seq)))


def write_commands(writer, device, host, phase=0.0):
    """Write commands as a host stamps them: its clock, and the newest sample's plus what passed since."""
    seq = np.arange(len(host))
    t_hw_ns = seq * 10_000_000 + round((phase + 0.002) * 1e9)
    t_hw_ns[400] -= 480_000_000  # between two stamps the clock was set
    channel = writer.add_stream(device, COMMAND)
    t_acq_ns = START + np.rint((host + 0.002) * 1e9).astype(np.int64)
    writer.write(channel, Batch(seq, t_acq_ns, t_hw_ns, np.zeros((len(seq), 1))))


def host_times(step=0.0, at=400, begin=0.0):
    host = begin + np.arange(SAMPLES) / 100.0 + np.random.default_rng(2).exponential(3e-4, SAMPLES)
    host[at:] += step
    return host


@pytest.mark.parametrize("step", [-0.5, 0.5, -3600.0, 3600.0])
def test_a_clock_that_was_set_moves_no_sample_and_is_named(tmp_path, step):
    with RecordingWriter(tmp_path / "a.mcap") as writer:
        write_state(writer, "bench", host_times(step), phase=7.0)
        write_commands(writer, "bench", host_times(step), phase=7.0)
        writer.event("run", START + round((8.0 + step) * 1e9), {"text": "late"})
        writer.event("bench", START + round(2.0 * 1e9), {"text": "early"})
    recording = read_recording(tmp_path / "a.mcap")
    state, command = recording.streams
    assert state.t == pytest.approx(np.arange(SAMPLES) / 100.0, abs=1e-9)
    assert state.rate == pytest.approx(100.0)
    assert (np.diff(command.t) > 0).all()
    assert command.t == pytest.approx(state.t + 0.002, abs=0.011)
    times = {event.body["text"]: event.t for event in recording.events}
    assert times == pytest.approx({"early": 2.0, "late": 8.0}, abs=0.002)
    (line,) = recording.warnings()
    assert "bench/state: the host's stamps jump by" in line and "at 4 s" in line
    assert recording.clocks["bench"].stepped == pytest.approx(abs(step), abs=0.01)
    (fault,) = detect_faults(record_of(recording, kind_named("ball_beam")))
    assert fault.kind is FaultKind.CLOCK_STEP and fault.statement.startswith("The host's stamps")
    assert assess_usability(record_of(recording, kind_named("ball_beam")), [fault]).is_usable


def test_without_a_clock_of_the_device_a_step_makes_data_unfit(tmp_path):
    with RecordingWriter(tmp_path / "a.mcap") as writer:
        write_state(writer, "bench", host_times(-0.5), own_clock=False)
    recording = read_recording(tmp_path / "a.mcap")
    assert "no clock of its own" in recording.warnings()[0]
    record = record_of(recording, kind_named("ball_beam"))
    faults = detect_faults(record)
    assert FaultKind.CLOCK_STEP in [fault.kind for fault in faults]
    assert not assess_usability(record, faults).is_usable


def test_what_is_cut_out_beside_a_step_has_none(tmp_path):
    with RecordingWriter(tmp_path / "a.mcap") as writer:
        write_state(writer, "bench", host_times(-0.5), own_clock=False)
    record = record_of(read_recording(tmp_path / "a.mcap"), kind_named("ball_beam"))
    assert FaultKind.CLOCK_STEP not in [fault.kind for fault in detect_faults(record.part(400, SAMPLES))]


def test_several_devices_share_the_hosts_time(tmp_path):
    """One clock 400 ppm fast, one that starts later: each has its own steps, and both one common time."""
    late = host_times(begin=3.0)
    with RecordingWriter(tmp_path / "a.mcap") as writer:
        write_state(writer, "fast", host_times() / (1 + 400e-6), phase=50.0)
        write_state(writer, "late", late, phase=9.0)
    recording = read_recording(tmp_path / "a.mcap")
    fast, other = recording.streams
    assert recording.warnings() == []
    for data in (fast, other):
        assert np.diff(data.t) == pytest.approx(0.01, abs=1e-9)
    assert (fast.t[0], other.t[0]) == pytest.approx((0.0, 3.0), abs=1e-3)
    true = np.arange(SAMPLES) / 100.0
    assert fast.t_common == pytest.approx(true / (1 + 400e-6), abs=5e-4)
    assert other.t_common == pytest.approx(3.0 + true, abs=5e-4)
    found = recording.clock_offsets["fast", "late"]
    elapsed = (found.t_host_ns - START) * 1e-9
    assert found.offset == pytest.approx(50.0 + elapsed * (1 + 400e-6) - (9.0 + elapsed - 3.0), abs=1e-3)


def test_a_recording_by_the_steady_clock_blames_no_host(tmp_path):
    with RecordingWriter(tmp_path / "a.mcap") as writer:
        write_state(writer, "bench", host_times(0.4), **{HOST_CLOCK: "0"})
    (line,) = read_recording(tmp_path / "a.mcap").warnings()
    assert "stood still" in line and "clock was set" not in line


SPEED = 20.0


def twin_times(stops=3.0, lasts=2.0, catches_up=4.0):
    """When the samples of a twin at 20 times real time came in (s of the host); for 0.1 s it had no time."""
    world = np.arange(6000) / 100.0
    behind = np.clip(1.0 - (world - stops) / catches_up, 0.0, 1.0) * (world > stops)
    late = np.random.default_rng(2).exponential(1e-4, 6000)
    return world, np.maximum.accumulate(world / SPEED + lasts / SPEED * behind + late)


def test_an_event_lies_among_the_samples_that_came_in_around_it_whatever_the_speed(tmp_path):
    host = twin_times()[1]
    with RecordingWriter(tmp_path / "a.mcap") as writer:
        write_state(writer, "bench", host, speed="20")
        for moment in (1.0, 2.99, 3.1, 3.5, 50.0):
            came = float(host[round(100.0 * moment)])
            writer.event("run", START + round(came * 1e9) + 1000, {"text": str(moment)})
        writer.event("run", START + round((host[-1] + 0.5) * 1e9), {"text": "60.0"})
    recording = read_recording(tmp_path / "a.mcap")
    times = {float(event.body["text"]): event.t for event in recording.events}
    assert times.pop(60.0) == pytest.approx(60.0 + 0.5 * SPEED, abs=0.1)
    for moment, t in times.items():
        assert t == pytest.approx(moment, abs=0.0101), "within the sample that came in just before"


def test_requested_values_of_a_fast_twin_keep_their_times_to_the_end(tmp_path):
    """Where samples are late, the host's times of commands go back, many rows in a row."""
    world, host = twin_times()
    command_hw = np.maximum(world + 0.2 * np.random.default_rng(3).standard_normal(len(world)), 0.0)
    with RecordingWriter(tmp_path / "a.mcap") as writer:
        write_state(writer, "bench", host, speed="20")
        channel = writer.add_stream("bench", COMMAND, {"speed": "20"})
        stamps = START + np.rint((host + 1e-4) * 1e9).astype(np.int64)
        seq = np.arange(len(world))
        hw_ns = np.rint(command_hw * 1e9).astype(np.int64)
        writer.write(channel, Batch(seq, stamps, hw_ns, np.zeros((len(seq), 1))))
    state, command = read_recording(tmp_path / "a.mcap").streams
    assert (np.diff(command.t) >= 0).all()
    assert np.abs(command.t - state.t).max() < 1.0

"""The emergency stop in every state of a run: exit status and recording say so."""

from __future__ import annotations

import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

from labhil.bus import latch
from labhil.errors import CommandRefusedError, DeviceError, EmergencyStopError
from labhil.experiment.interruption import emergency_stop_or, reason_of

sys.path.insert(0, str(Path(__file__).parents[2] / "benchmarks" / "measuring"))


@pytest.fixture(autouse=True)
def no_stop_stands() -> Iterator[None]:
    yield
    latch.release()


def test_a_stop_takes_the_place_of_a_good_end_and_of_a_refusal_and_of_nothing_else() -> None:
    refusal, failure = CommandRefusedError("an emergency stop stands"), DeviceError("the wire is gone")
    for unchanged in (None, refusal, failure):
        assert emergency_stop_or(unchanged) is unchanged
    latch.press("a test", "the ball jumped")
    for error in (None, refusal):
        found = emergency_stop_or(error)
        assert isinstance(found, EmergencyStopError) and found.exit_status == 1
        assert "the ball jumped" in str(found)
    assert emergency_stop_or(failure) is failure


def test_a_reason_names_the_stop_that_stands_beside_it() -> None:
    failure = DeviceError("the wire is gone")
    assert reason_of(failure) == "the wire is gone"
    latch.press("a test", "the ball jumped")
    assert reason_of(failure).startswith("the wire is gone; emergency stop by a test")
    assert reason_of(EmergencyStopError("emergency stop by a test")) == "emergency stop by a test"


@pytest.mark.extended
@pytest.mark.parametrize("state", ["starting", "running", "paused", "stopping"])
def test_a_stop_ends_a_run_in_every_state(state: str) -> None:
    import measure_estop
    from measure_safety import twin_behind_a_relay

    with twin_behind_a_relay() as relay:
        trial = measure_estop.press(relay, state, "file")
    assert measure_estop.is_right(trial), trial


@pytest.mark.extended
def test_a_stop_while_the_disk_is_full_latches_and_makes_the_device_safe() -> None:
    import measure_estop
    from measure_safety import twin_behind_a_relay

    with twin_behind_a_relay() as relay:
        trial = measure_estop.press(relay, "running, disk full", "file")
    # a full disk may hold no reason; what the run prints names the stop, beside the disk that ended the run
    assert measure_estop.is_right(trial), trial


@pytest.mark.extended
def test_a_stop_while_the_bus_is_cut_latches_and_makes_the_device_safe() -> None:
    import measure_estop
    from measure_safety import twin_behind_a_relay

    try:
        with twin_behind_a_relay() as relay:
            trial = measure_estop.press(relay, "running, bus cut", "file")
    except (OSError, subprocess.CalledProcessError) as error:
        pytest.skip(f"connections cannot be cut here: {error}")
    assert measure_estop.is_right(trial), trial

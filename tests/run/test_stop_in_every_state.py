"""The emergency stop in every state of a run: exit status and recording say so."""

from __future__ import annotations

import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

from labhil.bus import latch
from labhil.errors import CommandRefusedError, DeviceError, EmergencyStopError
from labhil.experiment.interruption import emergency_stop_or

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
    # the run may have been ended by the disk a moment before, and a full disk holds no reason
    assert (trial["latched"], trial["device_safe"], trial["exit_status"]) == (True, True, 1), trial

from __future__ import annotations

import contextlib
import os
import signal
import time
from collections.abc import Callable
from typing import Any

import pytest

from labhil.bus.keys import setpoint_key
from labhil.bus.publish import publish_command
from labhil.errors import BusError, CommandRefusedError, ConnectError, DeviceResetError, DeviceSilentError
from labhil.rig_sections import Limit
from labhil.service.hosts import HostProcess
from labhil.service.messages import WATCHDOG, HostConfig, Setpoint

Start = Callable[..., Any]


def test_a_host_tells_what_it_is_connected_to(bench: Any) -> None:
    assert bench.device.stream.names() == ("ball_position", "servo_angle")
    assert bench.device.safe == {"servo_angle": 0.0}
    assert bench.device.speed == 2.0
    status = bench.ask("status")
    assert status["state"] == "idle"
    assert status["holder"] is None


def test_a_command_answers_with_what_was_applied(bench: Any) -> None:
    bench.take_lease()
    answer = bench.set(0.5)
    assert answer["requested"] == {"servo_angle": 0.5}
    # the rate limit, 5 rad/s, allows 0.05 rad within the first sample
    assert answer["applied"]["servo_angle"] == pytest.approx(0.05, abs=0.02)
    assert bench.ask("status")["state"] == "active"


@pytest.mark.parametrize(
    ("angle", "reason"),
    [(1.1, "outside its limits, -1 to 1"), (float("nan"), "finite number"), (float("inf"), "finite number")],
)
def test_a_command_that_cannot_be_carried_out_is_refused(bench: Any, angle: float, reason: str) -> None:
    bench.take_lease()
    with pytest.raises(CommandRefusedError, match=reason):
        bench.set(angle)
    assert bench.ask("status")["state"] == "idle"


def test_commands_need_the_lease_and_a_fresh_setpoint(bench: Any) -> None:
    with pytest.raises(CommandRefusedError, match="nobody holds the lease"):
        bench.set(0.1)
    bench.take_lease("first")
    with pytest.raises(CommandRefusedError, match="held by 'first'"):
        bench.ask("lease", action="take", holder="second")
    with pytest.raises(CommandRefusedError, match="not its token"):
        bench.set(0.1, token="guessed")
    with pytest.raises(CommandRefusedError, match="stale"):
        bench.set(0.1, age=60.0)
    bench.ask("lease", action="return", token=bench.token)
    bench.take_lease("second")


def test_the_watchdog_makes_safe_when_commands_stop(start_bench: Start) -> None:
    bench = start_bench(watchdog=WATCHDOG)
    bench.take_lease()
    bench.put(0.1)
    bench.wait_for_event("active")
    event = bench.wait_for_event("watchdog")
    assert "commands stopped" in event["message"]
    status = bench.ask("status")
    assert (status["state"], status["applied"]) == ("idle", {"servo_angle": 0.0})
    with pytest.raises(CommandRefusedError, match="revoked"):
        bench.set(0.1)


def test_a_sample_outside_its_limits_makes_safe(start_bench: Start) -> None:
    bench = start_bench({"ball_position": Limit(min=-0.02, max=0.02)})
    bench.take_lease()
    while not any(event["kind"] == "tripped" for event in bench.events):
        bench.put(0.8)
        time.sleep(0.02)
    assert "ball_position" in bench.wait_for_event("tripped")["message"]
    assert bench.ask("status")["state"] == "tripped"
    with pytest.raises(CommandRefusedError):
        bench.set(0.0)


@pytest.mark.extended
def test_an_output_that_lasts_too_long_trips_the_host_which_goes_on(start_bench: Start) -> None:
    bench = start_bench({}, plugin="solenoid", set={"longest_output": 1.0})
    command = "coil_current_command"
    for times in (1, 2):
        bench.take_lease()
        while sum(event["kind"] == "tripped" for event in bench.events) < times:
            with contextlib.suppress(CommandRefusedError):  # it trips between two commands
                bench.ask("set", **Setpoint(bench.token, time.time_ns(), {command: 0.5}).to_json())
            time.sleep(0.02)
        assert "lasted longer" in bench.wait_for_event("tripped")["message"]
        status = bench.ask("status")
        assert (status["state"], status["applied"]) == ("tripped", {command: 0.0})
    assert bench.host.failure() is None


@pytest.mark.extended
def test_a_command_is_kept_within_what_the_device_takes(start_bench: Start) -> None:
    """A controller saturates there; whoever asks for such a value outright is told."""
    bench = start_bench({}, plugin="solenoid", set={})
    command = "coil_current_command"
    bench.take_lease()
    with pytest.raises(CommandRefusedError, match=r"9 is outside its limits, 0 to 2\.7"):
        bench.ask("set", **Setpoint(bench.token, time.time_ns(), {command: 9.0}).to_json())
    for asked, taken in ((9.0, 2.7), (-1.0, 0.0)):
        while bench.ask("status")["applied"] != {command: taken}:
            publish_command(
                bench.bus,
                setpoint_key("bench"),
                Setpoint(bench.token, time.time_ns(), {command: asked}).to_bytes(),
            )
            time.sleep(0.01)
    assert bench.ask("status")["state"] == "active"


def test_a_refused_setpoint_is_said_once(bench: Any) -> None:
    while not any(event["kind"] == "refused" for event in bench.events):
        bench.put(0.1)
        time.sleep(0.01)
    assert "lease" in bench.wait_for_event("refused")["message"]
    for _ in range(5):
        bench.put(0.1)
    bench.ask("status")
    assert sum(event["kind"] == "refused" for event in bench.events) == 1


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_signals_end_a_host_in_order(bench: Any, number: int) -> None:
    bench.take_lease()
    bench.set(0.2)
    os.kill(bench.host.pid, number)
    event = bench.wait_for_event("stopped")
    assert event["message"] == signal.Signals(number).name


def test_a_host_ends_when_its_parent_is_gone(bench: Any) -> None:
    bench.host.request_end()
    event = bench.wait_for_event("stopped")
    assert event["message"] == "standard input closed"
    assert event["counters"]["crc_errors"] == 0


def test_a_host_can_be_told_to_shut_down(bench: Any) -> None:
    bench.ask("shutdown")
    assert "shut down" in bench.wait_for_event("stopped")["message"]


@pytest.mark.extended
@pytest.mark.parametrize(
    ("fault", "error"), [("fault_reset_at", DeviceResetError), ("fault_silence_at", DeviceSilentError)]
)
def test_a_failing_device_ends_its_host_with_its_error(
    start_bench: Start, fault: str, error: type[Exception]
) -> None:
    bench = start_bench(set={fault: 0.2})
    bench.take_lease()
    deadline = time.monotonic() + 90.0
    while (failure := bench.host.failure()) is None and time.monotonic() < deadline:
        bench.put(0.0)
        time.sleep(0.02)
    assert isinstance(failure, error)
    assert bench.wait_for_event("failed")["error"] == error.__name__


def test_a_port_that_is_not_there_is_told_by_name() -> None:
    host = HostProcess(HostConfig("bench", "ball_beam", "/dev/ttyNOT_THERE"))
    try:
        with pytest.raises(ConnectError, match=r"bench: .*/dev/ttyNOT_THERE"):
            host.wait_connected()
    finally:
        host.stop()


def test_a_host_that_was_killed_is_told_by_its_signal(bench: Any) -> None:
    os.kill(bench.host.pid, signal.SIGKILL)
    deadline = time.monotonic() + 90.0
    while (failure := bench.host.failure()) is None and time.monotonic() < deadline:
        time.sleep(0.02)
    assert isinstance(failure, BusError)
    assert "SIGKILL" in str(failure)

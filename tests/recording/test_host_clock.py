"""The clock of host stamps: one for all processes of a session, and never set."""

import os
import subprocess
import sys
import time

import pytest

from labhil import host_clock
from labhil.host_clock import (
    OFFSET_VARIABLE,
    HostClockWatch,
    SuspendWatch,
    offset_ns,
    session_clock,
    steady_ns,
    unix_ns,
)

ASK = "from labhil.host_clock import offset_ns, unix_ns; print(offset_ns(), unix_ns())"


def in_a_process():
    found = subprocess.run([sys.executable, "-c", ASK], capture_output=True, text=True, check=True)
    offset, now = found.stdout.split()
    return int(offset), int(now)


def test_processes_of_a_session_share_its_clock():
    with session_clock() as offset:
        before = unix_ns()
        found, now = in_a_process()
        assert found == offset == offset_ns()
        assert before < now < unix_ns()
    assert OFFSET_VARIABLE not in os.environ


def test_a_session_is_anchored_once_whatever_becomes_of_the_wall_clock(monkeypatch):
    wall = time.time_ns
    with session_clock() as offset:
        assert abs(unix_ns() - wall()) < 50_000_000
        monkeypatch.setattr(time, "time_ns", lambda: wall() + 3_600_000_000_000)
        with session_clock() as inner:
            assert inner == offset
        assert abs(unix_ns() - wall()) < 50_000_000
    with session_clock() as again:
        assert again - offset == pytest.approx(3_600_000_000_000, abs=50_000_000)
    monkeypatch.undo()
    with session_clock():
        assert abs(unix_ns() - wall()) < 50_000_000


def test_the_steady_clock_counts_suspends():
    if not hasattr(time, "CLOCK_BOOTTIME"):
        pytest.skip("this system has no CLOCK_BOOTTIME")
    assert abs(steady_ns() - time.clock_gettime_ns(time.CLOCK_BOOTTIME)) < 50_000_000


def test_a_wall_clock_that_is_set_is_noticed_once(monkeypatch):
    wall, watch = time.time_ns, HostClockWatch()
    assert watch.look() == []
    monkeypatch.setattr(time, "time_ns", lambda: wall() - 3_600_000_000_000)
    ((kind, message),) = watch.look()
    assert kind == "clock_set" and "set back by 3600 s" in message
    assert watch.look() == []
    monkeypatch.undo()
    ((kind, message),) = watch.look()
    assert kind == "clock_set" and "set ahead by 3600 s" in message


def test_a_suspend_is_noticed_and_is_no_step_of_the_wall_clock(monkeypatch):
    wall, clock = time.time_ns, time.clock_gettime_ns
    watch, suspends = HostClockWatch(), SuspendWatch()
    assert abs(suspends.slept()) < 0.05

    def shifted(number):
        return clock(number) + (20_000_000_000 if number == host_clock._CLOCK else 0)

    monkeypatch.setattr(time, "time_ns", lambda: wall() + 20_000_000_000)
    monkeypatch.setattr(time, "clock_gettime_ns", shifted)
    assert suspends.slept() == pytest.approx(20.0, abs=0.05)
    ((kind, message),) = watch.look()
    assert kind == "suspended" and "for 20 s" in message
    assert watch.look() == [] and abs(suspends.slept()) < 0.05

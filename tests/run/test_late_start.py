"""Steps begin where their first setpoint can act, however many samples waited on a busy machine."""

from __future__ import annotations

import json
import threading
from pathlib import Path

import numpy as np
import pytest
from experiment_text import held_voltage

from labhil.bus import open_bus
from labhil.bus.authentication import Refusals
from labhil.bus.incoming import EventMessage, parse
from labhil.bus.keys import stream_key
from labhil.codec import Codec
from labhil.errors import LabhilError
from labhil.experiment.device_run import DeviceRun
from labhil.experiment.experiment import parse_experiment
from labhil.experiment.plan import make_plan
from labhil.host_clock import unix_ns
from labhil.service.hosts import ConnectedDevice
from labhil.signals import Batch

TEXT = held_voltage("late", duration=1.0)


def event(kind: str) -> EventMessage:
    words = {"t_ns": unix_ns(), "kind": kind, "state": "idle", "message": kind}
    return parse(EventMessage, json.dumps(words).encode(), "an event")


def test_a_device_that_is_back_before_the_run_has_looked_is_started_again(tmp_path: Path) -> None:
    """Silent for a moment only, it would else never be commanded again, and the run never end."""
    text = TEXT.replace('address = "twin"', 'address = "twin"\nreconnect = true')
    (plan,) = make_plan(parse_experiment(text, tmp_path / "late.toml")).devices
    device = ConnectedDevice(plan.spec.stream, plan.spec.safe, 1.0, "", "")
    with open_bus() as bus, DeviceRun(bus, plan, device, 1.0, threading.Event(), Refusals()) as run:
        run.start()
        run._take_event(event("quiet"))
        run._take_event(event("reconnected"))
        assert run.pause_reason and run.resumes_alone  # so the run pauses …
        with pytest.raises(LabhilError):
            run.make_safe("paused")  # no host is here to answer
        assert run.pause_reason == ""  # … and goes on
        run.start()
        run._take_event(event("quiet"))
        with pytest.raises(LabhilError):
            run.make_safe("paused")
        assert run.pause_reason
        run._take_event(event("reconnected"))
        assert run.pause_reason == ""


def test_a_step_is_not_over_before_it_was_asked_for(tmp_path: Path) -> None:
    (plan,) = make_plan(parse_experiment(TEXT, tmp_path / "late.toml")).devices
    stream, changed = plan.spec.stream, threading.Event()
    device = ConnectedDevice(stream, plan.spec.safe, 1.0, "", "")
    codec = Codec(stream)

    def samples(first: int, count: int, age: float = 0.0) -> list[bytes]:
        seq = np.arange(first, first + count)
        came_ns = np.full(count, unix_ns() - round(age * 1e9))
        return codec.encode(Batch(seq, came_ns, seq * 10_000_000, np.zeros((count, len(stream.columns())))))

    with open_bus() as bus, DeviceRun(bus, plan, device, 1.0, changed, Refusals()) as run:
        key = stream_key("bench", stream.name)
        run.start()
        for first in range(-300, 0, 50):
            run._take_samples(key, samples(first, 50, age=0.5))  # in pieces, and each of them old
        assert run.elapsed == 0.0
        run._take_samples(key, samples(0, 300))  # three seconds of them at once, of a step of one second
        assert not run.done
        assert run.elapsed == 0.0
        run._take_samples(key, samples(300, 50))
        assert not changed.is_set()
        run._take_samples(key, samples(350, 50))
        assert run.done
        assert changed.is_set()

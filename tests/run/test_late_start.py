"""Steps begin where their first setpoint can act, however many samples waited on a busy machine."""

from __future__ import annotations

import threading
from pathlib import Path

import numpy as np

from labhil.bus import open_bus
from labhil.bus.authentication import Refusals
from labhil.bus.keys import stream_key
from labhil.codec import Codec
from labhil.experiment.device_run import DeviceRun
from labhil.experiment.experiment import parse_experiment
from labhil.experiment.plan import make_plan
from labhil.service.hosts import ConnectedDevice
from labhil.signals import Batch

TEXT = """
[experiment]
name = "late"
[devices.bench]
plugin = "dc_motor"
address = "twin"
[[steps]]
device = "bench"
signal = "voltage"
excitation = "hold"
level = 3.0
duration = 1.0
"""


def test_a_step_is_not_over_before_it_was_asked_for(tmp_path: Path) -> None:
    (plan,) = make_plan(parse_experiment(TEXT, tmp_path / "late.toml")).devices
    stream, changed = plan.spec.stream, threading.Event()
    device = ConnectedDevice(stream, plan.spec.safe, 1.0, "", "")
    codec = Codec(stream)

    def samples(first: int, count: int) -> list[bytes]:
        seq = np.arange(first, first + count)
        t_ns = seq * 10_000_000
        return codec.encode(Batch(seq, t_ns, t_ns, np.zeros((count, len(stream.columns())))))

    with open_bus() as bus, DeviceRun(bus, plan, device, 1.0, changed, Refusals()) as run:
        key = stream_key("bench", stream.name)
        run.start()
        run._take_samples(key, samples(0, 300))  # three seconds of them at once, of a step of one second
        assert not run.done
        assert run.elapsed == 0.0
        run._take_samples(key, samples(300, 50))
        assert not changed.is_set()
        run._take_samples(key, samples(350, 50))
        assert run.done
        assert changed.is_set()

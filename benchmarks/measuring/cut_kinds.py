"""Kinds of cuts of a cable, and the run to which they are done; ``measure_cuts.py`` makes them."""

from __future__ import annotations

import random
import subprocess
import time
from collections.abc import Callable, Mapping
from contextlib import ExitStack
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from labhil.bus.keys import stream_key
from labhil.codec import stamps_of
from labhil.host_clock import unix_ns
from victims import Listener

CUT = (0.1, 1.0)
"""s; how long a cable is out."""

LATE = (2.0, 5.0)
"""s; how long a device stays away that is late."""


@dataclass(slots=True)
class Cut:
    """One cut: what, from when to when (Unix ns), and when the run went on."""

    kind: str
    began_ns: int
    returned_ns: int
    goes_on_ns: int | None = None


class Heard(Listener):
    """What is on the bus of a run, and when each sample came, by its number."""

    def __init__(self, endpoint: str, stack: ExitStack) -> None:
        self.arrived: dict[int, int] = {}
        super().__init__(endpoint, stack)

    def _take(self, key: str, payloads: list[bytes]) -> None:
        now = unix_ns()
        super()._take(key, payloads)
        if key == stream_key("bench", "state"):
            self.arrived.update(dict.fromkeys(stamps_of(payloads)[:, 0].tolist(), now))

    def running_since(self) -> int | None:
        """When the run began to be in the state that it is in, if it follows its steps; else None."""
        states = [e for e in self.events if e["device"] == "run" and e["kind"] in RUN_STATES]
        return states[-1]["t_ns"] if states and states[-1]["kind"] == "running" else None


RUN_STATES = ("starting", "running", "paused", "stopping", "aborting", "finished", "failed")


@dataclass(slots=True)
class Scene:
    """One run with its wire."""

    rig: str
    wire: Any
    run: subprocess.Popen[str]
    heard: Heard
    folder: Path
    restart: Callable[[], None] = lambda: None
    cuts: list[Cut] = field(default_factory=list)


CutFunction = Callable[[Scene, float], None]


# what is done to a serial wire; each returns when the cable is back


def line_dead(scene: Scene, seconds: float) -> None:
    """The cable between the adapter and the device is out."""
    wire = scene.wire
    wire.to_host = wire.to_device = False
    time.sleep(seconds)
    wire.to_host = wire.to_device = True


def way_out_dead(scene: Scene, seconds: float) -> None:
    """The wire that leads to the device is broken; samples come in as before."""
    scene.wire.to_device = False
    time.sleep(seconds)
    scene.wire.to_device = True


def port_gone(scene: Scene, seconds: float) -> None:
    """The adapter is pulled, or all connections to an arm are closed; the device keeps its power."""
    scene.wire.unplug()
    time.sleep(seconds)
    scene.wire.plug_in()


def power_gone(scene: Scene, seconds: float) -> None:
    """The device is powered by the cable that is pulled."""
    scene.wire.unplug()
    scene.wire.power_down()
    time.sleep(seconds)
    scene.wire.power_up()
    scene.wire.plug_in()


def device_boots(scene: Scene, _seconds: float) -> None:
    """The device boots, and its port stays."""
    scene.wire.power_down()
    scene.wire.power_up()


def bytes_held(scene: Scene, seconds: float) -> None:
    """Nothing comes through, and then all of it at once."""
    scene.wire.hold = True
    time.sleep(seconds)
    scene.wire.release()


def noise(scene: Scene, seconds: float) -> None:
    """Random bytes in between the others."""
    scene.wire.noise = True
    time.sleep(seconds)
    scene.wire.noise = False


# and to an arm's


def rtde_closed(scene: Scene, _seconds: float) -> None:
    """The controller closes the connections of its RTDE port, and takes new ones."""
    scene.wire.hang_up(scene.wire.PORTS[:1])


def arm_noise(scene: Scene, _seconds: float) -> None:
    """Bytes that are no package come in between."""
    scene.wire.disturb(b"\x00\x01\x02\xff" * 25)


def controller_boots(scene: Scene, _seconds: float) -> None:
    """The controller loses its power and boots, which takes it seconds."""
    scene.wire.unplug()
    scene.restart()
    scene.wire.plug_in()


def late(kind: CutFunction) -> CutFunction:
    """The same for seconds."""

    def longer(scene: Scene, seconds: float) -> None:
        kind(scene, LATE[0] + (LATE[1] - LATE[0]) * (seconds - CUT[0]) / (CUT[1] - CUT[0]))

    return longer


Kinds = Mapping[str, tuple[CutFunction, int]]

SERIAL_KINDS: Kinds = {
    "line dead": (line_dead, 10),
    "line to the device dead": (way_out_dead, 4),
    "port gone": (port_gone, 10),
    "port and power gone": (power_gone, 8),
    "device boots": (device_boots, 6),
    "bytes held": (bytes_held, 4),
    "noise": (noise, 5),
    "away for 2 to 5 s": (late(power_gone), 3),
}
ARM_KINDS: Kinds = {
    "connections closed": (port_gone, 18),
    "RTDE connections closed": (rtde_closed, 10),
    "bytes held": (bytes_held, 12),
    "noise": (arm_noise, 5),
    "away for 2 to 5 s": (late(port_gone), 3),
    "controller boots": (controller_boots, 2),
}
"""What is done, and how often of 50 times."""


def sequence(kinds: Kinds, cuts: int, chance: random.Random) -> list[str]:
    """Which cuts are made, in random order."""
    names = [name for name, (_, count) in kinds.items() for _ in range(count)]
    chance.shuffle(names)
    return [names[k % len(names)] for k in range(cuts)]

"""What many cuts of its cable in one run do to a device: serial rigs and the UR5. A command, no test:

    python benchmarks/measuring/measure_cuts.py --cuts 50 -o benchmarks/results/cuts.json

A `labhil run` with ``reconnect = true`` commands a twin through a wire that is cut 50 times, at random, for
0.1 to 1 s: the line dead, the port gone, the device without power, bytes held and delivered late, noise;
now and then the device boots, or comes back only after some seconds. The wire logs what the twin sent. After
the run each sample of the recording is held against that log: it has to be one that the twin sent, in order,
stamped when it came, and the hole in ``seq`` has to be as large as what is missing.
"""

from __future__ import annotations

import argparse
import os
import platform
import random
import signal
import statistics
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager, suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from cut_wires import ArmWire, Sent, SerialWire
from labhil.bus.ask import ask
from labhil.bus.keys import ALL_STREAMS, RUN, command_key, stream_key
from labhil.bus.session import open_bus
from labhil.bus.subscribe import subscribe
from labhil.codec import stamps_of
from labhil.documents import parse_json
from labhil.errors import LabhilError
from labhil.experiment.device_sections import TwinSection
from labhil.experiment.twins import start_twin
from labhil.host_clock import unix_ns
from labhil.plugins import load_driver
from labhil.recording.reader import read_recording
from labhil.recording.recording import Recording, StreamData
from labhil.service.child import Child
from labhil.service.hosts import HostProcess
from labhil.service.messages import HostConfig
from labhil.signals import IntArray
from measured import tell
from victims import endpoint_of, process

LABHIL = (sys.executable, "-P", "-m", "labhil")
"""The command whose runs are measured; a test takes one whose hosts wait longer for commands."""

CUT = (0.1, 1.0)
"""s; how long a cable is out."""

LATE = (2.0, 5.0)
"""s; how long a device stays away that is late."""

BETWEEN = (0.3, 0.8)
"""s between the end of what a cut did and the next one."""

BACK = 40.0
"""s; a run that has not gone on by then does not."""

START = 150.0
"""s that a run may take until it follows its steps."""

FRESH = 0.25
"""s; a sample that is stamped later than this after the device sent it is an old one."""

FRESH_ARM = 0.3
STEP = {
    "ball_beam": 'signal = "servo_angle"\nexcitation = "hold"\nlevel = 0.05\nduration = 3000.0',
    "solenoid": 'signal = "coil_current_command"\nexcitation = "prbs"\nlow = 0.0\nhigh = 1.0\ndwell = 0.05\n'
    "duration = 3000.0",
    "ur5": 'signal = "target_q_5"\nexcitation = "multisine"\nfrequencies = [0.3]\namplitude = 0.5\n'
    "fade = 1.0\nduration = 3000.0",
}
EXPERIMENT = """
[experiment]
name = "cut"
[devices.bench]
plugin = "PLUGIN"
address = "ADDRESS"
reconnect = true
MORE
[[steps]]
device = "bench"
"""
ARM_RIG = '[rig]\nkind = "ur5"\n[limits]\ntarget_q = { min = -3.2, max = 3.2, rate = 2.0 }\n'
MEASURED = {"ball_beam": "ball_position", "solenoid": "plunger_position", "ur5": "actual_q"}
TWIN_AT, ARM_AT = "127.77.0.2", "127.77.0.3"


@dataclass(slots=True)
class Cut:
    """One cut: what, from when to when (Unix ns), and when the run went on."""

    kind: str
    began_ns: int
    returned_ns: int
    goes_on_ns: int | None = None


class Heard:
    """What is on the bus of a run: when each sample came, by its number, and events."""

    def __init__(self, endpoint: str, stack: ExitStack) -> None:
        self.arrived: dict[int, int] = {}
        self.events: list[dict[str, Any]] = []
        self.bus = stack.enter_context(open_bus(endpoint))
        stack.enter_context(subscribe(self.bus, ALL_STREAMS, self._take))

    def _take(self, key: str, payloads: list[bytes]) -> None:
        _, device, stream = key.split("/")
        if stream == "event":
            self.events += [parse_json(payload.decode()) | {"device": device} for payload in payloads]
        elif (device, stream) == ("bench", "state"):
            now = unix_ns()
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


# what is done to a serial wire; each returns when the cable was out and back, Unix ns


def line_dead(scene: Scene, seconds: float) -> tuple[int, int]:
    """The cable between the adapter and the device is out."""
    wire = scene.wire
    began, wire.to_host, wire.to_device = unix_ns(), False, False
    time.sleep(seconds)
    wire.to_host = wire.to_device = True
    return began, unix_ns()


def way_out_dead(scene: Scene, seconds: float) -> tuple[int, int]:
    """The wire that leads to the device is broken; samples come in as before."""
    began, scene.wire.to_device = unix_ns(), False
    time.sleep(seconds)
    scene.wire.to_device = True
    return began, unix_ns()


def port_gone(scene: Scene, seconds: float) -> tuple[int, int]:
    """The adapter is pulled; the device keeps its power."""
    began = unix_ns()
    scene.wire.unplug()
    time.sleep(seconds)
    scene.wire.plug_in()
    return began, unix_ns()


def power_gone(scene: Scene, seconds: float) -> tuple[int, int]:
    """The device is powered by the cable that is pulled."""
    began = unix_ns()
    scene.wire.unplug()
    scene.wire.power_down()
    time.sleep(seconds)
    scene.wire.power_up()
    scene.wire.plug_in()
    return began, unix_ns()


def device_boots(scene: Scene, _seconds: float) -> tuple[int, int]:
    """The device boots, and its port stays."""
    began = unix_ns()
    scene.wire.power_down()
    scene.wire.power_up()
    return began, unix_ns()


def bytes_held(scene: Scene, seconds: float) -> tuple[int, int]:
    """Nothing comes through, and then all of it at once."""
    began, scene.wire.hold = unix_ns(), True
    time.sleep(seconds)
    scene.wire.release()
    return began, unix_ns()


def noise(scene: Scene, seconds: float) -> tuple[int, int]:
    """Random bytes in between the others."""
    began, scene.wire.noise = unix_ns(), True
    time.sleep(seconds)
    scene.wire.noise = False
    return began, unix_ns()


# and to an arm's


def connections_closed(scene: Scene, seconds: float) -> tuple[int, int]:
    """All connections are closed, and nobody answers."""
    began = unix_ns()
    scene.wire.unplug()
    time.sleep(seconds)
    scene.wire.plug_in()
    return began, unix_ns()


def rtde_closed(scene: Scene, _seconds: float) -> tuple[int, int]:
    """The controller closes the connections of its RTDE port, and takes new ones."""
    began = unix_ns()
    scene.wire.hang_up(scene.wire.PORTS[:1])
    return began, unix_ns()


def arm_noise(scene: Scene, _seconds: float) -> tuple[int, int]:
    """Bytes that are no package come in between."""
    began = unix_ns()
    scene.wire.disturb(b"\x00\x01\x02\xff" * 25)
    return began, unix_ns()


def controller_boots(scene: Scene, _seconds: float) -> tuple[int, int]:
    """The controller loses its power and boots, which takes it seconds."""
    began = unix_ns()
    scene.wire.unplug()
    scene.restart()
    scene.wire.plug_in()
    return began, unix_ns()


def late(kind: Callable[[Scene, float], tuple[int, int]]) -> Callable[[Scene, float], tuple[int, int]]:
    """The same for seconds."""

    def longer(scene: Scene, seconds: float) -> tuple[int, int]:
        return kind(scene, LATE[0] + (LATE[1] - LATE[0]) * (seconds - CUT[0]) / (CUT[1] - CUT[0]))

    return longer


Kinds = Mapping[str, tuple[Callable[[Scene, float], tuple[int, int]], int]]

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
    "connections closed": (connections_closed, 18),
    "RTDE connections closed": (rtde_closed, 10),
    "bytes held": (bytes_held, 12),
    "noise": (arm_noise, 5),
    "away for 2 to 5 s": (late(connections_closed), 3),
    "controller boots": (controller_boots, 2),
}
"""What is done, and how often of 50 times."""


def sequence(kinds: Kinds, cuts: int, chance: random.Random) -> list[str]:
    """Which cuts are made, in random order."""
    names = [name for name, (_, count) in kinds.items() for _ in range(count)]
    chance.shuffle(names)
    return [names[k % len(names)] for k in range(cuts)]


@contextmanager
def serial_scene(rig: str, folder: Path, chance: random.Random) -> Iterator[Scene]:
    """A run of a serial rig whose port is ours."""
    with ExitStack() as stack:
        twin, at = start_twin("bench", rig, TwinSection(seed=1), folder / "twin.json", lambda: False)
        stack.enter_context(twin)
        wire = SerialWire(at, load_driver(rig).rig, folder / "ttyBENCH", chance)
        stack.callback(wire.close)
        yield from started(stack, rig, wire, folder, lambda: None)


@contextmanager
def arm_scene(rig: str, folder: Path, _chance: random.Random) -> Iterator[Scene]:
    """A run of an arm whose cables are ours."""
    twins = [start_arm()]

    def restart() -> None:
        os.kill(twins[-1].pid, signal.SIGKILL)
        twins[-1].stop()
        twins.append(start_arm())

    def stop_newest() -> None:
        twins[-1].stop()

    with ExitStack() as stack:
        stack.callback(stop_newest)
        wire = ArmWire(TWIN_AT, ARM_AT, 500.0)
        stack.callback(wire.close)
        (folder / "rig.toml").write_text(ARM_RIG)
        yield from started(stack, rig, wire, folder, restart)


def start_arm() -> Child:
    """Start a simulated controller."""
    twin = Child("the twin", [sys.executable, "-P", "-m", "labhil", "twin", "ur5", "--host", TWIN_AT])
    if twin.line(90.0) != TWIN_AT:
        raise RuntimeError(f"the twin did not start{twin.last_error()}")
    return twin


def started(
    stack: ExitStack, rig: str, wire: Any, folder: Path, restart: Callable[[], None]
) -> Iterator[Scene]:
    """Start the run, and wait until it follows its steps."""
    text = EXPERIMENT.replace("PLUGIN", rig).replace("ADDRESS", wire.address) + STEP[rig] + "\n"
    text = text.replace("MORE", 'rig = "rig.toml"' if rig == "ur5" else "")
    (folder / "e.toml").write_text(text)
    command = [*LABHIL, "run", "e.toml"]
    run = stack.enter_context(process(command, folder))
    heard = Heard(patiently(run), stack)
    scene = Scene(rig, wire, run, heard, folder, restart)
    if wait_for_steps(scene, 0, START) is None:
        raise ValueError("the run did not begin")
    yield scene


def patiently(run: subprocess.Popen[str]) -> str:
    """Where the run can be reached; a busy machine takes minutes to start it."""
    for _ in range(2):
        with suppress(TimeoutError):
            return endpoint_of(run, "run")
    return endpoint_of(run, "run")


def wait_for_steps(scene: Scene, after_ns: int, patience: float = BACK) -> int | None:
    """When the run went on after a cut, Unix ns; it may have gone on all the time. None if it did not."""
    deadline = time.monotonic() + patience
    while time.monotonic() < deadline and scene.run.poll() is None:
        since, newest = scene.heard.running_since(), max(scene.heard.arrived.values(), default=0)
        if since is not None and newest > after_ns:
            return max(since, after_ns)
        time.sleep(0.005)
    return None


def cut_many(scene: Scene, kinds: Kinds, cuts: int, chance: random.Random) -> None:
    """Make all cuts, each once the run has gone on after the one before."""
    for kind in sequence(kinds, cuts, chance):
        time.sleep(chance.uniform(*BETWEEN))
        if scene.run.poll() is not None:
            return
        began_ns, returned_ns = kinds[kind][0](scene, chance.uniform(*CUT))
        # what was heard too late is heard by then: a silent device is given up after a second
        settled = returned_ns
        if kind in (
            "line dead",
            "line to the device dead",
            "bytes held",
            "noise",
            "device boots",
            "RTDE connections closed",
        ):
            time.sleep(0.4)
        cut = Cut(kind, began_ns, returned_ns, wait_for_steps(scene, settled))
        scene.cuts.append(cut)
        if cut.goes_on_ns is None:
            return


def stop(scene: Scene) -> str:
    """End the run in order, and return how it ended."""
    if scene.run.poll() is None:
        with suppress(LabhilError):
            ask(scene.heard.bus, command_key(RUN, "stop"), {"reason": "all cuts are made"}, 5.0)
    with suppress(subprocess.TimeoutExpired):
        scene.run.wait(30)
    (path,) = scene.folder.glob("*.mcap")
    recording = read_recording(path)
    reason = recording.metadata.get("end", {}).get("reason", "no end")
    return f"exit {scene.run.returncode}, complete {recording.complete}: {reason}"


# what the recording says


SENT = ("t_ns", "boot", "number", "t_hw_ns", "safe", "values")
PROBED = 300
UNCUT = ("noise", "device boots", "RTDE connections closed")
"""During these the device may hear its host."""

WRONG, UNKNOWN = -1, -2
"""Rows of samples that were sent otherwise, and of those whose number the log does not hold."""


@dataclass(frozen=True, slots=True)
class Matched:
    """The samples of a recording, and which of those sent each is: a row, ``WRONG`` or ``UNKNOWN``."""

    stream: StreamData
    rows: IntArray
    connections: IntArray


def match(
    stream: StreamData, values: np.ndarray, sent: Sent, seams_ns: Sequence[int], reach: float
) -> Matched:
    """Find each recorded sample among those that were sent.

    Within one connection number and clock of both differ by constants, and all values are equal. Connections
    begin at ``seams_ns``. ``reach`` (s) is how long before its stamp the first sample may have been sent.
    """
    connection = np.searchsorted(np.array(seams_ns, dtype=np.int64), stream.t_acq_ns, side="right")
    rows = rows_of(stream, values, sent, connection, reach)
    # a sample may bear a time shortly before its connection was announced: the newest that came with it
    late = (rows < 0) & (np.append(np.diff(connection), 0) > 0)
    while late.any():
        connection[late] += 1
        again = rows_of(stream, values, sent, connection, reach)
        late = (again < 0) & (rows < 0) & (np.append(np.diff(connection), 0) > 0) & ~late
        rows = again
    return Matched(stream, rows, connection)


def rows_of(
    stream: StreamData, values: np.ndarray, sent: Sent, connection: IntArray, reach: float
) -> IntArray:
    """Which row each recorded sample is, connection by connection."""
    rows = np.full(len(stream.seq), UNKNOWN)
    for number in np.unique(connection):
        here = np.flatnonzero(connection == number)
        first = int(here[0])
        near = np.abs(sent.t_ns - stream.t_acq_ns[first]) < reach * 1e9
        candidates = np.flatnonzero(near & (sent.values == values[first]).all(axis=1))
        # what stands still looks alike for long: a few hundred of the samples tell, the nearest in time first
        candidates = candidates[np.argsort(np.abs(sent.t_ns[candidates] - stream.t_acq_ns[first]))]
        some = here[:: max(len(here) // PROBED, 1)]
        best, best_count = -1, 0
        for candidate in candidates.tolist():
            count = np.count_nonzero(rows_from(stream, values, sent, some, candidate) >= 0)
            if count > best_count:
                best, best_count = candidate, count
            if best_count == len(some):
                break
        if best_count:
            rows[here] = rows_from(stream, values, sent, here, best)
    return rows


def rows_from(stream: StreamData, values: np.ndarray, sent: Sent, here: IntArray, candidate: int) -> IntArray:
    """Which row each sample of a connection is, if its first one is ``candidate``."""
    same_boot = np.flatnonzero(sent.boot == sent.boot[candidate])
    numbers = stream.seq[here] - stream.seq[here[0]] + sent.number[candidate]
    places = np.minimum(np.searchsorted(sent.number[same_boot], numbers), len(same_boot) - 1)
    found = same_boot[places]
    clock = stream.t_hw_ns[here] - stream.t_hw_ns[here[0]] + sent.t_hw_ns[candidate]
    good = (sent.number[found] == numbers) & (np.abs(sent.t_hw_ns[found] - clock) <= 1000)
    good &= (sent.values[found] == values[here]).all(axis=1)
    return np.where(sent.number[found] != numbers, UNKNOWN, np.where(good, found, WRONG))


def examine(scene: Scene, ending: str) -> dict[str, Any]:
    """Hold the recording against what was sent."""
    (path,) = scene.folder.glob("*.mcap")
    recording = read_recording(path)
    stream, sent = recording.stream_with(MEASURED[scene.rig]), scene.wire.sent()
    values = stream["actual_q"] if scene.rig == "ur5" else stream.values[:, : sent.values.shape[1]]
    seams = [
        event.t_ns
        for event in recording.events
        if event.body.get("kind") == "reconnected" and "configuration sent again" in event.body["message"]
    ]
    matched = match(stream, values, sent, seams, 3.0)
    known = matched.rows >= 0
    age = np.zeros(len(known))
    age[known] = (stream.t_acq_ns[known] - sent.t_ns[matched.rows[known]]) * 1e-9
    fresh = FRESH_ARM if scene.rig == "ur5" else FRESH
    result: dict[str, Any] = {
        "cuts": len(scene.cuts),
        "end": ending,
        "recorded": len(stream.seq),
        "not_sent_so": int(np.count_nonzero(matched.rows == WRONG)),
        "not_in_the_log": int(np.count_nonzero(matched.rows == UNKNOWN)),
        "out_of_order": int(
            np.count_nonzero(np.diff(stream.seq) <= 0)
            + np.count_nonzero(np.diff(stream.t_hw_ns) <= 0)
            + np.count_nonzero(np.diff(stream.t_acq_ns) < 0)
            + np.count_nonzero(np.diff(matched.rows[known]) <= 0)
        ),
        "old_as_new": int(np.count_nonzero(age > fresh)),
        "oldest_ms": round(1e3 * float(age.max()), 1),
        "old_after": old_after(scene, stream, age > fresh),
        "connections": len(seams) + 1,
        "configurations": len(scene.wire.configured),
        **gaps(scene, recording, matched, sent),
        **safety(scene, recording, sent),
    }
    result["kinds"] = {
        kind: times([cut for cut in scene.cuts if cut.kind == kind], scene, matched, sent)
        for kind in dict.fromkeys(cut.kind for cut in scene.cuts)
    }
    result["all"] = times(scene.cuts, scene, matched, sent)
    return result


def old_after(scene: Scene, stream: StreamData, old: np.ndarray) -> dict[str, int]:
    """How many old samples came during or right after which kind of cut, or at other times."""
    counts: dict[str, int] = {}
    for t_ns in stream.t_acq_ns[old].tolist():
        kind = next(
            (c.kind for c in scene.cuts if c.began_ns <= t_ns <= c.returned_ns + 500_000_000), "no cut"
        )
        counts[kind] = counts.get(kind, 0) + 1
    return counts


def times(cuts: Sequence[Cut], scene: Scene, matched: Matched, sent: Sent) -> dict[str, Any]:
    """From the return of the cable to the first fresh sample on the bus, and until the run went on, ms."""
    known = np.flatnonzero(matched.rows >= 0)
    sent_at = sent.t_ns[matched.rows[known]]
    to_fresh, to_steps = [], []
    for cut in cuts:
        after = known[np.flatnonzero(sent_at >= cut.returned_ns)]
        arrivals = (scene.heard.arrived.get(int(matched.stream.seq[row])) for row in after[:50])
        arrival = next((arrival for arrival in arrivals if arrival is not None), None)
        if arrival is not None:
            to_fresh.append((arrival - cut.returned_ns) * 1e-6)
        if cut.goes_on_ns is not None:
            to_steps.append(max(cut.goes_on_ns - cut.returned_ns, 0) * 1e-6)
    return {
        "cuts": len(cuts),
        "never_back": len(cuts) - len(to_fresh),
        "fresh_sample_ms": spread(to_fresh),
        "steps_go_on_ms": spread(to_steps),
    }


def spread(ms: Sequence[float]) -> dict[str, float] | None:
    """The median and the largest."""
    return {"median": round(statistics.median(ms), 1), "largest": round(max(ms), 1)} if ms else None


def gaps(scene: Scene, recording: Recording, matched: Matched, sent: Sent) -> dict[str, Any]:
    """Whether what is missing is marked: by holes in ``seq`` as long as it, and by events."""
    stream, rows = matched.stream, matched.rows
    rate = stream.stream.rate
    both = (rows[1:] >= 0) & (rows[:-1] >= 0)
    away = (sent.t_ns[rows[1:]] - sent.t_ns[rows[:-1]]) * 1e-9
    hole = np.diff(stream.seq) / rate
    # within a connection the numbers agree already; between two the hole is measured by the host's clock
    seam = both & (np.diff(matched.connections) > 0)
    events = [(event.t_ns, event.body.get("kind")) for event in recording.events]
    unmarked = []
    for cut in scene.cuts:
        low, high = cut.began_ns - 20_000_000, (cut.goes_on_ns or cut.returned_ns) + 500_000_000
        inside = (stream.t_acq_ns[1:] > low) & (stream.t_acq_ns[1:] < high) & both
        missing = inside & ((np.diff(sent.number[rows]) > 1) | (np.diff(sent.boot[rows]) > 0))
        is_marked = bool((np.diff(stream.seq)[missing] > 1).all())
        # a device that hears nothing makes itself safe, though its samples come in
        unheard = cut.kind == "line to the device dead" and cut.returned_ns - cut.began_ns > 0.35e9
        told = {kind for t_ns, kind in events if low < t_ns < high}
        lost = unheard or bool(missing.any() and away[missing].max() > 0.35)
        if (
            not is_marked
            or (lost and not told & {"lost", "quiet", "reconnected"})
            or (told & {"lost"} and "reconnected" not in told)
        ):
            unmarked.append(f"{cut.kind}: {sorted(map(str, told - {None}))}")
    errors = np.abs(hole - away)[seam]
    return {
        "missing": int(np.sum(np.diff(stream.seq) - 1)),
        "cuts_not_marked": unmarked,
        "worst_hole_error_ms": round(1e3 * float(errors.max()), 1) if len(errors) else None,
    }


def safety(scene: Scene, recording: Recording, sent: Sent) -> dict[str, Any]:
    """How long after a cut a device was last not safe, before the run said that it goes on."""
    running = [e.t_ns for e in recording.events if e.device == "run" and e.body.get("kind") == "running"]
    after_ms = []
    for cut in scene.cuts:
        if cut.kind in UNCUT:
            continue
        until = min((t_ns for t_ns in running if t_ns >= cut.returned_ns), default=cut.returned_ns)
        if cut.goes_on_ns is None or until > cut.goes_on_ns + 10**9:
            until = cut.returned_ns  # it ended before anybody noticed
        during = (sent.t_ns > cut.began_ns) & (sent.t_ns < until)
        active = sent.t_ns[during & ~sent.safe]
        if sent.safe[during].any():
            after_ms.append((int(active[-1]) - cut.began_ns) * 1e-6 if len(active) else 0.0)
    return {"safe_after_ms": spread(after_ms), "made_safe": len(after_ms)}


def late_at_start(rig: str, folder: Path, chance: random.Random, repeat: int) -> dict[str, Any]:
    """A device that is there only some seconds after its host looks for it, as `labhil serve` does."""
    ms = []
    with ExitStack() as stack:
        twin, at = start_twin("bench", rig, TwinSection(seed=1), folder / "twin.json", lambda: False)
        stack.enter_context(twin)
        for _ in range(repeat):
            with ExitStack() as one:
                bus = one.enter_context(open_bus())
                place = folder / "ttyBENCH"
                config = HostConfig("bench", rig, str(place), {}, bus.endpoint, reconnect=True, patient=True)
                first: list[int] = []
                one.enter_context(
                    subscribe(
                        bus, stream_key("bench", "state"), lambda _k, _p, first=first: first.append(unix_ns())
                    )
                )
                host = HostProcess(config)
                one.callback(host.stop)
                host.wait_reported(lambda: False)
                time.sleep(chance.uniform(*LATE))
                wire = SerialWire(at, load_driver(rig).rig, place, chance)
                one.callback(wire.close)
                began, deadline = unix_ns(), time.monotonic() + 20.0
                while not first and time.monotonic() < deadline:
                    time.sleep(0.005)
                if first:
                    ms.append((first[0] - began) * 1e-6)
    return {"repeats": repeat, "never_came": repeat - len(ms), "fresh_sample_ms": spread(ms)}


SCENES: Mapping[str, tuple[Callable[..., Any], Kinds]] = {
    "ball_beam": (serial_scene, SERIAL_KINDS),
    "solenoid": (serial_scene, SERIAL_KINDS),
    "ur5": (arm_scene, ARM_KINDS),
}


def measure(
    rig: str, cuts: int, folder: Path, chance: random.Random, only: str | None = None
) -> dict[str, Any]:
    """One run of a rig with so many cuts, of one kind or of all."""
    make, kinds = SCENES[rig]
    if only is not None:
        kinds = {only: kinds[only]}
    loads = [os.getloadavg()[0]]
    with make(rig, folder, chance) as scene:
        cut_many(scene, kinds, cuts, chance)
        ending = stop(scene)
        result = examine(scene, ending)
        sent = scene.wire.sent()
        np.savez(folder / "sent.npz", **{name: getattr(sent, name) for name in SENT})
    loads.append(os.getloadavg()[0])
    return result | {"load_average": [round(min(loads), 1), round(max(loads), 1)]}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else "")
    parser.add_argument("--rigs", nargs="+", choices=SCENES, default=list(SCENES))
    parser.add_argument("--cuts", type=int, default=50)
    parser.add_argument("--late", type=int, default=5, help="how often a device is late at the start")
    parser.add_argument("--only", help="one kind of cut")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--keep", type=Path, help="a folder for the recordings")
    parser.add_argument("-o", "--out", type=Path)
    options = parser.parse_args()
    result: dict[str, Any] = {"schema": "labhil.cuts/1", "cut_s": CUT, "rigs": {}}
    for rig in options.rigs:
        chance = random.Random(options.seed)
        with ExitStack() as stack:
            folder = Path(stack.enter_context(tempfile.TemporaryDirectory()))
            if options.keep is not None:
                folder = options.keep / rig
                folder.mkdir(parents=True)
            os.environ["XDG_RUNTIME_DIR"] = str(folder)  # nobody else's emergency stop is pressed
            result["rigs"][rig] = measure(rig, options.cuts, folder, chance, options.only)
            if rig != "ur5" and options.late:
                result["rigs"][rig]["late_at_start"] = late_at_start(rig, folder, chance, options.late)
        print(rig, result["rigs"][rig], file=sys.stderr, flush=True)
    result["machine"] = {"cores": os.cpu_count(), "python": platform.python_version()}
    tell(result, options.out)


if __name__ == "__main__":
    main()

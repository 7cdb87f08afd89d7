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
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import ExitStack, contextmanager, suppress
from pathlib import Path
from typing import Any

import numpy as np

from cut_findings import examine, spread
from cut_kinds import ARM_KINDS, CUT, LATE, SERIAL_KINDS, Cut, Heard, Kinds, Scene, sequence
from cut_wires import ArmWire, SerialWire
from labhil.bus.ask import ask
from labhil.bus.keys import RUN, command_key, stream_key
from labhil.bus.session import open_bus
from labhil.bus.subscribe import subscribe
from labhil.errors import LabhilError
from labhil.experiment.device_sections import TwinSection
from labhil.experiment.twins import start_twin
from labhil.host_clock import unix_ns
from labhil.plugins import load_driver
from labhil.recording.reader import read_recording
from labhil.service.child import Child
from labhil.service.hosts import HostProcess
from labhil.service.messages import HostConfig
from measured import tell
from victims import endpoint_of, process

LABHIL = (sys.executable, "-P", "-m", "labhil")
"""The command whose runs are measured; a test takes one whose hosts wait longer for commands."""

BETWEEN = (0.3, 0.8)
"""s between the end of what a cut did and the next one."""

BACK = 40.0
"""s; a run that has not gone on by then does not."""

START = 150.0
"""s that a run may take until it follows its steps."""

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
TWIN_AT, ARM_AT = "127.77.0.2", "127.77.0.3"
SENT = ("t_ns", "boot", "number", "t_hw_ns", "safe", "values")


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
        cut_cable, seconds = kinds[kind][0], chance.uniform(*CUT)
        began_ns = unix_ns()
        cut_cable(scene, seconds)
        returned_ns = unix_ns()
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

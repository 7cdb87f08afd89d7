"""One kill, kind by kind; ``measure_kills.py`` makes a hundred of each."""

from __future__ import annotations

import os
import pty
import random
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import Any

from labhil.codec import Codec, stamps_of
from labhil.documents import parse_json
from labhil.recording.reader import read_recording
from labhil_benchmarks.left_files import examine, variants
from logged_publisher import stream_at
from measure_safety import PATIENCE, Relay
from noted_syncs import synced
from victims import Commander, Listener, child_of, endpoint_of, family_of, kill, process, wait_until

RATE = 2000
SAMPLING = {"sample_rate": 2000.0, "samples_per_frame": 10.0}
HERE = Path(__file__).parent
NOTED = [sys.executable, "-P", str(HERE / "noted_syncs.py"), "syncs.txt"]
DEVICE = """
[devices.bench]
plugin = "solenoid"
address = "ADDRESS"
twin = { seed = 1, set = { sample_rate = 2000.0, samples_per_frame = 10.0 } }
"""
RUN = f"""
[experiment]
name = "killed"
{DEVICE}
[[steps]]
device = "bench"
signal = "coil_current_command"
excitation = "prbs"
low = 0.1
high = 1.0
dwell = 0.02
duration = 600.0
"""
LAB = f"""
[lab]
name = "killed"
roll = ROLL
analyse = ANALYSE
{DEVICE}
"""
STATE = "/bench/state"
AT_WORK = 0.7
"""Share of the runs that are killed once they have begun to record; the others while they start, too."""

BEGUN = 4096
"""Bytes that a recording has before its first samples, at most."""

COMING = (0.0, 3.0)
"""s after a process can be reached: when it is killed."""


def files_of(folder: Path, log: dict[str, dict[int, bytes]], begun: int, killed: int) -> list[dict[str, Any]]:
    """Each unfinished file of the folder, as it was left and as a power failure may have left it.

    Each says how many bytes were forced to the disk (``synced``): with none behind its beginning, a power
    failure leaves nothing to save.
    """
    examined: list[dict[str, Any]] = []
    for path in sorted(folder.glob("*.mcap*")):
        certain = synced(folder / "syncs.txt", path)
        for variant, data in variants(path.read_bytes(), certain, random.Random(len(examined))):
            left = examine(variant, data, log, begun, killed, folder.parent)
            examined.append({**left.to_json(), "synced": certain})
    return examined


def gapless(log: dict[str, dict[int, bytes]]) -> None:
    """ValueError where the listener itself missed something: nothing could be held against it."""
    for topic, samples in log.items():
        if samples and max(samples) - min(samples) + 1 != len(samples):
            raise ValueError(f"the listener missed samples of {topic}")


def kill_recorder(_relay: Relay | None, folder: Path, chance: random.Random) -> dict[str, Any]:
    """A recorder by itself: killed while it records, or while it ends its file."""
    place, outcome = folder / "lab", dict[str, Any]()
    place.mkdir()
    with ExitStack() as stack:
        command = [sys.executable, str(HERE / "recorder_alone.py"), "syncs.txt", "a.mcap"]
        recorder = stack.enter_context(process(command, place))
        wait_until((place / "endpoint.txt").exists, "the recorder is up")
        endpoint = (place / "endpoint.txt").read_text()
        devices = ("one", "two")
        publish = [sys.executable, "-P", str(HERE / "logged_publisher.py")]
        publishers = []
        for name in devices:
            command = [*publish, endpoint, name, "1000", f"{name}.log"]
            started = subprocess.Popen(command, cwd=folder, stdin=subprocess.PIPE)
            publishers.append(stack.enter_context(started))
        wait_until(lambda: all((folder / f"{name}.log").exists() for name in devices), "publishers are up")
        moment = chance.uniform(*COMING)
        time.sleep(moment)
        assert recorder.stdin is not None
        if chance.random() < 0.2:
            recorder.stdin.close()  # it ends its file now
            time.sleep(chance.uniform(0.0, 0.3))
        killed_ns = kill(recorder.pid, [], None, outcome)
        for publisher in publishers:
            assert publisher.stdin is not None
            publisher.stdin.close()
    log = {f"/{name}/state": published_in(folder / f"{name}.log") for name in devices}
    return {"moment_s": moment, **outcome, "files": files_of(place, log, 0, killed_ns)}


def published_in(path: Path) -> dict[int, bytes]:
    """What a publisher wrote down."""
    size, data = Codec(stream_at(1000.0)).size, path.read_bytes()
    payloads = [data[start : start + size] for start in range(0, len(data) - size + 1, size)]
    return dict(zip(stamps_of(payloads)[:, 0].tolist(), payloads, strict=True)) if payloads else {}


def with_a_run(relay: Relay | None, folder: Path, chance: random.Random, child: str = "") -> dict[str, Any]:
    """A run, of which one process is killed: the run itself, or the child with this word in its command."""
    place, outcome = folder / "lab", dict[str, Any]()
    place.mkdir()
    address = "twin" if relay is None else relay.address
    (place / "e.toml").write_text(RUN.replace("ADDRESS", address))
    with ExitStack() as stack:
        run = stack.enter_context(process([*NOTED, "run", "e.toml"], place))
        listener = Listener(endpoint_of(run, "run"), stack)
        moment = chance.uniform(*COMING)
        if child or chance.random() < AT_WORK:
            wait_for_run(listener, run)
        time.sleep(moment)
        if run.poll() is not None:
            raise ValueError(f"the run ended before: {(place / 'said.txt').read_text()[-200:]}")
        victim = child_of(run.pid, child) if child else run.pid
        killed_ns = kill(victim, family_of(run.pid), relay, outcome)
        run.wait(30)
        time.sleep(0.2)
    gapless(listener.streams)
    begun = listener.began_ns()
    log = listener.streams if begun is not None else {}
    if not child:
        return {"moment_s": moment, **outcome, "files": files_of(place, log, begun or 0, killed_ns)}
    return {"moment_s": moment, **outcome, **ended_run(place, run, log, begun or 0, killed_ns)}


def wait_for_run(listener: Listener, run: subprocess.Popen[str]) -> None:
    deadline = time.monotonic() + PATIENCE
    while listener.began_ns() is None:
        if time.monotonic() > deadline or run.poll() is not None:
            raise ValueError("the run did not begin")
        time.sleep(0.01)


def ended_run(
    place: Path, run: subprocess.Popen[str], log: dict[str, dict[int, bytes]], begun: int, killed: int
) -> dict[str, Any]:
    """The end of a run that lost one of its processes, and its file, which has an end."""
    (path,) = place.glob("*.mcap")
    recording = read_recording(path)
    reason = recording.metadata.get("end", {}).get("reason", "no end")
    examined = examine("finished", path.read_bytes(), log, begun, killed, place.parent)
    return {
        "end": f"exit {run.returncode}, complete {recording.complete}: {reason}",
        "files": [examined.to_json()],
    }


def kill_run(relay: Relay, folder: Path, chance: random.Random) -> dict[str, Any]:
    return with_a_run(relay, folder, chance)


def kill_host(relay: Relay, folder: Path, chance: random.Random) -> dict[str, Any]:
    return with_a_run(relay, folder, chance, "labhil.service.host")


def kill_twin(_relay: Relay, folder: Path, chance: random.Random) -> dict[str, Any]:
    return with_a_run(None, folder, chance, "twin")


@contextmanager
def served(
    relay: Relay, place: Path, roll: float, analyse: str
) -> Iterator[tuple[subprocess.Popen[str], Listener]]:
    """A served lab whose device is commanded."""
    place.mkdir()
    text = LAB.replace("ADDRESS", relay.address).replace("ROLL", repr(roll)).replace("ANALYSE", analyse)
    (place / "lab.toml").write_text(text)
    with ExitStack() as stack:
        service = stack.enter_context(process([*NOTED, "serve", "--config", "lab.toml"], place))
        listener = Listener(endpoint_of(service, "lab"), stack)
        commander = Commander(listener.bus)
        stack.callback(commander.close)
        relay.wait(safe=False)
        yield service, listener


def kill_service(relay: Relay, folder: Path, chance: random.Random) -> dict[str, Any]:
    """A served lab; it begins a new recording each second, so that some moments are between two."""
    place, outcome = folder / "lab", dict[str, Any]()
    with served(relay, place, 1.5, "[]") as (service, listener):
        # a busy machine reaches the device well before it records; what is not recorded cannot be lost
        wait_until(lambda: bool(filled_in(place)), "the lab records")
        moment = chance.uniform(*COMING)
        time.sleep(moment)
        killed_ns = kill(service.pid, family_of(service.pid), relay, outcome)
        service.wait(5)
        time.sleep(0.2)
    gapless(listener.streams)
    log = listener.streams
    # one that has just begun holds nothing yet: what could be lost is in the one before
    newest = max(filled_in(place), key=lambda path: path.stat().st_mtime_ns)
    for path in place.glob("*.mcap*"):
        if path != newest:
            path.unlink()  # those before were ended; the one that was written to counts
    return {"moment_s": moment, **outcome, "files": files_of(place, log, 0, killed_ns)}


def filled_in(folder: Path) -> list[Path]:
    """Recordings that hold samples."""
    return [path for path in folder.glob("*.mcap*") if size_of(path) > BEGUN]


def size_of(path: Path) -> int:
    """Bytes of a file; none where it has another name by now."""
    try:
        return path.stat().st_size
    except FileNotFoundError:
        return 0


def kill_study(relay: Relay, folder: Path, chance: random.Random) -> dict[str, Any]:
    """A study of a lab's worker: the lab goes on, and files of results are whole or not there."""
    place, outcome = folder / "lab", dict[str, Any]()
    with served(relay, place, 1.5, '["fit"]') as (service, listener):
        moment = chance.uniform(*COMING)
        deadline = time.monotonic() + PATIENCE
        while True:
            time.sleep(0.01)
            try:
                victim = child_of(service.pid, "labhil.campaign.studies.study")
                break
            except ValueError:
                if time.monotonic() > deadline:
                    raise
        time.sleep(moment)
        family = [child for child in family_of(service.pid) if child.pid == victim]
        kill(victim, family, None, outcome)
        before = len(listener.streams[STATE])
        time.sleep(0.5)
        goes_on = service.poll() is None and len(listener.streams[STATE]) > before and not relay.safe
    for path in place.glob("*.json"):
        parse_json(path.read_text())  # whole
    return {"moment_s": moment, **outcome, "end": f"the lab goes on, device active: {goes_on}"}


def kill_screen(relay: Relay, folder: Path, chance: random.Random) -> dict[str, Any]:
    """A terminal UI beside a served lab: the lab goes on and misses nothing."""
    place, outcome = folder / "lab", dict[str, Any]()
    with served(relay, place, 600.0, "[]") as (service, listener):
        ours, theirs = pty.openpty()
        command = [sys.executable, "-P", "-m", "labhil", "tui", "--connect", listener.bus.endpoint]
        environment = {**os.environ, "TERM": "xterm-256color"}
        screen = subprocess.Popen(
            command,
            cwd=place,
            stdin=theirs,
            stdout=theirs,
            stderr=theirs,
            env=environment,
            start_new_session=True,
        )
        os.close(theirs)
        reader = threading.Thread(target=read_all, args=(ours,))
        reader.start()
        moment = chance.uniform(0.5, 4.0)
        time.sleep(moment)
        family = family_of(screen.pid)
        kill(screen.pid, family, None, outcome)
        screen.wait(5)
        reader.join()
        time.sleep(0.5)
        goes_on = service.poll() is None and not relay.safe
        outcome["processes_left"] = outcome["processes_left"] if family else []
    gapless(listener.streams)
    (path,) = place.glob("*.mcap")
    recording = read_recording(path)
    lost = sum(data.lost for data in recording.streams)
    ending = (
        f"the lab goes on, device active: {goes_on}; its recording complete {recording.complete}, lost {lost}"
    )
    return {"moment_s": moment, **outcome, "end": ending}


def read_all(terminal: int) -> None:
    """Read what is drawn, until the other side is closed."""
    try:
        while os.read(terminal, 1 << 16):
            continue
    except OSError:
        os.close(terminal)


KINDS: dict[str, Callable[[Relay, Path, random.Random], dict[str, Any]]] = {
    "recorder": kill_recorder,
    "run": kill_run,
    "host": kill_host,
    "twin": kill_twin,
    "serve": kill_service,
    "study": kill_study,
    "tui": kill_screen,
}

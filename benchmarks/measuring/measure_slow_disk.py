"""What becomes of recordings on a disk that is slow. A command, no test:

    PYTHONPATH=benchmarks python benchmarks/measuring/measure_slow_disk.py --repeat 3 -o FILE.json

The disk is a loop device over a file in memory, whose writes the kernel limits (cgroup v1,
``blkio.throttle``): only root can make one. Two publishers write down what they publish, before they do; a
recorder of its own records it on that disk. The recording is held against what was published: what is not in
it has to be counted.

A recorder: the disk takes a half of what comes; or stands nearly still for 8 s; or takes so little that what
waits passes what may wait (here 1 MB; usually 64 MB), which ``check`` has to say. A run of a simulated device
behind a relay that sees when the device is safe: the disk takes too little, so that the run has to end.
"""

from __future__ import annotations

import argparse
import json
import os
import platform
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import Any

from kill_trials import HERE, RUN, SAMPLING
from labhil.bus import latch
from labhil.errors import LabhilError
from labhil.recording.reader import read_recording
from measure_overload import compare_with_log, publishers, reported_gaps
from measure_safety import Relay, twin_behind_a_relay
from measured import tell
from victims import process, wait_until

BLKIO = Path("/sys/fs/cgroup/blkio")
DISK_MB = 256
FAST = 1 << 30
"""Bytes a second of a disk that is not slow."""

STILL = 2000
"""Bytes a second of one that stands nearly still."""

MOST = 1_000_000
"""Bytes that may wait where too much shall wait."""

PATIENCE = 300.0
"""s that a recording may take to end, once nothing comes any more."""


class Disk:
    """A file system of its own, whose writes by the processes of ``group`` are limited."""

    def __init__(self, folder: Path, device: str, group: Path) -> None:
        self.folder, self.group = folder, group
        self._number = Path(f"/sys/class/block/{Path(device).name}/dev").read_text().strip()

    def slow(self, bytes_per_second: int) -> None:
        """Let it take so much."""
        limit = self.group / "blkio.throttle.write_bps_device"
        limit.write_text(f"{self._number} {bytes_per_second}")

    def on(self, program: str, *arguments: str, most: int = 0) -> list[str]:
        """The command line of a program that is slowed down."""
        script = str(HERE / "on_slow_disk.py")
        return [sys.executable, "-P", script, str(self.group), str(most), program, *arguments]


@contextmanager
def slow_disk() -> Iterator[Disk]:
    """Such a disk, not slow yet; OSError or CalledProcessError where none can be made."""
    with ExitStack() as stack:
        folder = Path(stack.enter_context(tempfile.TemporaryDirectory()))
        image = Path(stack.enter_context(tempfile.TemporaryDirectory(dir="/dev/shm"))) / "disk"
        image.touch()
        os.truncate(image, DISK_MB << 20)
        called("mkfs.ext4", "-q", str(image))
        device = called("losetup", "--find", "--show", str(image)).strip()
        stack.callback(called, "losetup", "--detach", device)
        called("mount", device, str(folder))
        stack.callback(called, "umount", str(folder))
        group = BLKIO / f"labhil-{os.getpid()}"
        group.mkdir()
        stack.callback(remove, group)
        yield Disk(folder, device, group)


def called(*command: str) -> str:
    return subprocess.run(command, check=True, capture_output=True, text=True).stdout


def remove(group: Path) -> None:
    """Remove a group, whose processes have ended a moment ago."""
    deadline = time.monotonic() + 20.0
    while (group / "cgroup.procs").read_text() and time.monotonic() < deadline:
        time.sleep(0.1)
    group.rmdir()


OF_A_BUSY_MACHINE = ("commands stopped", "nobody holds the lease", "a setpoint may be")
"""How a run ends whose process had no time: nothing is learnt of the disk then."""

COUNTED = ("published", "recorded", "lost", "wrong")

SLOW = {"half of what comes": 0.5, "still for 8 s": 1.0, "too slow": 0.1}
"""What a recorder meets, and the share of what comes that the disk takes in the end."""


def recorded(disk: Disk, how: str, seconds: float, came: float) -> dict[str, Any]:
    """A recorder on the disk while both publishers publish; ``came`` is what comes, bytes a second."""
    for old in disk.folder.iterdir():
        if old.is_file():
            old.unlink()
    disk.slow(FAST)
    with ExitStack() as stack:
        most = MOST if how == "too slow" else 0
        arguments = (str(HERE / "recorder_alone.py"), "syncs.txt", str(disk.folder / "a.mcap"))
        place = Path(stack.enter_context(tempfile.TemporaryDirectory()))
        recorder = stack.enter_context(process(disk.on(*arguments, most=most), place))
        wait_until((place / "endpoint.txt").exists, "the recorder is up")
        with publishers((place / "endpoint.txt").read_text(), place):
            time.sleep(1.0)
            if how == "still for 8 s":
                disk.slow(STILL)
                time.sleep(8.0)
                disk.slow(FAST)
            else:
                disk.slow(round(SLOW[how] * came))
            time.sleep(seconds)
        began = time.monotonic()
        assert recorder.stdin is not None
        recorder.stdin.close()
        recorder.wait(PATIENCE)
        ending = time.monotonic() - began
        said = (place / "said.txt").read_text()[-400:]
        (place / "a.mcap").symlink_to(disk.folder / "a.mcap")
        compared = compare_with_log(place)
    recording = read_recording(disk.folder / "a.mcap")
    slow = [str(e.body["message"]) for e in recording.events if e.body.get("kind") == "slow_disk"]
    notes = [text for e in recording.events if "disk is slow" in (text := str(e.body.get("text", "")))]
    return {
        **compared,
        "ending_s": round(ending, 1),
        "exit_status": recorder.returncode,
        "said": said,
        "event": slow[:1],
        "note": notes[-1:],
    }


def run_ended(disk: Disk, relay: Relay, bytes_per_second: int) -> dict[str, Any]:
    """A run whose disk becomes too slow: how it ends, and what can be read."""
    out = disk.folder / "run"
    disk.slow(FAST)
    with ExitStack() as stack:
        folder = Path(stack.enter_context(tempfile.TemporaryDirectory()))
        (folder / "e.toml").write_text(RUN.replace("ADDRESS", relay.address))
        command = disk.on("labhil", "run", "e.toml", "--out", str(out), most=MOST // 2)
        run = stack.enter_context(process(command, folder))
        relay.wait(safe=False)
        time.sleep(1.0)
        disk.slow(bytes_per_second)
        began = time.monotonic()
        while not relay.safe and time.monotonic() - began < PATIENCE:
            time.sleep(0.01)
        safe = time.monotonic() - began
        run.wait(PATIENCE)
        ended = time.monotonic() - began
        said = (folder / "said.txt").read_text()[-600:]
    (path,) = out.glob("*.mcap*")
    recording = read_recording(path)
    reason = recording.metadata.get("end", {}).get("reason", "")
    if any(text in reason for text in OF_A_BUSY_MACHINE):
        path.unlink()
        raise ValueError(f"the machine was too busy: {reason}")
    streams = {f"/{data.device}/{data.stream.name}": len(data) for data in recording.streams}
    outcome = {
        "exit_status": run.returncode,
        "device_safe": relay.safe,
        "safe_after_s": round(safe, 1),
        "ended_after_s": round(ended, 1),
        "said": said,
        "complete": recording.complete,
        "recorded_end": dict(recording.metadata.get("end", {})),
        "samples": streams,
        "lost": sum(data.lost for data in recording.streams),
        "gaps_in_its_last_status": reported_gaps(recording),
    }
    path.unlink()
    return outcome


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else "")
    parser.add_argument("--repeat", type=int, default=3)
    parser.add_argument("--seconds", type=float, default=15.0, help="how long the disk is slow")
    parser.add_argument("--came", type=float, default=400e3, help="bytes a second that come to the disk")
    parser.add_argument(
        "--run-bytes", type=int, default=20_000, help="bytes a second that a run's disk takes"
    )
    parser.add_argument("--only", help="parts of names: half,still,too slow,run")
    parser.add_argument("-o", "--out", type=Path)
    options = parser.parse_args()
    result: dict[str, Any] = {"schema": "labhil.slow_disk/1", "recorder": {}, "run": []}
    wanted = [*SLOW, "run"]
    if options.only:
        wanted = [name for name in wanted if any(part in name for part in options.only.split(","))]
        if options.out is not None and options.out.exists():
            result = json.loads(options.out.read_text())  # the others stay
    loads = [os.getloadavg()[0]]
    with slow_disk() as disk:
        for how in [name for name in wanted if name in SLOW]:
            trials = []
            for _ in range(options.repeat):
                try:
                    trials.append(recorded(disk, how, options.seconds, options.came))
                except (LabhilError, ValueError, subprocess.TimeoutExpired) as error:
                    trials.append({"not_set_up": str(error)})
                loads.append(os.getloadavg()[0])
                print(f"{how}: {trials[-1]}", file=sys.stderr, flush=True)
            valid = [trial for trial in trials if "not_set_up" not in trial]
            result["recorder"][how] = {
                "repeats": len(valid),
                **{key: sum(trial[key] for trial in valid) for key in COUNTED},
                "lost_and_not_counted": sum(t["lost"] - t["gaps_in_its_last_status"] for t in valid),
                "trials": trials,
            }
        trials = []
        with twin_behind_a_relay("solenoid", SAMPLING) as relay:
            for _ in range(options.repeat if "run" in wanted else 0):
                try:
                    trials.append(run_ended(disk, relay, options.run_bytes))
                except (LabhilError, ValueError, TimeoutError, subprocess.TimeoutExpired) as error:
                    trials.append({"not_set_up": str(error)})
                latch.release()
                loads.append(os.getloadavg()[0])
                print(f"run: {trials[-1]}", file=sys.stderr, flush=True)
        result["run"] = trials if "run" in wanted else result["run"]
    result.setdefault("load_average", {})["; ".join(wanted)] = [round(min(loads), 1), round(max(loads), 1)]
    result["machine"] = {"cores": os.cpu_count(), "python": platform.python_version()}
    tell(result, options.out)


if __name__ == "__main__":
    main()

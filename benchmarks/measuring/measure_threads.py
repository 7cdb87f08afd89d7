"""What becomes of a run when one of its threads raises. A command, no test:

    PYTHONPATH=benchmarks python benchmarks/measuring/measure_threads.py -o FILE.json

A run with a recorder and a host moves a solenoid's twin, which hangs on a TCP wire behind a relay that sees
when the device is safe. Each thread of the run and of the host is made to raise SystemExit, one a run. A
thread that waits for a message raises when the next one comes, so somebody asks at every key ten times a
second. Threads that Python itself started are left alone, as is the main thread, which is the process.
"""

from __future__ import annotations

import argparse
import contextlib
import os
import platform
import subprocess
import sys
import tempfile
import time
from contextlib import ExitStack
from pathlib import Path
from typing import Any

import psutil

from kill_trials import RUN
from labhil.bus import latch
from labhil.bus.keys import ARRIVED, PUBLISHED, command_key, event_key, schema_key, setpoint_key
from labhil.bus.keys import RUN as RUN_ITSELF
from labhil.bus.session import Bus, open_bus
from labhil.errors import LabhilError
from labhil.recording.reader import read_recording
from labhil.service.commands import COMMANDS
from measure_safety import PATIENCE, Relay, twin_behind_a_relay
from measured import tell
from victims import Listener, endpoint_of, family_of, process, wait_until

SETTINGS = {"sample_rate": 1000.0, "samples_per_frame": 10.0}
PROCESSES = {"run": "-m labhil run", "host": "labhil.service.host"}
NOT_OURS = ("MainThread", "strike")
OF_A_RUN = ("status", "pause", "resume", "stop", "abort", "mark")
GOES_ON = 10.0
"""s after which a run that still goes on has not noticed."""


def poke(bus: Bus, run: subprocess.Popen[str]) -> None:
    """Send each thread that listens something; all of it is refused, so that nothing is moved by it."""
    speak_for_hosts(run)
    keys = [command_key("bench", name) for name in COMMANDS]
    keys += [schema_key("bench", stream) for stream in ("state", "command")]
    keys += [PUBLISHED, ARRIVED, *(command_key(RUN_ITSELF, name) for name in OF_A_RUN)]
    for key in keys:
        bus.session.get(key, payload=b"[]", timeout=0.2)
    for key in (event_key("bench"), schema_key("bench", "odd"), setpoint_key("bench")):
        bus.session.put(key, b"false")
    time.sleep(0.1)


def speak_for_hosts(run: subprocess.Popen[str]) -> None:
    """Write an empty line where a host writes its own; a run ignores lines that are not JSON."""
    for member in family_of(run.pid):
        with contextlib.suppress(psutil.Error, OSError):
            if PROCESSES["host"] in " ".join(member.cmdline()):
                Path(f"/proc/{member.pid}/fd/1").write_bytes(b"\n")


def strike(relay: Relay, folder: Path, which: str, name: str) -> dict[str, Any]:
    """One run, in which a thread dies; without a ``name`` only the names of the threads."""
    (folder / "e.toml").write_text(RUN.replace("ADDRESS", relay.address))
    here = str(Path(__file__).parent / "struck")
    os.environ.update(PYTHONPATH=here, STRIKE_FOLDER=str(folder), STRIKE_PROCESS=PROCESSES[which])
    with ExitStack() as stack:
        command = [sys.executable, "-P", "-m", "labhil", "run", "e.toml"]
        run = stack.enter_context(process(command, folder))
        listener = Listener(endpoint_of(run, "run"), stack)
        bus = stack.enter_context(open_bus(listener.bus.endpoint))
        wait_until(lambda: listener.began_ns() is not None or run.poll() is not None, "the run began")
        relay.wait(safe=False)
        time.sleep(0.5)
        threads = (folder / "threads").read_text().splitlines()
        if not name:
            return {"threads": [thread for thread in threads if thread not in NOT_OURS]}
        relay.refuse_safe()
        return {"thread": name, **ended(relay, folder, run, bus, name)}


def ended(relay: Relay, folder: Path, run: subprocess.Popen[str], bus: Bus, name: str) -> dict[str, Any]:
    """Let the thread die, and return when the device was safe and how the run ended."""
    began = time.monotonic()
    (folder / "strike").write_text(name)
    while not relay.safe and time.monotonic() < began + GOES_ON:
        poke(bus, run)
    safe = relay.safe_since - began if relay.safe else None
    if safe is None:
        sleeps = name in (folder / "threads").read_text().splitlines()
        reason = "the thread sleeps, nothing woke it" if sleeps else "the run goes on"
        return {"safe_ms": None, "exit_status": None, "reason": reason, "load": round(os.getloadavg()[0], 1)}
    run.wait(PATIENCE)
    paths = list(folder.glob("*.mcap*"))
    end = read_recording(paths[0]).metadata.get("end", {}) if paths else {}
    return {
        "safe_ms": round(1e3 * safe, 1),
        "exit_status": run.returncode,
        "reason": end.get("reason", "") or (folder / "said.txt").read_text()[-300:],
        "load": round(os.getloadavg()[0], 1),
    }


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else "")
    parser.add_argument("--only", default="", help="a part of the threads' names")
    parser.add_argument("-o", "--out", type=Path)
    options = parser.parse_args()
    result: dict[str, Any] = {"schema": "labhil.threads/1"}
    result["machine"] = {"cores": os.cpu_count(), "python": platform.python_version()}
    with twin_behind_a_relay("solenoid", SETTINGS) as relay:
        for which in PROCESSES:
            with tempfile.TemporaryDirectory() as folder:
                names = strike(relay, Path(folder), which, "")["threads"]
            struck: list[dict[str, Any]] = []
            result[which] = {"threads": names, "struck": struck}
            for name in names:
                if options.only not in name:
                    continue
                try:
                    with tempfile.TemporaryDirectory() as folder:
                        struck.append(strike(relay, Path(folder), which, name))
                except (LabhilError, TimeoutError, ValueError) as error:
                    struck.append({"thread": name, "not_set_up": str(error)})
                finally:
                    latch.release()
                print(f"{which}: {struck[-1]}", file=sys.stderr, flush=True)
                if options.out is not None:
                    tell(result, options.out)
    tell(result, options.out)


if __name__ == "__main__":
    main()

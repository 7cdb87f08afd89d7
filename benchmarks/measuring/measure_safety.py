"""How long it takes until a device is safe after something has died. A command, no test:

    python benchmarks/measuring/measure_safety.py --repeat 50 -o benchmarks/results/safety.json

The twin hangs on a TCP wire behind a relay of ours, which sees every sample and passes it on. A device is
safe from the first sample on whose flag says so; samples come every 10 ms. The twin's own watchdog waits
300 ms, the host's as long as ``labhil.service.messages.WATCHDOG`` says.
"""

from __future__ import annotations

import argparse
import json
import os
import platform
import random
import resource
import select
import signal
import socket
import statistics
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import Any

from labhil.bus import latch
from labhil.bus.ask import ask
from labhil.bus.keys import command_key, setpoint_key
from labhil.bus.publish import publish_command
from labhil.bus.session import Bus, open_bus
from labhil.errors import BusError, LabhilError
from labhil.experiment.device_sections import TwinSection
from labhil.experiment.twins import start_twin
from labhil.link import Decoder, MessageType, StateFlag
from labhil.rig_sections import Limit
from labhil.service.hosts import HostProcess
from labhil.service.messages import HostConfig, Setpoint
from measured import tell

PATIENCE = 60.0
LIMITS = {"servo_angle": Limit(min=-1.0, max=1.0, rate=20.0)}
EXPERIMENT = """
[experiment]
name = "measured"
[devices.bench]
plugin = "ball_beam"
address = "ADDRESS"
[[steps]]
device = "bench"
signal = "servo_angle"
excitation = "hold"
level = 0.05
duration = 600.0
"""


class Relay:
    """A wire with a meter on it: one client at a time, whose end the twin never hears of."""

    def __init__(self, twin: str) -> None:
        host, port = twin.removeprefix("socket://").split(":")
        self._twin_at = (host, int(port))
        self._door = socket.create_server(("127.0.0.1", 0))
        self.port = int(self._door.getsockname()[1])
        self.address = f"socket://127.0.0.1:{self.port}"
        self.unplugged = False
        self.safe = True
        self.safe_since = 0.0
        self._over = False
        self._thread = threading.Thread(target=self._run)
        self._thread.start()

    def close(self) -> None:
        self._over = True
        self._thread.join()
        self._door.close()

    def wait(self, safe: bool, after: float = 0.0) -> float:
        deadline = time.monotonic() + PATIENCE
        while self.safe is not safe or (safe and self.safe_since < after):
            if time.monotonic() > deadline:
                raise TimeoutError(f"the device did not become {'safe' if safe else 'active'}")
            time.sleep(0.002)
        return self.safe_since

    def refuse_safe(self) -> None:
        """ValueError where a machine that is too busy has made the device safe before its time."""
        if self.safe:
            raise ValueError("the device was safe before the fault")

    def _run(self) -> None:
        client: socket.socket | None = None
        twin: socket.socket | None = None
        decoder = Decoder()
        while not self._over:
            peers = [peer for peer in (self._door, client, twin) if peer is not None]
            for peer in select.select(peers, [], [], 0.05)[0]:
                if peer is self._door:
                    for old in (client, twin):
                        if old is not None:
                            old.close()
                    if twin is not None:
                        time.sleep(0.1)  # the twin has to notice that its client is gone
                    client = self._door.accept()[0]
                    twin = socket.create_connection(self._twin_at)
                    for new in (client, twin):
                        new.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
                    decoder, self.safe = Decoder(), True
                    break
                data = _receive(peer)
                if peer is twin:
                    self._look(decoder, data)
                    _pass_on(client, b"" if self.unplugged else data)
                elif data:
                    _pass_on(twin, b"" if self.unplugged else data)
                else:
                    client.close()
                    client = None
        for peer in (client, twin):
            if peer is not None:
                peer.close()

    def _look(self, decoder: Decoder, data: bytes) -> None:
        now = time.monotonic()
        for frame in decoder.feed(data):
            if frame.type in (MessageType.STATE, MessageType.SAMPLES):
                safe = bool(frame.payload[0] & StateFlag.SAFE)  # both begin with the flags
                if safe and not self.safe:
                    self.safe_since = now
                self.safe = safe


def _receive(end: socket.socket) -> bytes:
    try:
        return end.recv(4096)
    except OSError:
        return b""


def _pass_on(peer: socket.socket | None, data: bytes) -> None:
    if peer is not None and data:
        try:
            peer.sendall(data)
        except OSError:
            return


class Seat:
    """A host of its own, and somebody who commands it a hundred times a second."""

    def __init__(self, relay: Relay) -> None:
        self.bus: Bus = open_bus()
        self.host = HostProcess(HostConfig("bench", "ball_beam", relay.address, LIMITS, self.bus.endpoint))
        try:
            self.host.wait_connected()
        except LabhilError:
            self.host.stop()
            self.bus.close()
            raise
        answer = ask(self.bus, command_key("bench", "lease"), {"holder": "meter"}, 2.0, patience=10.0)
        self._token = str(answer["token"])
        self._over = threading.Event()
        self._thread = threading.Thread(target=self._command)
        self._thread.start()

    def _command(self) -> None:
        while not self._over.wait(0.01):
            setpoint = Setpoint(self._token, time.time_ns(), {"servo_angle": 0.05})
            try:
                publish_command(self.bus, setpoint_key("bench"), setpoint.to_bytes())
            except BusError:  # the session was closed, as it was meant to be
                return

    def close(self) -> None:
        self._over.set()
        self._thread.join()
        self.host.stop()
        self.bus.close()


Fault = Callable[[Any, Relay], None]


def with_a_seat(relay: Relay, fault: Fault) -> float:
    relay.unplugged = False
    seat = Seat(relay)
    try:
        relay.wait(safe=False)
        time.sleep(random.uniform(0.2, 0.3))
        relay.refuse_safe()
        began = time.monotonic()
        fault(seat, relay)
        return relay.wait(safe=True, after=began) - began
    finally:
        relay.unplugged = False
        seat.close()
        latch.release()


def with_a_run(relay: Relay, fault: Fault) -> float:
    with tempfile.TemporaryDirectory() as directory:
        (Path(directory) / "e.toml").write_text(EXPERIMENT.replace("ADDRESS", relay.address))
        run = subprocess.Popen(
            [sys.executable, "-P", "-m", "labhil", "run", "e.toml"],
            cwd=directory,
            stdin=subprocess.DEVNULL,
            stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL,
        )
        try:
            relay.wait(safe=False)
            time.sleep(random.uniform(0.8, 1.1))
            relay.refuse_safe()
            began = time.monotonic()
            fault((run, Path(directory)), relay)
            return relay.wait(safe=True, after=began) - began
        finally:
            if run.poll() is None:
                run.send_signal(signal.SIGINT)
            run.wait(30)
            latch.release()
            time.sleep(0.3)


def kill_host(seat: Seat, _relay: Relay) -> None:
    os.kill(seat.host.pid, signal.SIGKILL)


def freeze_host(seat: Seat, _relay: Relay) -> None:
    os.kill(seat.host.pid, signal.SIGSTOP)
    threading.Timer(1.5, os.kill, (seat.host.pid, signal.SIGCONT)).start()


def pull_cable(_seat: Seat, relay: Relay) -> None:
    relay.unplugged = True


def close_session(seat: Seat, _relay: Relay) -> None:
    seat.bus.session.close()


def press_by_file(_seat: Seat, _relay: Relay) -> None:
    latch.press("the meter", "measured")


def press_by_bus(seat: Seat, _relay: Relay) -> None:
    ask(seat.bus, command_key("bench", "estop"), {"by": "the meter"})


def kill_run(run: tuple[subprocess.Popen[bytes], Path], _relay: Relay) -> None:
    run[0].kill()


def fill_disk(run: tuple[subprocess.Popen[bytes], Path], _relay: Relay) -> None:
    """From now on the recorder's file may not grow."""
    (part,) = run[1].glob("*.part")
    size = part.stat().st_size
    resource.prlimit(run[0].pid, resource.RLIMIT_FSIZE, (size, size))


def interrupt_run(run: tuple[subprocess.Popen[bytes], Path], _relay: Relay) -> None:
    run[0].send_signal(signal.SIGINT)


CASES: dict[str, tuple[Callable[[Relay, Fault], float], Fault, str]] = {
    "host and driver process killed": (with_a_seat, kill_host, "the device's own watchdog, 300 ms"),
    "host frozen": (with_a_seat, freeze_host, "the device's own watchdog, 300 ms"),
    "cable pulled": (with_a_seat, pull_cable, "the device's own watchdog, 300 ms"),
    "bus session closed": (with_a_seat, close_session, "the host's watchdog"),
    "run killed (controller and recorder)": (with_a_run, kill_run, "the host, whose standard input ends"),
    "recorder's disk full": (with_a_run, fill_disk, "the run; the disk is tried every 200 ms"),
    "Ctrl+C": (with_a_run, interrupt_run, "the run; looked at every 100 ms"),
    "emergency stop by the bus": (with_a_seat, press_by_bus, "the host"),
    "emergency stop by its file": (with_a_seat, press_by_file, "the host; looked at every 50 ms"),
}


def describe(times: list[float], by: str) -> dict[str, Any]:
    ms = sorted(1e3 * t for t in times)
    return {
        "made_safe_by": by,
        "repeats": len(ms),
        "median_ms": round(statistics.median(ms), 1),
        "p90_ms": round(ms[min(len(ms) - 1, int(0.9 * len(ms)))], 1),
        "largest_ms": round(ms[-1], 1),
        "all_ms": [round(t, 1) for t in ms],
    }


@contextmanager
def twin_behind_a_relay(
    kind: str = "ball_beam", settings: Mapping[str, float] | None = None
) -> Iterator[Relay]:
    """Start a twin, and what sees the last command that reaches it."""
    with ExitStack() as stack:
        directory = Path(stack.enter_context(tempfile.TemporaryDirectory()))
        os.environ["XDG_RUNTIME_DIR"] = str(directory)  # nobody else's emergency stop is pressed
        section = TwinSection(wire="tcp", seed=1, set=dict(settings or {}))
        twin, address = start_twin("bench", kind, section, directory / "twin.json", lambda: False)
        stack.enter_context(twin)
        relay = Relay(address)
        stack.callback(relay.close)
        yield relay


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else "")
    parser.add_argument("--repeat", type=int, default=20)
    parser.add_argument("--repeat-runs", type=int, help="of the cases that need a whole run each")
    parser.add_argument("--only", help="parts of cases' names: a,b,…")
    parser.add_argument("-o", "--out", type=Path)
    options = parser.parse_args()
    result: dict[str, Any] = {"schema": "labhil.safety/1", "cases": {}}
    with twin_behind_a_relay() as relay:
        for name, (way, fault, by) in CASES.items():
            if options.only and not any(part in name for part in options.only.split(",")):
                continue
            loads = [os.getloadavg()[0]]
            times: list[float] = []
            repeat = options.repeat_runs or options.repeat if way is with_a_run else options.repeat
            failed = 0
            while len(times) < repeat and failed < repeat:
                try:
                    times.append(way(relay, fault))
                except (LabhilError, TimeoutError, ValueError) as error:
                    failed += 1
                    print(f"not set up: {error}", file=sys.stderr, flush=True)
                loads.append(os.getloadavg()[0])
            result["cases"][name] = {
                **describe(times, by),
                "not_set_up": failed,
                "load_average": [round(min(loads), 1), round(max(loads), 1)],
            }
            shown = {k: v for k, v in result["cases"][name].items() if k != "all_ms"}
            print(f"{name}: {shown}", file=sys.stderr, flush=True)
            if options.out is not None:
                options.out.write_text(json.dumps(result, indent=1) + "\n", encoding="utf-8")
    result["machine"] = {"cores": os.cpu_count(), "python": platform.python_version()}
    tell(result, options.out)


if __name__ == "__main__":
    main()

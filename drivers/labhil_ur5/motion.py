"""The driver's side of the client process: it is started, commanded, watched, and replaced."""

from __future__ import annotations

import contextlib
import json
import os
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Mapping, Sequence
from enum import StrEnum
from typing import Any

from labhil.extras import require
from labhil_ur5.dashboard import stop_program

SILENCE = 2.0
"""How long the client may say nothing before it is taken for hung, s."""
START_TIMEOUT = 15.0
"""How long it may take to connect and to start its program on the controller, s."""
END_TIMEOUT = 3.0
ENDING_ALREADY = 0.2
"""How long an order to stop waits for another thread, s; whoever gives it is waited for."""
STOP_TIMEOUT = 1.5
"""How long a dashboard may take to stop the program, s."""


class MotionState(StrEnum):
    """What the client says it is doing, and what it cannot say itself."""

    NONE = "none"
    """There is no client."""
    STARTING = "starting"
    IDLE = "idle"
    MOVING = "moving"
    SERVO = "servo"
    STOPPING = "stopping"


class Motion:
    """The client process of one controller; nothing here waits but :meth:`end`."""

    def __init__(self, host: str, rate: float) -> None:
        self._command = [sys.executable, "-P", "-m", "labhil_ur5.client", host, repr(rate)]
        self._host = host
        self._process: subprocess.Popen[bytes] | None = None
        self._writing = threading.RLock()
        self._heard_at = 0.0
        self._rest = b""
        self.state = MotionState.NONE
        self.refusal = self._fault = ""
        self.died = False
        """Whether the client was lost by itself, and not because the controller ended its program."""
        self.starts = 0
        self._stopping: threading.Thread | None = None

    def start(self) -> None:
        """Start the process; :attr:`state` is IDLE once it can be moved.

        MissingExtraError without the client library: listening to an arm needs none.
        """
        require("rtde_control", "commanding a UR arm")
        with self._writing:
            self._discard()
            self._errors = tempfile.TemporaryFile()  # noqa: SIM115 - closed in `_discard`
            self._process = subprocess.Popen(
                self._command,
                stdin=subprocess.PIPE,
                stdout=subprocess.PIPE,
                stderr=self._errors,
                bufsize=0,
                start_new_session=True,
                env={**os.environ, "PYTHONPATH": os.pathsep.join(path for path in sys.path if path)},
            )
            for pipe in (self._process.stdin, self._process.stdout):
                assert pipe is not None
                os.set_blocking(pipe.fileno(), False)
            self._rest, self.refusal, self._fault = b"", "", ""
            self._heard_at = time.monotonic()
            self.state = MotionState.STARTING
            self.starts += 1

    @property
    def pid(self) -> int | None:
        """The process id, None when there is no client."""
        return None if self._process is None else self._process.pid

    def descriptors(self) -> list[int]:
        """What to wait on for news of the client."""
        process = self._process
        return [] if process is None or process.stdout is None else [process.stdout.fileno()]

    def look(self) -> str:
        """Take in what the client sent; returns why it is gone, or an empty string while all is well."""
        with self._writing:
            if self._process is None:
                return ""
            closed = self._read(self._process)
            if closed:
                with contextlib.suppress(subprocess.TimeoutExpired):
                    self._process.wait(0.5)
                self.died = not self._fault
                return self._give_up(self._fault or f"the client process died{self._exit_in_words()}")
            silence = START_TIMEOUT if self.state is MotionState.STARTING else SILENCE
            if time.monotonic() - self._heard_at > silence:
                self.died = True
                return self._give_up(f"the client process said nothing for {silence:g} s{self._complaint()}")
            return ""

    def tell(self, order: Mapping[str, Any]) -> None:
        """Send an order; :meth:`look` notices a client that takes none."""
        with self._writing:
            if self._process is None or self._process.stdin is None:
                return
            with contextlib.suppress(OSError, ValueError):
                self._process.stdin.write(json.dumps(order).encode() + b"\n")

    def move(self, q: Sequence[float]) -> None:
        """Go to ``q`` (rad) by moveJ."""
        self.tell({"move": list(q)})

    def waypoint(self, t: float, q: Sequence[float], begin: Sequence[float]) -> None:
        """Be at ``q`` at time ``t`` (s) of the controller's clock; the first begins a path at ``begin``."""
        self.tell({"t": t, "q": list(q), "from": list(begin)})

    def stop(self) -> None:
        """Come to rest and stay; by the dashboard where the client is no more. Never raises."""
        # where another thread ends the client, which takes seconds, that stops the arm as well
        if not self._writing.acquire(timeout=ENDING_ALREADY):
            return
        try:
            if self._process is not None and self._process.poll() is None:
                self.tell({"stop": True})
            elif self._process is not None:
                self._stop_by_dashboard()
        finally:
            self._writing.release()

    def end(self, patience: float = END_TIMEOUT) -> None:
        """Stop the arm, end the controller's program and the client; safe to call twice.

        A client that takes longer than ``patience`` s is killed; the controller's watchdog stops the arm.
        """
        with self._writing:
            if self._stopping is not None:
                self._stopping.join(STOP_TIMEOUT)
            process = self._process
            if process is None:
                return
            assert process.stdin is not None
            with contextlib.suppress(OSError):
                process.stdin.close()
            with contextlib.suppress(subprocess.TimeoutExpired):
                process.wait(patience)
            if process.poll() != 0:
                process.kill()
                process.wait()
                stop_program(self._host)
            self._discard()

    def _read(self, process: subprocess.Popen[bytes]) -> bool:
        """Take in what is there; whether the client has closed its output."""
        assert process.stdout is not None
        while True:
            try:
                data = os.read(process.stdout.fileno(), 1 << 16)
            except BlockingIOError:
                return False
            if not data:
                return True
            self._heard_at = time.monotonic()
            *lines, self._rest = (self._rest + data).split(b"\n")
            for line in lines:
                self._take(line)

    def _take(self, line: bytes) -> None:
        try:
            message = json.loads(line)
        except ValueError:
            return
        self.state = MotionState(message.get("state", self.state.value))
        self.refusal = str(message.get("refused", self.refusal))
        # a fault is sent before the output is closed, and may be read before that
        self._fault = str(message.get("fault", self._fault))

    def _give_up(self, why: str) -> str:
        self._discard()
        # the last command must not go on; the controller's watchdog stops it as well
        self._stop_by_dashboard()
        return why

    def _stop_by_dashboard(self) -> None:
        """Have the program stopped, while samples go on being read: a dashboard may keep one waiting."""
        if self._stopping is None or not self._stopping.is_alive():
            self._stopping = threading.Thread(target=stop_program, args=(self._host,), daemon=True)
            self._stopping.start()

    def _discard(self) -> None:
        process, self._process, self.state = self._process, None, MotionState.NONE
        if process is None:
            return
        if process.poll() is None:
            process.kill()
            process.wait()
        for pipe in (process.stdin, process.stdout):
            if pipe is not None:
                pipe.close()
        self._errors.close()

    def _exit_in_words(self) -> str:
        status = self._process.poll() if self._process is not None else None
        ending = (
            "" if status is None else f" by signal {-status}" if status < 0 else f" with exit status {status}"
        )
        return ending + self._complaint()

    def _complaint(self) -> str:
        written = os.pread(self._errors.fileno(), 1 << 20, 0).decode(errors="replace").strip()
        return f": {written.splitlines()[-1]}" if written else ""

"""The client process, seen from the driver: started, commanded, watched and ended."""

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


class MotionState(StrEnum):
    """States of the client, as it reports them, and NONE and STARTING."""

    NONE = "none"
    """There is no client."""
    STARTING = "starting"
    IDLE = "idle"
    MOVING = "moving"
    SERVO = "servo"
    STOPPING = "stopping"


class Motion:
    """The client process of one controller; only :meth:`end` blocks.

    Args:
        host: Address of the controller.
        rate: Rate of servo targets, Hz.
        max_silence: Time without a line after which the client counts as hung, s.
        start_timeout: Time in which the client has to connect and to start its program, s.
        end_timeout: Time in which the client has to end, s.
        stop_timeout: Time in which a dashboard has to stop the program, s.
        lock_timeout: Time that a request to stop waits for another thread, s, before the dashboard is asked.
    """

    def __init__(
        self,
        host: str,
        rate: float,
        *,
        max_silence: float = 2.0,
        start_timeout: float = 15.0,
        end_timeout: float = 3.0,
        stop_timeout: float = 1.5,
        lock_timeout: float = 0.2,
    ) -> None:
        self._max_silence, self._start_timeout = max_silence, start_timeout
        self._end_timeout, self._stop_timeout = end_timeout, stop_timeout
        self._lock_timeout = lock_timeout
        self._command = [sys.executable, "-P", "-m", "labhil_ur5.client", host, repr(rate)]
        self._host = host
        self._process: subprocess.Popen[bytes] | None = None
        self._lock = threading.RLock()
        self._heard_at = 0.0
        self._incomplete = b""
        self.state = MotionState.NONE
        self.refusal = self._fault = ""
        self.died = False
        """Whether the client died, and not because the controller ended its program."""
        self.starts = 0
        self._stopping: threading.Thread | None = None

    def start(self) -> None:
        """Start the process; :attr:`state` is IDLE once the arm can be moved.

        Raises:
            MissingExtraError: The client library is not installed, which only commands need.
        """
        require("rtde_control", "commanding a UR arm")
        with self._lock:
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
            self._incomplete, self.refusal, self._fault = b"", "", ""
            self._heard_at = time.monotonic()
            self.state = MotionState.STARTING
            self.starts += 1

    @property
    def pid(self) -> int | None:
        """The process id, None when there is no client."""
        return None if self._process is None else self._process.pid

    def descriptors(self) -> list[int]:
        """Return file descriptors that become readable when the client writes."""
        process = self._process
        return [] if process is None or process.stdout is None else [process.stdout.fileno()]

    def poll(self) -> str:
        """Handle the client's lines; return why the client is lost, or an empty string."""
        with self._lock:
            if self._process is None:
                return ""
            closed = self._read(self._process)
            if closed:
                with contextlib.suppress(subprocess.TimeoutExpired):
                    self._process.wait(0.5)
                self.died = not self._fault
                return self._abandon(self._fault or f"the client process died{self._exit_description()}")
            silence = self._start_timeout if self.state is MotionState.STARTING else self._max_silence
            if time.monotonic() - self._heard_at > silence:
                self.died = True
                return self._abandon(
                    f"the client process said nothing for {silence:g} s{self._last_error_line()}"
                )
            return ""

    def send(self, request: Mapping[str, Any]) -> None:
        """Send a request; :meth:`poll` detects a client that reads none."""
        with self._lock:
            if self._process is None or self._process.stdin is None:
                return
            with contextlib.suppress(OSError, ValueError):
                self._process.stdin.write(json.dumps(request).encode() + b"\n")

    def move(self, q: Sequence[float]) -> None:
        """Go to ``q`` (rad) by moveJ."""
        self.send({"move": list(q)})

    def waypoint(self, t: float, q: Sequence[float], begin: Sequence[float]) -> None:
        """Send a waypoint ``q`` (rad) at time ``t`` (s) of the controller; a path starts at ``begin``."""
        self.send({"t": t, "q": list(q), "from": list(begin)})

    def stop(self) -> None:
        """Stop and hold, by the dashboard where the client is dead. Never raises."""
        # another thread may be ending the client, which takes seconds, or be blocked by its full pipe
        if not self._lock.acquire(timeout=self._lock_timeout):
            self._stop_by_dashboard()
            return
        try:
            if self._process is not None and self._process.poll() is None:
                self.send({"stop": True})
            elif self._process is not None:
                self._stop_by_dashboard()
        finally:
            self._lock.release()

    def end(self, timeout: float | None = None) -> None:
        """Stop the arm, end the controller's program and the client; safe to call twice.

        Args:
            timeout: Time in which the client has to end, s; None for the usual one. A client that takes
                longer is killed, and the controller's watchdog stops the arm.
        """
        with self._lock:
            if self._stopping is not None:
                self._stopping.join(self._stop_timeout)
            process = self._process
            if process is None:
                return
            assert process.stdin is not None
            with contextlib.suppress(OSError):
                process.stdin.close()
            with contextlib.suppress(subprocess.TimeoutExpired):
                process.wait(self._end_timeout if timeout is None else timeout)
            if process.poll() != 0:
                process.kill()
                process.wait()
                stop_program(self._host)
            self._discard()

    def _read(self, process: subprocess.Popen[bytes]) -> bool:
        """Read and handle available lines; return whether the client has closed its output."""
        assert process.stdout is not None
        while True:
            try:
                data = os.read(process.stdout.fileno(), 1 << 16)
            except BlockingIOError:
                return False
            if not data:
                return True
            self._heard_at = time.monotonic()
            *lines, self._incomplete = (self._incomplete + data).split(b"\n")
            for line in lines:
                self._handle_line(line)

    def _handle_line(self, line: bytes) -> None:
        try:
            message = json.loads(line)
        except ValueError:
            return
        self.state = MotionState(message.get("state", self.state.value))
        self.refusal = str(message.get("refused", self.refusal))
        # a fault is sent before the output is closed, and may be read before that
        self._fault = str(message.get("fault", self._fault))

    def _abandon(self, reason: str) -> str:
        self._discard()
        # the last command must not continue; the controller's watchdog stops it as well
        self._stop_by_dashboard()
        return reason

    def _stop_by_dashboard(self) -> None:
        """Stop the program in another thread, so that a slow dashboard does not delay samples."""
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

    def _exit_description(self) -> str:
        status = self._process.poll() if self._process is not None else None
        ending = (
            "" if status is None else f" by signal {-status}" if status < 0 else f" with exit status {status}"
        )
        return ending + self._last_error_line()

    def _last_error_line(self) -> str:
        errors = os.pread(self._errors.fileno(), 1 << 20, 0).decode(errors="replace").strip()
        return f": {errors.splitlines()[-1]}" if errors else ""

"""The two wires that a twin can hang on: a pseudo terminal, and a TCP port of this machine.

Both carry one client at a time, never block, and lose what the client does not fetch, as a serial
line would.
"""

from __future__ import annotations

import contextlib
import os
import select
import socket
import tty
from typing import Protocol

UNFETCHED = 65536
"""How many bytes wait for a client before further messages are lost."""


class Wire(Protocol):
    """Where a client comes and goes."""

    address: str

    def fileno(self) -> int:
        """What to wait on for a client's bytes, or for a client."""
        ...

    def client(self) -> int:
        """Return the number of the client that is there, letting in one that waits; 0 for none."""
        ...

    def read(self) -> bytes:
        """Return what the client has sent, nothing when it has sent nothing or is gone."""
        ...

    def write(self, data: bytes) -> None:
        """Send whole messages to the client, as far as it fetches them."""
        ...

    def close(self) -> None:
        """Take the wire down."""
        ...


class PseudoTerminal:
    """A pty in raw mode; ``address`` is the path of the end that a driver opens."""

    def __init__(self) -> None:
        self._master, device = os.openpty()
        tty.setraw(device)
        self.address = os.ttyname(device)
        # with our own end closed, the kernel tells whether anybody else has it open
        os.close(device)
        os.set_blocking(self._master, False)
        self._poll = select.poll()
        self._poll.register(self._master, 0)
        self._unsent = b""
        self._clients = 0
        self._attended = False

    def fileno(self) -> int:
        """What to wait on for a client's bytes, or for a client."""
        return self._master

    def client(self) -> int:
        """Return the number of the client that is there, 0 for none."""
        connected = not any(event & select.POLLHUP for _, event in self._poll.poll(0))
        if connected and not self._attended:
            self._clients += 1
            self._unsent = b""
        self._attended = connected
        return self._clients if connected else 0

    def read(self) -> bytes:
        """Return what the client has sent."""
        # EAGAIN: nothing there; EIO: the client has closed its end
        with contextlib.suppress(OSError):
            return os.read(self._master, 4096)
        return b""

    def write(self, data: bytes) -> None:
        """Send whole messages, as far as the client fetches them."""
        if len(self._unsent) < UNFETCHED:
            self._unsent += data
        with contextlib.suppress(OSError):
            self._unsent = self._unsent[os.write(self._master, self._unsent) :]

    def close(self) -> None:
        """Take the wire down."""
        os.close(self._master)


class TcpPort:
    """A port on the loopback interface; ``address`` is ``socket://127.0.0.1:PORT``."""

    def __init__(self) -> None:
        self._door = socket.create_server(("127.0.0.1", 0))
        self._door.setblocking(False)
        self.address = f"socket://127.0.0.1:{self._door.getsockname()[1]}"
        self._client: socket.socket | None = None
        self._clients = 0
        self._unsent = b""

    def fileno(self) -> int:
        """What to wait on for a client's bytes, or for a client."""
        return (self._client or self._door).fileno()

    def client(self) -> int:
        """Return the number of the client that is there, 0 for none."""
        with contextlib.suppress(BlockingIOError, ConnectionError):
            newcomer, _ = self._door.accept()
            if self._client is None:
                newcomer.setblocking(False)
                newcomer.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
                self._client = newcomer
                self._clients += 1
            else:
                newcomer.close()
        return 0 if self._client is None else self._clients

    def read(self) -> bytes:
        """Return what the client has sent."""
        if self._client is None:
            return b""
        try:
            data = self._client.recv(4096)
        except BlockingIOError:
            return b""
        except OSError:
            data = b""
        if not data:
            self._hang_up()
        return data

    def write(self, data: bytes) -> None:
        """Send whole messages, as far as the client fetches them."""
        if self._client is None:
            return
        if len(self._unsent) < UNFETCHED:
            self._unsent += data
        try:
            self._unsent = self._unsent[self._client.send(self._unsent) :]
        except BlockingIOError:
            return
        except OSError:
            self._hang_up()

    def close(self) -> None:
        """Take the wire down."""
        self._hang_up()
        self._door.close()

    def _hang_up(self) -> None:
        if self._client is not None:
            self._client.close()
        self._client = None
        self._unsent = b""


def open_wire(kind: str) -> Wire:
    """Open a ``"pty"`` or ``"tcp"`` wire."""
    return PseudoTerminal() if kind == "pty" else TcpPort()

"""The two wires of a twin: a pseudo terminal, and a TCP port on the loopback.

Both carry one client at a time, never block, and lose what the client does not read, as a serial line does.
"""

from __future__ import annotations

import contextlib
import os
import select
import socket
import tty
from typing import Protocol

MAX_UNSENT = 65536
"""Bytes that may wait for a client; further messages are lost."""


class Wire(Protocol):
    """A wire that one client at a time opens."""

    address: str

    def fileno(self) -> int:
        """What to wait on for a client's bytes, or for a client."""
        ...

    def client(self) -> int:
        """Return the number of the connected client, after accepting a waiting one; 0 for none."""
        ...

    def read(self) -> bytes:
        """Return what the client has sent; empty where there is nothing."""
        ...

    def write(self, data: bytes) -> None:
        """Send whole messages to the client, as far as it reads them."""
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
        # with the device end closed here, the kernel reports whether a client has it open
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
        elif self._attended and not connected:
            while self.read():  # what the last client sent is no command to a device that boots
                continue
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
        if len(self._unsent) < MAX_UNSENT:
            self._unsent += data
        with contextlib.suppress(OSError):
            self._unsent = self._unsent[os.write(self._master, self._unsent) :]

    def close(self) -> None:
        """Take the wire down."""
        os.close(self._master)


class TcpPort:
    """A port on the loopback interface; ``address`` is ``socket://127.0.0.1:PORT``."""

    def __init__(self) -> None:
        self._listener = socket.create_server(("127.0.0.1", 0))
        self._listener.setblocking(False)
        self.address = f"socket://127.0.0.1:{self._listener.getsockname()[1]}"
        self._client: socket.socket | None = None
        self._clients = 0
        self._unsent = b""

    def fileno(self) -> int:
        """What to wait on for a client's bytes, or for a client."""
        return (self._client or self._listener).fileno()

    def client(self) -> int:
        """Return the number of the client that is there, 0 for none."""
        with contextlib.suppress(BlockingIOError, ConnectionError):
            newcomer, _ = self._listener.accept()
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
            self._disconnect()
        return data

    def write(self, data: bytes) -> None:
        """Send whole messages, as far as the client fetches them."""
        if self._client is None:
            return
        if len(self._unsent) < MAX_UNSENT:
            self._unsent += data
        try:
            self._unsent = self._unsent[self._client.send(self._unsent) :]
        except BlockingIOError:
            return
        except OSError:
            self._disconnect()

    def close(self) -> None:
        """Take the wire down."""
        self._disconnect()
        self._listener.close()

    def _disconnect(self) -> None:
        if self._client is not None:
            self._client.close()
        self._client = None
        self._unsent = b""


def open_wire(kind: str) -> Wire:
    """Open a ``"pty"`` or ``"tcp"`` wire."""
    return PseudoTerminal() if kind == "pty" else TcpPort()

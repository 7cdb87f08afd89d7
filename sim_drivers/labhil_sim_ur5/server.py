"""The controller's three ports and its clock, in one thread.

A tick happens at an absolute time; between ticks the thread waits for bytes. Nothing blocks: what a client
does not fetch is dropped, a whole package at a time.
"""

from __future__ import annotations

import contextlib
import errno
import select
import socket
import time
from collections.abc import Callable

from labhil.ending import Ending
from labhil.errors import UsageError
from labhil_sim_ur5.codec import FramingError
from labhil_sim_ur5.controller import Controller
from labhil_sim_ur5.dashboard import BANNER, Dashboard, Lines
from labhil_sim_ur5.rtde import Conversation, Variables
from labhil_sim_ur5.script import parse

RTDE_PORT, SCRIPT_PORT, DASHBOARD_PORT = 30004, 30003, 29999
PATIENCE = 0.5
"""How far (s) the controller may fall behind and still catch up; beyond that its world has paused."""
TOO_LATE = 0.05
"""How late (s) a tick may be to be sent; later ones are sent only after ``SILENCE`` s without any."""
SILENCE = 0.02
LARGEST_SCRIPT = 1 << 20
SEND_BUFFER = 1 << 16
"""Bytes that wait for a client in the kernel: about 50 packages."""


class Client:
    """One connection of one port."""

    def __init__(self, connection: socket.socket) -> None:
        self.connection = connection
        self.dropped = 0
        self._rest = b""

    def send(self, data: bytes) -> None:
        """Send a whole message or nothing of it; ConnectionError when the client is gone."""
        if self._rest:
            self._push(self._rest)
        if self._rest:
            self.dropped += 1
            return
        self._push(data)

    def _push(self, data: bytes) -> None:
        try:
            sent = self.connection.send(data)
        except BlockingIOError:
            if data is not self._rest:
                self.dropped += 1
            return
        self._rest = data[sent:]

    def close(self) -> None:
        """Let go of the connection."""
        self.connection.close()


class RtdeClient(Client):
    """A client of port 30004."""

    def __init__(self, connection: socket.socket, variables: Variables) -> None:
        super().__init__(connection)
        self.conversation = Conversation(variables)

    def close(self) -> None:
        """Let go of the connection and of its inputs."""
        self.conversation.close()
        super().close()


class Server:
    """Serves a controller at one address until it is ended."""

    def __init__(self, controller: Controller, dashboard: Dashboard, host: str) -> None:
        self.controller = controller
        self.variables = Variables(controller.version)
        self.missed = 0
        """Ticks that were given up because the machine had no time."""
        self.unsent = 0
        """Ticks that were done too late to be sent."""
        self._dashboard = dashboard
        self._clients: dict[int, Client] = {}
        self._lines: dict[int, Lines] = {}
        self._scripts: dict[int, bytes] = {}
        self._doors: dict[int, tuple[socket.socket, Callable[[socket.socket], Client]]] = {}
        try:
            for port, kind in (
                (RTDE_PORT, lambda c: RtdeClient(c, self.variables)),
                (SCRIPT_PORT, ScriptClient),
                (DASHBOARD_PORT, DashboardClient),
            ):
                door = _listening_socket(host, port)
                self._doors[door.fileno()] = (door, kind)
        except BaseException:
            self.close()
            raise

    def run(self, ending: Ending, on_line: Callable[[str], None], each_tick: Callable[[], None]) -> None:
        """Serve; ``on_line`` gets lines from the side, ``each_tick`` is called before every tick."""
        due = sent_at = time.monotonic()
        while not ending.due:
            readable = self._wait(ending, due - time.monotonic())
            self._serve(readable)
            for line in ending.hear(readable):
                on_line(line)
            now = time.monotonic()
            if now < due:
                continue
            if now - due > PATIENCE:
                # the host had no time: the controller's own clock stands still meanwhile
                missed = int((now - due) / self.controller.period)
                self.missed += missed
                due += missed * self.controller.period
            each_tick()
            self.controller.tick()
            if now - due < TOO_LATE or now - sent_at > SILENCE:
                sent_at = now
                self._send_samples()
            else:
                self.unsent += 1
            due += self.controller.period

    def rtde_clients(self) -> list[RtdeClient]:
        """All clients of port 30004."""
        return [client for client in self._clients.values() if isinstance(client, RtdeClient)]

    def hang_up(self, client: Client) -> None:
        """End one connection."""
        number = client.connection.fileno()
        self._clients.pop(number, None)
        client.close()

    def close(self) -> None:
        """End all connections and take the ports down."""
        for client in list(self._clients.values()):
            self.hang_up(client)
        for door, _ in self._doors.values():
            door.close()
        self._doors.clear()

    def _wait(self, ending: Ending, timeout: float) -> list[int]:
        watched = [*self._doors, *self._clients, *ending.watched()]
        readable, _, _ = select.select(watched, [], [], max(timeout, 0.0))
        return readable

    def _serve(self, readable: list[int]) -> None:
        for number in readable:
            if number in self._doors:
                self._let_in(*self._doors[number])
            elif number in self._clients:
                self._listen(self._clients[number])

    def _let_in(self, door: socket.socket, kind: Callable[[socket.socket], Client]) -> None:
        with contextlib.suppress(BlockingIOError, ConnectionError):
            connection, _ = door.accept()
            connection.setblocking(False)
            connection.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
            client = kind(connection)
            self._clients[connection.fileno()] = client
            if isinstance(client, DashboardClient):
                client.send(f"{BANNER}\n".encode())

    def _listen(self, client: Client) -> None:
        try:
            data = client.connection.recv(65536)
        except BlockingIOError:
            return
        except OSError:
            data = b""
        if not data:
            if isinstance(client, ScriptClient):
                self._take_script(client, closed=True)
            self.hang_up(client)
            return
        try:
            self._take(client, data)
        except (FramingError, OSError) as error:
            self.controller.log(f"a client is cut off: {error}")
            self.hang_up(client)

    def _take(self, client: Client, data: bytes) -> None:
        match client:
            case RtdeClient():
                answers = client.conversation.receive(data)
                for inputs in client.conversation.received:
                    self.controller.receive(inputs)
                client.conversation.received.clear()
                if answers:
                    client.send(answers)
            case ScriptClient():
                client.text += data
                self._take_script(client)
            case DashboardClient():
                for line in client.lines.take(data):
                    answer = "Disconnected" if line.strip() == "quit" else self._dashboard.answer(line)
                    client.send(f"{answer}\n".encode())

    def _take_script(self, client: ScriptClient, closed: bool = False) -> None:
        for text in client.scripts(closed):
            self.controller.upload(parse(text))

    def _send_samples(self) -> None:
        tick = self.controller.ticks
        due = [client for client in self.rtde_clients() if client.conversation.due(tick)]
        if due:
            self.controller.publish(any(client.conversation.reads_tool for client in due))
        for client in due:
            try:
                client.send(client.conversation.sample(self.controller.values))
            except OSError:
                self.hang_up(client)


class ScriptClient(Client):
    """A client of port 30003: programs in plain text."""

    def __init__(self, connection: socket.socket) -> None:
        super().__init__(connection)
        self.text = b""

    def scripts(self, closed: bool) -> list[str]:
        """Return the programs that are complete: from ``def`` or ``sec`` to the ``end`` at the margin.

        A line outside of a program is a program of its own.
        """
        scripts = []
        lines = self.text.split(b"\n")
        rest = [] if closed else [lines.pop()]
        block: list[bytes] = []
        for line in lines:
            block.append(line)
            begun = block[0].startswith((b"def ", b"sec "))
            if not begun or line.rstrip() == b"end":
                if any(part.strip() for part in block):
                    scripts.append(b"\n".join(block).decode("utf-8", "replace"))
                block = []
        self.text = b"\n".join([*block, *rest])[-LARGEST_SCRIPT:]
        return scripts


class DashboardClient(Client):
    """A client of port 29999."""

    def __init__(self, connection: socket.socket) -> None:
        super().__init__(connection)
        self.lines = Lines()


def _listening_socket(host: str, port: int) -> socket.socket:
    try:
        door = socket.create_server((host, port))
    except OSError as error:
        why = (error.strerror or str(error)).partition(" (while")[0]
        if error.errno == errno.EADDRINUSE:
            raise UsageError(
                f"{host}:{port}: expected a free port, found: {why}; another twin may be there: give each an"
                ' address of its own by --host 127.0.0.2, or by twin = { host = "127.0.0.2" } in an'
                " experiment file"
            ) from error
        raise UsageError(
            f"{host}:{port}: expected an address of this machine, such as 127.0.0.2, found: {why}"
        ) from error
    door.setblocking(False)
    return door

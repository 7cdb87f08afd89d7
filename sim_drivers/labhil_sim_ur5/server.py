"""The controller's three ports and its clock, in one thread.

Ticks have absolute times; between ticks the thread waits for bytes. Nothing blocks: packages that a client
does not read are dropped.
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
from labhil_sim_ur5.dashboard import BANNER, Dashboard, LineSplitter
from labhil_sim_ur5.rtde import Conversation, Variables
from labhil_sim_ur5.script import parse_script

RTDE_PORT, SCRIPT_PORT, DASHBOARD_PORT = 30004, 30003, 29999
MAX_LAG = 0.5
"""Delay up to which the controller catches up, s; beyond it, simulated time pauses."""
MAX_SEND_DELAY = 0.05
"""Delay up to which a tick is sent, s; later ones are sent only ``MAX_SEND_GAP`` s after the last one."""
MAX_SEND_GAP = 0.02
MAX_SCRIPT_SIZE = 1 << 20
SEND_BUFFER = 1 << 16
"""Bytes that wait for a client in the kernel: about 50 packages."""


class Client:
    """A connection of one of the ports."""

    def __init__(self, connection: socket.socket) -> None:
        self.connection = connection
        self.dropped = 0
        self._unsent = b""

    def send(self, data: bytes) -> None:
        """Send a complete message, or drop it.

        Raises:
            ConnectionError: The client is gone.
        """
        if self._unsent:
            self._send_now(self._unsent)
        if self._unsent:
            self.dropped += 1
            return
        self._send_now(data)

    def _send_now(self, data: bytes) -> None:
        try:
            sent = self.connection.send(data)
        except BlockingIOError:
            if data is not self._unsent:
                self.dropped += 1
            return
        self._unsent = data[sent:]

    def close(self) -> None:
        """Close the connection."""
        self.connection.close()


class RtdeClient(Client):
    """A client of the RTDE port."""

    def __init__(self, connection: socket.socket, variables: Variables) -> None:
        super().__init__(connection)
        self.conversation = Conversation(variables)

    def close(self) -> None:
        """Release the inputs and close the connection."""
        self.conversation.close()
        super().close()


class Server:
    """Serves a controller at one address.

    Args:
        controller: The controller.
        dashboard: Answers of the dashboard port.
        host: An address of this machine.

    Raises:
        UsageError: A port is in use, or the address is not of this machine.
    """

    def __init__(self, controller: Controller, dashboard: Dashboard, host: str) -> None:
        self.controller = controller
        self.variables = Variables(controller.version)
        self.missed_ticks = 0
        """Ticks that were skipped because the machine was too slow."""
        self.late_ticks = 0
        """Ticks that were too late to be sent."""
        self._dashboard = dashboard
        self._clients: dict[int, Client] = {}
        self._lines: dict[int, LineSplitter] = {}
        self._scripts: dict[int, bytes] = {}
        self._listeners: dict[int, tuple[socket.socket, Callable[[socket.socket], Client]]] = {}
        try:
            for port, kind in (
                (RTDE_PORT, lambda c: RtdeClient(c, self.variables)),
                (SCRIPT_PORT, ScriptClient),
                (DASHBOARD_PORT, DashboardClient),
            ):
                listener = _listening_socket(host, port)
                self._listeners[listener.fileno()] = (listener, kind)
        except BaseException:
            self.close()
            raise

    def run(self, ending: Ending, on_line: Callable[[str], None], before_tick: Callable[[], None]) -> None:
        """Serve until ``ending`` is due.

        Args:
            ending: Signals and the end of standard input.
            on_line: Called with lines of standard input.
            before_tick: Called before every tick.
        """
        due = sent_at = time.monotonic()
        while not ending.due:
            readable = self._wait(ending, due - time.monotonic())
            self._serve(readable)
            for line in ending.hear(readable):
                on_line(line)
            now = time.monotonic()
            if now < due:
                continue
            if now - due > MAX_LAG:
                # the host was too slow: the controller's clock pauses meanwhile
                missed_ticks = int((now - due) / self.controller.period)
                self.missed_ticks += missed_ticks
                due += missed_ticks * self.controller.period
            before_tick()
            self.controller.tick()
            if now - due < MAX_SEND_DELAY or now - sent_at > MAX_SEND_GAP:
                sent_at = now
                self._send_samples()
            else:
                self.late_ticks += 1
            due += self.controller.period

    def rtde_clients(self) -> list[RtdeClient]:
        """Return all clients of the RTDE port."""
        return [client for client in self._clients.values() if isinstance(client, RtdeClient)]

    def disconnect(self, client: Client) -> None:
        """Close a connection."""
        descriptor = client.connection.fileno()
        self._clients.pop(descriptor, None)
        client.close()

    def close(self) -> None:
        """Close all connections and ports."""
        for client in list(self._clients.values()):
            self.disconnect(client)
        for listener, _ in self._listeners.values():
            listener.close()
        self._listeners.clear()

    def _wait(self, ending: Ending, timeout: float) -> list[int]:
        watched = [*self._listeners, *self._clients, *ending.watched()]
        readable, _, _ = select.select(watched, [], [], max(timeout, 0.0))
        return readable

    def _serve(self, readable: list[int]) -> None:
        for descriptor in readable:
            if descriptor in self._listeners:
                self._accept(*self._listeners[descriptor])
            elif descriptor in self._clients:
                self._read(self._clients[descriptor])

    def _accept(self, listener: socket.socket, kind: Callable[[socket.socket], Client]) -> None:
        with contextlib.suppress(BlockingIOError, ConnectionError):
            connection, _ = listener.accept()
            connection.setblocking(False)
            connection.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
            client = kind(connection)
            self._clients[connection.fileno()] = client
            if isinstance(client, DashboardClient):
                client.send(f"{BANNER}\n".encode())

    def _read(self, client: Client) -> None:
        try:
            data = client.connection.recv(65536)
        except BlockingIOError:
            return
        except OSError:
            data = b""
        if not data:
            if isinstance(client, ScriptClient):
                self._upload_scripts(client, closed=True)
            self.disconnect(client)
            return
        try:
            self._handle(client, data)
        except (FramingError, OSError) as error:
            self.controller.log(f"a client is cut off: {error}")
            self.disconnect(client)

    def _handle(self, client: Client, data: bytes) -> None:
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
                self._upload_scripts(client)
            case DashboardClient():
                for line in client.lines.split(data):
                    answer = "Disconnected" if line.strip() == "quit" else self._dashboard.answer(line)
                    client.send(f"{answer}\n".encode())

    def _upload_scripts(self, client: ScriptClient, closed: bool = False) -> None:
        for text in client.scripts(closed):
            self.controller.upload(parse_script(text))

    def _send_samples(self) -> None:
        tick = self.controller.ticks
        due = [client for client in self.rtde_clients() if client.conversation.due(tick)]
        if due:
            self.controller.publish(any(client.conversation.reads_tool for client in due))
        for client in due:
            try:
                client.send(client.conversation.sample(self.controller.values))
            except OSError:
                self.disconnect(client)


class ScriptClient(Client):
    """A client of the script port: programs in plain text."""

    def __init__(self, connection: socket.socket) -> None:
        super().__init__(connection)
        self.text = b""

    def scripts(self, closed: bool) -> list[str]:
        """Return complete programs: from ``def`` or ``sec`` to the ``end`` at the margin, or single lines.

        Args:
            closed: Whether the client has closed the connection.
        """
        scripts = []
        lines = self.text.split(b"\n")
        rest = [] if closed else [lines.pop()]
        block: list[bytes] = []
        for line in lines:
            block.append(line)
            in_block = block[0].startswith((b"def ", b"sec "))
            if not in_block or line.rstrip() == b"end":
                if any(part.strip() for part in block):
                    scripts.append(b"\n".join(block).decode("utf-8", "replace"))
                block = []
        self.text = b"\n".join([*block, *rest])[-MAX_SCRIPT_SIZE:]
        return scripts


class DashboardClient(Client):
    """A client of the dashboard port."""

    def __init__(self, connection: socket.socket) -> None:
        super().__init__(connection)
        self.lines = LineSplitter()


def _listening_socket(host: str, port: int) -> socket.socket:
    try:
        listener = socket.create_server((host, port))
    except OSError as error:
        reason = (error.strerror or str(error)).partition(" (while")[0]
        if error.errno == errno.EADDRINUSE:
            raise UsageError(
                f"{host}:{port}: expected a free port, found: {reason}; another twin may be there: give each"
                ' an address of its own by --host 127.0.0.2, or by twin = { host = "127.0.0.2" } in an'
                " experiment file"
            ) from error
        raise UsageError(
            f"{host}:{port}: expected an address of this machine, such as 127.0.0.2, found: {reason}"
        ) from error
    listener.setblocking(False)
    return listener

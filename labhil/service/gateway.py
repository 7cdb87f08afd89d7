"""The gateway of a lab: guests with certificates from other machines reach the buses of this machine.

The buses of this machine stay on the loopback. Guests connect over TLS to a session for them alone; zenoh's
access control permits each only the requests of its role (:mod:`labhil.bus.rights`), under keys that contain
its name. A permitted request is signed with the key of the bus that it is for and passed on.
"""

from __future__ import annotations

import queue
import threading
import time
from collections.abc import Callable, Mapping, Sequence
from contextlib import ExitStack, suppress
from dataclasses import dataclass
from pathlib import Path
from types import TracebackType
from typing import Any, Self

import zenoh

from labhil.bus import latch
from labhil.bus.authentication import Refusals
from labhil.bus.incoming import EstopRequest, dump, load
from labhil.bus.keys import ALL_SCHEMAS, RUN, command_key, guest_key, setpoint_key
from labhil.bus.register import Registered, reachable_buses
from labhil.bus.session import Bus, open_to_guests
from labhil.bus.subscribe import subscribe
from labhil.errors import BusError, CommandRefusedError, LabhilError
from labhil.security.authority import Authority
from labhil.security.roles import RIGHTS, SETPOINT, Role
from labhil.service.commands import reader_of
from labhil.service.emergency import EVERYTHING, Outcome, press_everywhere, release_everywhere
from labhil.service.relay import Answer, Relay
from labhil.supervised import SupervisedThread

POLL_INTERVAL = 0.5
"""How often the buses of the machine and the folder of certificates are checked, s."""
MAX_WAITING = 256
"""Requests that may wait; further ones are refused immediately."""
WORKERS = {"estop": 2, "all others": 4}
"""Threads that answer, by kind of request: many requests must not delay the emergency stop."""


def serve_guests(
    folder: Path, address: str, ended: Callable[[], bool], report: Callable[[str], None]
) -> None:
    """Serve the guests of a lab until ``ended`` returns true.

    When somebody gets a certificate or loses it, every link is closed and opened again with the new rights.

    Args:
        folder: The folder that ``labhil security init`` made.
        address: Address of this machine at which to listen.
        ended: Whether to end.
        report: Is called with each line for the operator.

    Raises:
        UsageError: The folder cannot be used.
        BusError: It is not possible to listen at ``address``.
    """
    while not ended():
        authority = Authority.load(folder)
        people = authority.valid_people()
        authority.check_server()
        with open_to_guests(authority, address) as door, Gateway(door, people, report) as gateway:
            names = ", ".join(f"{name} ({role})" for name, role in people.items()) or "nobody yet"
            report(f"open at {door.endpoint} to {names}")
            while not ended() and people == Authority.load(folder).valid_people():
                gateway.poll()
                time.sleep(POLL_INTERVAL)


@dataclass(frozen=True, slots=True)
class _Request:
    """A request of ``person`` to ``device`` (``*``: to all)."""

    person: str
    device: str
    command: str
    payload: bytes

    @property
    def by(self) -> str:
        """The name of this person in recordings and in the latch."""
        return f"{self.person} (certificate)"


class Gateway:
    """Answers guests with the answers of the buses of this machine; a context manager.

    Args:
        door: The bus of the guests.
        people: Who may connect, with their roles.
        report: Is called with refused requests.
    """

    def __init__(self, door: Bus, people: Mapping[str, Role], report: Callable[[str], None]) -> None:
        self._door, self._people = door, people
        self._relays: dict[str, Relay] = {}
        self._resources = ExitStack()
        self._refusals = Refusals(report)
        self._stopping = threading.Lock()
        self._queues: dict[str, queue.Queue[zenoh.Query | None]] = {
            name: queue.Queue(MAX_WAITING) for name in WORKERS
        }
        self._threads: list[SupervisedThread] = []

    def __enter__(self) -> Self:
        with ExitStack() as resources:
            resources.callback(self._leave_all)
            resources.callback(self._end_threads)
            for name, count in WORKERS.items():
                for number in range(count):
                    self._start_thread(self._queues[name], f"answer guests: {name} {number}")
            request_keys = [guest_key(command_key(device, "*"), "*") for device in ("*", RUN)]
            for key in (*request_keys, ALL_SCHEMAS):
                enqueue = zenoh.handlers.Callback(self._enqueue, indirect=False)
                resources.callback(self._door.session.declare_queryable(key, enqueue).undeclare)
            setpoints = guest_key(setpoint_key("*"), "*")
            resources.enter_context(subscribe(self._door, setpoints, self._command, depth=MAX_WAITING))
            self.poll()
            self._resources = resources.pop_all()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._resources.close()

    def poll(self) -> None:
        """Join new buses and leave those that are gone; BusError where guests are not heard any more."""
        if fault := self._door.failure():
            raise BusError(f"guests are not heard any more: {fault}")
        entries = {entry.endpoint: entry for entry in reachable_buses() if entry.kind != "replay"}
        for endpoint in set(self._relays) - set(entries):
            self._leave(endpoint)
        for endpoint, entry in entries.items():
            if endpoint not in self._relays:
                self._join(entry)
        for endpoint, relay in list(self._relays.items()):
            try:
                relay.poll()
            except LabhilError:
                self._leave(endpoint)

    def _join(self, entry: Registered) -> None:
        duplicates = [device for device in entry.devices if self._relay_of(device) is not None]
        if duplicates:
            message = f"a device called {duplicates[0]!r} is on another bus here already"
            self._refusals.note(entry.name, message)
            return
        with suppress(LabhilError):  # it may have ended since
            self._relays[entry.endpoint] = Relay(entry, self._door).__enter__()

    def _leave(self, endpoint: str) -> None:
        self._relays.pop(endpoint).__exit__(None, None, None)

    def _leave_all(self) -> None:
        for endpoint in list(self._relays):
            self._leave(endpoint)

    # requests of guests, in the threads of the bus

    def _enqueue(self, query: zenoh.Query) -> None:
        worker = "estop" if str(query.key_expr).endswith("/cmd/estop") else "all others"
        try:
            self._queues[worker].put_nowait(query)
        except queue.Full:
            _fail(query, "", BusError(f"{MAX_WAITING} questions are waiting here already"))
            query.drop()

    def _command(self, key: str, payloads: list[bytes]) -> None:
        _, device, _, person, _ = key.split("/")
        relay = self._relay_of(device)
        if relay is not None and SETPOINT in RIGHTS[self._people[person]]:
            relay.command(device, payloads)

    # threads of the gateway

    def _start_thread(self, waiting: queue.Queue[zenoh.Query | None], name: str) -> None:
        thread = SupervisedThread(lambda: self._work(waiting), name)
        self._threads.append(thread)
        thread.start()
        self._door.watch(thread)

    def _end_threads(self) -> None:
        for thread in self._threads:
            thread.end()
            self._door.unwatch(thread)
        for name, count in WORKERS.items():
            for _ in range(count):
                self._queues[name].put(None)
        for thread in self._threads:
            thread.join()

    def _work(self, waiting: queue.Queue[zenoh.Query | None]) -> None:
        while (query := waiting.get()) is not None:
            with suppress(zenoh.ZError), query:  # the guest may be gone
                self._answer(query)

    def _answer(self, query: zenoh.Query) -> None:
        key = str(query.key_expr)
        try:
            answers = self._answers(key, b"" if query.payload is None else query.payload.to_bytes())
        except LabhilError as error:
            if isinstance(error, CommandRefusedError):
                self._refusals.note(key, str(error))
            _fail(query, key, error)
            return
        for place, answer in answers.items():
            if isinstance(answer, LabhilError):
                _fail(query, place, answer)
            else:
                query.reply(place, dump(answer))

    def _answers(self, key: str, payload: bytes) -> Mapping[str, Answer]:
        if "/by/" not in key:
            return {
                place: answer for relay in self._all_relays() for place, answer in relay.schemas(key).items()
            }
        _, device, _, person, _, command = key.split("/")
        request = _Request(person, device, command, payload)
        role = self._people.get(person)
        if role is None or command not in RIGHTS[role]:  # access control refuses it already
            raise CommandRefusedError(f"{person!r} may not {command!r} here")
        if command == "estop":
            return _by_device(request, self._press(request))
        if command == "release":
            return _by_device(request, self._release(request, role))
        relay = self._require_relay(device, command)
        return {key: relay.ask(device, command, _with_name(request))}

    def _press(self, request: _Request) -> Outcome:
        stop = reader_of("estop")(request.payload or b"{}")
        assert isinstance(stop, EstopRequest)
        if stop.action != "press":
            raise CommandRefusedError("expected a stop; a release has a key of its own")
        with self._stopping:
            return press_everywhere(request.by, stop.reason)

    def _release(self, request: _Request, role: Role) -> Outcome:
        with self._stopping:
            standing = latch.read_latch()
            is_own = standing is not None and standing.by == request.by and not standing.others
            if role is not Role.ADMIN and not is_own:
                actual = "none" if standing is None else standing.describe()
                raise CommandRefusedError(
                    f"expected an emergency stop that nobody but {request.person!r} has pressed, since an"
                    f" {role} releases no other; found {actual}"
                )
            return release_everywhere()

    def _all_relays(self) -> Sequence[Relay]:
        return list(self._relays.values())

    def _relay_of(self, device: str) -> Relay | None:
        return next((relay for relay in self._all_relays() if relay.serves(device)), None)

    def _require_relay(self, device: str, command: str) -> Relay:
        serving = [relay for relay in self._all_relays() if relay.serves(device)]
        if device == RUN:
            runs = [relay for relay in serving if relay.entry.kind == "run"]
            serving = runs or (serving if command == "status" else [])
        if not serving:
            expected = "a run that is up" if device == RUN else f"a device {device!r}"
            raise CommandRefusedError(f"expected {expected} in this lab, found none")
        if len(serving) > 1:
            names = ", ".join(relay.entry.name for relay in serving)
            raise CommandRefusedError(f"expected one run that is up in this lab, found several: {names}")
        return serving[0]


def _with_name(request: _Request) -> dict[str, Any]:
    """Return the request with the name of the certificate instead of the name that the guest gave."""
    data = load(request.payload or b"{}", request.command)
    if request.command == "lease":
        return {**data, "holder": request.by}
    if request.command == "mark":
        return {**data, "text": f"{data.get('text', '')} ({request.person})"}
    if request.command in ("safe", "pause", "resume", "stop", "abort"):
        return {
            **data,
            "reason": f"{data.get('reason') or f'{request.command} was asked for'} (by {request.by})",
        }
    return data


def _by_device(request: _Request, outcome: Outcome) -> dict[str, Answer]:
    """Return the outcome of a stop or a release by the keys of the devices."""

    def key(device: str) -> str:
        return guest_key(command_key(device, request.command), request.person)

    silent = {device: BusError(f"{device}: no answer") for device in outcome.silent}
    failed = {device: BusError(why) for device, why in outcome.failed.items()}
    answered = {device: {"state": state} for device, state in outcome.answered.items()}
    everything: dict[str, Answer] = {**silent, **failed, **answered, EVERYTHING: {}}
    return {key(device): answer for device, answer in everything.items()}


def _fail(query: zenoh.Query, key: str, error: LabhilError) -> None:
    query.reply_err(dump({"error": type(error).__name__, "message": str(error), "key": key}))

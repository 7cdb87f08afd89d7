"""The door of a lab to other machines: guests with certificates on one side, the loopback on the other.

The buses of this machine stay on the loopback. Guests reach a session of its own over TLS; zenoh's access
control lets each say only what its role may (:mod:`labhil.bus.rights`), under keys with its own name in them.
What comes through is signed with the key of the bus it is for, and passed on.
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
from labhil.bus.keys import ALL_SCHEMAS, RUN, command_key, key_by, setpoint_key
from labhil.bus.register import Registered, reachable_buses
from labhil.bus.session import Bus, open_to_others
from labhil.bus.subscribe import subscribe
from labhil.errors import BusError, CommandRefusedError, LabhilError
from labhil.security.authority import Authority
from labhil.security.roles import RIGHTS, SETPOINT, Role
from labhil.service.commands import reader_of
from labhil.service.emergency import EVERYTHING, Outcome, press_everywhere, release_everywhere
from labhil.service.relay import Answer, Relay
from labhil.supervised import SupervisedThread

LOOK = 0.5
"""How often the machine's buses and the folder of certificates are looked at, s."""
WAITING = 256
"""Questions that may wait; further ones are refused at once."""
WORKERS = {"estop": 2, "all others": 4}
"""Threads that answer: who asks much keeps nobody from the emergency stop."""


def keep_open(folder: Path, address: str, ended: Callable[[], bool], say: Callable[[str], None]) -> None:
    """Serve the guests of a folder that ``labhil security init`` made until ``ended``.

    When somebody gets a certificate or loses it, every link is closed and comes back with the new rights.
    Raises UsageError for a folder that cannot be used, BusError where it cannot be listened at ``address``.
    """
    while not ended():
        authority = Authority.load(folder)
        people = authority.valid_people()
        authority.check_server()
        with open_to_others(authority, address) as door, Gateway(door, people, say) as gateway:
            names = ", ".join(f"{name} ({role})" for name, role in people.items()) or "nobody yet"
            say(f"open at {door.endpoint} to {names}")
            while not ended() and people == Authority.load(folder).valid_people():
                gateway.look()
                time.sleep(LOOK)


@dataclass(frozen=True, slots=True)
class _Request:
    """What ``person`` asks of ``device`` (``*``: of all)."""

    person: str
    device: str
    command: str
    payload: bytes

    @property
    def by(self) -> str:
        """How this person is called in recordings, and in the latch."""
        return f"{self.person} (certificate)"


class Gateway:
    """Answers guests on ``door`` with what the buses of this machine say; a context manager."""

    def __init__(self, door: Bus, people: Mapping[str, Role], say: Callable[[str], None]) -> None:
        self._door, self._people = door, people
        self._relays: dict[str, Relay] = {}
        self._resources = ExitStack()
        self._refusals = Refusals(say)
        self._stopping = threading.Lock()
        self._queues: dict[str, queue.Queue[zenoh.Query | None]] = {
            name: queue.Queue(WAITING) for name in WORKERS
        }
        self._threads: list[SupervisedThread] = []

    def __enter__(self) -> Self:
        with ExitStack() as resources:
            resources.callback(self._leave_all)
            resources.callback(self._end_threads)
            for name, count in WORKERS.items():
                for number in range(count):
                    self._start_thread(self._queues[name], f"answer guests: {name} {number}")
            asked = [key_by(command_key(device, "*"), "*") for device in ("*", RUN)]
            for key in (*asked, ALL_SCHEMAS):
                take = zenoh.handlers.Callback(self._take, indirect=False)
                resources.callback(self._door.session.declare_queryable(key, take).undeclare)
            setpoints = key_by(setpoint_key("*"), "*")
            resources.enter_context(subscribe(self._door, setpoints, self._command, depth=WAITING))
            self.look()
            self._resources = resources.pop_all()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._resources.close()

    def look(self) -> None:
        """Join buses that have come, leave those that are gone; BusError where guests are not heard."""
        if deaf := self._door.failure():
            raise BusError(f"guests are not heard any more: {deaf}")
        entries = {entry.endpoint: entry for entry in reachable_buses() if entry.kind != "replay"}
        for endpoint in set(self._relays) - set(entries):
            self._leave(endpoint)
        for endpoint, entry in entries.items():
            if endpoint not in self._relays:
                self._join(entry)
        for endpoint, relay in list(self._relays.items()):
            try:
                relay.look()
            except LabhilError:
                self._leave(endpoint)

    def _join(self, entry: Registered) -> None:
        taken = [device for device in entry.devices if self._relay_of(device) is not None]
        if taken:
            self._refusals.note(entry.name, f"a device called {taken[0]!r} is on another bus here already")
            return
        with suppress(LabhilError):  # it ended after it was listed
            self._relays[entry.endpoint] = Relay(entry, self._door).__enter__()

    def _leave(self, endpoint: str) -> None:
        self._relays.pop(endpoint).__exit__(None, None, None)

    def _leave_all(self) -> None:
        for endpoint in list(self._relays):
            self._leave(endpoint)

    # what guests say, in the bus's threads

    def _take(self, query: zenoh.Query) -> None:
        place = "estop" if str(query.key_expr).endswith("/cmd/estop") else "all others"
        try:
            self._queues[place].put_nowait(query)
        except queue.Full:
            _fail(query, "", BusError(f"{WAITING} questions are waiting here already"))
            query.drop()

    def _command(self, key: str, payloads: list[bytes]) -> None:
        _, device, _, person, _ = key.split("/")
        relay = self._relay_of(device)
        if relay is not None and SETPOINT in RIGHTS[self._people[person]]:
            relay.command(device, payloads)

    # threads of our own

    def _start_thread(self, waiting: queue.Queue[zenoh.Query | None], name: str) -> None:
        thread = SupervisedThread(lambda: self._work(waiting), name)
        self._threads.append(thread)
        thread.start()
        self._door.attend(thread)

    def _end_threads(self) -> None:
        for thread in self._threads:
            thread.end()
            self._door.dismiss(thread)
        for name, count in WORKERS.items():
            for _ in range(count):
                self._queues[name].put(None)
        for thread in self._threads:
            thread.join()

    def _work(self, waiting: queue.Queue[zenoh.Query | None]) -> None:
        while (query := waiting.get()) is not None:
            with suppress(zenoh.ZError), query:  # the asker may be gone
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
            return {place: said for relay in self._all_relays() for place, said in relay.schemas(key).items()}
        _, device, _, person, _, command = key.split("/")
        request = _Request(person, device, command, payload)
        role = self._people.get(person)
        if role is None or command not in RIGHTS[role]:  # access control has refused it before
            raise CommandRefusedError(f"{person!r} may not {command!r} here")
        if command == "estop":
            return _by_device(request, self._press(request))
        if command == "release":
            return _by_device(request, self._release(request, role))
        relay = self._require_relay(device, command)
        return {key: relay.ask(device, command, _with_name(request))}

    def _press(self, request: _Request) -> Outcome:
        read = reader_of("estop")(request.payload or b"{}")
        assert isinstance(read, EstopRequest)
        if read.action != "press":
            raise CommandRefusedError("expected a stop; a release has a key of its own")
        with self._stopping:
            return press_everywhere(request.by, read.reason)

    def _release(self, request: _Request, role: Role) -> Outcome:
        with self._stopping:
            standing = latch.read_latch()
            own = standing is not None and standing.by == request.by and not standing.others
            if role is not Role.ADMIN and not own:
                stands = "none" if standing is None else standing.describe()
                raise CommandRefusedError(
                    f"expected an emergency stop that nobody but {request.person!r} has pressed, since an"
                    f" {role} releases no other; found {stands}"
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
            what = "a run that is up" if device == RUN else f"a device {device!r}"
            raise CommandRefusedError(f"expected {what} in this lab, found none")
        if len(serving) > 1:
            names = ", ".join(relay.entry.name for relay in serving)
            raise CommandRefusedError(f"expected one run that is up in this lab, found several: {names}")
        return serving[0]


def _with_name(request: _Request) -> dict[str, Any]:
    """Return the request with the name of its certificate where its own would stand."""
    asked = load(request.payload or b"{}", request.command)
    if request.command == "lease":
        return {**asked, "holder": request.by}
    if request.command == "mark":
        return {**asked, "text": f"{asked.get('text', '')} ({request.person})"}
    if request.command in ("safe", "pause", "resume", "stop", "abort"):
        return {
            **asked,
            "reason": f"{asked.get('reason') or f'{request.command} was asked for'} (by {request.by})",
        }
    return asked


def _by_device(request: _Request, outcome: Outcome) -> dict[str, Answer]:
    """What came of a stop or a release, by the keys of the devices."""

    def key(device: str) -> str:
        return key_by(command_key(device, request.command), request.person)

    silent = {device: BusError(f"{device}: no answer") for device in outcome.silent}
    failed = {device: BusError(why) for device, why in outcome.failed.items()}
    answered = {device: {"state": state} for device, state in outcome.answered.items()}
    everything: dict[str, Answer] = {**silent, **failed, **answered, EVERYTHING: {}}
    return {key(device): said for device, said in everything.items()}


def _fail(query: zenoh.Query, key: str, error: LabhilError) -> None:
    query.reply_err(dump({"error": type(error).__name__, "message": str(error), "key": key}))

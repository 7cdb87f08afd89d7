"""Every bus in reach: discovered, watched, and stopped all at once."""

from __future__ import annotations

import threading
from collections.abc import Callable, Iterable
from contextlib import ExitStack
from dataclasses import dataclass
from types import TracebackType
from typing import Self

from labhil.bus.incoming import ReplayMessage
from labhil.bus.latch import Latch, read_latch
from labhil.bus.register import reachable_buses
from labhil.bus.session import open_bus
from labhil.errors import LabhilError
from labhil.service.emergency import Outcome, press_everywhere, press_on, release_everywhere
from labhil.signals import Signal
from labhil.supervised import SupervisedThread
from labhil.tui.bus_watch import MISSES_UNTIL_GONE, Announcement, BusWatch, DeviceView
from labhil.tui.stream_watch import StreamWatch

DISCOVERY_INTERVAL = 0.5
"""Time between two searches for buses, s."""
STOP_ORIGIN = "the terminal UI"

EndpointSource = Callable[[], Iterable[str]]


def registered_buses() -> list[str]:
    """Return the endpoints of the buses on this machine."""
    return [entry.endpoint for entry in reachable_buses()]


@dataclass(frozen=True, slots=True)
class SignalSource:
    """Identify a signal by the endpoint of its bus, its device and its stream."""

    endpoint: str
    device: str
    stream: str
    signal: Signal

    @property
    def key(self) -> str:
        """Unique name of the signal."""
        return f"{self.endpoint} {self.device} {self.stream} {self.signal.name}"


class Session:
    """Watch buses, as a context manager.

    Args:
        fixed: Endpoints that are always watched.
        discover: Returns the endpoints of further buses, again and again.

    Raises:
        BusError: Nobody listens at a fixed endpoint.
    """

    def __init__(self, fixed: Iterable[str] = (), discover: EndpointSource = registered_buses) -> None:
        self._fixed, self._discover = tuple(fixed), discover
        self._watches: dict[str, BusWatch] = {}
        self._missed_polls: dict[str, int] = {}
        self._stacks: dict[str, ExitStack] = {}
        self._lock = threading.Lock()
        self._stop_discovery = threading.Event()
        self._thread = SupervisedThread(self._discover_buses, "discover buses")

    def __enter__(self) -> Self:
        try:
            for endpoint in self._fixed:
                self._watch_bus(endpoint)
        except BaseException:
            self._unwatch_all()
            raise
        self._thread.start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._thread.end()
        self._stop_discovery.set()
        self._thread.join()
        self._unwatch_all()

    @property
    def watches(self) -> dict[str, BusWatch]:
        """The watched buses, by their endpoints."""
        with self._lock:
            return dict(self._watches)

    def devices(self) -> list[tuple[str, DeviceView]]:
        """Return every device in reach, with the endpoint of its bus."""
        return [(endpoint, view) for endpoint, watch in self.watches.items() for view in watch.devices()]

    def signal_sources(self) -> list[SignalSource]:
        """Return every signal in reach."""
        return [
            SignalSource(endpoint, device, stream, signal)
            for endpoint, watch in self.watches.items()
            for device, stream, signal in watch.signals()
        ]

    def stream(self, source: SignalSource) -> StreamWatch | None:
        """Return the stream of a signal; None when its bus is gone."""
        watch = self.watches.get(source.endpoint)
        return None if watch is None else watch.stream(source.device, source.stream)

    def events(self) -> list[Announcement]:
        """Return all announcements, the oldest first."""
        events = [event for watch in self.watches.values() for event in watch.events.copy()]
        return sorted(events, key=lambda event: event.t_ns)

    def replays(self) -> list[tuple[str, ReplayMessage]]:
        """Return the replays in reach, each with the endpoint of its bus."""
        return [
            (endpoint, watch.replay) for endpoint, watch in self.watches.items() if watch.replay is not None
        ]

    def control_replay(self, endpoint: str, action: str, value: float = 0.0) -> None:
        """Send a command to a replay, and wait for its answer.

        Args:
            endpoint: Endpoint of its bus.
            action: "pause", "play", "speed" or "seek".
            value: The speed, or the position in s.

        Raises:
            LabhilError: It does not answer, or refuses.
        """
        watch = self.watches.get(endpoint)
        if watch is not None:
            watch.control_replay(action, value)

    @property
    def fault(self) -> str:
        """Why the view is out of date, and the last errors in incoming messages; empty where all is well."""
        faults = [self.failure(), *(watch.fault for watch in self.watches.values())]
        return "; ".join(fault for fault in faults if fault)

    def failure(self) -> str:
        """Return why the view is out of date; empty while it is not."""
        failure_of_watch = next((why for watch in self.watches.values() if (why := watch.failure())), "")
        return self._thread.failure() or failure_of_watch

    @property
    def latch(self) -> Latch | None:
        """The emergency stop, whoever pressed it, or None. One that cannot be read counts as pressed."""
        try:
            return read_latch()
        except (LabhilError, OSError) as error:
            return Latch("nobody known", f"its state cannot be read: {error}", 0.0)

    def stop_all(self, reason: str) -> Outcome:
        """Press the emergency stop: every device on this machine and in reach, at once.

        The latch is set before any request, and works without any bus.

        Args:
            reason: Reason in every recording.

        Returns:
            The answers of the devices, and who did not answer.
        """
        outcomes = [press_everywhere(STOP_ORIGIN, reason)]
        for endpoint in self._fixed:
            watch = self.watches.get(endpoint)
            if watch is not None:
                present = [view for view in watch.devices() if view.state != "gone" and not view.is_replayed]
                try:
                    outcomes.append(press_on(watch.bus, STOP_ORIGIN, reason, [view.name for view in present]))
                except LabhilError as error:  # a lab on another machine that did not confirm it
                    outcomes.append(Outcome({}, {endpoint: str(error)}, ()))
        answered = {name: state for outcome in outcomes for name, state in outcome.answered.items()}
        failed = {name: why for outcome in outcomes for name, why in outcome.failed.items()}
        silent = {name for outcome in outcomes for name in outcome.silent} - answered.keys()
        return Outcome(answered, failed, tuple(sorted(silent)))

    def release(self) -> None:
        """Release the emergency stop everywhere; nothing moves by that."""
        release_everywhere()
        for endpoint in self._fixed:
            release_everywhere(endpoint)

    # the thread of discovery

    def _discover_buses(self) -> None:
        while not self._stop_discovery.wait(DISCOVERY_INTERVAL):
            try:
                endpoints = set(self._discover())
            except (LabhilError, OSError):
                endpoints = set(self.watches)  # the register cannot be read now: keep those
            for endpoint in endpoints - set(self.watches):
                try:
                    self._watch_bus(endpoint)
                except LabhilError:
                    continue  # it ended after it was listed
            for endpoint in set(self.watches) - endpoints - set(self._fixed):
                self._unwatch_if_empty(endpoint)

    def _watch_bus(self, endpoint: str) -> None:
        with ExitStack() as stack:
            watch = BusWatch(stack.enter_context(open_bus(endpoint)))
            stack.enter_context(watch)
            with self._lock:
                self._watches[endpoint], self._missed_polls[endpoint] = watch, 0
                self._stacks[endpoint] = stack.pop_all()

    def _unwatch_if_empty(self, endpoint: str) -> None:
        self._missed_polls[endpoint] += 1
        if self._missed_polls[endpoint] >= MISSES_UNTIL_GONE and not self.watches[endpoint].alive:
            self._unwatch_bus(endpoint)

    def _unwatch_bus(self, endpoint: str) -> None:
        with self._lock:
            self._watches.pop(endpoint, None)
            stack = self._stacks.pop(endpoint)
        stack.close()

    def _unwatch_all(self) -> None:
        for endpoint in list(self._stacks):
            self._unwatch_bus(endpoint)

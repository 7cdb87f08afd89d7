"""Lossless subscriptions: a thread that empties its channel as fast as it can."""

from __future__ import annotations

import threading
from collections.abc import Callable
from contextlib import suppress
from types import TracebackType
from typing import Self

import zenoh

from labhil.bus.authentication import MAX_SAMPLE_AGE, MAX_TRANSIT, Refusals
from labhil.bus.keys import ARRIVED
from labhil.bus.session import Bus
from labhil.supervised import SupervisedThread

CHANNEL_DEPTH = 65536

"""Messages that may wait for the thread."""

OnSamples = Callable[[str, list[bytes]], None]
"""Receives a key and the payloads that arrived under it, oldest first."""


class Subscription:
    """A subscription with its thread; ``close`` delivers what has already arrived, and ends both.

    ``error`` is the exception of the callback, if it raised one; the subscription then delivers no more but
    still empties its channel, so that publishers are not blocked. See :func:`subscribe` for the arguments.
    """

    def __init__(
        self,
        bus: Bus,
        key: str,
        on_samples: OnSamples,
        refusals: Refusals | None = None,
        depth: int = CHANNEL_DEPTH,
        *,
        commands: bool = False,
        gather: float = 0.0,
    ) -> None:
        self.error: Exception | None = None
        self._gather, self._ending = gather, threading.Event()
        self._bus, self._key, self._closed = bus, key, False
        self._refusals = refusals
        self._verifier = bus.verifier() if commands else bus.verifier(MAX_SAMPLE_AGE, MAX_TRANSIT)
        self._on_samples = on_samples
        self._subscriber = bus.session.declare_subscriber(key, zenoh.handlers.FifoChannel(depth))
        # answered where samples are received, so never before one that was sent earlier
        answer: zenoh.handlers.Callback[zenoh.Query] = zenoh.handlers.Callback(
            lambda query: query.reply(ARRIVED, b""), indirect=False
        )
        self._arrived = bus.session.declare_queryable(ARRIVED, answer)
        # undeclaring is refused while a thread waits in the subscriber itself, not in its handler
        self._handler = self._subscriber.handler
        self._thread = SupervisedThread(self._run, f"subscribe {key}")
        self._thread.start()
        bus.watch(self)

    def failure(self) -> str:
        """Return why nothing is delivered any more although it is open; empty while it is."""
        if self.error is not None:
            return f"{self._key}: what came in could not be dealt with: {self.error!r}"
        return self._thread.failure()

    def close(self) -> None:
        """End the subscription; safe to call twice, but not from the callback."""
        if self._closed:
            return
        self._closed = True
        self._ending.set()
        self._thread.end()
        self._bus.unwatch(self)
        # also where the thread has died: a full channel would block all who send to this process
        with suppress(zenoh.ZError):  # the session may have been closed before
            self._arrived.undeclare()
            self._subscriber.undeclare()
        self._thread.join()

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def _run(self) -> None:
        while True:
            try:
                sample: zenoh.Sample | None = self._handler.recv()
            except zenoh.ZError:
                return  # undeclared, and empty
            if self._gather:
                self._ending.wait(self._gather)
            arrived: dict[str, list[bytes]] = {}
            while sample is not None:
                self._admit(sample, arrived)
                try:
                    sample = self._handler.try_recv()
                except zenoh.ZError:
                    break
            self._deliver(arrived)

    def _admit(self, sample: zenoh.Sample, arrived: dict[str, list[bytes]]) -> None:
        key, attached, objection = str(sample.key_expr), sample.attachment, ""
        if self._refusals is not None and attached is None:
            objection = self._verifier.objection(key, b"", None)
        else:
            # a waiting sample pins kilobytes until its bytes are copied out
            payload = sample.payload.to_bytes()
            if self._refusals is not None and attached is not None:
                objection = self._verifier.objection(key, payload, attached.to_bytes())
            if not objection:
                arrived.setdefault(key, []).append(payload)
        if objection and self._refusals is not None:
            self._refusals.note(key, objection)

    def _deliver(self, arrived: dict[str, list[bytes]]) -> None:
        for key, payloads in arrived.items():
            if self.error is not None:
                return
            try:
                self._on_samples(key, payloads)
            except Exception as error:  # noqa: BLE001 - kept for the owner of the subscription
                self.error = error


def subscribe(
    bus: Bus,
    key: str,
    on_samples: OnSamples,
    refusals: Refusals | None = None,
    depth: int = CHANNEL_DEPTH,
    *,
    commands: bool = False,
    gather: float = 0.0,
) -> Subscription:
    """Call a function in a thread of its own with everything that is published under a key.

    Args:
        bus: The bus.
        key: The key expression.
        on_samples: Is called with each key and its payloads.
        refusals: Where given, only messages that are signed with the session's key are delivered, and the
            others are counted here.
        depth: Messages that may wait. Behind more their senders wait, too: a flood delays the others by as
            many messages at most.
        commands: Whether they are commands, which may be 10 s old; other messages may be 120 s old.
        gather: Messages within this time after the first are delivered together with it, s: a subscriber
            that need not answer at once is woken less often.
    """
    return Subscription(bus, key, on_samples, refusals, depth, commands=commands, gather=gather)

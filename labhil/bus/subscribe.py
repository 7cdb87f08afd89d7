"""Subscribing without losing: one thread that drains a channel as fast as it can."""

from __future__ import annotations

import threading
from collections.abc import Callable
from contextlib import suppress
from types import TracebackType
from typing import Self

import zenoh

from labhil.bus.authentication import OLDEST_SAMPLE, TRANSIT, Refusals
from labhil.bus.keys import ARRIVED
from labhil.bus.session import Bus
from labhil.supervised import SupervisedThread

CHANNEL_DEPTH = 65536

OnSamples = Callable[[str, list[bytes]], None]
"""Receives a key and the payloads that came in under it, oldest first."""


class Subscription:
    """A subscription with its thread; ``close`` delivers what has already come in, and ends both.

    ``error`` holds what the callback raised, if it did; the subscription has then stopped delivering
    (it goes on draining, so that publishers are not held up). With ``refusals`` only what is signed with the
    session's key is delivered, and the rest is counted there.
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
        self._verifier = bus.verifier() if commands else bus.verifier(OLDEST_SAMPLE, TRANSIT)
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
        bus.attend(self)

    def failure(self) -> str:
        """Return why nothing is delivered any more, though nobody closed it; empty while all is well."""
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
        self._bus.dismiss(self)
        # also where the thread has died: what nobody takes would hold up everybody who sends to this process
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
                return  # undeclared, and nothing left
            if self._gather:
                self._ending.wait(self._gather)
            arrived: dict[str, list[bytes]] = {}
            while sample is not None:
                self._sort_in(sample, arrived)
                try:
                    sample = self._handler.try_recv()
                except zenoh.ZError:
                    break
            self._deliver(arrived)

    def _sort_in(self, sample: zenoh.Sample, arrived: dict[str, list[bytes]]) -> None:
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
            except Exception as error:  # noqa: BLE001 - kept for whoever owns the subscription
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
    """Call ``on_samples`` in a thread of its own with everything published under ``key``.

    With ``refusals`` only with what is signed with the session's key, of the last 10 s where it ``commands``
    and of the last 120 s where it does not. Where more messages than ``depth`` wait, their senders wait, too:
    who floods a key delays all others there by as many messages at most.

    What comes within ``gather`` s after a message is delivered together with it: who need not answer at once
    is woken a few times a second, not once per sample.
    """
    return Subscription(bus, key, on_samples, refusals, depth, commands=commands, gather=gather)

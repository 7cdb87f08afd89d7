"""Message authentication: each message carries a code that needs the session's key.

The key never travels on the bus. It is in a file that only this user can read (:mod:`labhil.bus.register`),
so the operating system decides who has it. The attachment of a message has sender, number and time, then one
code (keyed BLAKE2b) for each key that the sender holds, over these, the key expression and the payload.
Loopback only: the time is the machine's monotonic clock, which no step of the wall clock changes.
"""

from __future__ import annotations

import contextlib
import itertools
import secrets
import struct
import threading
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from hashlib import blake2b

from labhil.errors import LabhilError

KEY_BYTES = 32
CODE_BYTES = 16
"""128 bits cannot be guessed within a session, and lengthen a setpoint by only 41 bytes."""

HEAD = struct.Struct(">B8sQQ")
VERSION = 1
MAX_KEYS = 16
"""Codes in one message at most: as many buses as one user runs at a time."""

MAX_AGE = 10.0
"""How old a message may be, s: longer than any request waits for its answer."""

MAX_SAMPLE_AGE = 120.0
"""How old a published message may be, s: a recorder that was frozen for a minute still accepts it."""

MAX_TRANSIT = 1.0
"""How long before a subscription a sample may have been sent, s."""

REPLAY_WINDOW = 64
"""How far below the highest number a message may be: threads of one process may overtake each other."""


def new_key() -> bytes:
    """Generate the key of a session."""
    return secrets.token_bytes(KEY_BYTES)


class Signer:
    """Signs messages with one or more keys; safe from any thread."""

    def __init__(self, keys: Sequence[bytes]) -> None:
        self._keys = tuple(keys)[:MAX_KEYS]
        self._sender = secrets.token_bytes(8)
        self._numbers = itertools.count(1)

    def sign(self, key_expression: str, payload: bytes) -> bytes:
        """Return the attachment of a message."""
        head = HEAD.pack(VERSION, self._sender, next(self._numbers), time.monotonic_ns())
        return head + b"".join(_code(key, head, key_expression, payload) for key in self._keys)


@dataclass(slots=True)
class _Seen:
    """Numbers that came from one sender: the highest, and a bit for each of the ``REPLAY_WINDOW`` below."""

    highest: int = 0
    below: int = 0
    at_ns: int = 0

    def is_new(self, number: int) -> bool:
        back = self.highest - number
        return back < 0 or (0 < back <= REPLAY_WINDOW and not self.below >> (back - 1) & 1)

    def take(self, number: int) -> None:
        forward = number - self.highest
        if forward > 0:
            shifted = (self.below << 1 | 1) << (forward - 1) if self.highest else 0
            self.below, self.highest = shifted & ((1 << REPLAY_WINDOW) - 1), number
        else:
            self.below |= 1 << (-forward - 1)


class Verifier:
    """Checks the messages of one queryable or subscription; used by one thread.

    Args:
        keys: The keys that are accepted.
        max_age: How old a message may be, s.
        transit: How long before this object a message may have been sent, s: samples are already on their way
            when a subscription begins.
    """

    def __init__(self, keys: Sequence[bytes], max_age: float = MAX_AGE, transit: float = 0.0) -> None:
        self._keys = tuple(keys)
        self._oldest = max_age
        self._began_ns = time.monotonic_ns() - round(transit * 1e9)
        self._seen: dict[bytes, _Seen] = {}

    def objection(self, key_expression: str, payload: bytes, attachment: bytes | None) -> str:
        """Return why a message is refused; empty where it is new and from a holder of the key."""
        if not attachment:
            return "not authenticated: it has no code of this session's key"
        codes, odd = divmod(len(attachment) - HEAD.size, CODE_BYTES)
        if odd or not 0 < codes <= MAX_KEYS or attachment[0] != VERSION:
            return "not authenticated: its code is malformed"
        head = attachment[: HEAD.size]
        if not self._is_authentic(head, key_expression, payload, attachment[HEAD.size :]):
            return "not authenticated: its code was not made with this session's key"
        _, sender, number, t_ns = HEAD.unpack(head)
        now = time.monotonic_ns()
        # a message from before this object existed can only be a copy
        if t_ns < self._began_ns or not -self._oldest * 1e9 < now - t_ns < self._oldest * 1e9:
            return "replayed: its code was made at another time"
        seen = self._seen.get(sender) or _Seen()
        if not seen.is_new(number):
            return "replayed: a message of this number came before"
        seen.take(number)
        seen.at_ns = now
        if sender not in self._seen:
            self._forget_old_senders(now)
            self._seen[sender] = seen
        return ""

    def _is_authentic(self, head: bytes, key_expression: str, payload: bytes, codes: bytes) -> bool:
        received = [codes[start : start + CODE_BYTES] for start in range(0, len(codes), CODE_BYTES)]
        accepted = [_code(key, head, key_expression, payload) for key in self._keys]
        return any(secrets.compare_digest(code, expected) for code in received for expected in accepted)

    def _forget_old_senders(self, now: int) -> None:
        """Forget senders whose messages would all be refused as too old."""
        self._seen = {s: seen for s, seen in self._seen.items() if now - seen.at_ns < 2e9 * self._oldest}


class Refusals:
    """Counts refused messages, and reports them at a limited rate; safe from any thread.

    Args:
        report: Is called with each report.
        interval: Shortest time between two reports about the same place, s.
    """

    def __init__(self, report: Callable[[str], object] | None = None, interval: float = 1.0) -> None:
        self.counts: dict[str, int] = {}
        self._report = report
        self._interval = interval
        self._lock = threading.Lock()
        self._reported: dict[str, tuple[float, int]] = {}

    @property
    def total(self) -> int:
        """Number of refused messages."""
        return sum(self.counts.values())

    def note(self, place: str, reason: str) -> None:
        """Count a refusal at ``place`` and report it, unless one there was reported a moment ago."""
        now = time.monotonic()
        with self._lock:
            self.counts[place] = count = self.counts.get(place, 0) + 1
            reported_at, reported_count = self._reported.get(place, (float("-inf"), 0))
            if now - reported_at < self._interval:
                return
            self._reported[place] = (now, count)
        if self._report is not None:
            further = (
                f" ({count - reported_count} since the last report, {count} in all)" if count > 1 else ""
            )
            # a failure of the bus is detected elsewhere (`Bus.failure`)
            with contextlib.suppress(LabhilError):
                self._report(f"refused at {place}: {reason}{further}")


def _code(key: bytes, head: bytes, key_expression: str, payload: bytes) -> bytes:
    where = key_expression.encode("utf-8", "replace")
    code = blake2b(head, key=key, digest_size=CODE_BYTES, person=b"labhil command")
    code.update(struct.pack(">I", len(where)))
    code.update(where)
    code.update(payload)
    return code.digest()

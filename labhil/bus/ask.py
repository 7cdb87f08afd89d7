"""Questions and answers over the bus: JSON both ways, and errors that reach the asker."""

from __future__ import annotations

import json
import time
from collections.abc import Callable, Mapping
from contextlib import suppress
from types import TracebackType
from typing import Any, Self

import zenoh

from labhil.bus.authentication import OLDEST, Refusals
from labhil.bus.incoming import LARGEST, ErrorReply, dump, load, parse
from labhil.bus.session import Bus
from labhil.errors import BusError, CommandRefusedError
from labhil.supervised import SupervisedThread

Handler = Callable[[Any], Mapping[str, Any]]
"""Takes a request and returns the answer; what it raises goes back as an error."""

Reader = Callable[[bytes], Any]
"""Reads a question; CommandRefusedError where it is none."""

LONGEST = 4000
"""Characters of an error's message that are sent."""

LARGEST_ANSWER = 2 * 1024 * 1024
"""Bytes: a schema has the descriptor of its stream in it."""


def _any_object(payload: bytes) -> dict[str, Any]:
    return load(payload, "a question")


class Answering:
    """A key whose questions are answered, one after another, by a thread of its own.

    ``reader`` turns a payload into what the handler gets. A question for which ``guarded`` is true has to be
    signed with the session's key, no longer ago than ``oldest`` s. What is refused before the handler sees it
    is counted in ``refusals``.
    """

    def __init__(
        self,
        bus: Bus,
        key: str,
        handler: Handler,
        *,
        reader: Reader = _any_object,
        guarded: Callable[[Any], bool] = lambda _: False,
        refusals: Refusals | None = None,
        oldest: float = OLDEST,
    ) -> None:
        self._bus, self._key, self._closed = bus, key, False
        self._handler, self._reader, self._guarded = handler, reader, guarded
        self._refusals = refusals or Refusals()
        self._verifier = bus.verifier(oldest)
        self._queryable = bus.session.declare_queryable(key, zenoh.handlers.FifoChannel(256), complete=True)
        self._queries = self._queryable.handler
        self._thread = SupervisedThread(self._run, f"serve {key}")
        self._thread.start()
        bus.attend(self)

    def failure(self) -> str:
        """Return why nobody is answered any more, though nobody closed it; empty while all is well."""
        return self._thread.failure()

    def close(self) -> None:
        """Stop answering; safe to call twice, but not from the handler."""
        if self._closed:
            return
        self._closed = True
        self._thread.end()
        self._bus.dismiss(self)
        with suppress(zenoh.ZError):  # the session may have been closed before
            self._queryable.undeclare()
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
                query = self._queries.recv()
            except zenoh.ZError:
                return  # undeclared
            # the asker may be gone, or its answer cannot be sent: the next query is answered all the same
            with suppress(zenoh.ZError), query:
                self._answer(query)

    def _answer(self, query: zenoh.Query) -> None:
        try:
            answer = dump(self._handler(self._admit(query)))
        except Exception as error:  # noqa: BLE001 - a handler that raises must not leave the caller waiting
            failure = {"error": type(error).__name__, "message": str(error)[:LONGEST], "key": self._key}
            query.reply_err(dump(failure))
        else:
            query.reply(self._key, answer)

    def _admit(self, query: zenoh.Query) -> Any:
        """Return the request; CommandRefusedError where it is malformed or lacks its signature."""
        try:
            payload = _payload(query)
            request = self._reader(payload)
            if self._guarded(request):
                self._refuse_unsigned(query, payload)
        except CommandRefusedError as error:
            self._refusals.note(self._key, str(error))
            raise
        return request

    def _refuse_unsigned(self, query: zenoh.Query, payload: bytes) -> None:
        attached = query.attachment
        code = None if attached is None else attached.to_bytes()
        objection = self._verifier.objection(str(query.key_expr), payload, code)
        if objection:
            raise CommandRefusedError(objection)


def _payload(query: zenoh.Query) -> bytes:
    payload = query.payload
    if payload is None or len(payload) == 0:
        return b"{}"
    if len(payload) > LARGEST:
        raise CommandRefusedError(f"a question has at most {LARGEST} bytes, this one {len(payload)}")
    return payload.to_bytes()


def serve(
    bus: Bus,
    key: str,
    handler: Handler,
    *,
    reader: Reader = _any_object,
    guarded: Callable[[Any], bool] = lambda _: False,
    refusals: Refusals | None = None,
    oldest: float = OLDEST,
) -> Answering:
    """Answer questions at ``key`` with ``handler`` until the result is closed; see :class:`Answering`."""
    return Answering(bus, key, handler, reader=reader, guarded=guarded, refusals=refusals, oldest=oldest)


def ask(
    bus: Bus,
    key: str,
    payload: Mapping[str, Any] | None = None,
    timeout: float = 2.0,
    *,
    patience: float = 0.0,
) -> dict[str, Any]:
    """Ask at ``key`` and return the answer, waiting up to ``timeout`` s.

    Where somebody is known to live there, ``patience`` (s) is how long the bus may take to find them: on
    a busy machine that is seconds. CommandRefusedError when it was refused; BusError when nobody
    answers or the answer is an error.
    """
    question = _question(payload)
    answer = _ask_once(bus, key, question, timeout)
    give_up = time.monotonic() + patience
    while answer is None and (bus.settling or time.monotonic() < give_up):
        time.sleep(0.02)
        answer = _ask_once(bus, key, question, timeout)
    if answer is None:
        raise bus.unanswered(key)
    return answer


def ask_all(
    bus: Bus, key: str, payload: Mapping[str, Any] | None = None, timeout: float = 2.0
) -> dict[str, dict[str, Any] | BusError | CommandRefusedError]:
    """Ask everybody whose key matches ``key``, at once; each one's answer, or error, by its own key.

    Who has not answered within ``timeout`` s, or is not known yet, is simply not there.
    """
    answers: dict[str, dict[str, Any] | BusError | CommandRefusedError] = {}
    question, key = _question(payload), _asked_at(bus, key)
    try:
        replies = bus.session.get(
            key,
            payload=question,
            attachment=bus.sign(key, question),
            timeout=timeout,
            target=zenoh.QueryTarget.ALL,
        )
        for reply in replies:
            if reply.ok is not None:
                place = str(reply.ok.key_expr)
                try:
                    answers[place] = load(reply.ok.payload.to_bytes(), place, LARGEST_ANSWER)
                except CommandRefusedError as error:
                    answers[place] = BusError(f"the answer is none: {error}")
            elif reply.err is not None:
                error_payload = reply.err.payload.to_bytes()
                answers[_key_in(error_payload)] = _error(key, error_payload, timeout)
    except zenoh.ZError as failure:
        raise BusError(f"{key}: could not be asked: {failure}") from failure
    answers.pop("", None)
    return answers


def _question(payload: Mapping[str, Any] | None) -> bytes:
    # unchecked, NaN and all: the receiver says what is wrong with it
    return json.dumps(dict(payload or {}), ensure_ascii=False).encode("utf-8", "replace")


def _ask_once(bus: Bus, key: str, question: bytes, timeout: float) -> dict[str, Any] | None:
    """Return the answer, or None when no peer that is known answers at ``key``."""
    key = _asked_at(bus, key)
    try:
        replies = bus.session.get(
            key,
            payload=question,
            attachment=bus.sign(key, question),
            timeout=timeout,
            target=zenoh.QueryTarget.BEST_MATCHING,
        )
        for reply in replies:
            if reply.ok is not None:
                return _answer_in(key, reply.ok.payload.to_bytes())
            if reply.err is not None:
                raise _error(key, reply.err.payload.to_bytes(), timeout)
    except zenoh.ZError as error:
        raise BusError(f"{key}: could not be asked: {error}") from error
    return None


def _asked_at(bus: Bus, key: str) -> str:
    """Return where a question is asked; what a stream is, guests ask where everybody does."""
    return bus.place(key) if "/cmd/" in key else key


def _answer_in(key: str, payload: bytes) -> dict[str, Any]:
    try:
        return load(payload, key, LARGEST_ANSWER)
    except CommandRefusedError as error:
        raise BusError(f"the answer is none: {error}") from error


def _key_in(payload: bytes) -> str:
    """Which key an error came from; empty when it does not say."""
    try:
        return parse(ErrorReply, payload, "an error").key
    except CommandRefusedError:
        return ""


def _error(key: str, payload: bytes, timeout: float) -> BusError | CommandRefusedError:
    try:
        reply = parse(ErrorReply, payload, "an error")
        kind, message = reply.error, reply.message
    except CommandRefusedError:
        text = payload[:200].decode("utf-8", "replace")
        return BusError(f"{key}: no answer within {timeout:g} s ({text})")
    if kind == CommandRefusedError.__name__:
        return CommandRefusedError(message)
    return BusError(f"{key}: {kind}: {message}")

"""Requests and answers over the bus: JSON both ways, with errors that reach the sender."""

from __future__ import annotations

import json
import time
from collections.abc import Callable, Mapping
from contextlib import suppress
from types import TracebackType
from typing import Any, Self

import zenoh

from labhil.bus.authentication import MAX_AGE, Refusals
from labhil.bus.incoming import MAX_BYTES, ErrorReply, dump, load, parse
from labhil.bus.session import Bus
from labhil.errors import BusError, CommandRefusedError
from labhil.supervised import SupervisedThread

Handler = Callable[[Any], Mapping[str, Any]]
"""Takes a request and returns the answer; its exception goes back as an error."""

Reader = Callable[[bytes], Any]
"""Reads a request; CommandRefusedError where it is malformed."""

MAX_MESSAGE_LENGTH = 4000
"""Characters of an error message that are sent."""

MAX_ANSWER_BYTES = 2 * 1024 * 1024
"""Bytes of an answer; a schema contains the descriptor of its stream."""


def _any_object(payload: bytes) -> dict[str, Any]:
    return load(payload, "a question")


class Responder:
    """Answers the requests at a key, one after another, in a thread of its own.

    Args:
        bus: The bus.
        key: The key.
        handler: Returns the answer to a request.
        reader: Reads the payload of a request.
        guarded: Whether a request has to be signed with the session's key.
        refusals: Counts requests that are refused before the handler gets them.
        max_age: How old a signature may be, s.
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
        max_age: float = MAX_AGE,
    ) -> None:
        self._bus, self._key, self._closed = bus, key, False
        self._handler, self._reader, self._guarded = handler, reader, guarded
        self._refusals = refusals or Refusals()
        self._verifier = bus.verifier(max_age)
        self._queryable = bus.session.declare_queryable(key, zenoh.handlers.FifoChannel(256), complete=True)
        self._queries = self._queryable.handler
        self._thread = SupervisedThread(self._run, f"serve {key}")
        self._thread.start()
        bus.watch(self)

    def failure(self) -> str:
        """Return why requests are not answered any more although it is open; empty while they are."""
        return self._thread.failure()

    def close(self) -> None:
        """Stop answering; safe to call twice, but not from the handler."""
        if self._closed:
            return
        self._closed = True
        self._thread.end()
        self._bus.unwatch(self)
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
            # the sender may be gone, or its answer cannot be sent: the next request is answered all the same
            with suppress(zenoh.ZError), query:
                self._answer(query)

    def _answer(self, query: zenoh.Query) -> None:
        try:
            answer = dump(self._handler(self._admit(query)))
        except Exception as error:  # noqa: BLE001 - a handler that raises must not leave the caller waiting
            message = str(error)[:MAX_MESSAGE_LENGTH]
            query.reply_err(dump({"error": type(error).__name__, "message": message, "key": self._key}))
        else:
            query.reply(self._key, answer)

    def _admit(self, query: zenoh.Query) -> Any:
        """Return the request; CommandRefusedError where it is malformed or lacks its signature."""
        try:
            payload = _payload(query)
            request = self._reader(payload)
            if self._guarded(request):
                self._check_signature(query, payload)
        except CommandRefusedError as error:
            self._refusals.note(self._key, str(error))
            raise
        return request

    def _check_signature(self, query: zenoh.Query, payload: bytes) -> None:
        attached = query.attachment
        code = None if attached is None else attached.to_bytes()
        objection = self._verifier.objection(str(query.key_expr), payload, code)
        if objection:
            raise CommandRefusedError(objection)


def _payload(query: zenoh.Query) -> bytes:
    payload = query.payload
    if payload is None or len(payload) == 0:
        return b"{}"
    if len(payload) > MAX_BYTES:
        raise CommandRefusedError(f"a request has at most {MAX_BYTES} bytes, this one {len(payload)}")
    return payload.to_bytes()


def serve(
    bus: Bus,
    key: str,
    handler: Handler,
    *,
    reader: Reader = _any_object,
    guarded: Callable[[Any], bool] = lambda _: False,
    refusals: Refusals | None = None,
    max_age: float = MAX_AGE,
) -> Responder:
    """Answer requests at ``key`` with ``handler`` until the result is closed; see :class:`Responder`."""
    return Responder(bus, key, handler, reader=reader, guarded=guarded, refusals=refusals, max_age=max_age)


def ask(
    bus: Bus,
    key: str,
    payload: Mapping[str, Any] | None = None,
    timeout: float = 2.0,
    *,
    patience: float = 0.0,
) -> dict[str, Any]:
    """Send a request and return the answer.

    Args:
        bus: The bus.
        key: Where the request goes.
        payload: The request, JSON data.
        timeout: Longest wait for the answer, s.
        patience: How long the bus may take to find a receiver that is known to exist, s; seconds on a busy
            machine.

    Raises:
        CommandRefusedError: The request was refused.
        BusError: Nobody answers, or the answer is another error.
    """
    question = _encode_request(payload)
    answer = _ask_once(bus, key, question, timeout)
    give_up = time.monotonic() + patience
    while answer is None and (bus.is_settling or time.monotonic() < give_up):
        time.sleep(0.02)
        answer = _ask_once(bus, key, question, timeout)
    if answer is None:
        raise bus.unanswered_error(key)
    return answer


def ask_all(
    bus: Bus, key: str, payload: Mapping[str, Any] | None = None, timeout: float = 2.0
) -> dict[str, dict[str, Any] | BusError | CommandRefusedError]:
    """Send a request to all receivers whose keys match ``key``.

    Args:
        bus: The bus.
        key: The key expression.
        payload: The request, JSON data.
        timeout: Longest wait for the answers, s.

    Returns:
        The answer or the error of each receiver, by its key; those without an answer are missing.

    Raises:
        BusError: The request cannot be sent.
    """
    answers: dict[str, dict[str, Any] | BusError | CommandRefusedError] = {}
    question, key = _encode_request(payload), _request_key(bus, key)
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
                    answers[place] = load(reply.ok.payload.to_bytes(), place, MAX_ANSWER_BYTES)
                except CommandRefusedError as error:
                    answers[place] = BusError(f"the answer is none: {error}")
            elif reply.err is not None:
                error_payload = reply.err.payload.to_bytes()
                answers[_error_key(error_payload)] = _error(key, error_payload, timeout)
    except zenoh.ZError as failure:
        raise BusError(f"{key}: could not be asked: {failure}") from failure
    answers.pop("", None)
    return answers


def _encode_request(payload: Mapping[str, Any] | None) -> bytes:
    # unchecked, even for NaN: the receiver reports what is wrong
    return json.dumps(dict(payload or {}), ensure_ascii=False).encode("utf-8", "replace")


def _ask_once(bus: Bus, key: str, question: bytes, timeout: float) -> dict[str, Any] | None:
    """Return the answer, or None where no known peer answers at ``key``."""
    key = _request_key(bus, key)
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
                return _read_answer(key, reply.ok.payload.to_bytes())
            if reply.err is not None:
                raise _error(key, reply.err.payload.to_bytes(), timeout)
    except zenoh.ZError as error:
        raise BusError(f"{key}: could not be asked: {error}") from error
    return None


def _request_key(bus: Bus, key: str) -> str:
    """Return the key of a request; guests request schemas at the same key as everybody."""
    return bus.place(key) if "/cmd/" in key else key


def _read_answer(key: str, payload: bytes) -> dict[str, Any]:
    try:
        return load(payload, key, MAX_ANSWER_BYTES)
    except CommandRefusedError as error:
        raise BusError(f"the answer is none: {error}") from error


def _error_key(payload: bytes) -> str:
    """Return the key that an error came from; empty where it does not state one."""
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

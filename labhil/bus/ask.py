"""Questions and answers over the bus: JSON both ways, and errors that reach the one who asked."""

from __future__ import annotations

import json
import threading
import time
from collections.abc import Callable, Mapping
from types import TracebackType
from typing import Any, Self

import zenoh

from labhil.bus.session import Bus
from labhil.documents import parse_json
from labhil.errors import BusError, CommandRefusedError

Handler = Callable[[dict[str, Any]], Mapping[str, Any]]
"""Receives what was asked and returns the answer; what it raises goes back as an error."""


class Answering:
    """A key whose questions are answered, one after another, by a thread of its own."""

    def __init__(self, bus: Bus, key: str, handler: Handler) -> None:
        self._key = key
        self._handler = handler
        self._queryable = bus.session.declare_queryable(key, zenoh.handlers.FifoChannel(256), complete=True)
        self._queries = self._queryable.handler
        self._thread = threading.Thread(target=self._run, name=f"serve {key}")
        self._thread.start()

    def close(self) -> None:
        """Stop answering; safe to call twice, but not from the handler."""
        if self._thread.is_alive():
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
            with query:
                self._answer(query)

    def _answer(self, query: zenoh.Query) -> None:
        try:
            payload = query.payload.to_bytes() if query.payload is not None else b"{}"
            answer = json.dumps(dict(self._handler(parse_json(payload))))
        except Exception as error:  # noqa: BLE001 - a handler that raises must not leave the caller waiting
            told = {"error": type(error).__name__, "message": str(error), "key": self._key}
            query.reply_err(json.dumps(told))
        else:
            query.reply(self._key, answer)


def serve(bus: Bus, key: str, handler: Handler) -> Answering:
    """Answer questions at ``key`` with ``handler`` until the result is closed."""
    return Answering(bus, key, handler)


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
    question = json.dumps(dict(payload or {}))
    answer = _ask_once(bus, key, question, timeout)
    give_up = time.monotonic() + patience
    while answer is None and (bus.settling or time.monotonic() < give_up):
        time.sleep(0.02)
        answer = _ask_once(bus, key, question, timeout)
    if answer is None:
        raise BusError(f"{key}: nobody answers there")
    return answer


def ask_all(
    bus: Bus, key: str, payload: Mapping[str, Any] | None = None, timeout: float = 2.0
) -> dict[str, dict[str, Any] | BusError | CommandRefusedError]:
    """Ask everybody whose key matches ``key``, at once; each one's answer, or error, by its own key.

    Who has not answered within ``timeout`` s, or is not known yet, is simply not there.
    """
    answers: dict[str, dict[str, Any] | BusError | CommandRefusedError] = {}
    question = json.dumps(dict(payload or {}))
    try:
        replies = bus.session.get(key, payload=question, timeout=timeout, target=zenoh.QueryTarget.ALL)
        for reply in replies:
            if reply.ok is not None:
                answers[str(reply.ok.key_expr)] = dict(parse_json(reply.ok.payload.to_bytes()))
            elif reply.err is not None:
                found = reply.err.payload.to_bytes()
                answers[_key_in(found)] = _error(key, found, timeout)
    except zenoh.ZError as failure:
        raise BusError(f"{key}: could not be asked: {failure}") from failure
    answers.pop("", None)
    return answers


def _ask_once(bus: Bus, key: str, question: str, timeout: float) -> dict[str, Any] | None:
    """Return the answer, or None when no peer that is known answers at ``key``."""
    try:
        replies = bus.session.get(
            key, payload=question, timeout=timeout, target=zenoh.QueryTarget.BEST_MATCHING
        )
        for reply in replies:
            if reply.ok is not None:
                return dict(parse_json(reply.ok.payload.to_bytes()))
            if reply.err is not None:
                raise _error(key, reply.err.payload.to_bytes(), timeout)
    except zenoh.ZError as error:
        raise BusError(f"{key}: could not be asked: {error}") from error
    return None


def _key_in(payload: bytes) -> str:
    """Which key an error came from; empty when it does not say."""
    try:
        return str(parse_json(payload)["key"])
    except (ValueError, KeyError, TypeError):
        return ""


def _error(key: str, payload: bytes, timeout: float) -> BusError | CommandRefusedError:
    try:
        found: dict[str, str] = parse_json(payload)
        kind, message = found["error"], found["message"]
    except (ValueError, KeyError, TypeError):
        text = payload.decode("utf-8", "replace")
        return BusError(f"{key}: no answer within {timeout:g} s ({text})")
    if kind == CommandRefusedError.__name__:
        return CommandRefusedError(message)
    return BusError(f"{key}: {kind}: {message}")

"""The queue of requests and setpoints from the threads of the bus to the control thread of a device."""

from __future__ import annotations

import queue
from collections.abc import Iterator
from concurrent.futures import Future
from dataclasses import dataclass
from typing import Any

from labhil.errors import BusError, LabhilError

ANSWER_TIMEOUT = 1.0
"""How long a command waits for the control thread, s."""


@dataclass(slots=True)
class Request:
    """A request for the control thread; without ``answer`` the sender does not wait for one."""

    name: str
    payload: Any
    answer: Future[dict[str, Any]] | None = None

    def succeed(self, answer: dict[str, Any]) -> None:
        """Answer a sender that waits."""
        if self.answer is not None:
            self.answer.set_result(answer)

    def fail(self, error: LabhilError) -> None:
        """Let a sender that waits raise this error."""
        if self.answer is not None:
            self.answer.set_exception(error)


class Inbox:
    """Requests to a device: added by the threads of the bus, taken by its control thread."""

    def __init__(self, device: str) -> None:
        self._device = device
        self._requests: queue.Queue[Request] = queue.Queue()

    def put_setpoints(self, _key: str, payloads: list[bytes]) -> None:
        """Add streamed setpoints, which get no answer."""
        for payload in payloads:
            self._requests.put(Request("setpoint", payload))

    def ask(self, name: str, payload: Any) -> dict[str, Any]:
        """Add a request, wait for its answer and return it; BusError after ``ANSWER_TIMEOUT`` s."""
        answer: Future[dict[str, Any]] = Future()
        self._requests.put(Request(name, payload, answer))
        try:
            return answer.result(ANSWER_TIMEOUT)
        except TimeoutError:
            raise BusError(
                f"the host of {self._device!r} did not answer within {ANSWER_TIMEOUT:g} s"
            ) from None

    def take(self, patience: float) -> Iterator[Request]:
        """Yield the waiting requests; where there are none, wait up to ``patience`` s for the first."""
        while True:
            try:
                request = (
                    self._requests.get(timeout=patience) if patience > 0 else self._requests.get_nowait()
                )
            except queue.Empty:
                return
            patience = 0.0
            yield request

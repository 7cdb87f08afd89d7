"""Control of a run from other processes: requests over the bus, answered by the process of the run."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from contextlib import ExitStack, contextmanager
from functools import partial
from typing import Any, TypeVar

from labhil.bus.ask import serve
from labhil.bus.authentication import Refusals
from labhil.bus.incoming import AnyRequest, Incoming, MarkRequest, RunRequest, parse
from labhil.bus.keys import RUN, command_key
from labhil.bus.session import Bus
from labhil.errors import CommandRefusedError
from labhil.experiment.control import RunControl, RunState

MAX_REASON_LENGTH = 200
"""Characters of a reason that are kept."""

Form = TypeVar("Form", bound=Incoming)
Describe = Callable[[], Mapping[str, Any]]


@contextmanager
def offer_control(
    bus: Bus,
    control: RunControl,
    describe: Describe,
    refusals: Refusals | None = None,
    *,
    answer_after: float = 1.5,
) -> Iterator[None]:
    """Answer on ``lab/@run/cmd/{status,pause,resume,stop,abort,mark}`` as long as the context lasts.

    ``pause``, ``stop`` and ``abort`` take a ``reason``, ``mark`` a ``text``. The answer is
    ``{"state", "reason", …}``. Requests that the state does not allow, or that the run refuses, are answered
    as refused, and so is every request but ``status`` that is not signed with the session's key.

    Args:
        bus: The bus of the run.
        control: The handle of the run.
        describe: Returns what is added to each answer.
        refusals: Counts messages that are not authentic.
        answer_after: How long an answer waits at most for the run to carry out the request, s.
    """
    endings = (RunState.STOPPING, RunState.ABORTING, RunState.FINISHED, RunState.FAILED)
    requests: dict[str, tuple[Callable[[str], None], tuple[RunState, ...]]] = {
        "pause": (control.pause, (RunState.PAUSED, *endings)),
        "resume": (lambda _reason: control.resume(), (RunState.RUNNING, *endings)),
        "stop": (control.stop, endings),
        "abort": (control.abort, endings),
    }

    def status() -> dict[str, Any]:
        return {"state": control.state.value, "reason": control.reason, **describe()}

    def handler(name: str) -> Callable[[RunRequest], dict[str, Any]]:
        request, awaited = requests[name]

        def handle(message: RunRequest) -> dict[str, Any]:
            request((message.reason or f"{name} was requested over the bus")[:MAX_REASON_LENGTH])
            control.wait_for(*awaited, timeout=answer_after)
            if control.refusal:
                raise CommandRefusedError(control.refusal)
            return status()

        return handle

    def mark(message: MarkRequest) -> dict[str, Any]:
        control.mark(message.text)
        return status()

    refusals = refusals or Refusals()
    with ExitStack() as stack:
        offer_status(bus, status, stack)
        for name in requests:
            _offer(bus, name, RunRequest, handler(name), refusals, stack)
        _offer(bus, "mark", MarkRequest, mark, refusals, stack)
        yield


def _offer(
    bus: Bus,
    name: str,
    form: type[Form],
    handle: Callable[[Form], dict[str, Any]],
    refusals: Refusals,
    stack: ExitStack,
) -> None:
    """Answer signed requests on ``lab/@run/cmd/<name>`` until ``stack`` is closed."""
    reader = partial(parse, form, what=name)
    key = command_key(RUN, name)
    stack.enter_context(
        serve(bus, key, handle, reader=reader, guarded=lambda _request: True, refusals=refusals)
    )


def offer_status(bus: Bus, status: Callable[[], Mapping[str, Any]], stack: ExitStack) -> None:
    """Answer everybody on ``lab/@run/cmd/status`` until ``stack`` is closed."""
    reader = partial(parse, AnyRequest, what="status")
    stack.enter_context(serve(bus, command_key(RUN, "status"), lambda _request: status(), reader=reader))

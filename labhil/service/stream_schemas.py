"""The schemas of the streams of a bus: from the declarations of their publishers, or by asking them."""

from __future__ import annotations

import time

from labhil.bus.ask import ask
from labhil.bus.authentication import Refusals
from labhil.bus.incoming import MAX_SCHEMA_BYTES, SchemaMessage, parse, validate
from labhil.bus.keys import ALL_SCHEMAS, schema_key, split_key
from labhil.bus.session import Bus
from labhil.bus.subscribe import subscribe
from labhil.service.recorded import RecordedStream

MAX_STREAMS = 1000
"""Streams of one bus at most."""
SCHEMA_TIMEOUT = 1.0
"""How long a publisher may take to answer, s."""
SCHEMA_INTERVAL = 0.25
"""Time between two requests for a schema that nobody answers, s."""


class StreamSchemas:
    """The schemas of all streams of a bus; receives declarations from its construction on.

    Args:
        bus: The bus.
        refusals: Counts messages that are not authentic.
    """

    def __init__(self, bus: Bus, refusals: Refusals) -> None:
        self._bus = bus
        self._declarations: dict[tuple[str, str], bytes] = {}
        self._subscription = subscribe(bus, ALL_SCHEMAS, self._receive, refusals)

    def schema_of(self, channel: RecordedStream) -> SchemaMessage | None:
        """Return the schema of a stream; None where its publisher was asked less than an interval ago.

        Raises:
            CommandRefusedError: The schema is malformed.
            BusError: Nobody answers.
        """
        # each declaration is read once: after a malformed one the publisher itself is asked
        declaration = self._declarations.pop((channel.device, channel.stream), None)
        if declaration is not None:
            return parse(SchemaMessage, declaration, "a schema", MAX_SCHEMA_BYTES)
        if time.monotonic() < channel.asked_at + SCHEMA_INTERVAL:
            return None
        channel.asked_at = time.monotonic()
        key = schema_key(channel.device, channel.stream)
        return validate(SchemaMessage, ask(self._bus, key, timeout=SCHEMA_TIMEOUT), "a schema")

    def failure(self) -> str:
        """Return why declarations are not received any more; empty while they are."""
        return self._subscription.failure()

    def close(self) -> None:
        """End the subscription; safe to call twice."""
        self._subscription.close()

    def _receive(self, key: str, payloads: list[bytes]) -> None:
        stream = split_key(key)
        if stream in self._declarations or len(self._declarations) < MAX_STREAMS:
            self._declarations[stream] = payloads[-1]

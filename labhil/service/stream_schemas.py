"""What the streams of a bus are: as their publishers declared them, else as they answer when asked."""

from __future__ import annotations

import time

from labhil.bus.ask import ask
from labhil.bus.authentication import Refusals
from labhil.bus.incoming import LARGEST_SCHEMA, SchemaMessage, parse, validate
from labhil.bus.keys import ALL_SCHEMAS, schema_key, split_key
from labhil.bus.session import Bus
from labhil.bus.subscribe import subscribe
from labhil.service.recorded import RecordedStream

MOST_STREAMS = 1000
SCHEMA_TIMEOUT = 1.0
SCHEMA_INTERVAL = 0.25
"""s between two questions for a schema that nobody answered."""


class StreamSchemas:
    """The schemas of all streams of a bus; listens to their declarations from the moment it is made."""

    def __init__(self, bus: Bus, refusals: Refusals) -> None:
        self._bus = bus
        self._declarations: dict[tuple[str, str], bytes] = {}
        self._subscription = subscribe(bus, ALL_SCHEMAS, self._receive, refusals)

    def schema_of(self, channel: RecordedStream) -> SchemaMessage | None:
        """Return the schema of a stream; None where its publisher was asked for it a moment ago.

        Raises CommandRefusedError for one that is malformed, and what :func:`labhil.bus.ask.ask` raises.
        """
        # each declaration is read once: one that is wrong leaves the question to the publisher itself
        declaration = self._declarations.pop((channel.device, channel.stream), None)
        if declaration is not None:
            return parse(SchemaMessage, declaration, "a schema", LARGEST_SCHEMA)
        if time.monotonic() < channel.asked_at + SCHEMA_INTERVAL:
            return None
        channel.asked_at = time.monotonic()
        key = schema_key(channel.device, channel.stream)
        return validate(SchemaMessage, ask(self._bus, key, timeout=SCHEMA_TIMEOUT), "a schema")

    def failure(self) -> str:
        """Return why declarations are heard no more; empty while all is well."""
        return self._subscription.failure()

    def close(self) -> None:
        """End the subscription; safe to call twice."""
        self._subscription.close()

    def _receive(self, key: str, payloads: list[bytes]) -> None:
        place = split_key(key)
        if place in self._declarations or len(self._declarations) < MOST_STREAMS:
            self._declarations[place] = payloads[-1]

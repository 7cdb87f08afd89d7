"""Where the streams of a bus end: what their publishers say when they leave, else whether they still live."""

from __future__ import annotations

from collections.abc import Iterable

from labhil.bus.ask import ask, serve
from labhil.bus.authentication import OLDEST_SAMPLE, Refusals
from labhil.bus.incoming import PublishedRequest, parse
from labhil.bus.keys import PUBLISHED, schema_key
from labhil.bus.session import Bus
from labhil.errors import BusError, CommandRefusedError
from labhil.service.recorded import RecordedStream
from labhil.service.stream_schemas import MOST_STREAMS, SCHEMA_TIMEOUT


class StreamEnds:
    """How many samples each publisher that left had published; answers from the moment it is made.

    The question comes by the same way as the samples, so all that were sent before it are here by then.
    """

    def __init__(self, bus: Bus, refusals: Refusals) -> None:
        self._bus = bus
        self._stated: dict[tuple[str, str], int] = {}
        self._answering = serve(
            bus,
            PUBLISHED,
            self._note,
            reader=lambda payload: parse(PublishedRequest, payload, "the end of a stream"),
            guarded=lambda _: True,
            refusals=refusals,
            oldest=OLDEST_SAMPLE,
        )

    def count_missing(self, channels: Iterable[RecordedStream]) -> tuple[str, ...]:
        """Count in each stream what its publisher sent after the last sample that came; a sentence for each.

        A publisher that is still there states nothing: all that it published before it answers is here then.
        """
        warnings = []
        for channel in channels:
            place = (channel.device, channel.stream)
            stated = self._stated.get(place)
            if stated is not None:
                channel.take_end(stated)
            name = f"{channel.device}/{channel.stream}"
            if channel.missing_at_end:
                warnings.append(f"{name}: the last {channel.missing_at_end} samples were published, but lost")
            elif channel.end_unknown:
                warnings.append(
                    f"{name}: its publisher is gone and did not say how many samples it published: "
                    "the last ones may be missing"
                )
        return tuple(warnings)

    def look_for_publishers(self, channels: Iterable[RecordedStream]) -> None:
        """Note which publishers are gone and stated no end; what others published so far is here then."""
        for channel in channels:
            if (channel.device, channel.stream) in self._stated:
                continue
            try:
                ask(self._bus, schema_key(channel.device, channel.stream), timeout=SCHEMA_TIMEOUT)
            except (BusError, CommandRefusedError):
                channel.end_unknown = channel.number is not None

    def failure(self) -> str:
        """Return why nobody is answered any more; empty while all is well."""
        return self._answering.failure()

    def close(self) -> None:
        """Answer no more; safe to call twice."""
        self._answering.close()

    def _note(self, request: PublishedRequest) -> dict[str, bool]:
        place = (request.device, request.stream)
        if place in self._stated or len(self._stated) < MOST_STREAMS:
            self._stated[place] = request.last_seq
        return {"received": True}

"""The ends of the streams of a bus: the statements of publishers that leave, and whether the others live."""

from __future__ import annotations

from collections.abc import Iterable

from labhil.bus.ask import ask, serve
from labhil.bus.authentication import MAX_SAMPLE_AGE, Refusals
from labhil.bus.incoming import PublishedRequest, parse
from labhil.bus.keys import PUBLISHED, schema_key
from labhil.bus.session import Bus
from labhil.errors import BusError, CommandRefusedError
from labhil.service.recorded import RecordedStream
from labhil.service.stream_schemas import MAX_STREAMS, SCHEMA_TIMEOUT


class StreamEnds:
    """Receives from each publisher that leaves how many samples it published.

    The statement travels as the samples do, so all samples that were sent before it have arrived by then.

    Args:
        bus: The bus.
        refusals: Counts messages that are not authentic.
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
            max_age=MAX_SAMPLE_AGE,
        )

    def count_missing(self, channels: Iterable[RecordedStream]) -> tuple[str, ...]:
        """Count the samples that each publisher sent after the last one that came; return warnings.

        A publisher that is still there makes no statement: :meth:`check_publishers` has asked it.
        """
        warnings = []
        for channel in channels:
            last_seq = self._stated.get((channel.device, channel.stream))
            if last_seq is not None:
                channel.note_last_seq(last_seq)
            name = f"{channel.device}/{channel.stream}"
            if channel.missing_at_end:
                warnings.append(f"{name}: the last {channel.missing_at_end} samples were published, but lost")
            elif channel.end_unknown:
                warnings.append(
                    f"{name}: its publisher is gone and did not say how many samples it published: "
                    "the last ones may be missing"
                )
        return tuple(warnings)

    def check_publishers(self, channels: Iterable[RecordedStream]) -> None:
        """Note which publishers are gone without a statement; the samples of the others have arrived then."""
        for channel in channels:
            if (channel.device, channel.stream) in self._stated:
                continue
            try:
                ask(self._bus, schema_key(channel.device, channel.stream), timeout=SCHEMA_TIMEOUT)
            except (BusError, CommandRefusedError):
                channel.end_unknown = channel.number is not None

    def failure(self) -> str:
        """Return why statements are not received any more; empty while they are."""
        return self._answering.failure()

    def close(self) -> None:
        """Stop receiving; safe to call twice."""
        self._answering.close()

    def _note(self, request: PublishedRequest) -> dict[str, bool]:
        stream = (request.device, request.stream)
        if stream in self._stated or len(self._stated) < MAX_STREAMS:
            self._stated[stream] = request.last_seq
        return {"received": True}

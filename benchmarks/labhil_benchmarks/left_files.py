"""What a killed recorder, or a power failure, left in a file, held against what was published.

A power failure keeps what was forced to the disk. Of what was written after that nothing is certain: here it
is cut off, or each of its pages is kept or is zeros, by chance.
"""

from __future__ import annotations

import random
from collections.abc import Iterator, Mapping
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from mcap.reader import make_reader

from labhil.codec import stamps_of
from labhil.errors import LabhilError
from labhil.recording.recover import recover

PAGE = 4096

Log = Mapping[str, Mapping[int, bytes]]
"""What was published: payloads by their number, by topic (``/device/stream``)."""


@dataclass(frozen=True, slots=True)
class LeftFile:
    """What one file gave back, over all streams.

    ``wrong`` counts samples that nobody published so; ``unheard`` those from before the log began or after
    its end (a killed publisher has reached one subscriber and not yet another), or of streams that it does
    not hold; ``holes`` those that are missing between the first and the last that were
    saved. ``lost`` (s) is the time between the last sample saved and the last one published before the kill,
    of the stream where it is longest; None where no sample was published.
    """

    variant: str
    saved: int
    wrong: int
    unheard: int
    holes: int
    lost: float | None
    fault: str = ""

    def to_json(self) -> dict[str, Any]:
        """Return it as plain JSON data."""
        return asdict(self)


def variants(data: bytes, synced: int, chance: random.Random) -> Iterator[tuple[str, bytes]]:
    """Yield a file as a kill left it, and as a power failure may have left it.

    Args:
        data: The bytes of the file.
        synced: How many of them were forced to the disk.
        chance: What decides over the pages behind them.
    """
    yield "killed", data
    yield "power lost: cut", data[:synced]
    pages = [data[start : start + PAGE] for start in range(synced, len(data), PAGE)]
    kept = [page if chance.random() < 0.5 else bytes(len(page)) for page in pages]
    yield "power lost: pages", data[:synced] + b"".join(kept)


def examine(variant: str, data: bytes, log: Log, begun_ns: int, killed_ns: int, folder: Path) -> LeftFile:
    """Recover a file and hold every sample against the log.

    Args:
        variant: What was done to it.
        data: The bytes of the file.
        log: What was published.
        begun_ns: From when on samples were to be kept, Unix time.
        killed_ns: When its recorder was killed.
        folder: Where files may be made; they are taken away again.
    """
    broken, out = folder / "left.mcap.part", folder / "saved.mcap"
    broken.write_bytes(data)
    saved: dict[str, dict[int, bytes]] = {}
    fault = ""
    try:
        recover(broken, out)
        saved = _messages(out)
    except LabhilError as error:
        fault = str(error).replace(str(folder), "")
    finally:
        broken.unlink()
        out.unlink(missing_ok=True)
    wrong = unheard = holes = 0
    for topic, samples in saved.items():
        published = log.get(topic, {})
        first, last = min(published, default=1 << 63), max(published, default=0)
        heard = {number: payload for number, payload in samples.items() if first <= number <= last}
        wrong += sum(published.get(number) != payload for number, payload in heard.items())
        unheard += len(samples) - len(heard)
        holes += max(samples) - min(samples) + 1 - len(samples)
    lost = [_lost(saved.get(topic, {}), samples, begun_ns, killed_ns) for topic, samples in log.items()]
    longest = max((time for time in lost if time is not None), default=None)
    return LeftFile(variant, sum(map(len, saved.values())), wrong, unheard, holes, longest, fault)


def _messages(path: Path) -> dict[str, dict[int, bytes]]:
    """The samples of a recording by mcap's own reader, by topic and number."""
    by_topic: dict[str, list[bytes]] = {}
    with path.open("rb") as file:
        for _, channel, message in make_reader(file).iter_messages():
            if "labhil.stream" in channel.metadata:
                by_topic.setdefault(channel.topic, []).append(message.data)
    numbers = {topic: stamps_of(payloads)[:, 0].tolist() for topic, payloads in by_topic.items()}
    return {topic: dict(zip(numbers[topic], by_topic[topic], strict=True)) for topic in by_topic}


def _lost(
    saved: Mapping[int, bytes], published: Mapping[int, bytes], begun_ns: int, killed_ns: int
) -> float | None:
    wanted = [time for time in _times(published) if begun_ns <= time <= killed_ns]
    if not wanted:
        return None
    last = max(_times(saved), default=min(wanted))
    return max(0.0, (max(wanted) - last) * 1e-9)


def _times(samples: Mapping[int, bytes]) -> list[int]:
    """When the host stamped samples, Unix time in ns."""
    return [int(time) for time in stamps_of(list(samples.values()))[:, 1]] if samples else []

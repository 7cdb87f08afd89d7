"""All keys of the bus.

Wildcards do not match a chunk that begins with ``@``, so ``lab/*/*`` matches only data and events.
"""

from __future__ import annotations

LAB, REPLAY = "lab", "replay"
"""The namespaces of devices and of replayed recordings; neither sees messages of the other."""

ALL_STREAMS = "lab/*/*"
"""Every stream and every event of every device, which a recorder subscribes to."""

ALL_SCHEMAS = "lab/*/@schema/*"
"""Where each publisher declares its stream before the first sample, and later answers requests for it."""

ALL_LIVE = "lab/*/@live"
"""The liveliness tokens of all devices."""

REPLAYED_STREAMS, REPLAYED_SCHEMAS = "replay/*/*", "replay/*/@schema/*"
"""The same for replayed recordings; no recorder and no host subscribes to them."""

REPLAY_CONTROL = "replay/@control"
"""Where a replay answers with its state, and takes requests to pause, play, change its speed or seek."""

ARRIVED = "lab/@arrived"
"""Where every subscription answers; the answer comes after all messages that were sent before the request."""

PUBLISHED = "lab/@published"
"""Where a publisher that leaves states how many samples it published; recorders answer as above."""

RUN = "@run"
"""The place of the device's name in the keys of requests to the run itself."""

WORKER_PROGRESS, WORKER_RESULT = "lab/@worker/progress", "lab/@worker/result"
"""Where the analysis process of a lab publishes its progress and its results, as JSON."""

EVENT = "event"
SETPOINT = "setpoint"


def stream_key(device: str, stream: str, namespace: str = LAB) -> str:
    """Return the key under which the samples of a stream are published, one message each."""
    return f"{namespace}/{device}/{stream}"


def schema_key(device: str, stream: str, namespace: str = LAB) -> str:
    """Return the key of the schema of a stream."""
    return f"{namespace}/{device}/@schema/{stream}"


def live_key(device: str) -> str:
    """Return the key of the liveliness token of the device's host."""
    return f"lab/{device}/@live"


def command_key(device: str, name: str) -> str:
    """Return the key of the command ``name`` (a query that is answered)."""
    return f"lab/{device}/cmd/{name}"


def setpoint_key(device: str) -> str:
    """Return the key of streamed setpoints (a put that is not answered)."""
    return f"lab/{device}/{SETPOINT}"


def event_key(device: str, namespace: str = LAB) -> str:
    """Return the key under which a device's events are published, as JSON."""
    return f"{namespace}/{device}/{EVENT}"


def guest_key(key: str, person: str) -> str:
    """Return the key that ``person`` on another machine uses in place of ``key``."""
    namespace, device, rest = key.split("/", 2)
    return f"{namespace}/{device}/by/{person}/{rest}"


def split_key(key: str) -> tuple[str, str]:
    """Return the device and the stream of the key of a stream or a schema, live or replayed."""
    parts = key.split("/")
    return parts[1], parts[-1]

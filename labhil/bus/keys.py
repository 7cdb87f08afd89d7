"""The keys of the bus, all in one place.

A chunk that begins with ``@`` is not matched by wildcards, so ``lab/*/*`` sees data and events only.
"""

from __future__ import annotations

LAB, REPLAY = "lab", "replay"
"""The namespaces of devices and of replayed recordings: who listens to the one hears nothing of the other."""

ALL_STREAMS = "lab/*/*"
"""What a recorder subscribes: every stream and every event of every device."""

ALL_SCHEMAS = "lab/*/@schema/*"
"""Where each publisher says what its stream is, before the first sample; later it answers there."""

ALL_LIVE = "lab/*/@live"
"""The liveliness tokens of all devices."""

REPLAYED_STREAMS, REPLAYED_SCHEMAS = "replay/*/*", "replay/*/@schema/*"
"""The same of recordings that are replayed; no recorder and no host listens there."""

REPLAY_CONTROL = "replay/@control"
"""Where a replay says how far it is, and takes requests to pause, play, change its speed or seek."""

ARRIVED = "lab/@arrived"
"""Where every subscription answers; the answer comes after all that was sent to it before the question."""

PUBLISHED = "lab/@published"
"""Where a publisher that leaves says how many samples it published; each recorder answers as above."""

RUN = "@run"
"""Stands where a device's name does, for requests to the run itself."""

WORKER_PROGRESS, WORKER_RESULT = "lab/@worker/progress", "lab/@worker/result"
"""Where a lab's worker says what it is doing, and what came of it, as JSON."""

EVENT = "event"
SETPOINT = "setpoint"


def stream_key(device: str, stream: str, namespace: str = LAB) -> str:
    """Where the samples of a stream are published, one message each."""
    return f"{namespace}/{device}/{stream}"


def schema_key(device: str, stream: str, namespace: str = LAB) -> str:
    """Where the declaration of a stream is queried."""
    return f"{namespace}/{device}/@schema/{stream}"


def live_key(device: str) -> str:
    """The token that stands as long as the device's host lives."""
    return f"lab/{device}/@live"


def command_key(device: str, name: str) -> str:
    """Where the command ``name`` is sent (a query that is answered)."""
    return f"lab/{device}/cmd/{name}"


def setpoint_key(device: str) -> str:
    """Where setpoints are streamed to (a put that is not answered)."""
    return f"lab/{device}/{SETPOINT}"


def event_key(device: str, namespace: str = LAB) -> str:
    """Where a device's events are published, as JSON."""
    return f"{namespace}/{device}/{EVENT}"


def guest_key(key: str, person: str) -> str:
    """Return where ``person`` on another machine says what is said at ``key`` on this one."""
    namespace, device, said = key.split("/", 2)
    return f"{namespace}/{device}/by/{person}/{said}"


def split_key(key: str) -> tuple[str, str]:
    """Return device and stream of a key of a stream or of a schema, of a device or of a replay."""
    parts = key.split("/")
    return parts[1], parts[-1]

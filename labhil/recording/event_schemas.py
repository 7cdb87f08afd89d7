"""What the JSON of events holds, as JSON Schema: other programs offer the fields that it names.

A point in time is ``{"sec", "nsec"}``, as Foxglove and the programs that follow it expect it.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from typing import Any

NS = 1_000_000_000

_TIMESTAMP = {
    "type": "object",
    "title": "time",
    "description": "Unix time of the host",
    "properties": {
        "sec": {"type": "integer", "minimum": 0},
        "nsec": {"type": "integer", "minimum": 0, "maximum": NS - 1},
    },
    "required": ["sec", "nsec"],
}

EVENT = {
    "timestamp": _TIMESTAMP,
    "t_ns": {"type": "integer", "description": "Unix time of the host, ns"},
    "kind": {"type": "string", "description": "what happened: leased, active, safe, mark, limit, …"},
    "state": {"type": "string", "description": "the state of the device or of the run after it"},
    "message": {"type": "string", "description": "the same in a sentence"},
    "text": {"type": "string", "description": "a note without a kind"},
    "reason": {"type": "string", "description": "why, where somebody gave a reason"},
}

STATUS = {
    "timestamp": _TIMESTAMP,
    "streams": {
        "type": "object",
        "description": "by topic",
        "additionalProperties": {
            "type": "object",
            "properties": {
                "received": {"type": "integer", "description": "samples so far"},
                "gaps": {"type": "integer", "description": "numbers missing in the sequence so far"},
                "refused": {"type": "integer", "description": "messages that were no samples"},
                "waiting": {"type": "integer", "description": "samples that nobody has explained yet"},
                "lag": {"type": ["number", "null"], "description": "s since the newest sample"},
            },
        },
    },
    "queued": {"type": "integer", "description": "batches that wait to be written"},
}


def schema_of(topic: str) -> bytes:
    """The JSON Schema of the events of a topic; of one that is not known, that of any event."""
    properties = STATUS if topic == "status" else EVENT
    schema = {
        "$schema": "https://json-schema.org/draft/2020-12/schema",
        "title": f"labhil.{topic}",
        "type": "object",
        "properties": properties,
        "required": ["timestamp"],
    }
    return json.dumps(schema, ensure_ascii=False).encode()


def with_timestamp(body: Mapping[str, Any], t_ns: int) -> dict[str, Any]:
    """Return an event with its time; a ``timestamp`` that it has already stays."""
    return {"timestamp": _time(t_ns), **body}


def without_timestamp(body: Mapping[str, Any], t_ns: int) -> dict[str, Any]:
    """Return an event without the time that :func:`with_timestamp` gave it: as it was published."""
    added = body.get("timestamp") == _time(t_ns)
    return {name: value for name, value in body.items() if not (added and name == "timestamp")}


def _time(t_ns: int) -> dict[str, int]:
    return {"sec": t_ns // NS, "nsec": t_ns % NS}

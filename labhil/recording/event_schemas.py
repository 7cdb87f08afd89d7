"""JSON Schema of events, from which other programs know their fields.

A time is ``{"sec", "nsec"}``, as Foxglove and compatible programs expect it.
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
                "waiting": {"type": "integer", "description": "samples that wait for their schema"},
                "lag": {"type": ["number", "null"], "description": "s since the newest sample"},
            },
        },
    },
    "queued": {"type": "integer", "description": "batches that wait to be written"},
}


def schema_of(topic: str) -> bytes:
    """JSON Schema of the events of a topic; of any event for an unknown topic."""
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
    """Add the time to an event; an existing ``timestamp`` stays."""
    return {"timestamp": _timestamp(t_ns), **body}


def without_timestamp(body: Mapping[str, Any], t_ns: int) -> dict[str, Any]:
    """Remove the time of :func:`with_timestamp` from an event."""
    added = body.get("timestamp") == _timestamp(t_ns)
    return {name: value for name, value in body.items() if not (added and name == "timestamp")}


def _timestamp(t_ns: int) -> dict[str, int]:
    return {"sec": t_ns // NS, "nsec": t_ns % NS}

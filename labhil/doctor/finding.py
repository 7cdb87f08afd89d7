"""Findings of the checks: subject, state, and advice."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass
from enum import StrEnum
from typing import Any


class State(StrEnum):
    """The state of what was checked."""

    FINE = "fine"
    NOTE = "note"
    """Works, but there is something to know, or an extra is not installed."""
    BROKEN = "broken"
    """Something does not work."""


@dataclass(frozen=True, slots=True)
class Finding:
    """The result of a check: its ``subject``, its state, what was ``found``, and ``advice`` if any."""

    subject: str
    state: State
    found: str
    advice: str = ""

    def to_json(self) -> dict[str, Any]:
        """Return the finding as JSON data."""
        return {
            "subject": self.subject,
            "state": self.state.value,
            "found": self.found,
            "advice": self.advice,
        }


Check = Callable[[], Iterable[Finding]]


def fine(subject: str, found: str) -> Finding:
    """Return a finding that needs no action."""
    return Finding(subject, State.FINE, found)


def note(subject: str, found: str, advice: str = "") -> Finding:
    """Return a finding that a person should know, though everything works."""
    return Finding(subject, State.NOTE, found, advice)


def broken(subject: str, found: str, advice: str) -> Finding:
    """Return a finding of something that does not work until it is repaired."""
    return Finding(subject, State.BROKEN, found, advice)

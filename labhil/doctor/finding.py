"""What was looked at, how it stands, and what to do."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass
from enum import StrEnum
from typing import Any


class State(StrEnum):
    """How something stands."""

    FINE = "fine"
    NOTE = "note"
    """Works; something is worth knowing, or an extra is not installed."""
    BROKEN = "broken"
    """Something will not work."""


@dataclass(frozen=True, slots=True)
class Finding:
    """One check: what it ``found``, in words, ``advice`` where there is something to do."""

    subject: str
    state: State
    found: str
    advice: str = ""

    def to_json(self) -> dict[str, Any]:
        """Return it as plain JSON data."""
        return {
            "subject": self.subject,
            "state": self.state.value,
            "found": self.found,
            "advice": self.advice,
        }


Check = Callable[[], Iterable[Finding]]


def fine(subject: str, found: str) -> Finding:
    """Nothing to do."""
    return Finding(subject, State.FINE, found)


def note(subject: str, found: str, advice: str = "") -> Finding:
    """It works, but a person should know."""
    return Finding(subject, State.NOTE, found, advice)


def broken(subject: str, found: str, advice: str) -> Finding:
    """It will not work until somebody does something."""
    return Finding(subject, State.BROKEN, found, advice)

"""The lease on a device: one holder at a time may command it, and has to renew the lease."""

from __future__ import annotations

import secrets

from labhil.errors import CommandRefusedError

DURATION = 2.0
"""How long a lease lasts after its last renewal, s."""


class Lease:
    """A lease on one device. Times are s on the host's monotonic clock."""

    def __init__(self) -> None:
        self.holder: str | None = None
        self._token = ""
        self._expires = 0.0

    def take(self, holder: str, now: float) -> str:
        """Give the lease to ``holder`` and return its token; CommandRefusedError while it is held."""
        if self.is_held(now):
            remaining = self._expires - now
            raise CommandRefusedError(
                f"the device is held by {self.holder!r} for another {remaining:.1f} s at most"
            )
        self.holder, self._token, self._expires = holder, secrets.token_hex(8), now + DURATION
        return self._token

    def remaining(self, now: float) -> float:
        """Return how long the lease lasts without a renewal, s; 0 where nobody holds it."""
        return max(self._expires - now, 0.0) if self.holder is not None else 0.0

    def is_held(self, now: float) -> bool:
        """Return whether somebody holds the lease."""
        return self.holder is not None and now < self._expires

    def renew(self, token: str, now: float) -> None:
        """Extend the lease; CommandRefusedError where it has run out or ``token`` is not its token."""
        if not self.is_held(now):
            raise CommandRefusedError("nobody holds the lease: it was never taken, ran out, or was revoked")
        if objection := self.objection(token, now):
            raise CommandRefusedError(objection)
        self._expires = now + DURATION

    def objection(self, token: str, now: float) -> str:
        """Return a message where somebody with another token holds the lease; otherwise empty."""
        if not self.is_held(now) or secrets.compare_digest(token.encode(), self._token.encode()):
            return ""
        return f"the lease is held by {self.holder!r}; this is not its token"

    def revoke(self) -> None:
        """End the lease, whoever holds it."""
        self.holder, self._token, self._expires = None, "", 0.0

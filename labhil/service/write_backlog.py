"""Samples between the bus and the disk: how many wait, and whether the disk keeps up."""

from __future__ import annotations

from collections.abc import Sequence


class WriteBacklog:
    """Counts the bytes of samples that wait to be written.

    :meth:`admit` is called in the thread that receives, :meth:`note_written` in the one that writes; each
    changes numbers of its own.

    Args:
        max_bytes: Bytes that may wait before the disk counts as too slow. Samples beyond twice that, which
            come while the run ends, are left out and counted.
        slow_flush: Time of one forced write from which a disk is called slow, s; a disk that spins up takes
            a second.
    """

    def __init__(self, max_bytes: int, slow_flush: float) -> None:
        self._max_bytes, self._slow_flush = max_bytes, slow_flush
        self._received = self._written = 0
        self._largest = 0
        self._left_out = 0

    @property
    def waiting(self) -> int:
        """Bytes that wait."""
        return self._received - self._written

    def admit(self, payloads: Sequence[bytes]) -> bool:
        """Count payloads that came in, and return whether there is room for them."""
        size = sum(map(len, payloads))
        if self.waiting + size > 2 * self._max_bytes:
            self._left_out += len(payloads)
            return False
        self._received += size
        self._largest = max(self._largest, self.waiting)
        return True

    def note_written(self, payloads: Sequence[bytes]) -> None:
        """Count payloads that do not wait any more."""
        self._written += sum(map(len, payloads))

    def overflow(self) -> str:
        """Describe a backlog that is too large; "" otherwise."""
        if self.waiting <= self._max_bytes:
            return ""
        return (
            f"the disk is too slow: {self.waiting / 1e6:.1f} MB wait to be written; they are written before "
            "the recording ends"
        )

    def slowness(self, longest_flush: float) -> str:
        """Describe a slow disk, whose longest forced write took ``longest_flush`` s; "" if it is not slow."""
        if longest_flush <= self._slow_flush and not self._left_out:
            return ""
        loss = "nothing is lost"
        if self._left_out:
            loss = f"{self._left_out} messages found no room and are missing"
        return (
            f"the disk is slow: one forced write took up to {longest_flush:.1f} s, and up to "
            f"{self._largest / 1e6:.2f} MB waited for it; {loss}"
        )

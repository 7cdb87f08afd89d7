"""How much a file may claim to hold, by its own size.

Compressed files and file formats with sizes in their headers can claim any amount: 26 kB of zstd make 300 MB
of zeros. Before anything is unpacked, what a part claims is held against these bounds.
"""

from __future__ import annotations

import errno
from dataclasses import dataclass
from pathlib import Path

RATIO = 255
"""Bytes of content for a byte of file. It is the most that LZ4, which our recorder writes, can reach, so no
recording of ours is refused; recordings and tables of real samples stay below 30, packed by whatever."""

FREE = 1 << 24
"""Bytes of content (16 MiB) that a file of any size may claim: two million numbers, which cost a second."""

LARGEST = 1 << 36
"""Bytes of content (64 GiB) that no file may claim: more than a workstation can hold in its memory."""

LARGEST_CHUNK = 1 << 30
"""Bytes of one chunk (1 GiB). Recorders write chunks of 1 to 16 MB, a raw picture has below 200 MB."""

FREE_RECORDS = 1 << 16
"""Records that a file of any size may claim. Beyond that one for a byte of file: each message differs from
the one before in its number and its times, which no general packer stores in less than a byte."""


class ImplausibleError(ValueError):
    """What a file claims to hold is out of all proportion to its size."""


def read_file(path: Path) -> bytes:
    """Return the bytes of a file or a pipe; OSError for a device, which may have no end."""
    if path.is_char_device():
        raise OSError(errno.EINVAL, "expected a file, found a device")
    return path.read_bytes()


def content_bound(size: int) -> int:
    """The most bytes of content that a file of ``size`` bytes may claim."""
    return min(max(FREE, RATIO * size), LARGEST)


def refuse_claim(what: str, claimed: int, size: int) -> None:
    """Raise ImplausibleError where ``what`` claims more bytes than a file of ``size`` bytes may hold."""
    bound = content_bound(size)
    if claimed > bound:
        raise ImplausibleError(
            f"{what} claims {claimed} bytes of content; a file of {size} bytes may claim {bound}"
        )


@dataclass(slots=True)
class Work:
    """How many bytes may still be looked through in search of something."""

    remaining: int

    @classmethod
    def of(cls, size: int) -> Work:
        """As much as a file of ``size`` bytes may hold: what takes more is made to take long."""
        return cls(content_bound(size))

    def take(self, length: int) -> None:
        """Note that ``length`` bytes are looked through; ImplausibleError when they are too many."""
        if length > self.remaining:
            raise ImplausibleError(f"{length} bytes to look through, {self.remaining} left")
        self.remaining -= length


@dataclass(slots=True)
class Budget:
    """What is left of the bytes and the records that a file of ``size`` bytes may claim."""

    size: int
    content: int
    records: int

    @classmethod
    def of(cls, size: int) -> Budget:
        """The whole budget of a file of ``size`` bytes."""
        return cls(size, content_bound(size), max(FREE_RECORDS, size))

    def take_content(self, claimed: int) -> None:
        """Take a chunk's bytes out of the budget; ImplausibleError when they are more than is left."""
        if claimed > min(self.content, LARGEST_CHUNK):
            raise ImplausibleError(
                f"a chunk claims {claimed} bytes of content; {min(self.content, LARGEST_CHUNK)} are left of "
                f"the {content_bound(self.size)} that a file of {self.size} bytes may claim"
            )
        self.content -= claimed

    def take_record(self) -> None:
        """Take one record out of the budget; ImplausibleError when none is left."""
        if self.records <= 0:
            raise ImplausibleError(
                f"its chunks hold more than the {max(FREE_RECORDS, self.size)} records that a file of "
                f"{self.size} bytes may hold"
            )
        self.records -= 1

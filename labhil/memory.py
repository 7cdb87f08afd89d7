"""What a process that lives for months does with memory that it needs no more: it gives it back.

Python frees what refers to itself only now and then, by the number of its objects: a recorder that is over is
few objects and many megabytes, and a dozen of them wait for that.
glibc keeps an arena of free memory for each of many threads. A service that starts threads for every
recording touches one arena after the other, and none of them gives anything back: it grows for hours, though
nothing is kept. Where the C library is another one, nothing is done.
"""

from __future__ import annotations

import ctypes
import gc
import platform
from typing import Any

ARENA_MAX = -8
"""The number of that option of ``mallopt``."""

ARENAS = 2


def keep_few_arenas() -> None:
    """Let all threads of this process share their free memory; call it before threads are started."""
    if (library := _glibc()) is not None:
        library.mallopt(ARENA_MAX, ARENAS)


def give_back() -> None:
    """Free what nothing refers to, and give it back to the system; takes some tens of milliseconds."""
    gc.collect()
    if (library := _glibc()) is not None:
        library.malloc_trim(0)


def _glibc() -> Any:
    return ctypes.CDLL(None) if platform.libc_ver()[0] == "glibc" else None

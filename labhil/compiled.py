"""One typed door to numba.

Imported only by simulation kernels: a process that merely acquires data never loads numba.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import TypeVar, cast

import numba

Function = TypeVar("Function", bound=Callable[..., object])


def compiled(function: Function) -> Function:
    """Compile ``function`` to machine code at its first call and cache that on disk beside the source."""
    return cast(Function, numba.njit(cache=True, fastmath=False, nogil=True)(function))

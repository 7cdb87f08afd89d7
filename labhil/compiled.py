"""One typed door to numba.

Imported only by simulation kernels: a process that merely acquires data never loads numba.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, TypeVar, cast

import numba

Function = TypeVar("Function", bound=Callable[..., object])

HOW: dict[str, Any] = {"nogil": True, "fastmath": {"contract"}, "error_model": "numpy"}
"""Products may go into sums without rounding in between; a division by zero is infinite, as in arrays."""


def compiled(function: Function) -> Function:
    """Compile ``function`` to machine code at its first call and cache that on disk beside the source."""
    return cast(Function, numba.njit(cache=True, **HOW)(function))


def inlined(function: Function) -> Function:
    """The same for a law that a kernel calls many times per sample: the kernel has it inside.

    Such kernels run up to twice as fast and take longer to compile.
    """
    return cast(Function, numba.njit(cache=True, forceinline=True, **HOW)(function))


def specialised(function: Function) -> Function:
    """Compile a function made for one kernel by closing over that kernel's laws, into the kernel.

    Such a function cannot be found again on disk; the kernel that calls it can, and has it inside.
    """
    alone: dict[str, Any] = {"no_cpython_wrapper": True, "no_cfunc_wrapper": True}
    return cast(Function, numba.njit(**HOW, **alone)(function))

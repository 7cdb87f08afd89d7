"""One typed door to numba.

Imported only by simulation kernels: a process that merely acquires data never loads numba.
"""

from __future__ import annotations

import hashlib
from collections.abc import Callable
from contextlib import suppress
from functools import cache
from pathlib import Path
from typing import Any, TypeVar, cast

import numba
from numba.core import caching, config

Function = TypeVar("Function", bound=Callable[..., object])

HOW: dict[str, Any] = {"nogil": True, "fastmath": {"contract"}, "error_model": "numpy"}
"""Products may go into sums without rounding in between; a division by zero is infinite, as in arrays."""

PACKAGE = Path(__file__).parent


class Fresh:
    """Mixed into numba's cache locators: a kernel on disk is as old as the sources of its whole room.

    Numba alone looks at the file of a kernel only, and would go on with the old laws of another file that
    the kernel has inside.
    """

    _py_file: str

    def get_source_stamp(self) -> str:
        """A digest of all sources that the function may have inside."""
        return _digest(_room(Path(self._py_file)))


class FreshInTree(Fresh, caching.InTreeCacheLocator):
    """Kernels beside their sources."""


class FreshForUser(Fresh, caching.UserWideCacheLocator):
    """Kernels in the user's cache, where the sources' folder cannot be written."""


class FreshElsewhere(Fresh, caching.UserProvidedCacheLocator):
    """Kernels in the folder that ``NUMBA_CACHE_DIR`` names."""


def _room(source: Path) -> Path:
    """The folder below the package in which a source is, or its own folder."""
    inside = [folder for folder in source.parents if folder.parent == PACKAGE]
    return inside[0] if inside else source.parent


@cache
def _digest(room: Path) -> str:
    """Of all Python files in a folder and below; this one says how they are compiled."""
    sources = [Path(__file__), *sorted(room.rglob("*.py"))]
    return hashlib.sha256(b"".join(path.read_bytes() for path in sources)).hexdigest()


def _keep_fresh() -> None:
    """Put these locators before numba's own, unless the user asks for others."""
    settings: Any = config
    if not settings.CACHE_LOCATOR_CLASSES:
        ours = [f"{kind.__module__}.{kind.__name__}" for kind in (FreshElsewhere, FreshInTree, FreshForUser)]
        settings.CACHE_LOCATOR_CLASSES = ",".join([*ours, "IPythonCacheLocator", "ZipCacheLocator"])


_keep_fresh()


def _compile_to_disk(function: Callable[..., object], **more: bool) -> Any:
    njit: Any = numba.njit
    dispatcher = njit(cache=True, **more, **HOW)(function)
    kernel_cache = getattr(dispatcher, "_cache", None)  # NUMBA_DISABLE_JIT leaves functions as they are
    if kernel_cache is not None:
        kernel_cache.save_overload = _where_there_is_room(kernel_cache.save_overload)
        index = kernel_cache._cache_file
        index._load_index = _of_known_classes(index._load_index)
    return dispatcher


def _of_known_classes(load: Callable[[], dict[Any, Any]]) -> Callable[[], dict[Any, Any]]:
    """An index of kernels whose signatures name classes that are no more is of older sources: no index."""

    def load_index() -> dict[Any, Any]:
        try:
            return load()
        except (AttributeError, ImportError):
            return {}

    return load_index


def _where_there_is_room(save: Callable[[Any, Any], None]) -> Callable[[Any, Any], None]:
    """Keep a kernel on a disk that is not full; elsewhere it is compiled again by the next process."""

    def save_overload(signature: Any, kernel: Any) -> None:
        with suppress(OSError):
            save(signature, kernel)

    return save_overload


def compiled(function: Function) -> Function:
    """Compile ``function`` to machine code at its first call and cache that on disk beside the source."""
    return cast(Function, _compile_to_disk(function))


def inlined(function: Function) -> Function:
    """The same for a law that a kernel calls many times per sample: the kernel has it inside.

    Such kernels run up to twice as fast and take longer to compile.
    """
    return cast(Function, _compile_to_disk(function, forceinline=True))


def specialised(function: Function) -> Function:
    """Compile a function made for one kernel by closing over that kernel's laws, into the kernel.

    Such a function cannot be loaded from disk again; the kernel that calls it can, and has it inside.
    """
    alone: dict[str, Any] = {"no_cpython_wrapper": True, "no_cfunc_wrapper": True}
    return cast(Function, numba.njit(**HOW, **alone)(function))


def merged(function: Function) -> Function:
    """The same for a function that is called in one place: its statements become those of its caller.

    Machine code is made once then, of the kernel, and not of every function on the way to it, each with all
    that it calls inside: a third of the time.
    """
    return cast(Function, numba.njit(inline="always", **HOW)(function))


def by_type(
    function: Callable[..., object], laws: dict[type, Callable[..., object]], other: Callable[..., object]
) -> None:
    """Let kernels call ``function`` and have inside the law that belongs to its last argument's type.

    Args:
        function: What chooses likewise outside of kernels.
        laws: Laws by the class of a named tuple.
        other: The law for arguments of every other type.
    """
    overload: Any = numba.extending.overload

    def choose(*arguments: Any) -> Callable[..., object]:
        law: Any = laws.get(getattr(arguments[-1], "instance_class", object), other)
        return cast(Callable[..., object], getattr(law, "py_func", law))

    overload(function, jit_options={**HOW, "forceinline": True}, strict=False)(choose)

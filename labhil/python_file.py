"""An object of somebody's own Python file, as ``bench.py:pendulum`` names it."""

from __future__ import annotations

import importlib.util
import sys
from collections.abc import Mapping
from importlib.machinery import SourceFileLoader
from pathlib import Path
from types import ModuleType
from typing import Any

from labhil.errors import UsageError, suggestion


def object_of(stated: str, folder: Path) -> object:
    """Run a Python file and give what one of its names stands for.

    Args:
        stated: File and name, ``bench.py:pendulum``.
        folder: Where the file stands, when its path is relative.

    Returns:
        The object.

    Raises:
        UsageError: There is no such file or name, or the file cannot be run.
    """
    file, colon, name = stated.rpartition(":")
    if not colon or not file.endswith(".py") or not name.isidentifier():
        raise UsageError(f"expected a Python file and a name in it, like bench.py:pendulum, found {stated!r}")
    path = (folder / file).resolve()
    module = module_of(path)
    names = [key for key in vars(module) if not key.startswith("_")]
    if name not in names:
        raise UsageError(f"{path}: has no {name!r}{suggestion(name, names)}")
    value: object = getattr(module, name)
    return value


class _Uncached(SourceFileLoader):
    """Compiles a file each time, as it may change within the resolution of its time, and leaves no cache."""

    def path_stats(self, path: str) -> Mapping[str, Any]:
        """Refuse to tell time and size, without which no cache is read or written."""
        raise OSError(f"{path}: not cached")


def module_of(path: Path) -> ModuleType:
    """Run a Python file; UsageError where there is none, or it cannot be run."""
    if not path.is_file():
        raise UsageError(
            f"expected the Python file {path}, found none (paths are relative to the file that names them)"
        )
    name = f"labhil_file_{path.stem}"
    spec = importlib.util.spec_from_file_location(name, path, loader=_Uncached(name, str(path)))
    assert spec is not None and spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    sys.modules[spec.name] = module
    try:
        spec.loader.exec_module(module)
    except Exception as error:
        raise UsageError(f"{path}: cannot be run: {type(error).__name__}: {error}") from error
    return module

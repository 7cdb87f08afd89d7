"""The way to the project's benchmarks, which measure labhil and are no part of the package.

They come with the source, in ``benchmarks/``, and run from the checkout that labhil was installed from. What
needs them is a few commands and one method of sealed trials; nothing else in labhil knows of them.
"""

from __future__ import annotations

import json
import sys
from importlib import import_module
from importlib.metadata import PackageNotFoundError, distribution
from importlib.util import find_spec
from pathlib import Path
from types import ModuleType
from urllib.parse import urlsplit
from urllib.request import url2pathname

from labhil.errors import MissingBenchmarksError

PACKAGE = "labhil_benchmarks"


def benchmark_module(name: str, purpose: str) -> ModuleType:
    """Import a module of the benchmarks; ``purpose`` is what needs it, as a person typed it.

    Once imported they stay on the path, also for processes that this one starts. MissingBenchmarksError where
    labhil was not installed from a checkout, or the checkout is gone.
    """
    if find_spec(PACKAGE) is None:
        folder = _folder_of_the_checkout()
        if folder is None:
            raise MissingBenchmarksError(purpose)
        sys.path.append(str(folder))
    return import_module(f"{PACKAGE}.{name}")


def _folder_of_the_checkout() -> Path | None:
    """``benchmarks/`` of the folder that ``pip install`` was given, as pip itself noted it (PEP 610)."""
    try:
        noted = distribution("labhil").read_text("direct_url.json")
    except PackageNotFoundError:
        return None
    address = urlsplit(json.loads(noted)["url"]) if noted else None
    if address is None or address.scheme != "file":
        return None
    folder = Path(url2pathname(address.path)) / "benchmarks"
    return folder if (folder / PACKAGE / "__init__.py").is_file() else None

"""Import of the project's benchmarks, which measure labhil and are not part of the package.

They are in ``benchmarks/`` of the checkout that labhil was installed from. Only a few commands and one method
of sealed trials need them.
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
    """Import a module of the benchmarks, which stay on the path.

    Args:
        name: of the module in the package of the benchmarks.
        purpose: the command or option that needs it, for the message.

    Raises:
        MissingBenchmarksError: labhil was not installed from a checkout, or the checkout is gone.
    """
    if find_spec(PACKAGE) is None:
        folder = _benchmarks_folder()
        if folder is None:
            raise MissingBenchmarksError(purpose)
        sys.path.append(str(folder))
    return import_module(f"{PACKAGE}.{name}")


def _benchmarks_folder() -> Path | None:
    """Return ``benchmarks/`` of the folder that pip installed labhil from (PEP 610)."""
    try:
        origin = distribution("labhil").read_text("direct_url.json")
    except PackageNotFoundError:
        return None
    url = urlsplit(json.loads(origin)["url"]) if origin else None
    if url is None or url.scheme != "file":
        return None
    folder = Path(url2pathname(url.path)) / "benchmarks"
    return folder if (folder / PACKAGE / "__init__.py").is_file() else None

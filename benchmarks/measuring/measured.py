"""Where a measuring command's result goes."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any


def tell(result: Any, out: Path | None) -> None:
    """Write it as JSON to a file, or to standard output where none was named."""
    text = json.dumps(result, indent=1)
    if out is None:
        print(text)
    else:
        out.write_text(text + "\n", encoding="utf-8")

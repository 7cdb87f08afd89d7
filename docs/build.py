"""Build the site: ``python docs/build.py [FOLDER]``, by default into ``build/site``. Warnings are errors."""

from __future__ import annotations

import sys
from pathlib import Path

from sphinx.cmd.build import main

DOCS = Path(__file__).parent

if __name__ == "__main__":
    site = sys.argv[1] if len(sys.argv) > 1 else str(DOCS.parent / "build" / "site")
    # -W: a warning, such as a link to a page or a heading that does not exist, is an error
    sys.exit(main(["-b", "html", "-W", "--keep-going", "-q", str(DOCS), site]))

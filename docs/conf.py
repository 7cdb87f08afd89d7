"""How Sphinx builds the site; ``python docs/build.py`` does it."""

from __future__ import annotations

import re
from pathlib import Path
from typing import TYPE_CHECKING

from labhil.version import __version__

if TYPE_CHECKING:
    from sphinx.application import Sphinx

project = "labhil"
author = "The labhil developers"
copyright = "The labhil developers, Apache-2.0"  # noqa: A001 - Sphinx wants this name
release = version = __version__
extensions = ["myst_parser", "sphinx.ext.autodoc", "sphinx.ext.napoleon"]
exclude_patterns = ["measured/**"]
html_theme = "furo"
html_title = f"labhil {__version__}"
html_copy_source = False
smartquotes = False  # an option keeps its two hyphens
html_theme_options = {"navigation_with_keys": True}
html_extra_path = ["reference/schemas"]  # found at /fit.schema.json and so on
myst_heading_anchors = 4
myst_links_external_new_tab = True
autodoc_member_order = "bysource"
autodoc_typehints = "signature"
autodoc_typehints_format = "short"
napoleon_numpy_docstring = False
highlight_language = "text"  # what a program prints is no Python
pygments_style = "friendly"


def _offer_pages_outside(app: Sphinx, name: str, source: list[str]) -> None:
    """A link to a page outside of docs/, such as a README of a folder, becomes a download of that page."""
    folder = Path(app.srcdir, name).parent

    def offered(link: re.Match[str]) -> str:
        target = (folder / link[2].partition("#")[0]).resolve()
        if "://" in link[2] or target.suffix != ".md" or target.is_relative_to(Path(app.srcdir).resolve()):
            return link[0]
        return f"{{download}}`{link[1]} <{link[2].partition('#')[0]}>`"

    source[0] = re.sub(r"(?<!!)\[([^\]]+)\]\(([^)\s#][^)\s]*)\)", offered, source[0])


def setup(app: Sphinx) -> None:
    """Called by Sphinx."""
    app.connect("source-read", _offer_pages_outside)

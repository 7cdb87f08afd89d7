"""The frame of every page: head, style, headline, contents, sections, foot."""

from __future__ import annotations

import base64
import hashlib
from dataclasses import dataclass
from importlib.resources import files
from pathlib import Path

from labhil.atomic_file import atomic_file
from labhil.report.html.element import Content, Markup, join, tag
from labhil.version import __version__

POLICY = "default-src 'none'; style-src 'unsafe-inline'; img-src data:; script-src {script}"
"""What a browser may load for a page: nothing from anywhere, and our own script, known by its digest."""

FEWEST_FOR_CONTENTS = 4


@dataclass(frozen=True, slots=True)
class PageSection:
    """Hold a part of a page with its heading."""

    title: str
    content: tuple[Content, ...]


@dataclass(frozen=True, slots=True)
class Page:
    """Hold a page.

    Attributes:
        kind: Kind of page, above the headline.
        title: Title of the window.
        headline: The result in one sentence.
        tone: Colour of the headline: a verdict, or "plain".
        lead: Content before all sections.
        sections: The sections, listed in the contents.
        foot: Last line: where the page comes from.
    """

    kind: str
    title: str
    headline: str
    tone: str
    lead: tuple[Content, ...]
    sections: tuple[PageSection, ...]
    foot: str

    def html(self) -> str:
        """Return the whole file."""
        script = _file("zoom.js")
        head = tag(
            "head",
            tag("meta", charset="utf-8"),
            tag("meta", name="viewport", content="width=device-width, initial-scale=1"),
            tag("meta", http_equiv="Content-Security-Policy", content=POLICY.format(script=_digest(script))),
            tag("meta", name="color-scheme", content="light dark"),
            tag("title", self.title),
            tag("style", Markup(_file("style.css"))),
        )
        body = tag(
            "body", _header(self), tag("main", *_body(self)), _footer(self), tag("script", Markup(script))
        )
        return f"<!DOCTYPE html>\n{tag('html', head, body, lang='en-GB').text}\n"


def section(title: str, *content: Content) -> PageSection | None:
    """Make a section; None where all its content is None."""
    return PageSection(title, content) if any(piece is not None for piece in content) else None


def drop_empty(*sections: PageSection | None) -> tuple[PageSection, ...]:
    """Return the sections that are not None."""
    return tuple(part for part in sections if part is not None)


def write_page(page: Page, path: Path) -> None:
    """Write a page.

    Args:
        page: The page.
        path: The file.

    Raises:
        UsageError: The file cannot be written.
        DiskFailedError: The disk is full or fails.
    """
    with atomic_file(path, "the page") as draft:
        draft.write_text(page.html(), encoding="utf-8")


def _header(page: Page) -> Markup:
    return tag(
        "header",
        tag("p", page.kind, class_="kind"),
        tag("h1", page.headline),
        class_=page.tone,
    )


def _body(page: Page) -> list[Content]:
    parts: list[Content] = [*page.lead]
    if len(page.sections) >= FEWEST_FOR_CONTENTS:
        parts.append(_contents(page))
    parts += [
        tag("section", tag("h2", part.title, id=f"part-{i}"), *part.content, aria_labelledby=f"part-{i}")
        for i, part in enumerate(page.sections, 1)
    ]
    return parts


def _contents(page: Page) -> Markup:
    links = [tag("a", part.title, href=f"#part-{i}") for i, part in enumerate(page.sections, 1)]
    return tag("nav", tag("ul", *(tag("li", link) for link in links)), aria_label="Contents")


def _footer(page: Page) -> Markup:
    return tag("footer", tag("p", join((page.foot, f" Written by labhil {__version__}."))))


def _file(name: str) -> str:
    return (files("labhil.report.html") / name).read_text(encoding="utf-8")


def _digest(script: str) -> str:
    digest = hashlib.sha256(script.encode()).digest()
    return f"'sha256-{base64.b64encode(digest).decode()}'"

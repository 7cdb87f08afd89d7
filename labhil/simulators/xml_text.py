"""An XML file whose attributes are changed in its text: all else stays as its author wrote it."""

from __future__ import annotations

import re
from dataclasses import dataclass, field
from pathlib import Path
from xml.parsers import expat

from labhil.errors import UsageError


@dataclass(frozen=True, slots=True)
class Element:
    """An element: tag, attributes, those around it from the root on, and its start tag in the text."""

    number: int
    tag: str
    attributes: dict[str, str]
    above: tuple[int, ...]
    first: int
    last: int

    def label(self) -> str:
        """For messages."""
        name = self.attributes.get("name")
        return f"<{self.tag}>" if name is None else f'<{self.tag} name="{name}">'


@dataclass(frozen=True, slots=True)
class Change:
    """One attribute that is changed: of which element, from what to what (None: absent), and why."""

    element: str
    attribute: str
    before: str | None
    after: str | None
    why: str


@dataclass
class XmlText:
    """A file's bytes with its elements, and the changes to make."""

    path: Path
    content: bytes
    elements: list[Element]
    changes: list[Change] = field(default_factory=list)
    _wanted: dict[int, dict[str, str | None]] = field(default_factory=dict)
    _added: dict[int, list[str]] = field(default_factory=dict)

    @classmethod
    def read(cls, path: Path) -> XmlText:
        """Read a file; UsageError where it cannot be read or is no XML."""
        try:
            content = path.read_bytes()
        except OSError as error:
            raise UsageError(f"{path}: cannot be read: {error.strerror}") from error
        return cls(path, content, _elements(path, content))

    def inside(self, tag: str, around: str) -> list[Element]:
        """Elements of a tag ("" for all) anywhere in one of another, in the order of the file."""
        return [
            e
            for e in self.elements
            if (not tag or e.tag == tag) and any(self.elements[k].tag == around for k in e.above)
        ]

    def children(self, element: Element, tag: str = "") -> list[Element]:
        """Elements directly in another."""
        return [
            e
            for e in self.elements
            if e.above and e.above[-1] == element.number and (not tag or e.tag == tag)
        ]

    def set(self, element: Element, attribute: str, value: str, why: str) -> None:
        """Ask for an attribute's value; the same value as before is no change."""
        before = self.current(element, attribute)
        if before == value:
            return
        self._wanted.setdefault(element.number, {})[attribute] = value
        self.changes.append(Change(element.label(), attribute, before, value, why))

    def drop(self, element: Element, attribute: str, why: str) -> None:
        """Ask for an attribute to be taken away; one that is absent is no change."""
        before = self.current(element, attribute)
        if before is not None:
            self._wanted.setdefault(element.number, {})[attribute] = None
            self.changes.append(Change(element.label(), attribute, before, None, why))

    def add(self, parent: Element, line: str, why: str) -> None:
        """Ask for one more element, as text, before all others in a parent."""
        self._added.setdefault(parent.number, []).append(line)
        self.changes.append(Change(parent.label(), "", None, line, why))

    def add_attribute_of_new(self, parent: Element, tag: str, attribute: str, value: str, why: str) -> None:
        """Ask for an attribute of an element that is not there yet; of several, one element takes all."""
        begun = f"<{tag} "
        lines = self._added.setdefault(parent.number, [])
        place = next((k for k, line in enumerate(lines) if line.startswith(begun)), None)
        if place is None:
            lines.append(f'{begun}{attribute}="{value}"/>')
        else:
            lines[place] = lines[place].replace("/>", f' {attribute}="{value}"/>')
        self.changes.append(Change(f"{parent.label()}/<{tag}>", attribute, None, value, why))

    def current(self, element: Element, attribute: str) -> str | None:
        """What an attribute has, changes included; None where it is absent."""
        wanted = self._wanted.get(element.number, {})
        return wanted.get(attribute, element.attributes.get(attribute))

    def changed(self) -> bytes:
        """The file's bytes with all changes."""
        content = self.content
        for number in sorted(self._wanted.keys() | self._added.keys(), reverse=True):
            element = self.elements[number]
            tag = content[element.first : element.last]
            for attribute, value in self._wanted.get(number, {}).items():
                tag = _without(tag, attribute) if value is None else _with_attribute(tag, attribute, value)
            for line in self._added.get(number, ()):
                tag += self._indent(element) + line.encode()
            content = content[: element.first] + tag + content[element.last :]
        return content

    def _indent(self, parent: Element) -> bytes:
        """What stands before the first element in a parent: the end of a line, and spaces."""
        inner = self.children(parent)
        before = self.content[parent.last : inner[0].first] if inner else b"\n  "
        return before if before and not before.strip() else b"\n  "


def _elements(path: Path, content: bytes) -> list[Element]:
    elements: list[Element] = []
    open_ones: list[int] = []
    parser = expat.ParserCreate()

    def start(tag: str, attributes: dict[str, str]) -> None:
        first = parser.CurrentByteIndex
        elements.append(
            Element(
                len(elements), tag, dict(attributes), tuple(open_ones), first, _end_of_tag(content, first)
            )
        )
        open_ones.append(len(elements) - 1)

    def end(tag: str) -> None:
        open_ones.pop()

    parser.StartElementHandler, parser.EndElementHandler = start, end
    try:
        parser.Parse(content, True)
    except expat.ExpatError as error:
        raise UsageError(f"{path}: expected XML, found: {error}") from error
    return elements


def _end_of_tag(content: bytes, first: int) -> int:
    """Behind the > that ends a start tag; one inside of quotes does not."""
    match = re.compile(rb"""<(?:[^>"']|"[^"]*"|'[^']*')*>""").match(content, first)
    return len(content) if match is None else match.end()


def _without(tag: bytes, name: str) -> bytes:
    """A start tag without an attribute, and without the space before it."""
    return re.sub(rb"\s+" + re.escape(name.encode()) + rb"\s*=\s*(\"[^\"]*\"|'[^']*')", b"", tag, count=1)


def _with_attribute(tag: bytes, name: str, value: str) -> bytes:
    """A start tag with an attribute changed where it stands, or put behind the last one."""
    quoted = value.replace("&", "&amp;").replace("<", "&lt;").replace('"', "&quot;").encode()
    pattern = re.compile(rb"(\s" + re.escape(name.encode()) + rb"\s*=\s*)(\"[^\"]*\"|'[^']*')")
    match = pattern.search(tag)
    if match is not None:
        quote = match.group(2)[:1]
        return tag[: match.start()] + match.group(1) + quote + quoted + quote + tag[match.end() :]
    end = re.search(rb"\s*/?>$", tag)
    at = len(tag) if end is None else end.start()
    return tag[:at] + b" " + name.encode() + b'="' + quoted + b'"' + tag[at:]

"""Change attributes in the text of an XML file; everything else stays as it was written."""

from __future__ import annotations

import re
from dataclasses import dataclass, field
from pathlib import Path
from xml.parsers import expat

from labhil.errors import UsageError


@dataclass(frozen=True, slots=True)
class Element:
    """An element of an XML file.

    Attributes:
        number: Its number in the order of the file.
        tag: Its tag.
        attributes: Its attributes.
        ancestors: Numbers of the elements around it, from the root on.
        start: First byte of its start tag.
        end: Byte after its start tag.
    """

    number: int
    tag: str
    attributes: dict[str, str]
    ancestors: tuple[int, ...]
    start: int
    end: int

    def label(self) -> str:
        """Format tag and name for a message."""
        name = self.attributes.get("name")
        return f"<{self.tag}>" if name is None else f'<{self.tag} name="{name}">'


@dataclass(frozen=True, slots=True)
class Change:
    """A changed attribute (None: absent) of an element, and the reason; a row of the result's JSON."""

    element: str
    attribute: str
    before: str | None
    after: str | None
    why: str


@dataclass
class XmlText:
    """The bytes of an XML file, its elements, and the changes to make."""

    path: Path
    content: bytes
    elements: list[Element]
    changes: list[Change] = field(default_factory=list)
    _changed_attributes: dict[int, dict[str, str | None]] = field(default_factory=dict)
    _added: dict[int, list[str]] = field(default_factory=dict)

    @classmethod
    def read(cls, path: Path) -> XmlText:
        """Read a file; UsageError where it cannot be read or is no XML."""
        try:
            content = path.read_bytes()
        except OSError as error:
            raise UsageError(f"{path}: cannot be read: {error.strerror}") from error
        return cls.of(path, content)

    @classmethod
    def of(cls, path: Path, content: bytes) -> XmlText:
        """Parse the bytes of a file; UsageError where they are no XML."""
        return cls(path, content, _elements(path, content))

    def inside(self, tag: str, ancestor: str) -> list[Element]:
        """Return the elements of a tag ("" for all) below an element of another tag, in file order."""
        return [
            e
            for e in self.elements
            if (not tag or e.tag == tag) and any(self.elements[k].tag == ancestor for k in e.ancestors)
        ]

    def children(self, element: Element, tag: str = "") -> list[Element]:
        """Return the children of an element."""
        return [
            e
            for e in self.elements
            if e.ancestors and e.ancestors[-1] == element.number and (not tag or e.tag == tag)
        ]

    def set(self, element: Element, attribute: str, value: str, why: str) -> None:
        """Set an attribute; the same value as before is no change, also of one number among several."""
        before = self.current(element, attribute)
        if before is not None:
            value = _keep_equal_numbers(before, value)
        if before == value:
            return
        self._changed_attributes.setdefault(element.number, {})[attribute] = value
        self.changes.append(Change(element.label(), attribute, before, value, why))

    def drop(self, element: Element, attribute: str, why: str) -> None:
        """Remove an attribute; an absent one is no change."""
        before = self.current(element, attribute)
        if before is not None:
            self._changed_attributes.setdefault(element.number, {})[attribute] = None
            self.changes.append(Change(element.label(), attribute, before, None, why))

    def add(self, parent: Element, line: str, why: str) -> None:
        """Insert an element, as text, before the other children of a parent."""
        self._added.setdefault(parent.number, []).append(line)
        self.changes.append(Change(parent.label(), "", None, line, why))

    def add_attribute_of_new(self, parent: Element, tag: str, attribute: str, value: str, why: str) -> None:
        """Set an attribute of a new child; several attributes of a tag go into one element."""
        prefix = f"<{tag} "
        lines = self._added.setdefault(parent.number, [])
        place = next((k for k, line in enumerate(lines) if line.startswith(prefix)), None)
        if place is None:
            lines.append(f'{prefix}{attribute}="{value}"/>')
        else:
            lines[place] = lines[place].replace("/>", f' {attribute}="{value}"/>')
        self.changes.append(Change(f"{parent.label()}/<{tag}>", attribute, None, value, why))

    def current(self, element: Element, attribute: str) -> str | None:
        """Return the value of an attribute with all changes; None where it is absent."""
        attributes = self._changed_attributes.get(element.number, {})
        return attributes.get(attribute, element.attributes.get(attribute))

    def changed(self) -> bytes:
        """Return the file's bytes with all changes."""
        content = self.content
        for number in sorted(self._changed_attributes.keys() | self._added.keys(), reverse=True):
            element = self.elements[number]
            tag = content[element.start : element.end]
            for attribute, value in self._changed_attributes.get(number, {}).items():
                tag = (
                    _drop_attribute(tag, attribute)
                    if value is None
                    else _set_attribute(tag, attribute, value)
                )
            for line in self._added.get(number, ()):
                tag += self._indent(element) + line.encode()
            content = content[: element.start] + tag + content[element.end :]
        return content

    def _indent(self, parent: Element) -> bytes:
        """Return the line break and spaces before the first child of a parent."""
        children = self.children(parent)
        before = self.content[parent.end : children[0].start] if children else b"\n  "
        return before if before and not before.strip() else b"\n  "


def _elements(path: Path, content: bytes) -> list[Element]:
    elements: list[Element] = []
    open_elements: list[int] = []
    parser = expat.ParserCreate()

    def open_element(tag: str, attributes: dict[str, str]) -> None:
        start, number = parser.CurrentByteIndex, len(elements)
        end = _tag_end(content, start)
        elements.append(Element(number, tag, dict(attributes), tuple(open_elements), start, end))
        open_elements.append(number)

    def close_element(tag: str) -> None:
        open_elements.pop()

    parser.StartElementHandler, parser.EndElementHandler = open_element, close_element
    try:
        parser.Parse(content, True)
    except expat.ExpatError as error:
        raise UsageError(f"{path}: expected XML, found: {error}") from error
    return elements


def _tag_end(content: bytes, start: int) -> int:
    """Return the position after the > that ends a start tag; one inside of quotes does not."""
    match = re.compile(rb"""<(?:[^>"']|"[^"]*"|'[^']*')*>""").match(content, start)
    return len(content) if match is None else match.end()


def _drop_attribute(tag: bytes, name: str) -> bytes:
    """Return a start tag without an attribute and the space before it."""
    return re.sub(rb"\s+" + re.escape(name.encode()) + rb"\s*=\s*(\"[^\"]*\"|'[^']*')", b"", tag, count=1)


def _set_attribute(tag: bytes, name: str, value: str) -> bytes:
    """Return a start tag with a changed attribute, or a new one after the others."""
    quoted = value.replace("&", "&amp;").replace("<", "&lt;").replace('"', "&quot;").encode()
    pattern = re.compile(rb"(\s" + re.escape(name.encode()) + rb"\s*=\s*)(\"[^\"]*\"|'[^']*')")
    match = pattern.search(tag)
    if match is not None:
        quote = match.group(2)[:1]
        return tag[: match.start()] + match.group(1) + quote + quoted + quote + tag[match.end() :]
    end = re.search(rb"\s*/?>$", tag)
    at = len(tag) if end is None else end.start()
    return tag[:at] + b" " + name.encode() + b'="' + quoted + b'"' + tag[at:]


def _keep_equal_numbers(before: str, after: str) -> str:
    """The numbers of ``after``, as they stood before where they differ by no more than rounding."""
    old, new = before.split(), after.split()
    try:
        numbers = [(float(a), float(b)) for a, b in zip(old, new, strict=True)]
    except ValueError:
        return after
    rounding = max(1e-9 * max((abs(b) for _, b in numbers), default=0.0), 1e-12)
    return " ".join(
        text if abs(a - b) <= rounding else changed
        for text, changed, (a, b) in zip(old, new, numbers, strict=True)
    )

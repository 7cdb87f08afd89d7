"""Write identified values as starts into the description of an FMU; its binary stays as it is."""

from __future__ import annotations

import zipfile
from collections.abc import Mapping
from io import BytesIO
from pathlib import Path
from typing import NamedTuple

from labhil.simulators.names import identifier
from labhil.simulators.patches import drop_inactive, format_number, with_shared_values
from labhil.simulators.xml_text import Element, XmlText

DESCRIPTION = "modelDescription.xml"


def read_description(path: Path) -> XmlText:
    """Read the description of an FMU as text.

    Args:
        path: The FMU, which has been read before (``fmu_file.FmuFile``).

    Returns:
        The text; its path is that in the FMU.
    """
    with zipfile.ZipFile(path) as packed:
        return XmlText.of(path / DESCRIPTION, packed.read(DESCRIPTION))


def with_description(path: Path, description: bytes) -> bytes:
    """Return the bytes of an FMU with another description, and all else as it was."""
    content = BytesIO()
    with zipfile.ZipFile(path) as packed, zipfile.ZipFile(content, "w") as new:
        for part in packed.infolist():
            data = description if part.filename == DESCRIPTION else packed.read(part)
            new.writestr(part, data, compress_type=part.compress_type)
    return content.getvalue()


class PatchedDescription(NamedTuple):
    """What becomes of identified values.

    Attributes:
        starts: Changed starts by the name of the FMU's variable.
        remaining: Values of effects, which a description cannot hold.
    """

    starts: Mapping[str, float]
    remaining: Mapping[str, float]


def patch_fmu(text: XmlText, starts: Mapping[str, float], values: Mapping[str, float]) -> PatchedDescription:
    """Set the starts of parameters.

    Args:
        text: The description.
        starts: Starts of the parameters that can be estimated, by name.
        values: Values of parameters and of effects, by name.

    Returns:
        The changed starts and the values of effects.
    """
    remaining, changed = with_shared_values(values), {}
    for name, start in starts.items():
        value = remaining.pop(name, start)
        if format_number(value) != format_number(start):
            variable = _variable(text, name)
            changed[variable.attributes["name"]] = value
            text.set(_start_element(text, variable), "start", format_number(value), f"{name} as identified")
    return PatchedDescription(changed, drop_inactive(remaining))


def _variable(text: XmlText, name: str) -> Element:
    """The element of a variable; the names of parameters were read from the same description."""
    variables = text.inside("", "ModelVariables")
    return next(e for e in variables if identifier(e.attributes.get("name", "")) == name)


def _start_element(text: XmlText, variable: Element) -> Element:
    """The element that has the start of a variable: itself (FMI 3), or the one of its type inside (FMI 2)."""
    with_start = (e for e in (variable, *text.children(variable)) if "start" in e.attributes)
    return next(with_start, variable)

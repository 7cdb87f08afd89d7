"""The reference page of the experiment file, generated from the models that read it.

``python -m labhil.experiment.reference > docs/reference/experiment-file.md`` writes it.
"""

from __future__ import annotations

import inspect
import json
import re
import types
from collections.abc import Iterator
from typing import Annotated, Any, Literal, Union, get_args, get_origin

from annotated_types import Ge, Gt, Le
from pydantic import BaseModel
from pydantic.fields import FieldInfo

from labhil.experiment.checks import CheckSection
from labhil.experiment.condition import Condition
from labhil.experiment.device_sections import DeviceSection, TwinSection
from labhil.experiment.excitation.make import EXCITATIONS
from labhil.experiment.experiment import (
    KEYS_OF_EXCITATIONS,
    ExperimentSection,
    RecordSection,
    Stabilise,
    Step,
)
from labhil.experiment.sweep import SweepSection
from labhil.terminal import show

SECTIONS: tuple[tuple[str, type[BaseModel]], ...] = (
    ("[experiment]", ExperimentSection),
    ("[devices.NAME]", DeviceSection),
    ("[devices.NAME.twin]", TwinSection),
    ("[[steps]]", Step),
    ("stabilise = { … }", Stabilise),
    ("[[checks]]", CheckSection),
    ("[record]", RecordSection),
    ("[sweep]", SweepSection),
)
HEAD = """# The experiment file

What `labhil run` reads: a TOML file, values in SI units, angles in rad. This page is made of the models that
read the file (`python -m labhil.experiment.reference`); a key that is not here is refused. Paths are relative
to the file.
"""


def page() -> str:
    """Return the page as Markdown."""
    return "\n".join([HEAD, *_sections(), *_excitations()]).rstrip() + "\n"


def _sections() -> Iterator[str]:
    for title, model in SECTIONS:
        yield f"## `{title}`\n"
        yield _markdown(model) + "\n"
        yield "| key | value | default |\n|---|---|---|"
        for name, field in model.model_fields.items():
            if model is Step and name in KEYS_OF_EXCITATIONS:
                continue
            yield f"| `{name}` | {_type(field)} | {_default(field)} |"
        yield ""


def _excitations() -> Iterator[str]:
    yield "## Excitations\n"
    yield "A step's `excitation` is one of these names; the other keys of the step are what that one takes.\n"
    yield "| excitation | needs | takes too | |\n|---|---|---|---|"
    for name, recipe in EXCITATIONS.items():
        required = ", ".join(f"`{key}`" for key in recipe.required)
        optional = ", ".join(f"`{key}`" for key in recipe.known_keys() if key not in recipe.required)
        summary = (inspect.getdoc(recipe.make) or "").partition("\n\n")[0]
        yield f"| `{name}` | {required} | {optional} | {_cell(summary)} |"
    yield "\n| key | value |\n|---|---|"
    for name, field in Step.model_fields.items():
        if name in KEYS_OF_EXCITATIONS:
            yield f"| `{name}` | {_type(field)} |"


def _markdown(model: type[BaseModel]) -> str:
    """Return the docstring of a model as Markdown."""
    text = inspect.getdoc(model) or ""
    return re.sub(r"``(.+?)``", r"`\1`", text, flags=re.DOTALL)


def _cell(text: str) -> str:
    return re.sub(r"``(.+?)``", r"`\1`", " ".join(text.split())).replace("|", "\\|")


def _type(field: FieldInfo) -> str:
    return _cell(_describe_type(field.annotation, field.metadata))


def _describe_type(annotation: Any, metadata: Any = ()) -> str:
    origin, arguments = get_origin(annotation), get_args(annotation)
    if origin is Annotated:
        return _describe_type(arguments[0], arguments[1:])
    if origin in (Union, types.UnionType):
        members = [member for member in arguments if member is not type(None)]
        return " or ".join(_describe_type(member, metadata) for member in members)
    if origin is Literal:
        return ", ".join(f'"{value}"' for value in arguments)
    if origin in (tuple, dict):
        container, item = ("list", arguments[0]) if origin is tuple else ("table", arguments[1])
        return f"{container} of {_plural(_describe_type(item))}"
    if inspect.isclass(annotation) and issubclass(annotation, BaseModel):
        return "table, see below"
    names = {
        str: "text",
        int: "whole number",
        float: "number",
        bool: "true or false",
        Condition: "condition",
    }
    return names.get(annotation, "value") + _bounds(metadata)


def _plural(description: str) -> str:
    if description.startswith("list of "):
        return f"lists{description.removeprefix('list')}"
    for singular, plural in (("whole number", "whole numbers"), ("number", "numbers"), ("value", "values")):
        if description.startswith(singular):
            return plural + description.removeprefix(singular)
    return description + "s" if description == "text" else description


def _bounds(metadata: Any) -> str:
    bounds = []
    for item in metadata:
        for bound in getattr(item, "metadata", [item]):
            match bound:
                case Gt(gt=low):
                    bounds.append(f"more than {low}")
                case Ge(ge=low):
                    bounds.append(f"{low} or more")
                case Le(le=high):
                    bounds.append(f"at most {high}")
                case _:
                    pass
    return f", {', '.join(bounds)}" if bounds else ""


def _default(field: FieldInfo) -> str:
    if field.is_required():
        return "needed"
    value = field.default
    if value is None or isinstance(value, BaseModel) or value in ("", (), {}):
        return "–"
    return f"`{json.dumps(value)}`"


if __name__ == "__main__":
    show(page().rstrip())

"""Write the pages of docs/reference that come from the code: ``python docs/generate_reference.py [FOLDER]``.

The command line, the keys of a rig file, the terms, the JSON schemas of results, the exit codes, and the
picture of a run's states. A test fails when a page differs from what this makes.
``reference/python-api.md`` is filled by Sphinx; the table of names over each of its blocks is made here.
"""

from __future__ import annotations

import argparse
import inspect
import json
import pydoc
import re
import types
import typing
from collections.abc import Callable, Iterator, Mapping
from importlib.util import module_from_spec, spec_from_file_location
from pathlib import Path
from typing import TYPE_CHECKING

from pydantic import BaseModel

if TYPE_CHECKING:
    from pydantic.fields import FieldInfo

    from labhil.kinds import RigKind

REFERENCE = Path(__file__).parent / "reference"
NOTE = "<!-- Made by docs/generate_reference.py; edit the code, then run it again. -->"


def page(title: str, *parts: str) -> str:
    """A page of Markdown: title, note of origin, parts with an empty line between."""
    return "\n\n".join((f"# {title}", NOTE, *(part.strip() for part in parts if part.strip()))) + "\n"


def table(head: tuple[str, ...], rows: list[tuple[str, ...]]) -> str:
    """A table of Markdown; pipes within a cell are escaped."""
    lines = [head, ("---",) * len(head), *rows]
    return "\n".join(
        f"| {' | '.join(' '.join(cell.split()).replace('|', chr(92) + '|') for cell in line)} |"
        for line in lines
    )


def code(text: object) -> str:
    """As inline code; nothing for nothing."""
    return f"`{text}`" if text not in (None, "") else ""


# the command line


def command_line() -> str:
    """Every command with its arguments and options."""
    from typer.main import get_command

    from labhil.command_line import app

    group = get_command(app)
    sections = list(_commands(group, "labhil"))
    intro = (
        "`labhil COMMAND --help` prints the same. Results go to stdout, progress and complaints to stderr; "
        "what a command's status means is in [](exit-codes.md)."
    )
    return page("The command line", intro, *sections)


def _commands(group: typing.Any, path: str) -> Iterator[str]:
    for name, command in group.commands.items():
        if command.hidden:
            continue
        if hasattr(command, "commands"):
            yield f"## {path} {name}\n\n{_help_of(command)}"
            yield from _commands(command, f"{path} {name}")
        else:
            yield _command(f"{path} {name}", command)


def _help_of(command: typing.Any) -> str:
    paragraphs = inspect.cleandoc(command.help or "").split("\n\n")
    return "\n\n".join(" ".join(paragraph.split()) for paragraph in paragraphs)


def _command(path: str, command: typing.Any) -> str:
    hints = typing.get_type_hints(command.callback)
    rows = [
        (_spelled(parameter, hints.get(parameter.name)), parameter.help or "", _default_of(parameter))
        for parameter in command.params
        if not parameter.hidden and parameter.name != "help"
    ]
    example, _, guide = (
        " ".join((command.epilog or "").split()).removeprefix("Example: ").partition("Page: docs/")
    )
    parts = [f"## {path}", _help_of(command), f"```sh\n{example.strip()}\n```" if example else ""]
    if guide and not guide.startswith("reference/cli.md"):
        parts.append(f"More: [](../{guide}).")
    if rows:
        parts.append(table(("argument or option", "meaning", "default"), rows))
    return "\n\n".join(part for part in parts if part)


def _spelled(parameter: typing.Any, hint: object) -> str:
    if not hasattr(parameter, "is_flag"):  # an argument
        return code(parameter.metavar or parameter.name.upper())
    value = (
        ""
        if parameter.is_flag
        else parameter.metavar or _type(hint).upper().replace("WHOLE NUMBER", "INTEGER")
    )
    return code(" ".join((", ".join((*parameter.opts, *parameter.secondary_opts)), value)).strip())


def _default_of(parameter: typing.Any) -> str:
    if parameter.required:
        return "required"
    default = parameter.default
    default = getattr(default, "value", default)
    if default in (None, False, (), []) or callable(default):
        return ""
    return code(default)


# keys of a file, from its pydantic model


def rig_file() -> str:
    """Every key of a rig file."""
    from labhil.kinds import KINDS
    from labhil.rig import RigFile

    intro = (
        "A TOML file that says what is known of a rig, its limits, and how columns of a table become "
        "signals. A key that is not listed is an error that names the nearest one."
    )
    heading = (
        "## What each kind knows\n\nSignals are the names that `[limits]`, `[interlocks]` and `[channels]` "
        "may use; sizes are the keys of `[known]`."
    )
    kinds = [_kind(kind) for kind in KINDS.values()]
    return page("The rig file, key by key", intro, *keys_of(RigFile), heading, *kinds)


def _kind(kind: RigKind) -> str:
    signals = [(code(s.name), s.unit, s.direction.value, s.description) for s in kind.signals()]
    known = [(code(name), size.unit, size.expected()) for name, size in kind.known.items()]
    parts = [f"### {kind.name}", table(("signal", "unit", "direction", "meaning"), signals)]
    if known:
        parts.append(table(("size", "unit", "expected"), known))
    return "\n\n".join(parts)


def keys_of(model: type[BaseModel], section: str = "") -> Iterator[str]:
    """A section for each table of a TOML file: what its docstring says, and its keys."""
    plain: list[tuple[str, ...]] = []
    nested: list[str] = []
    for name, field in model.model_fields.items():
        if field.exclude:
            continue
        inner, keyed = _model_in(field.annotation)
        path = ".".join(part for part in (section, name) if part)
        if inner is not None:
            nested += keys_of(inner, f"{path}.NAME" if keyed else path)
        elif typing.get_origin(field.annotation) is dict:
            nested.append(f"## [{path}]\n\nNames of your own or of the rig, each: {_type(field.annotation)}.")
        else:
            plain.append((code(name), _type(field.annotation) + _bounds(field), _default(field)))
    if section:
        words = " ".join(inspect.cleandoc(model.__doc__ or "").replace("``", "`").split())
        yield "\n\n".join((f"## [{section}]", words, table(("key", "type", "default"), plain)))
    yield from nested


def _model_in(annotation: object) -> tuple[type[BaseModel] | None, bool]:
    if isinstance(annotation, type) and issubclass(annotation, BaseModel):
        return annotation, False
    for argument in typing.get_args(annotation):
        if isinstance(argument, type) and issubclass(argument, BaseModel):
            return argument, typing.get_origin(annotation) is dict
    return None, False


def _type(annotation: object) -> str:
    origin, arguments = typing.get_origin(annotation), typing.get_args(annotation)
    if origin is typing.Annotated:
        return _type(arguments[0])
    if origin is typing.Literal:
        return " or ".join(json.dumps(value) for value in arguments)
    if origin in (typing.Union, types.UnionType):
        return " or ".join(dict.fromkeys(_type(each) for each in arguments if each is not type(None)))
    if origin is list:
        return f"list of {_type(arguments[0])}"
    if origin is dict:
        return _type(arguments[1])
    words = {str: "text", float: "number", int: "whole number", bool: "true or false", Path: "path"}
    return words.get(typing.cast("type", annotation), getattr(annotation, "__name__", str(annotation)))


def _bounds(field: FieldInfo) -> str:
    signs = (("gt", ">"), ("ge", "≥"), ("lt", "<"), ("le", "≤"))
    found = [
        f"{sign} {getattr(m, name):g}" for m in field.metadata for name, sign in signs if hasattr(m, name)
    ]
    return f", {', '.join(found)}" if found else ""


def _default(field: FieldInfo) -> str:
    if field.is_required():
        return "required"
    return "" if field.default is None else code(json.dumps(field.default).replace("Infinity", "inf"))


# terms


def terms() -> str:
    """Every term of every rig with equation, parameters, units and source."""
    import labhil
    from labhil.kinds import KINDS

    return page(
        "Terms with equations",
        "Effects that a model may have, as `labhil terms RIG` and `labhil.model(RIG).terms` list them. "
        "Units are those of a rig file without `[known]` sizes.",
        *(_terms_of(labhil.model(kind)) for kind in KINDS),
    )


def _terms_of(model: typing.Any) -> str:
    rows = [
        (
            code(term.name),
            term.statement,
            code(term.equation),
            "; ".join(f"{code(p.name)} ({p.unit})" if p.unit else code(p.name) for p in term.parameters),
            term.source,
        )
        for term in model.terms.values()
    ]
    baseline = ", ".join(code(name) for name in model.baseline)
    head = ("term", "effect", "equation", "parameters", "source")
    return f"## {model.kind}\n\nBaseline: {baseline or 'none'}.\n\n{table(head, rows)}"


# results and status


def schemas() -> dict[str, str]:
    """The JSON schema of each result, by file name."""
    from labhil.analysis.schema.comparison import ComparisonPart
    from labhil.analysis.schema.diagnosis import DiagnosisPart
    from labhil.analysis.schema.fit import FitPart
    from labhil.analysis.schema.verification import VerificationPart
    from labhil.device_check.report import DeviceCheck

    parts: Mapping[str, type[BaseModel]] = {
        "fit": FitPart,
        "diagnosis": DiagnosisPart,
        "verification": VerificationPart,
        "comparison": ComparisonPart,
        "device_check": DeviceCheck,
    }
    return {
        f"{name}.schema.json": json.dumps(
            part.model_json_schema(mode="validation"), indent=1, ensure_ascii=False
        )
        + "\n"
        for name, part in parts.items()
    }


def schema_page() -> str:
    """The page that names the schema files."""
    rows = [
        (
            f"[{name}](schemas/{name})",
            code(f"labhil.{name.partition('.')[0]}/1"),
            code(f"labhil {made} --json"),
        )
        for name, made in zip(
            schemas(), ("fit", "diagnose", "verify", "compare", "new KIND --check"), strict=True
        )
    ]
    return page(
        "JSON schemas of results",
        "What `--json` and `.save()` write has these parts (JSON Schema 2020-12). Keys may be added within a "
        "version; none is renamed or dropped. `labhil.load(path)` reads each but that of a device check.",
        table(("schema", "`schema` in the file", "made by"), rows),
    )


def exit_codes() -> str:
    """What the status of a command means, and which error ends with which."""
    from labhil import errors
    from labhil.interrupted import INTERRUPTED

    named = inspect.getmembers(
        errors, lambda each: inspect.isclass(each) and issubclass(each, errors.LabhilError)
    )
    rows = [
        (code(name), str(error.exit_status), inspect.cleandoc(error.__doc__ or "").split("\n\n")[0])
        for name, error in named
        if name not in {"LabhilError", "UsageError", "RunError"}
    ]
    status = [
        ("0", "Done, whatever was found."),
        (
            "1",
            "The run failed (a limit tripped, somebody stopped it, the disk is full, also "
            "for results and exports); or a gate says no: "
            "`diagnose --exit-code` found a mismatch, `verify` that the recording contradicts the model, "
            "`new --check` or `doctor` a fault.",
        ),
        (
            "2",
            "Wrong use or bad input, with a message that says what was expected and what was found. A device "
            "that is not there, talks garbage, resets or falls silent counts as input.",
        ),
        (
            str(INTERRUPTED),
            "Ctrl+C came before a command had a result; it says so. `fit` and `diagnose` end with 0 and the "
            "best so far once they have one, and a run that is stopped with 1.",
        ),
    ]
    return page(
        "Exit codes",
        table(("status", "meaning"), status),
        "## Errors\n\nIn Python the same faults raise these (`labhil.errors`):",
        table(("error", "status", "meaning"), rows),
    )


# the Python API

BLOCK = re.compile(r"(?:^\| name \|.*?\n\n)?(^```\{eval-rst\}\n.*?^```)", re.DOTALL | re.MULTILINE)
DIRECTIVE = re.compile(r"^\.\. auto(?:function|class):: (\S+)$", re.MULTILINE)


def python_api() -> str:
    """The page of the Python API, with a table of names over each block that Sphinx fills."""
    text = (REFERENCE / "python-api.md").read_text(encoding="utf-8")
    return BLOCK.sub(_with_names, text)


def _with_names(block: re.Match[str]) -> str:
    rows = [(code(path.removeprefix("labhil.")), _first_line(path)) for path in DIRECTIVE.findall(block[1])]
    return f"{table(('name', 'what it does'), rows)}\n\n{block[1]}" if rows else block[1]


def _first_line(path: str) -> str:
    """What the docstring of a public name says first, as Markdown."""
    words = inspect.getdoc(pydoc.locate(path)) or ""
    plain = re.sub(r":\w+:`~?(?:[\w.]+\.)?(\w+)`", r"`\1`", words.split("\n\n")[0])
    return plain.replace("``", "`")


PAGES: Mapping[str, Callable[[], str]] = {
    "cli.md": command_line,
    "rig-file.md": rig_file,
    "terms.md": terms,
    "schemas.md": schema_page,
    "exit-codes.md": exit_codes,
    "python-api.md": python_api,
}


def run_states() -> str:
    """The picture of the states of a run."""
    spec = spec_from_file_location("run_states", Path(__file__).with_name("run_states.py"))
    assert spec is not None
    assert spec.loader is not None
    module = module_from_spec(spec)
    spec.loader.exec_module(module)
    picture: str = module.draw_run_states()
    return picture


def generate() -> dict[str, str]:
    """Every generated file's text, by its path below docs/reference."""
    texts = {name: make() for name, make in PAGES.items()}
    texts |= {f"schemas/{name}": text for name, text in schemas().items()}
    texts["../pictures/run-states.svg"] = run_states()
    return {name: re.sub(r"[ \t]+$", "", text, flags=re.MULTILINE) for name, text in texts.items()}


def main(folder: Path = REFERENCE) -> None:
    """Write them all below a folder."""
    for name, text in generate().items():
        path = folder / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(text, encoding="utf-8")


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description="Write the generated pages of the reference.")
    parser.add_argument("folder", type=Path, nargs="?", default=REFERENCE, help="where to; docs/reference")
    main(parser.parse_args().folder)

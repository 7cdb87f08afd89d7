"""Change the starts of parameters in the text of a Python file; everything else stays as it was written."""

from __future__ import annotations

import ast
from collections.abc import Collection, Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path

from labhil.errors import UsageError
from labhil.simulators.xml_text import Change

Table = Mapping[str, ast.expr]
"""The expressions of a dictionary by key."""


@dataclass
class PythonText:
    """The bytes of a Python file, the expressions of its starts by parameter, and the changes to make."""

    path: Path
    content: bytes
    starts: Table
    changes: list[Change] = field(default_factory=list)
    _new: dict[str, str] = field(default_factory=dict)

    @classmethod
    def read(cls, path: Path, simulator: str, parameters: Collection[str]) -> PythonText:
        """Find the starts of a simulator's parameters in a file.

        Args:
            path: The file, which has been run before.
            simulator: The name that the file gives the simulator.
            parameters: The names of its parameters.

        Raises:
            UsageError: They are not in the file as a dictionary.
        """
        content = path.read_bytes()
        try:
            content.decode("utf-8")
        except UnicodeDecodeError as error:
            raise UsageError(f"{path}: expected a Python file in UTF-8, found {error}") from error
        table = _table_of(ast.parse(content), simulator, set(parameters))
        starts = {name: start for name, value in table.items() if (start := _start_of(value)) is not None}
        missing = sorted(set(parameters) - starts.keys())
        if missing:
            raise UsageError(
                f"{path}: expected the starts of {simulator} as a dictionary in this file, parameters = "
                f'{{"{missing[0]}": lh.Quantity(…), …}}, found none for {", ".join(missing)}; nothing is '
                "written"
            )
        return cls(path, content, starts)

    def set(self, parameter: str, value: str, why: str) -> None:
        """Set the start of a parameter."""
        first, last = self._place(self.starts[parameter])
        before = self.content[first:last].decode("utf-8")
        self._new[parameter] = value
        self.changes.append(Change(f'parameters["{parameter}"]', "start", before, value, why))

    def changed(self) -> bytes:
        """Return the file's bytes with all changes."""
        content = self.content
        places = [(self._place(self.starts[name]), value) for name, value in self._new.items()]
        for (first, last), value in sorted(places, reverse=True):
            content = content[:first] + value.encode() + content[last:]
        return content

    def _place(self, expression: ast.expr) -> tuple[int, int]:
        """First byte of an expression, and the byte after it."""
        lengths = [len(line) for line in self.content.splitlines(keepends=True)]
        assert expression.end_lineno is not None and expression.end_col_offset is not None
        first, last = sum(lengths[: expression.lineno - 1]), sum(lengths[: expression.end_lineno - 1])
        return first + expression.col_offset, last + expression.end_col_offset


def _table_of(module: ast.Module, simulator: str, parameters: set[str]) -> Table:
    """The dictionary of the parameters: that of the simulator's own call, else the only one of the file."""
    assigned = dict(_assignments(module))
    call = assigned.get(simulator)
    for keyword in call.keywords if isinstance(call, ast.Call) else ():
        value = keyword.value
        table = _table(assigned.get(value.id, value) if isinstance(value, ast.Name) else value)
        if keyword.arg == "parameters" and table.keys() == parameters:
            return table
    tables = [table for node in ast.walk(module) if (table := _table(node)).keys() == parameters]
    return tables[0] if len(tables) == 1 else {}


def _assignments(module: ast.Module) -> Iterator[tuple[str, ast.expr]]:
    """Names of the module and the expressions that they are assigned."""
    for node in module.body:
        targets = node.targets if isinstance(node, ast.Assign) else [getattr(node, "target", None)]
        value = getattr(node, "value", None)
        yield from ((target.id, value) for target in targets if isinstance(target, ast.Name) and value)


def _table(node: ast.AST) -> Table:
    """The expressions of ``{"name": …}`` or ``dict(name=…)`` by key; empty for all else."""
    if isinstance(node, ast.Dict):
        keys = [key.value if isinstance(key, ast.Constant) else None for key in node.keys]
        return {key: value for key, value in zip(keys, node.values, strict=True) if isinstance(key, str)}
    if isinstance(node, ast.Call) and isinstance(node.func, ast.Name) and node.func.id == "dict":
        return {keyword.arg: keyword.value for keyword in node.keywords if keyword.arg is not None}
    return {}


def _start_of(value: ast.expr) -> ast.expr | None:
    """The expression of the start: a number, or the first argument of a ``Quantity``."""
    if not isinstance(value, ast.Call):
        return value
    named = [keyword.value for keyword in value.keywords if keyword.arg == "start"]
    first = next(iter([*value.args, *named]), None)
    return None if isinstance(first, ast.Starred) else first

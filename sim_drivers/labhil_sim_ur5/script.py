"""Parser of uploaded scripts: kind of program, register offset, injected paths, simple calls."""

from __future__ import annotations

import ast
import re
from dataclasses import dataclass

CONTROL_PROGRAM = "rtde_control"
"""Name of the client's program; the twin knows its contract and does not interpret it."""
_PATH = "# inject move path"
_OFFSET = re.compile(r"global reg_offset_int\s*=\s*# int register offset\s*\n\s*(\d+)")
_NAME = re.compile(r"^\s*(?:def|sec)\s+(\w+)\s*\(", re.MULTILINE)
_CALL = re.compile(r"^\s*(\w+)\((.*)\)\s*$")


class ScriptError(Exception):
    """An error that ends a program: a pose out of reach, two motions at once."""


@dataclass(frozen=True, slots=True)
class Statement:
    """A call: name, arguments, keywords; ``poses`` marks arguments that are poses ``p[…]``."""

    name: str
    arguments: tuple[object, ...]
    keywords: dict[str, object]
    poses: tuple[bool, ...]
    line: str

    def number(self, keyword: str, position: int, default: float) -> float:
        """Return a numeric argument by keyword or position."""
        value = self.keywords.get(keyword)
        if value is None and position < len(self.arguments):
            value = self.arguments[position]
        return float(value) if isinstance(value, int | float) else default

    def six(self) -> tuple[float, ...] | None:
        """Return the first argument as six numbers, None when it is something else."""
        first = self.arguments[0] if self.arguments else None
        if isinstance(first, list) and len(first) == 6 and all(isinstance(x, int | float) for x in first):
            return tuple(float(x) for x in first)
        return None


@dataclass(frozen=True, slots=True)
class Script:
    """An uploaded program.

    Attributes:
        name: Its name.
        control: Whether it is the client's program.
        offset: Offset of its registers.
        path: Moves that are injected into the client's program.
        body: Lines of another program.
    """

    name: str
    control: bool
    offset: int
    path: tuple[Statement, ...]
    body: tuple[Statement, ...]


def parse_script(text: str) -> Script:
    """Parse an uploaded script; a line that is no plain call has its first word as name."""
    match_name = _NAME.search(text)
    name = match_name.group(1) if match_name else "<unnamed>"
    if name == CONTROL_PROGRAM or "signal_async_operation_started" in text:
        match = _OFFSET.search(text)
        offset = int(match.group(1)) if match else 0
        return Script(name, True, offset, _injected_path(text), ())
    return Script(name, False, 0, (), tuple(_statements(text.splitlines())))


def _injected_path(text: str) -> tuple[Statement, ...]:
    lines = text[text.find(_PATH) :].splitlines()[1:] if _PATH in text else []
    end = next((i for i, line in enumerate(lines) if line.strip() == "end"), len(lines))
    return tuple(_statements(lines[:end]))


def _statements(lines: list[str]) -> list[Statement]:
    statements = []
    for line in lines:
        code = line.partition("#")[0].strip()
        if code and not code.startswith(("def ", "sec ")) and code != "end":
            statements.append(_statement(code))
    return statements


def _statement(code: str) -> Statement:
    call = _CALL.match(code)
    if call is None:
        return Statement(code.split(maxsplit=1)[0], (), {}, (), code)
    arguments_code = re.sub(r"\bp\[", "POSE+[", call.group(2))
    try:
        tree = ast.parse(f"f({arguments_code})", mode="eval").body
        assert isinstance(tree, ast.Call)
        arguments = tuple(_literal(node) for node in tree.args)
        keywords = {word.arg or "": _literal(word.value) for word in tree.keywords}
    except (SyntaxError, ValueError, AssertionError):
        return Statement(call.group(1), (), {}, (), code)
    return Statement(call.group(1), arguments, keywords, tuple(map(_is_pose, tree.args)), code)


def _is_pose(node: ast.expr) -> bool:
    return isinstance(node, ast.BinOp) and isinstance(node.left, ast.Name) and node.left.id == "POSE"


def _literal(node: ast.expr) -> object:
    """Evaluate a number, a boolean, text or a list of numbers; ValueError for anything else."""
    if _is_pose(node):
        assert isinstance(node, ast.BinOp)
        return _literal(node.right)
    if isinstance(node, ast.BinOp) and isinstance(node.op, ast.Add | ast.Sub | ast.Mult | ast.Div):
        return _arithmetic(node.op, _literal(node.left), _literal(node.right))
    return ast.literal_eval(node)


def _arithmetic(operator: ast.operator, left: object, right: object) -> float:
    if not isinstance(left, int | float) or not isinstance(right, int | float):
        raise ValueError("not numbers")  # noqa: TRY004 - as ast.literal_eval does
    if isinstance(operator, ast.Add):
        return left + right
    if isinstance(operator, ast.Sub):
        return left - right
    if isinstance(operator, ast.Mult):
        return left * right
    if right == 0:
        raise ValueError("division by zero")
    return left / right

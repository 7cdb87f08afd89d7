"""Conditions on signals, such as ``winding_temperature < 30 and abs(speed) < 0.1``.

The grammar is a part of Python's: numbers, names of signals, ``+ - *``, ``/`` by a number, ``abs(…)``,
comparisons (also chained), ``and``, ``or``, ``not`` and parentheses. The text is parsed and never executed.
"""

from __future__ import annotations

import ast
import operator
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Annotated, TypeGuard

from pydantic import BeforeValidator, InstanceOf, PlainSerializer

from labhil.errors import UnknownNameError

Values = Sequence[float]
Term = Callable[[Values], float]
Test = Callable[[Values], bool]

ARITHMETIC: Mapping[type[ast.operator], Callable[[float, float], float]] = {
    ast.Add: operator.add,
    ast.Sub: operator.sub,
    ast.Mult: operator.mul,
}
COMPARISONS: Mapping[type[ast.cmpop], Callable[[float, float], bool]] = {
    ast.Lt: operator.lt,
    ast.LtE: operator.le,
    ast.Gt: operator.gt,
    ast.GtE: operator.ge,
}
MAX_NUMBER = 1e100
"""Bound of the numbers in a condition, so that no product overflows."""
MAX_LENGTH = 500
"""Characters of a condition at most."""


@dataclass(frozen=True, slots=True)
class Condition:
    """A condition: its text and the names of the signals in it."""

    text: str
    names: tuple[str, ...]
    _tree: ast.expr = field(compare=False, repr=False)

    def __str__(self) -> str:
        return self.text

    def bind(self, columns: Sequence[str]) -> Test:
        """Return a function that tests one sample.

        Args:
            columns: Names of the values of a sample, in their order.

        Raises:
            UnknownNameError: A signal of the condition is not among them.
        """
        for name in self.names:
            if name not in columns:
                raise UnknownNameError("signal", name, columns)
        return _compile_test(self._tree, {name: index for index, name in enumerate(columns)})


def parse_condition(text: str) -> Condition:
    """Parse a condition.

    Raises:
        ValueError: A part of the text is outside the grammar; the message quotes it.

    Example:
        >>> condition = parse_condition("winding_temperature < 30 and abs(speed) < 0.1")
        >>> condition.names
        ('speed', 'winding_temperature')
        >>> condition.bind(["speed", "winding_temperature"])([0.0, 29.0])
        True
    """
    if len(text) > MAX_LENGTH:
        raise ValueError(f"expected a condition of at most {MAX_LENGTH} characters, found {len(text)}")
    try:
        tree = ast.parse(text.strip(), mode="eval").body
        names = sorted({node.id for node in ast.walk(tree) if isinstance(node, ast.Name)} - {"abs"})
        _compile_test(tree, dict.fromkeys(names, 0))
    except (SyntaxError, RecursionError, MemoryError) as error:
        raise ValueError(f"expected a condition like `speed < 0.1`, found {text!r}") from error
    if not names:
        raise ValueError(f"expected a condition on a signal, found none in {text!r}")
    return Condition(text, tuple(names), tree)


def _to_condition(value: object) -> Condition:
    if isinstance(value, Condition):
        return value
    if not isinstance(value, str):
        raise ValueError(f"expected a condition like `speed < 0.1`, found {value!r:.200}")  # noqa: TRY004
    return parse_condition(value)


StatedCondition = Annotated[
    InstanceOf[Condition], BeforeValidator(_to_condition), PlainSerializer(str, return_type=str)
]
"""A condition as a key of a file: text in the file, a :class:`Condition` in the model."""


def format_values(names: Sequence[str], columns: Sequence[str], values: Values) -> str:
    """Format the values of some signals for a message: ``speed = 3.2, current = 0.11``."""
    return ", ".join(f"{name} = {values[columns.index(name)]:.4g}" for name in names)


def _compile_test(node: ast.expr, indices: Mapping[str, int]) -> Test:
    match node:
        case ast.BoolOp(op=op, values=parts):
            tests = [_compile_test(part, indices) for part in parts]
            combine = all if isinstance(op, ast.And) else any
            return lambda values: combine(test(values) for test in tests)
        case ast.UnaryOp(op=ast.Not(), operand=part):
            inner = _compile_test(part, indices)
            return lambda values: not inner(values)
        case ast.Compare(left=left, ops=ops, comparators=rights):
            terms = [_compile_term(part, indices) for part in (left, *rights)]
            comparisons = [_comparison(op) for op in ops]

            def holds(values: Values) -> bool:
                results = [term(values) for term in terms]
                return all(
                    compare(a, b)
                    for compare, a, b in zip(comparisons, results[:-1], results[1:], strict=True)
                )

            return holds
    raise ValueError(f"expected a comparison with <, <=, > or >=, found `{ast.unparse(node)}`")


def _comparison(op: ast.cmpop) -> Callable[[float, float], bool]:
    if type(op) not in COMPARISONS:
        raise ValueError("expected <, <=, > or >=: measured values are never exactly equal")
    return COMPARISONS[type(op)]


def _is_number(value: object) -> TypeGuard[float]:
    return isinstance(value, (int, float)) and not isinstance(value, bool) and abs(value) < MAX_NUMBER


def _compile_term(node: ast.expr, indices: Mapping[str, int]) -> Term:
    match node:
        case ast.Constant(value=value) if _is_number(value):
            number = float(value)
            return lambda _values: number
        case ast.Name(id=name) if name in indices:
            index = indices[name]
            return lambda values: values[index]
        case ast.UnaryOp(op=ast.USub(), operand=part):
            inner = _compile_term(part, indices)
            return lambda values: -inner(values)
        case ast.BinOp(left=left, op=op, right=right) if type(op) in ARITHMETIC:
            operation = ARITHMETIC[type(op)]
            first, second = _compile_term(left, indices), _compile_term(right, indices)
            return lambda values: operation(first(values), second(values))
        case ast.BinOp(left=left, op=ast.Div(), right=ast.Constant(value=value)) if (
            _is_number(value) and value
        ):
            numerator, denominator = _compile_term(left, indices), float(value)
            return lambda values: numerator(values) / denominator
        case ast.Call(func=ast.Name(id="abs"), args=[part], keywords=[]):
            inner = _compile_term(part, indices)
            return lambda values: abs(inner(values))
    raise ValueError(
        f"expected numbers, signals, + - *, / by a number, and abs(…), found `{ast.unparse(node)}`"
    )

"""``[sweep]``: values of an experiment file that vary from run to run."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from itertools import product
from typing import Annotated, Any, Literal

from pydantic import Field, field_validator, model_validator

from labhil.errors import suggestion
from labhil.experiment.device_sections import Section

MAX_RUNS = 10_000
"""Runs of one campaign at most; more are a typing error."""
NOT_SWEPT = ("sweep", "record", "experiment.name", "experiment.repeat")
"""Places that name or count the runs, so that they are the same in all of them."""


class SweepSection(Section):
    """``[sweep]``: values that differ from run to run; each combination is one recording.

    ``over`` maps places of this file, such as ``"steps.0.amplitude"``, to lists of values. ``kind`` "grid"
    runs every combination, the last place varying fastest; "list" takes the first value of each, then the
    second of each. ``on_failure`` "continue" goes on with the next run after one that failed; an
    emergency stop or an interruption always ends the campaign.
    """

    kind: Literal["grid", "list"] = "grid"
    over: Annotated[dict[str, tuple[Any, ...]], Field(min_length=1)]
    on_failure: Literal["stop", "continue"] = "stop"

    @field_validator("over")
    @classmethod
    def _check_values(cls, value: dict[str, tuple[Any, ...]]) -> dict[str, tuple[Any, ...]]:
        for place, values in value.items():
            if not values:
                raise ValueError(f"{place!r}: expected at least one value, found none")
            if any(place == fixed or place.startswith(f"{fixed}.") for fixed in NOT_SWEPT):
                raise ValueError(f"{place!r} cannot be swept: it names or counts the runs themselves")
        return value

    @model_validator(mode="after")
    def _check_lengths(self) -> SweepSection:
        lengths = {place: len(values) for place, values in self.over.items()}
        if self.kind == "list" and len(set(lengths.values())) > 1:
            actual = ", ".join(f"{place}: {length}" for place, length in lengths.items())
            raise ValueError(f'kind = "list" expects lists of one length, found {actual}')
        if self.count > MAX_RUNS:
            raise ValueError(f"expected at most {MAX_RUNS} runs, found {self.count} combinations")
        return self

    @property
    def count(self) -> int:
        """Number of combinations."""
        lengths = [len(values) for values in self.over.values()]
        if self.kind == "list":
            return lengths[0]
        count = 1
        for length in lengths:
            count *= length
        return count

    def combinations(self) -> Iterator[dict[str, Any]]:
        """Yield the values of each run by place."""
        rows = product(*self.over.values()) if self.kind == "grid" else zip(*self.over.values(), strict=True)
        for row in rows:
            yield dict(zip(self.over, row, strict=True))


def replace_value(data: dict[str, Any], place: str, value: object) -> None:
    """Set a value in nested tables and lists, in place.

    Args:
        data: The contents of a file.
        place: Keys and indices, such as "steps.0.amplitude". A last key that does not exist is added: the
            models of the file decide whether they take it.
        value: The new value.

    Raises:
        ValueError: The place does not exist; the message lists the keys that do.
    """
    parts = place.split(".")
    current: Any = data
    for depth, part in enumerate(parts):
        is_last = depth == len(parts) - 1
        so_far = ".".join(parts[: depth + 1])
        if isinstance(current, list):
            if not part.isdecimal() or int(part) >= len(current):
                raise ValueError(f"no {so_far}: expected a number from 0 to {len(current) - 1}")
            key: Any = int(part)
        elif isinstance(current, Mapping):
            # dotted names, such as those of a twin's `set`, are one key
            dotted_key = ".".join(parts[depth:])
            if dotted_key in current:
                current[dotted_key] = value  # type: ignore[index]
                return
            if part not in current and not is_last:
                near = suggestion(part, current)
                raise ValueError(f"no {so_far}{near}; found: {', '.join(map(str, current))}")
            key = part
        else:
            # the file's fault, not that of the program
            raise ValueError(f"no {so_far}: {'.'.join(parts[:depth])} is a plain value")  # noqa: TRY004
        if is_last:
            current[key] = value
            return
        current = current[key]

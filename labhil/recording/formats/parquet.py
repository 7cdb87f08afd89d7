"""Parquet files, by pyarrow."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from labhil.bounds import ImplausibleError, refuse_claim
from labhil.errors import TableError
from labhil.extras import load_optional
from labhil.recording.formats.columns import NumberColumns, number_columns, parse_cell
from labhil.recording.memory_maps import release_array
from labhil.signals import FloatArray, Stream

ROW_GROUP = 1 << 18
"""Rows per written block."""


def read_parquet(path: Path) -> NumberColumns:
    """Read a Parquet file; a column of lists of equal length becomes several columns (``name_0`` …).

    Args:
        path: the file.

    Returns:
        The table: nulls and text are NaN, times in s of Unix time, durations in s.

    Raises:
        TableError: The file cannot be read or is empty.
        MissingExtraError: pyarrow is not installed.
    """
    arrow = load_optional("pyarrow", f"{path}: a Parquet file")
    parquet = load_optional("pyarrow.parquet", f"{path}: a Parquet file")
    try:
        file = parquet.ParquetFile(path)
        _refuse_claims(file.metadata, path.stat().st_size)
        table = file.read()
    except ImplausibleError:
        raise
    except (arrow.ArrowException, OSError, ValueError) as error:
        raise TableError(
            f"{path}: expected a Parquet file, found one that cannot be read: {error}"
        ) from error
    names: list[str] = []
    columns: list[FloatArray] = []
    texts: dict[int, list[Any]] = {}
    for name, column in zip(table.column_names, table.columns, strict=True):
        if arrow.types.is_string(column.type) or arrow.types.is_large_string(column.type):
            texts[len(names)] = column.to_pylist()
        for suffix, values in _numbers(arrow, column):
            names.append(f"{name}{suffix}")
            columns.append(values)
    if not names or not len(columns[0]):
        raise TableError(f"{path}: expected columns with rows, found {len(names)} columns and no rows")
    return number_columns(names, columns, texts)


def _refuse_claims(metadata: Any, size: int) -> None:
    """Raise ImplausibleError if the row groups claim more than a file of ``size`` bytes can contain."""
    unpacked = sum(metadata.row_group(number).total_byte_size for number in range(metadata.num_row_groups))
    refuse_claim("the table", max(unpacked, 8 * metadata.num_rows * metadata.num_columns), size)


def write_parquet(stream: Stream, t: FloatArray, values: FloatArray, out: Path) -> None:
    """Write columns ``t`` (n,) and the signals' (n, columns), with units in the fields' metadata."""
    purpose = f"{out}: writing a Parquet file"
    arrow = load_optional("pyarrow", purpose)
    parquet = load_optional("pyarrow.parquet", purpose)
    units = ["s", *(signal.unit for signal in stream.signals for _ in signal.columns())]
    fields = [
        arrow.field(name, arrow.float64(), metadata={"unit": unit})
        for name, unit in zip(("t", *stream.columns()), units, strict=True)
    ]
    schema = arrow.schema(fields)
    with parquet.ParquetWriter(out, schema) as writer:
        for start in range(0, max(len(t), 1), ROW_GROUP):
            block = slice(start, start + ROW_GROUP)
            columns = [arrow.array(column) for column in (t[block], *values[block].T)]
            writer.write_table(arrow.table(columns, schema=schema))
            release_array(values)


def _numbers(arrow: Any, column: Any) -> list[tuple[str, FloatArray]]:
    """Suffixes of a column's name ("", or ``_0`` … for lists) with their numbers (rows,)."""
    kind = column.type
    types = arrow.types
    if types.is_fixed_size_list(kind) or types.is_list(kind) or types.is_large_list(kind):
        rows = column.to_pylist()
        width = max((len(row) for row in rows if row is not None), default=0)
        values = np.full((len(rows), width), np.nan)
        for index, row in enumerate(rows):
            if row is not None and len(row) == width:
                values[index] = [parse_cell(item) for item in row]
        return [(f"_{number}", values[:, number]) for number in range(width)]
    if types.is_timestamp(kind) or types.is_duration(kind):
        per_second = {"s": 1, "ms": 10**3, "us": 10**6, "ns": 10**9}[kind.unit]
        return [("", _floats(column.cast(arrow.int64()).to_pylist()) / per_second)]
    if types.is_integer(kind) or types.is_floating(kind) or types.is_boolean(kind):
        return [("", _floats(column.cast(arrow.float64(), safe=False).to_pylist()))]
    return [("", np.array([parse_cell(item) for item in column.to_pylist()], dtype=np.float64))]


def _floats(items: list[Any]) -> FloatArray:
    return np.array([np.nan if item is None else item for item in items], dtype=np.float64)

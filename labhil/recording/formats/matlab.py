"""MAT files: versions 4 to 7 by scipy, version 7.3 (and other HDF5 files) by h5py."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Iterable, Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from labhil.bounds import ImplausibleError, refuse_claim
from labhil.errors import TableError
from labhil.recording.formats.columns import NumberColumns, number_columns, the_package
from labhil.signals import FloatArray, Stream

NUMBERS = "iufb"
"""numpy's letters for kinds of numbers; complex ones are none of a signal's."""

NOT_NUMBERS = (b"char", b"cell", b"function_handle", b"string")
"""What MATLAB calls things that version 7.3 keeps as numbers, and that are none."""


def read_mat(path: Path) -> NumberColumns:
    """Read a MAT file of version 4 to 7: each variable a column, or several (``name_0`` …) for a matrix.

    The fields of a struct are variables ``struct.field``. TableError where there are no columns.
    """
    from scipy.io import loadmat, whosmat

    try:
        refuse_claim("the file", _claimed(whosmat(path)), path.stat().st_size)
        variables: dict[str, Any] = loadmat(path, struct_as_record=False)
    except (ImplausibleError, MemoryError):
        raise
    except Exception as error:  # a cut MAT file makes scipy raise almost anything
        raise TableError(f"{path}: expected a MAT file, found one that cannot be read: {error}") from error
    arrays = dict(_numeric_variables(variables))
    return _as_columns(path, arrays)


def read_hdf5(path: Path) -> NumberColumns:
    """Read a MAT file of version 7.3, or any HDF5 file with columns, as :func:`read_mat` does."""
    h5py = the_package("h5py", "h5py", f"{path}: a MAT file of version 7.3 (HDF5)")
    arrays: dict[str, FloatArray] = {}
    size, claimed = path.stat().st_size, 0

    def take(name: str, item: Any) -> None:
        shape = getattr(item, "shape", None)
        if not shape or item.dtype.kind not in NUMBERS or name.startswith("#"):
            return
        if item.attrs.get("MATLAB_class", b"") in NOT_NUMBERS or "MATLAB_empty" in item.attrs:
            return
        nonlocal claimed
        claimed += 8 * math.prod(shape)
        refuse_claim(f"the dataset {name!r}", claimed, size)
        value = np.asarray(item[()], dtype=np.float64)
        # MATLAB writes its columns as HDF5's rows
        upright = value.T if "MATLAB_class" in item.attrs else value
        arrays[name.replace("/", ".")] = upright[:, None] if upright.ndim == 1 else upright

    try:
        with h5py.File(path, "r") as file:
            file.visititems(take)
    except ImplausibleError:
        raise
    except (OSError, RuntimeError, ValueError, KeyError) as error:
        raise TableError(f"{path}: expected an HDF5 file, found one that cannot be read: {error}") from error
    return _as_columns(path, {name: value for name, value in arrays.items() if _is_table(value)})


def write_mat(stream: Stream, t: FloatArray, values: FloatArray, out: Path) -> None:
    """Write ``t`` (n, 1) and each signal (n, width) as variables of a MAT file of version 5."""
    from scipy.io import savemat

    variables = {signal.name: values[:, stream.columns_of(signal.name)] for signal in stream.signals}
    with out.open("wb") as file:
        savemat(file, {"t": t[:, None], **variables}, long_field_names=True, do_compression=True)


def _claimed(variables: Iterable[tuple[str, tuple[int, ...], str]]) -> int:
    """Bytes that the variables of a MAT file would take as numbers."""
    return sum(8 * math.prod(shape) for _, shape, _ in variables)


def _numeric_variables(variables: Mapping[str, Any], prefix: str = "") -> Iterator[tuple[str, FloatArray]]:
    for name, value in variables.items():
        if name.startswith("_") or not isinstance(value, np.ndarray):
            continue
        if value.dtype.kind in NUMBERS:
            array = np.asarray(value, dtype=np.float64)
            if _is_table(array):
                yield f"{prefix}{name}", array
        elif value.dtype == object and value.size == 1 and hasattr(value.flat[0], "_fieldnames"):
            yield from _numeric_variables(vars(value.flat[0]), f"{prefix}{name}.")


def _is_table(value: FloatArray) -> bool:
    return value.ndim == 2 and value.size > 0


def _as_columns(path: Path, arrays: Mapping[str, FloatArray]) -> NumberColumns:
    """Variables of the most frequent length are columns; scalars and settings beside them do not count."""
    if not arrays:
        raise TableError(f"{path}: expected variables that are columns of numbers, found none")
    sizes: Counter[int] = Counter()
    for value in arrays.values():
        sizes[max(value.shape)] += value.size
    rows = sizes.most_common(1)[0][0]
    names: list[str] = []
    columns: list[FloatArray] = []
    for name, value in arrays.items():
        upright = value if value.shape[0] == rows else value.T
        if upright.shape[0] != rows:
            continue  # a scalar or a table of something else
        count = upright.shape[1]
        names += [name] if count == 1 else [f"{name}_{column}" for column in range(count)]
        columns += list(upright.T)
    return number_columns(names, columns)

"""MAT files: versions 4 to 7 by scipy, version 7.3 (and other HDF5 files) by h5py."""

from __future__ import annotations

import math
import struct
import warnings
from collections.abc import Callable, Mapping, Sequence
from io import BytesIO
from pathlib import Path
from typing import Any

import numpy as np

from labhil.bounds import ImplausibleError, refuse_claim
from labhil.errors import TableError
from labhil.extras import load_optional
from labhil.recording.formats.matlab_mcos import Objects, UnknownObjectError
from labhil.recording.formats.matlab_objects import advice, objects_in, references_in
from labhil.recording.formats.variables import MOST_PARTS, Part, VariableColumns, table_of, variables_of
from labhil.signals import FloatArray, Stream

NUMBERS = "iufb"
"""numpy's letters for kinds of numbers; complex ones are none of a signal's."""

IN_WORDS = {"char": "text", "cell": "a cell array", "function_handle": "a function", "string": "text"}
"""What MATLAB calls things that version 7.3 keeps as numbers, and that are none."""

MOST_PARTS_IN_ALL = 10_000
"""Parts of a file that are looked at; logs have some hundreds."""

MOST_TEXT = 256
"""Characters of a text that may be a label."""


def read_mat(path: Path, wanted: Sequence[str] = ()) -> VariableColumns:
    """Read a MAT file of version 4 to 7: each variable a column, or several (``name_0`` …) for a matrix.

    The fields of a struct are variables ``struct.field``, those of a struct array ``array(1).field``.

    Args:
        path: The file.
        wanted: Names that the rig file asks for; where variables have several lengths, theirs counts.

    Raises:
        TableError: The file cannot be read, or holds no columns.
    """
    from scipy.io import loadmat

    try:
        with warnings.catch_warnings():
            # scipy calls every object "None"; objects_in finds them by their own names
            warnings.filterwarnings("ignore", 'Duplicate variable name "None"')
            refuse_claim("the file", _claimed_bytes(path), path.stat().st_size)
            variables: dict[str, Any] = loadmat(path, struct_as_record=False)
    except (ImplausibleError, MemoryError):
        raise
    except Exception as error:  # a cut MAT file makes scipy raise almost anything
        raise TableError(f"{path}: expected a MAT file, found one that cannot be read: {error}") from error
    content = path.read_bytes()
    objects = _objects_of(variables.get("__function_workspace__"))
    parts = {
        name: _part(name, value, objects)
        for name, value in variables.items()
        if not name.startswith("_") and type(value).__name__ != "MatlabOpaque"
    }
    references = references_in(content)
    parts |= {name: _object(name, kind, references.get(name), objects) for name, kind in objects_in(content)}
    return table_of(path, variables_of(parts), wanted)


def read_hdf5(path: Path, wanted: Sequence[str] = ()) -> VariableColumns:
    """Read a MAT file of version 7.3, or any HDF5 file with columns, as :func:`read_mat` does."""
    h5py = load_optional("h5py", f"{path}: a MAT file of version 7.3 (HDF5)")
    size = path.stat().st_size
    try:
        with h5py.File(path, "r") as file:
            reader = _Hdf5(file, lambda dtype: h5py.check_ref_dtype(dtype) is h5py.Reference, size)
            parts = {name: reader.part(name, item) for name, item in file.items() if name[0] != "#"}
    except ImplausibleError:
        raise
    except (OSError, RuntimeError, ValueError, KeyError) as error:
        raise TableError(f"{path}: expected an HDF5 file, found one that cannot be read: {error}") from error
    return table_of(path, variables_of(parts), wanted)


def write_mat(stream: Stream, t: FloatArray, values: FloatArray, out: Path) -> None:
    """Write ``t`` (n, 1) and each signal (n, width) as variables of a MAT file of version 5."""
    from scipy.io import savemat

    variables = {signal.name: values[:, stream.columns_of(signal.name)] for signal in stream.signals}
    with out.open("wb") as file:
        savemat(file, {"t": t[:, None], **variables}, long_field_names=True, do_compression=True)


def _objects_of(workspace: Any) -> Objects | None:
    """The objects of a MAT file of version 5, which stand in a variable that is such a file itself."""
    from scipy.io import loadmat

    if not isinstance(workspace, np.ndarray) or workspace.dtype != np.uint8:
        return None
    inner = workspace.tobytes()
    order = "<" if inner[2:4] == b"IM" else ">"
    try:
        _, size = struct.unpack_from(f"{order}II", inner, 8)
        # its head has 8 bytes in place of 128; of its elements the first holds the objects
        content = b" " * 124 + inner[:4] + inner[8 : 16 + size]
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            whole = loadmat(BytesIO(content), struct_as_record=False)["__function_workspace__"]
        cells = whole[0, 0].MCOS.ravel()[0]["arr"].ravel(order="F")
        objects = Objects(cells[0].tobytes(), lambda number: _cell_of(cells, number, objects), order)
    except Exception:  # noqa: BLE001 - scipy raises almost anything; objects are named with what to do
        return None
    return objects


def _cell_of(cells: Any, number: int, objects: Objects) -> Part:
    value = cells[number]
    if isinstance(value, np.ndarray) and value.dtype.kind == "c":
        value = value.real  # a datetime: beside its milliseconds there is what they lack
    return objects.resolved(_part("", value))


def _object(name: str, kind: str, reference: Any, objects: Objects | None) -> Part:
    """An object as a struct; why it is none, and what to do in MATLAB, where it cannot be read."""
    if objects is not None and reference is not None:
        try:
            return _or_advice(name, kind, objects.part(reference))
        except UnknownObjectError:
            pass
    return Part(reason=advice(name, kind))


def _or_advice(name: str, kind: str, part: Part) -> Part:
    """An object's part, or what to do in MATLAB where it holds no numbers at all."""
    if part.array is None and not any(v.array is not None for v in variables_of({name: part})):
        return Part(reason=advice(name, kind))
    return part


def _claimed_bytes(path: Path) -> int:
    """Bytes that the variables of a MAT file would take as numbers."""
    from scipy.io import whosmat

    try:
        variables = whosmat(path)
    except TypeError:  # scipy finds no shape for MATLAB's objects: the bounds of the reader's process remain
        return 0
    return sum(8 * math.prod(shape) for _, shape, _ in variables)


def _part(name: str, value: Any, objects: Objects | None = None) -> Part:
    """What scipy read as the variable ``name``, or as a part of it."""
    if hasattr(value, "_fieldnames"):
        inner = {key: getattr(value, key) for key in value._fieldnames}
        return Part(fields={key: _part(f"{name}.{key}", field, objects) for key, field in inner.items()})
    if not isinstance(value, np.ndarray):
        return Part(reason="a sparse matrix" if hasattr(value, "toarray") else type(value).__name__)
    if type(value).__name__ == "MatlabOpaque" and value.size:
        opaque = value.ravel()[0]
        return _object(name, _decode(opaque["s2"]), opaque["arr"], objects)
    if value.dtype == object and value.size:
        return _elements(name, list(value.ravel(order="F")), objects)
    if value.dtype.kind in NUMBERS:
        return Part(array=np.atleast_2d(np.asarray(value, dtype=np.float64)))
    text = "".join(value.ravel().tolist())[:MOST_TEXT] if value.dtype.kind in "US" else ""
    reasons = {"c": "complex numbers", "O": "empty", "U": "text", "S": "text", "V": "a MATLAB object"}
    return Part(reason=reasons.get(value.dtype.kind, f"numpy's {value.dtype}"), text=text)


def _elements(name: str, values: Sequence[Any], objects: Objects | None) -> Part:
    """A struct, a struct array or a cell; of many elements no more than tell that they are too many."""
    cell = not all(hasattr(element, "_fieldnames") for element in values)
    single = not cell and len(values) == 1
    paths = (
        name if single else f"{name}{{{k}}}" if cell else f"{name}({k})" for k in range(1, MOST_PARTS + 2)
    )
    parts = [_part(path, element, objects) for path, element in zip(paths, values, strict=False)]
    if cell:
        return Part(elements=parts, braces="{}")
    return parts[0] if single else Part(elements=parts)


class _Hdf5:
    """Takes an HDF5 file of ``size`` bytes apart.

    ``references`` says whether a dataset's elements point to others.
    """

    def __init__(self, file: Any, references: Callable[[Any], bool], size: int) -> None:
        self._file = file
        self._references = references
        self._size = size
        self._claimed = 0
        self._left = MOST_PARTS_IN_ALL
        self._within = 0
        self._objects = self._find_objects()

    def _find_objects(self) -> Objects | None:
        """The objects of the file; None where it has none, or they cannot be read."""
        cells = self._file.get("#subsystem#/MCOS")
        if cells is None or not hasattr(cells, "dtype") or not self._references(cells.dtype):
            return None
        try:
            references = self._values("#subsystem#", cells).ravel()
            metadata = np.asarray(self._values("#subsystem#", self._file[references[0]]), dtype=np.uint8)
            return Objects(metadata.tobytes(), lambda number: self._cell(references[number]))
        except (UnknownObjectError, IndexError, ValueError, KeyError, OSError, RuntimeError, TypeError):
            return None

    def _cell(self, reference: Any) -> Part:
        self._within += 1
        try:
            part = self.part("", self._file[reference])
            return part if self._objects is None else self._objects.resolved(part)
        finally:
            self._within -= 1

    def part(self, name: str, item: Any) -> Part:
        """The variable ``name``, or a part of it."""
        self._left -= 1
        if self._left < 0:  # parts may point to one another without an end
            return Part(reason=f"more than {MOST_PARTS_IN_ALL} parts in the file")
        kind = _decode(item.attrs.get("MATLAB_class", b""))
        if "MATLAB_object_decode" in item.attrs and kind not in IN_WORDS:
            plain = hasattr(item, "dtype") and item.dtype.kind in "iu"
            reference = self._values(name, item) if plain else None
            return _object(name, kind, reference, self._objects)
        if not hasattr(item, "dtype"):
            return _struct({key: self.part(name, inner) for key, inner in item.items()})
        return self._dataset(name, item, kind)

    def _dataset(self, name: str, item: Any, kind: str) -> Part:
        if "MATLAB_empty" in item.attrs or not item.shape or not item.size:
            return Part(reason="empty")
        if self._references(item.dtype):
            inner = self._values(name, item).ravel()[: MOST_PARTS + 1]
            parts = [
                self.part(name, self._file[reference]) if reference else Part(reason="empty")
                for reference in inner
            ]
            return Part(elements=parts, braces="{}" if kind == "cell" else "()")
        if self._within and item.dtype.names == ("real", "imag"):
            return Part(array=np.atleast_2d(self._values(name, item)["real"].T))
        if item.dtype.kind not in NUMBERS or kind in IN_WORDS:
            text = "".join(map(chr, self._values(name, item).ravel()[:MOST_TEXT])) if kind == "char" else ""
            return Part(reason=IN_WORDS.get(kind, f"HDF5's {item.dtype}"), text=text)
        value = np.asarray(self._values(name, item), dtype=np.float64)
        # MATLAB writes its columns as HDF5's rows
        turned = value.T if kind or value.ndim > 2 else value
        return Part(array=turned[:, None] if turned.ndim == 1 else turned)

    def _values(self, name: str, item: Any) -> Any:
        """Read a dataset; ImplausibleError where all those read claim more than the file can hold."""
        self._claimed += 8 * math.prod(item.shape)
        refuse_claim(f"the dataset {name!r}", self._claimed, self._size)
        return item[()]


def _struct(fields: Mapping[str, Part]) -> Part:
    """A struct; an array of them where every field has as many elements, as version 7.3 keeps those."""
    counts = {len(part.elements) if part.braces == "()" else 0 for part in fields.values()}
    if len(counts) != 1 or counts == {0}:
        return Part(fields=fields)
    rows = zip(*(part.elements for part in fields.values()), strict=True)
    return Part(elements=[Part(fields=dict(zip(fields, row, strict=True))) for row in rows])


def _decode(text: Any) -> str:
    return text.decode("utf-8", "replace") if isinstance(text, bytes) else str(text)

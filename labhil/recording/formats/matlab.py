"""MAT files: versions 4 to 7 by scipy, version 7.3 and other HDF5 files by h5py."""

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
from labhil.recording.formats.matlab_objects import list_objects, list_references, object_advice
from labhil.recording.formats.variables import MAX_ELEMENTS, Node, VariableColumns, list_variables, make_table
from labhil.signals import FloatArray, Stream

REAL_KINDS = "iufb"
"""numpy's kinds of real numbers."""

NON_NUMERIC_CLASSES = {
    "char": "text",
    "cell": "a cell array",
    "function_handle": "a function",
    "string": "text",
}
"""MATLAB classes that version 7.3 stores as numbers though they are none, as messages call them."""

MAX_NODES = 10_000
"""Largest number of nodes of a file that are read; logs have some hundreds."""

MAX_LABEL_LENGTH = 256
"""Characters of a label."""


def read_mat(path: Path, wanted: Sequence[str] = ()) -> VariableColumns:
    """Read a MAT file of version 4 to 7.

    A variable is a column; a matrix is several columns ``name_0`` …. The fields of a struct are variables
    ``struct.field``, those of a struct array ``array(1).field``.

    Args:
        path: the file.
        wanted: names of columns, whose length is the table's.

    Returns:
        The table.

    Raises:
        TableError: The file cannot be read, or has no columns.
    """
    from scipy.io import loadmat

    try:
        with warnings.catch_warnings():
            # scipy calls every object "None"; list_objects finds their names
            warnings.filterwarnings("ignore", 'Duplicate variable name "None"')
            refuse_claim("the file", _claimed_bytes(path), path.stat().st_size)
            variables: dict[str, Any] = loadmat(path, struct_as_record=False)
    except (ImplausibleError, MemoryError):
        raise
    except Exception as error:  # a cut MAT file makes scipy raise almost anything
        raise TableError(f"{path}: expected a MAT file, found one that cannot be read: {error}") from error
    content = path.read_bytes()
    objects = _read_objects(variables.get("__function_workspace__"))
    nodes = {
        name: _node(name, value, objects)
        for name, value in variables.items()
        if not name.startswith("_") and type(value).__name__ != "MatlabOpaque"
    }
    references = list_references(content)
    nodes |= {
        name: _object_node(name, kind, references.get(name), objects) for name, kind in list_objects(content)
    }
    return make_table(path, list_variables(nodes), wanted)


def read_hdf5(path: Path, wanted: Sequence[str] = ()) -> VariableColumns:
    """Read a MAT file of version 7.3, or any HDF5 file with columns.

    Args:
        path: the file.
        wanted: names of columns, whose length is the table's.

    Returns:
        The table, as :func:`read_mat` makes it.

    Raises:
        TableError: The file cannot be read, or has no columns.
        MissingExtraError: h5py is not installed.
    """
    h5py = load_optional("h5py", f"{path}: a MAT file of version 7.3 (HDF5)")
    size = path.stat().st_size
    try:
        with h5py.File(path, "r") as file:
            reader = _Hdf5(file, lambda dtype: h5py.check_ref_dtype(dtype) is h5py.Reference, size)
            nodes = {name: reader.node(name, item) for name, item in file.items() if name[0] != "#"}
    except ImplausibleError:
        raise
    except (OSError, RuntimeError, ValueError, KeyError) as error:
        raise TableError(f"{path}: expected an HDF5 file, found one that cannot be read: {error}") from error
    return make_table(path, list_variables(nodes), wanted)


def write_mat(stream: Stream, t: FloatArray, values: FloatArray, out: Path) -> None:
    """Write ``t`` (n, 1) and each signal (n, width) as variables of a MAT file of version 5."""
    from scipy.io import savemat

    variables = {signal.name: values[:, stream.columns_of(signal.name)] for signal in stream.signals}
    with out.open("wb") as file:
        savemat(file, {"t": t[:, None], **variables}, long_field_names=True, do_compression=True)


def _read_objects(workspace: Any) -> Objects | None:
    """Objects of a MAT file of version 5, in a variable that is itself such a file; None without them."""
    from scipy.io import loadmat

    if not isinstance(workspace, np.ndarray) or workspace.dtype != np.uint8:
        return None
    inner = workspace.tobytes()
    order = "<" if inner[2:4] == b"IM" else ">"
    try:
        _, size = struct.unpack_from(f"{order}II", inner, 8)
        # its head has 8 bytes instead of 128; the first of its elements contains the objects
        content = b" " * 124 + inner[:4] + inner[8 : 16 + size]
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            loaded = loadmat(BytesIO(content), struct_as_record=False)["__function_workspace__"]
        cells = loaded[0, 0].MCOS.ravel()[0]["arr"].ravel(order="F")
        objects = Objects(cells[0].tobytes(), lambda number: _cell_node(cells, number, objects), order)
    except Exception:  # noqa: BLE001 - scipy raises almost anything; messages then advise a conversion
        return None
    return objects


def _cell_node(cells: Any, number: int, objects: Objects) -> Node:
    value = cells[number]
    if isinstance(value, np.ndarray) and value.dtype.kind == "c":
        value = value.real  # a datetime: the imaginary part is the rounding error of its milliseconds
    return objects.resolve(_node("", value))


def _object_node(name: str, kind: str, reference: Any, objects: Objects | None) -> Node:
    """Node of an object as a struct; if it cannot be read, a node with advice to convert it."""
    advice = Node(reason=object_advice(name, kind))
    if objects is None or reference is None:
        return advice
    try:
        return _node_or_advice(name, kind, objects.node(reference))
    except UnknownObjectError:
        return advice


def _node_or_advice(name: str, kind: str, node: Node) -> Node:
    """Node of an object; if it contains no numbers, a node with advice to convert it."""
    if node.array is None and not any(v.array is not None for v in list_variables({name: node})):
        return Node(reason=object_advice(name, kind))
    return node


def _claimed_bytes(path: Path) -> int:
    """Size of the variables of a MAT file as numbers, bytes."""
    from scipy.io import whosmat

    try:
        variables = whosmat(path)
    except TypeError:  # scipy finds no shape of MATLAB objects; the limits of the reader's process remain
        return 0
    return sum(8 * math.prod(shape) for _, shape, _ in variables)


def _node(name: str, value: Any, objects: Objects | None = None) -> Node:
    """Node of what scipy read as ``name``."""
    if hasattr(value, "_fieldnames"):
        inner = {key: getattr(value, key) for key in value._fieldnames}
        return Node(fields={key: _node(f"{name}.{key}", field, objects) for key, field in inner.items()})
    if not isinstance(value, np.ndarray):
        return Node(reason="a sparse matrix" if hasattr(value, "toarray") else type(value).__name__)
    if type(value).__name__ == "MatlabOpaque" and value.size:
        opaque = value.ravel()[0]
        return _object_node(name, _decode(opaque["s2"]), opaque["arr"], objects)
    if value.dtype == object and value.size:
        return _elements(name, list(value.ravel(order="F")), objects)
    if value.dtype.kind in REAL_KINDS:
        return Node(array=np.atleast_2d(np.asarray(value, dtype=np.float64)))
    text = "".join(value.ravel().tolist())[:MAX_LABEL_LENGTH] if value.dtype.kind in "US" else ""
    reasons = {"c": "complex numbers", "O": "empty", "U": "text", "S": "text", "V": "a MATLAB object"}
    return Node(reason=reasons.get(value.dtype.kind, f"numpy's {value.dtype}"), text=text)


def _elements(name: str, values: Sequence[Any], objects: Objects | None) -> Node:
    """Node of a struct, struct array or cell, with at most one element more than are allowed."""
    cell = not all(hasattr(element, "_fieldnames") for element in values)
    single = not cell and len(values) == 1
    paths = (
        name if single else f"{name}{{{k}}}" if cell else f"{name}({k})" for k in range(1, MAX_ELEMENTS + 2)
    )
    nodes = [_node(path, element, objects) for path, element in zip(paths, values, strict=False)]
    if cell:
        return Node(elements=nodes, braces="{}")
    return nodes[0] if single else Node(elements=nodes)


class _Hdf5:
    """Reader of an HDF5 file of ``size`` bytes; ``references`` checks if a dataset's type is references."""

    def __init__(self, file: Any, references: Callable[[Any], bool], size: int) -> None:
        self._file = file
        self._references = references
        self._size = size
        self._claimed = 0
        self._nodes_left = MAX_NODES
        self._object_depth = 0
        self._objects = self._read_objects()

    def _read_objects(self) -> Objects | None:
        """Objects of the file; None if there are none, or they cannot be read."""
        cells = self._file.get("#subsystem#/MCOS")
        if cells is None or not hasattr(cells, "dtype") or not self._references(cells.dtype):
            return None
        try:
            references = self._values("#subsystem#", cells).ravel()
            metadata = np.asarray(self._values("#subsystem#", self._file[references[0]]), dtype=np.uint8)
            return Objects(metadata.tobytes(), lambda number: self._cell_node(references[number]))
        except (UnknownObjectError, IndexError, ValueError, KeyError, OSError, RuntimeError, TypeError):
            return None

    def _cell_node(self, reference: Any) -> Node:
        self._object_depth += 1
        try:
            node = self.node("", self._file[reference])
            return node if self._objects is None else self._objects.resolve(node)
        finally:
            self._object_depth -= 1

    def node(self, name: str, item: Any) -> Node:
        """Node of the group or dataset ``item``."""
        self._nodes_left -= 1
        if self._nodes_left < 0:  # references may be circular
            return Node(reason=f"more than {MAX_NODES} parts in the file")
        kind = _decode(item.attrs.get("MATLAB_class", b""))
        if "MATLAB_object_decode" in item.attrs and kind not in NON_NUMERIC_CLASSES:
            is_reference = hasattr(item, "dtype") and item.dtype.kind in "iu"
            reference = self._values(name, item) if is_reference else None
            return _object_node(name, kind, reference, self._objects)
        if not hasattr(item, "dtype"):
            return _struct({key: self.node(name, inner) for key, inner in item.items()})
        return self._dataset(name, item, kind)

    def _dataset(self, name: str, item: Any, kind: str) -> Node:
        if "MATLAB_empty" in item.attrs or not item.shape or not item.size:
            return Node(reason="empty")
        if self._references(item.dtype):
            inner = self._values(name, item).ravel()[: MAX_ELEMENTS + 1]
            nodes = [
                self.node(name, self._file[reference]) if reference else Node(reason="empty")
                for reference in inner
            ]
            return Node(elements=nodes, braces="{}" if kind == "cell" else "()")
        if self._object_depth and item.dtype.names == ("real", "imag"):
            return Node(array=np.atleast_2d(self._values(name, item)["real"].T))
        if item.dtype.kind not in REAL_KINDS or kind in NON_NUMERIC_CLASSES:
            text = (
                "".join(map(chr, self._values(name, item).ravel()[:MAX_LABEL_LENGTH]))
                if kind == "char"
                else ""
            )
            return Node(reason=NON_NUMERIC_CLASSES.get(kind, f"HDF5's {item.dtype}"), text=text)
        value = np.asarray(self._values(name, item), dtype=np.float64)
        # MATLAB writes its columns as HDF5's rows
        turned = value.T if kind or value.ndim > 2 else value
        return Node(array=turned[:, None] if turned.ndim == 1 else turned)

    def _values(self, name: str, item: Any) -> Any:
        """Read a dataset; ImplausibleError if all datasets claim more than the file can contain."""
        self._claimed += 8 * math.prod(item.shape)
        refuse_claim(f"the dataset {name!r}", self._claimed, self._size)
        return item[()]


def _struct(fields: Mapping[str, Node]) -> Node:
    """Node of a struct, or of a struct array, whose fields version 7.3 stores as arrays of equal length."""
    counts = {len(node.elements) if node.braces == "()" else 0 for node in fields.values()}
    if len(counts) != 1 or counts == {0}:
        return Node(fields=fields)
    rows = zip(*(node.elements for node in fields.values()), strict=True)
    return Node(elements=[Node(fields=dict(zip(fields, row, strict=True))) for row in rows])


def _decode(text: Any) -> str:
    return text.decode("utf-8", "replace") if isinstance(text, bytes) else str(text)

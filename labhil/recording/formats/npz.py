"""Reader of NumPy archives (NPZ): trajectories and time series of mujoco.sysid, and archives of plain arrays.

A trajectory contains ``control``, ``sensordata`` and optionally ``state``, each with its own times and a
mapping of names to columns. A column is named ``sensordata.NAME`` or just ``NAME``; a signal of several
numbers has ``NAME[0]``, ``NAME[1]`` and so on.
"""

from __future__ import annotations

import json
import zipfile
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from labhil.bounds import refuse_claim
from labhil.errors import TableError
from labhil.recording.formats.bag import BagColumns, find_topics, make_columns
from labhil.recording.formats.bag_messages import FieldPath, MessageGroup
from labhil.recording.formats.columns import Columns
from labhil.recording.formats.variables import Node, list_variables, make_table
from labhil.signals import FloatArray

GROUPS = ("sensordata", "control", "state")
"""Groups of a trajectory of mujoco.sysid; the first one is the rows unless columns of others are wanted."""

SERIES_GROUP = "data"
"""Name of the only group of a time series."""

SUFFIXES = ("_ctrl", "_qpos", "_qvel", "_act")
"""Suffixes that mujoco.sysid adds to the names of actuators and joints; optional in names of columns."""

MAX_WIDTH = 4096
"""Largest number of columns of a group; models have some hundreds."""

REAL_KINDS = "iufb"
"""numpy's kinds of real numbers."""


@dataclass(frozen=True)
class SysidColumns(BagColumns):
    """Columns of a trajectory or a time series of mujoco.sysid, at the times of one of its groups."""

    row_word = "sample"
    bare_paths = True

    @property
    def notes(self) -> tuple[str, ...]:
        """Lines about the group that is the rows, and resampled groups."""
        others = tuple(
            f"{name} has times of its own: its values are taken at those" for name in sorted(self.used)
        )
        return (f"rows are the samples of {self.base.topic}; without a channel t the time is theirs", *others)

    def find(self, name: str) -> tuple[int, ...]:
        """Find columns by name, with or without a suffix of mujoco.sysid."""
        exact = super().find(name)
        return exact or tuple(
            column for suffix in SUFFIXES for column in super(SysidColumns, self).find(f"{name}{suffix}")
        )


def is_npz(path: Path) -> bool:
    """Whether a ZIP file contains NumPy arrays and nothing else."""
    try:
        with zipfile.ZipFile(path) as file:
            names = file.namelist()
    except (zipfile.BadZipFile, OSError, ValueError, NotImplementedError):
        return False
    return bool(names) and all(name.endswith(".npy") for name in names)


def read_npz(path: Path, wanted: Sequence[str]) -> Columns:
    """Read a NumPy archive.

    Args:
        path: the file.
        wanted: names of columns; the group of the first one is the rows.

    Returns:
        The table.

    Raises:
        TableError: The archive cannot be read, or has no columns.
    """
    arrays, skipped = _read_arrays(path)
    if {"times", "data"} <= arrays.keys():
        groups = [
            _make_group(path, SERIES_GROUP, arrays["times"], arrays["data"], arrays.get("signal_mapping"))
        ]
    else:
        groups = [
            _make_group(
                path,
                name,
                arrays[f"{name}_times"],
                arrays[f"{name}_data"],
                arrays.get(f"{name}_signal_mapping"),
            )
            for name in GROUPS
            if {f"{name}_times", f"{name}_data"} <= arrays.keys()
        ]
    if not groups:
        nodes = {name: _node(array) for name, array in arrays.items()}
        return make_table(
            path, list_variables(nodes | {name: Node(reason=why) for name, why in skipped.items()}), wanted
        )
    available = [(group.topic, field_path) for group in groups for field_path in group.values]
    first = find_topics([*wanted, *(f"{n}{s}" for n in wanted for s in SUFFIXES)], available, True)[:1]
    base, *others = sorted(groups, key=lambda group: group.topic not in first)
    aligned = [replace(group, received=_align_times(group.received, base.received)) for group in others]
    return make_columns(path, [base, *aligned], wanted, kind=SysidColumns)


def _align_times(times: FloatArray, others: FloatArray, rounding: float = 1e-6) -> FloatArray:
    """Replace times by those of ``others`` that differ by rounding, so that held controls begin with these.

    MuJoCo adds up its time steps, controls have multiples of them. Sums of a million steps are exact to 1e-8
    of a step; ``rounding`` is a fraction of a step, too.
    """
    if len(others) < 2:
        return times
    index = np.clip(np.searchsorted(others, times), 1, len(others) - 1)
    near = np.where(times - others[index - 1] < others[index] - times, others[index - 1], others[index])
    aligned: FloatArray = np.where(np.abs(near - times) <= rounding * np.median(np.diff(others)), near, times)
    return aligned


def _read_arrays(path: Path) -> tuple[dict[str, Any], dict[str, str]]:
    """Arrays of an archive, and reasons for members that are not read."""
    arrays: dict[str, Any] = {}
    skipped: dict[str, str] = {}
    try:
        with zipfile.ZipFile(path) as archive_file:
            size = path.stat().st_size
            refuse_claim("the archive", sum(entry.file_size for entry in archive_file.infolist()), size)
        with np.load(path, allow_pickle=False) as archive:
            for name in archive.files:
                try:
                    arrays[name] = archive[name]
                except ValueError as error:  # objects are in pickle, which runs code
                    skipped[name] = str(error)
    except (zipfile.BadZipFile, OSError, EOFError, KeyError, NotImplementedError, SyntaxError) as error:
        raise TableError(
            f"{path}: expected an archive of NumPy's (NPZ), found one that cannot be read: {error}"
        ) from error
    return arrays, skipped


def _node(array: Any) -> Node:
    if array.dtype.kind not in REAL_KINDS or not array.ndim:
        return Node(
            reason="a number by itself" if array.dtype.kind in REAL_KINDS else f"NumPy's {array.dtype}"
        )
    upright = array[:, None] if array.ndim == 1 else array
    # the first axis is the samples; with more than two axes make_table takes the last one, so make it two
    return Node(array=np.asarray(upright.reshape(len(upright), -1), dtype=np.float64))


def _make_group(path: Path, name: str, times: Any, data: Any, mapping: Any) -> MessageGroup:
    """A group with its times and named columns."""
    where = "" if name == SERIES_GROUP else f"{name}_"
    if times.dtype.kind not in REAL_KINDS or data.dtype.kind not in REAL_KINDS:
        raise TableError(
            f"{path}: expected numbers in {where}times and {where}data, found {times.dtype} and {data.dtype}"
        )
    values = np.asarray(data[:, None] if data.ndim == 1 else data, dtype=np.float64)
    if times.ndim != 1 or values.ndim != 2 or len(values) != len(times) or values.shape[1] > MAX_WIDTH:
        raise TableError(
            f"{path}: expected {where}times of shape (n,) and {where}data of shape (n, at most {MAX_WIDTH}), "
            f"found {times.shape} and {data.shape}"
        )
    seconds = np.asarray(times, dtype=np.float64)
    if name == "state" and values.shape[1] and np.array_equal(values[:, 0], seconds):
        values = values[:, 1:]  # MuJoCo's states begin with the time; the names do not count it
    columns = dict(_named_columns(path, f"{where}signal_mapping", mapping, values))
    return MessageGroup(name, np.arange(len(seconds)), seconds, columns, {})


def _named_columns(
    path: Path, what: str, mapping: Any, values: FloatArray
) -> Iterator[tuple[FieldPath, FloatArray]]:
    """Columns by name; those without a name by index."""
    unnamed = set(range(values.shape[1]))
    for name, indices in _parse_mapping(path, what, mapping).items():
        if any(index >= values.shape[1] for index in indices):
            raise TableError(
                f"{path}: {what}: {name}: expected indices from 0 to {values.shape[1] - 1}, found {indices}"
            )
        for number, index in enumerate(indices):
            yield ((name,) if len(indices) == 1 else (name, number)), values[:, index]
        unnamed -= set(indices)
    for index in sorted(unnamed):
        yield (str(index),), values[:, index]


def _parse_mapping(path: Path, what: str, mapping: Any) -> Mapping[str, list[int]]:
    """Indices of columns by name, from the JSON ``{name: [kind, [index, …]]}`` of mujoco.sysid."""
    if mapping is None:
        return {}
    try:
        stated = json.loads(str(mapping))
        read = {name: [int(index) for index in indices] for name, (_, indices) in stated.items()}
    except (ValueError, TypeError, AttributeError, RecursionError, OverflowError) as error:
        raise TableError(
            f'{path}: {what}: expected JSON of {{"NAME": [kind, [index, …]]}}, found what cannot be read: '
            f"{error}"
        ) from error
    if any(index < 0 for indices in read.values() for index in indices):
        raise TableError(f"{path}: {what}: expected indices from 0, found negative ones")
    return read

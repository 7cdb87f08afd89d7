"""NumPy archives (NPZ): trajectories and time series that mujoco.sysid saved, and archives of plain arrays.

A trajectory holds ``control``, ``sensordata`` and perhaps ``state``, each with times of its own and a mapping
of names to columns. A column is ``sensordata.NAME`` or just ``NAME``; a signal of several numbers has
``NAME[0]``, ``NAME[1]`` and so on.
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
from labhil.recording.formats.bag import BagColumns, columns_of, topics_of
from labhil.recording.formats.bag_messages import Source, Way
from labhil.recording.formats.columns import Columns
from labhil.recording.formats.variables import Part, table_of, variables_of
from labhil.signals import FloatArray

GROUPS = ("sensordata", "control", "state")
"""What a trajectory of mujoco.sysid holds; the first gives the rows unless others are asked for."""

SERIES = "data"
"""What stands for the group of a time series, which has no others beside it."""

SUFFIXES = ("_ctrl", "_qpos", "_qvel", "_act")
"""What mujoco.sysid adds to the name of an actuator or a joint; it may be left out."""

WIDEST = 4096
"""Columns of one group; models have some hundreds."""

ROUNDING = 1e-6
"""Of a step; times that differ by less are one. Sums of a million time steps are exact to 1e-8 of one."""

NUMBERS = "iufb"


@dataclass(frozen=True)
class SysidColumns(BagColumns):
    """Columns of a trajectory or a time series of mujoco.sysid, at the times of one of its groups."""

    row_word = "sample"
    bare_paths = True

    @property
    def notes(self) -> tuple[str, ...]:
        """Which group gives the rows and the time, and what was taken from others."""
        others = tuple(
            f"{name} has times of its own: its values are taken at those" for name in sorted(self.used)
        )
        return (f"rows are the samples of {self.base.topic}; without a channel t the time is theirs", *others)

    def find(self, source: str) -> tuple[int, ...]:
        """The numbers of the columns that bear this name, or the name with a suffix of mujoco.sysid."""
        found = super().find(source)
        return found or tuple(
            place for suffix in SUFFIXES for place in super(SysidColumns, self).find(f"{source}{suffix}")
        )


def is_npz(path: Path) -> bool:
    """Whether a zipped file holds NumPy's arrays and nothing else."""
    try:
        with zipfile.ZipFile(path) as file:
            names = file.namelist()
    except (zipfile.BadZipFile, OSError, ValueError, NotImplementedError):
        return False
    return bool(names) and all(name.endswith(".npy") for name in names)


def read_npz(path: Path, wanted: Sequence[str]) -> Columns:
    """Read an archive.

    Args:
        path: The file.
        wanted: Names of columns that the rig file asks for.

    Raises:
        TableError: It cannot be read, or holds no columns.
    """
    arrays, odd = _arrays(path)
    if {"times", "data"} <= arrays.keys():
        groups = [_group(path, SERIES, arrays["times"], arrays["data"], arrays.get("signal_mapping"))]
    else:
        groups = [
            _group(
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
        parts = {name: _part(array) for name, array in arrays.items()}
        return table_of(
            path, variables_of(parts | {name: Part(reason=why) for name, why in odd.items()}), wanted
        )
    listed = [(group.topic, way) for group in groups for way in group.values]
    first = topics_of([*wanted, *(f"{n}{s}" for n in wanted for s in SUFFIXES)], listed, True)[:1]
    base, *others = sorted(groups, key=lambda group: group.topic not in first)
    aligned = [replace(group, received=_aligned(group.received, base.received)) for group in others]
    return columns_of(path, [base, *aligned], wanted, kind=SysidColumns)


def _aligned(times: FloatArray, others: FloatArray) -> FloatArray:
    """Times, where one of ``others`` differs by rounding that one: a held control begins just then.

    MuJoCo adds up its time steps, controls have multiples of them.
    """
    if len(others) < 2:
        return times
    place = np.clip(np.searchsorted(others, times), 1, len(others) - 1)
    near = np.where(times - others[place - 1] < others[place] - times, others[place - 1], others[place])
    aligned: FloatArray = np.where(np.abs(near - times) <= ROUNDING * np.median(np.diff(others)), near, times)
    return aligned


def _arrays(path: Path) -> tuple[dict[str, Any], dict[str, str]]:
    """The arrays of an archive, and why others are none."""
    arrays: dict[str, Any] = {}
    odd: dict[str, str] = {}
    try:
        with zipfile.ZipFile(path) as packed:
            size = path.stat().st_size
            refuse_claim("the archive", sum(entry.file_size for entry in packed.infolist()), size)
        with np.load(path, allow_pickle=False) as archive:
            for name in archive.files:
                try:
                    arrays[name] = archive[name]
                except ValueError as error:  # objects, which only pickle can read: that would run code
                    odd[name] = str(error)
    except (zipfile.BadZipFile, OSError, EOFError, KeyError, NotImplementedError, SyntaxError) as error:
        raise TableError(
            f"{path}: expected an archive of NumPy's (NPZ), found one that cannot be read: {error}"
        ) from error
    return arrays, odd


def _part(array: Any) -> Part:
    if array.dtype.kind not in NUMBERS or not array.ndim:
        return Part(reason="a number by itself" if array.dtype.kind in NUMBERS else f"NumPy's {array.dtype}")
    upright = array[:, None] if array.ndim == 1 else array
    # of more than two axes the last counts the samples in other files; in NumPy's it is the first
    return Part(array=np.asarray(upright.reshape(len(upright), -1), dtype=np.float64))


def _group(path: Path, name: str, times: Any, data: Any, mapping: Any) -> Source:
    """One group with its times and the names of its columns."""
    where = "" if name == SERIES else f"{name}_"
    if times.dtype.kind not in NUMBERS or data.dtype.kind not in NUMBERS:
        raise TableError(
            f"{path}: expected numbers in {where}times and {where}data, found {times.dtype} and {data.dtype}"
        )
    values = np.asarray(data[:, None] if data.ndim == 1 else data, dtype=np.float64)
    if times.ndim != 1 or values.ndim != 2 or len(values) != len(times) or values.shape[1] > WIDEST:
        raise TableError(
            f"{path}: expected {where}times of shape (n,) and {where}data of shape (n, at most {WIDEST}), "
            f"found {times.shape} and {data.shape}"
        )
    seconds = np.asarray(times, dtype=np.float64)
    if name == "state" and values.shape[1] and np.array_equal(values[:, 0], seconds):
        values = values[:, 1:]  # MuJoCo's states begin with the time; the names do not count it
    columns = dict(_named(path, f"{where}signal_mapping", mapping, values))
    return Source(name, np.arange(len(seconds)), seconds, columns, {})


def _named(path: Path, what: str, mapping: Any, values: FloatArray) -> Iterator[tuple[Way, FloatArray]]:
    """The columns by their names; those that have none by their places."""
    left = set(range(values.shape[1]))
    for name, places in _mapping(path, what, mapping).items():
        if any(place >= values.shape[1] for place in places):
            raise TableError(
                f"{path}: {what}: {name}: expected places from 0 to {values.shape[1] - 1}, found {places}"
            )
        for number, place in enumerate(places):
            yield ((name,) if len(places) == 1 else (name, number)), values[:, place]
        left -= set(places)
    for place in sorted(left):
        yield (str(place),), values[:, place]


def _mapping(path: Path, what: str, mapping: Any) -> Mapping[str, list[int]]:
    """Names and places: JSON of ``{name: [kind, [place, …]]}``, as mujoco.sysid keeps them."""
    if mapping is None:
        return {}
    try:
        stated = json.loads(str(mapping))
        read = {name: [int(place) for place in places] for name, (_, places) in stated.items()}
    except (ValueError, TypeError, AttributeError, RecursionError, OverflowError) as error:
        raise TableError(
            f'{path}: {what}: expected JSON of {{"NAME": [kind, [place, …]]}}, found what cannot be read: '
            f"{error}"
        ) from error
    if any(place < 0 for places in read.values() for place in places):
        raise TableError(f"{path}: {what}: expected places from 0, found negative ones")
    return read

"""Reader of LeRobot datasets of versions 2 and 3, by pyarrow: one episode, with the dataset's names.

A dataset is a folder with ``meta/info.json`` and Parquet files below ``data``: one for each episode (version
2), or with several episodes in each (version 3). A list such as ``observation.state`` has a column for each
number. Videos and images are not read. A single Parquet file of a dataset is read in the same way.
"""

from __future__ import annotations

import json
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from labhil.bounds import refuse_claim
from labhil.errors import TableError
from labhil.extras import load_optional
from labhil.recording.formats.parquet import read_parquet
from labhil.recording.formats.variables import VariableColumns
from labhil.rig_sections import Table
from labhil.signals import FloatArray
from labhil.terminal import printable_name

EPISODE = "episode_index"
FRAME_COLUMNS = (EPISODE, "frame_index", "timestamp")
"""Columns of each Parquet file of a LeRobot dataset."""

MAX_INFO_SIZE = 16 << 20
"""Largest size of ``meta/info.json``, bytes; the largest robots need some kB."""

MAX_LIST_LENGTH = 256
"""Longest list that becomes columns; longer ones are images."""

MAX_FILES = 100_000
"""Largest number of Parquet files of a dataset."""


@dataclass(frozen=True)
class LerobotColumns(VariableColumns):
    """Columns of an episode; its rows are the frames.

    Attributes:
        origin: line about the episode.
        files_read: files of the episode.
    """

    origin: str = ""
    files_read: tuple[Path, ...] = ()

    row_word = "frame"

    @property
    def files(self) -> tuple[Path, ...]:
        """Files of the dataset that were read."""
        return self.files_read

    @property
    def notes(self) -> tuple[str, ...]:
        """Lines about the episode and the columns that were not used."""
        return (self.origin, *super().notes)


def is_dataset(path: Path) -> bool:
    """Whether a folder is a LeRobot dataset."""
    return (path / "meta" / "info.json").is_file() and (path / "data").is_dir()


def read_parquet_or_episode(path: Path, table: Table, wanted: Sequence[str]) -> Any:
    """Read a Parquet file; if it belongs to a LeRobot dataset, one episode of it.

    Args:
        path: the file.
        table: section ``[table]`` of the rig file with the number of the episode.
        wanted: names of columns; unused.

    Returns:
        The table.

    Raises:
        TableError: The file cannot be read, or contains several episodes and ``[table]`` names none.
        MissingExtraError: pyarrow is not installed.
    """
    arrow, parquet = _load_arrow(path)
    names = set(_open(arrow, parquet, path).schema_arrow.names)
    if names >= set(FRAME_COLUMNS):
        root = path.absolute().parents[2] if len(path.absolute().parents) > 2 else path.parent
        return _Dataset(arrow, parquet, path, root, [path]).columns(table.episode)
    if table.episode is not None:
        missing = " or ".join(name for name in FRAME_COLUMNS if name not in names)
        raise TableError(
            f"{path}: expected a file of a LeRobot dataset, as [table] episode counts its episodes, found a "
            f"Parquet file without a column {missing}"
        )
    return read_parquet(path)


def read_dataset(path: Path, table: Table, wanted: Sequence[str]) -> LerobotColumns:
    """Read an episode of a dataset.

    Args:
        path: the folder.
        table: section ``[table]`` of the rig file with the number of the episode; not needed for only one.
        wanted: names of columns; unused.

    Returns:
        The table.

    Raises:
        TableError: The dataset cannot be read, has several episodes and ``[table]`` names none, or does not
            have the named one.
        MissingExtraError: pyarrow is not installed.
    """
    arrow, parquet = _load_arrow(path)
    files = sorted((path / "data").rglob("*.parquet"))
    if not files or len(files) > MAX_FILES:
        found = f"{len(files)} of them" if files else "none"
        raise TableError(f"{path}: expected Parquet files of a LeRobot dataset below data, found {found}")
    return _Dataset(arrow, parquet, path, path, files).columns(table.episode)


def _load_arrow(path: Path) -> tuple[Any, Any]:
    purpose = f"{path}: a Parquet file"
    return load_optional("pyarrow", purpose), load_optional("pyarrow.parquet", purpose)


def _open(arrow: Any, parquet: Any, path: Path) -> Any:
    try:
        return parquet.ParquetFile(path)
    except (arrow.ArrowException, OSError, ValueError) as error:
        raise TableError(
            f"{path}: expected a Parquet file, found one that cannot be read: {error}"
        ) from error


@dataclass
class _Dataset:
    """Files of a dataset below ``root``, with the modules that read them; ``path`` is for messages."""

    arrow: Any
    parquet: Any
    path: Path
    root: Path
    files: list[Path]

    def columns(self, episode: int | None) -> LerobotColumns:
        """Read an episode; the only one for None."""
        info = self._read_info()
        number = self._only_episode() if episode is None else episode
        found = [
            (file, table)
            for file in self._candidate_files(number)
            for table in self._read_frames(file, number)
        ]
        if not found:
            raise TableError(f"{self.path}: expected an episode {number}, found {self._describe_episodes()}")
        names: list[str] = []
        columns: list[FloatArray] = []
        labels: list[tuple[str, ...]] = []
        frames = self.arrow.concat_tables([table for _, table in found])
        for feature, column in zip(frames.column_names, frames.columns, strict=True):
            values = _values(self.arrow, column)
            titles = _element_names(info, feature, values.shape[1])
            for index in range(values.shape[1]):
                single = not _is_list(self.arrow, column.type)
                names.append(feature if single else f"{feature}.{titles[index]}")
                labels.append(() if single else (f"{feature}_{index}", f"{feature}[{index}]"))
                columns.append(values[:, index])
        rows = frames.num_rows
        return LerobotColumns(
            names=tuple(names),
            width=len(names),
            lines=np.arange(1, rows + 1),
            counts=np.full(rows, len(names)),
            values=columns,
            labels=tuple(labels),
            unused=self._skipped_columns(found[0][0]),
            origin=_describe_episode(info, number, rows),
            files_read=tuple(dict.fromkeys(file for file, _ in found)),
        )

    def _read_info(self) -> dict[str, Any]:
        """Content of ``meta/info.json``; empty for a file without a dataset."""
        file = self.root / "meta" / "info.json"
        if not file.is_file():
            return {}
        try:
            with file.open("rb") as stream:
                text = stream.read(MAX_INFO_SIZE + 1)
            info = json.loads(text) if len(text) <= MAX_INFO_SIZE else None
        except (OSError, ValueError, RecursionError) as error:
            raise TableError(
                f"{file}: expected the description of a LeRobot dataset, found a file that cannot be read: "
                f"{error}"
            ) from error
        if not isinstance(info, dict):
            raise TableError(f"{file}: expected the description of a LeRobot dataset, found no JSON object")
        return info

    def _candidate_files(self, number: int) -> list[Path]:
        """Files that may contain an episode; version 2 names its files by episode."""
        named = [file for file in self.files if file.name == f"episode_{number:06d}.parquet"]
        return named or self.files

    def _read_frames(self, file: Path, number: int) -> Iterator[Any]:
        """Frames of an episode in a file, row group by row group, without columns that are no numbers."""
        opened = _open(self.arrow, self.parquet, file)
        requested = [
            name
            for name, kind in zip(opened.schema_arrow.names, opened.schema_arrow.types, strict=True)
            if not _skip_reason(self.arrow, kind)
        ]
        if EPISODE not in requested:
            raise TableError(
                f"{file}: expected a file of a LeRobot dataset with a column {EPISODE}, found the columns "
                f"{', '.join(map(printable_name, opened.schema_arrow.names[:40]))}"
            )
        size = file.stat().st_size
        for group in range(opened.metadata.num_row_groups):
            least, most = _episode_range(opened, group)
            if not least <= number <= most:
                continue
            refuse_claim(
                f"{file.name}: its row group {group}", _uncompressed_size(opened, group, requested), size
            )
            try:
                table = opened.read_row_group(group, requested)
            except (self.arrow.ArrowException, OSError, ValueError) as error:
                raise TableError(
                    f"{file}: expected a Parquet file, found one that cannot be read: {error}"
                ) from error
            episodes = np.array(table[EPISODE].cast(self.arrow.float64()).to_numpy())
            part = table.filter(self.arrow.array(episodes == number))
            if part.num_rows:
                yield part

    def _only_episode(self) -> int:
        least, most = self._range()
        if least != most:
            raise TableError(
                f"{self.path}: expected to know which episode: --episode N, or [table] episode = N in the "
                f"rig file; found {self._describe_episodes()}"
            )
        return least

    def _range(self) -> tuple[int, int]:
        """Lowest and highest number of an episode, by the statistics of the files or else their rows."""
        least, most = 2**62, -1
        # version 2 has a file for each episode, in the order of their names
        files = self.files if len(self.files) < 3 else [self.files[0], self.files[-1]]
        for file in files:
            opened = _open(self.arrow, self.parquet, file)
            for group in range(opened.metadata.num_row_groups):
                low, high = _episode_range(opened, group)
                if high == np.inf:
                    numbers = opened.read_row_group(group, [EPISODE])[EPISODE].to_numpy()
                    low, high = (numbers.min(), numbers.max()) if len(numbers) else (2**62, -1)
                least, most = min(least, int(low)), max(most, int(high))
        if most < 0:
            raise TableError(f"{self.path}: expected an episode, found none with frames")
        return least, most

    def _describe_episodes(self) -> str:
        least, most = self._range()
        return f"the episodes {least} to {most}" if most > least else f"the episode {least}"

    def _skipped_columns(self, file: Path) -> tuple[tuple[str, str], ...]:
        schema = _open(self.arrow, self.parquet, file).schema_arrow
        reasons = [
            (name, _skip_reason(self.arrow, kind))
            for name, kind in zip(schema.names, schema.types, strict=True)
        ]
        return tuple((name, reason) for name, reason in reasons if reason)


def _episode_range(opened: Any, group: int) -> tuple[float, float]:
    """Lowest and highest episode in a row group; infinite without statistics."""
    description = opened.metadata.row_group(group)
    for index in range(description.num_columns):
        column = description.column(index)
        if column.path_in_schema == EPISODE:
            statistics = column.statistics
            if statistics is not None and statistics.has_min_max:
                return statistics.min, statistics.max
    return -np.inf, np.inf


def _uncompressed_size(opened: Any, group: int, requested: Sequence[str]) -> int:
    """Size of requested columns in a row group, bytes."""
    description = opened.metadata.row_group(group)
    columns = (description.column(index) for index in range(description.num_columns))
    sizes = [
        column.total_uncompressed_size
        for column in columns
        if any(
            column.path_in_schema == name or column.path_in_schema.startswith(f"{name}.")
            for name in requested
        )
    ]
    return max(sum(sizes), 8 * description.num_rows * len(requested))


def _is_list(arrow: Any, kind: Any) -> bool:
    types = arrow.types
    return bool(types.is_list(kind) or types.is_large_list(kind) or types.is_fixed_size_list(kind))


def _skip_reason(arrow: Any, kind: Any) -> str:
    """Why a column is not read; empty if it is one of numbers."""
    types = arrow.types
    inner = kind.value_type if _is_list(arrow, kind) else kind
    if types.is_floating(inner) or types.is_integer(inner) or types.is_boolean(inner):
        return ""
    return "images" if types.is_struct(inner) else f"no numbers, {kind}"


def _values(arrow: Any, column: Any) -> FloatArray:
    """Values of a column, (rows, width); NaN for nulls and in lists that are shorter than others."""
    array = column.combine_chunks()
    if not _is_list(arrow, array.type):
        values: FloatArray = np.array(
            array.cast(arrow.float64(), safe=False).to_numpy(zero_copy_only=False), dtype=np.float64
        )
        return values[:, None]
    compute = load_optional("pyarrow.compute", "lists in a Parquet file")
    lengths = compute.fill_null(compute.list_value_length(array), 0)
    width = int(compute.max(lengths).as_py() or 0)
    if not 0 < width <= MAX_LIST_LENGTH:
        return np.empty((len(array), 0))
    full = compute.equal(lengths, width)
    flat = array.filter(full).flatten().cast(arrow.float64(), safe=False).to_numpy(zero_copy_only=False)
    values = np.full((len(array), width), np.nan)
    values[np.array(full.to_numpy(zero_copy_only=False), dtype=bool)] = np.reshape(flat, (-1, width))
    return values


def _element_names(info: dict[str, Any], feature: str, width: int) -> list[str]:
    """Names of the elements of a list; their indices if the dataset does not name each of them."""
    features = info.get("features")
    description = features.get(feature) if isinstance(features, dict) else None
    names = description.get("names") if isinstance(description, dict) else None
    if isinstance(names, dict) and len(names) == 1:  # {"motors": […]}, as of version 2
        names = next(iter(names.values()))
    stated = [name for name in names if isinstance(name, str) and name] if isinstance(names, list) else []
    good = len(stated) == len(set(stated)) == width
    return stated if good else [str(index) for index in range(width)]


def _describe_episode(info: dict[str, Any], number: int, rows: int) -> str:
    robot, rate = info.get("robot_type"), info.get("fps")
    more = [f"robot {printable_name(robot)}"] if isinstance(robot, str) else []
    more += [f"{rate:g} frames a second as it says"] if isinstance(rate, (int, float)) else []
    return f"rows are the {rows} frames of episode {number} of a LeRobot dataset" + (
        f" ({', '.join(more)})" if more else ""
    )

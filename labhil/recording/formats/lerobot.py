"""LeRobot datasets of versions 2 and 3: one episode of them as columns, with the names of ``meta/info.json``.

A dataset is a folder with ``meta/info.json`` and Parquet files below ``data``: one for each episode (version
2), or with several episodes in each (version 3). A list such as ``observation.state`` has a column for each
number. Videos and pictures are not read. One file of a dataset is read as the dataset is.
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
MARKS = (EPISODE, "frame_index", "timestamp")
"""Columns by which a Parquet file is one of a LeRobot dataset."""

LARGEST_INFO = 16 << 20
"""Bytes of ``meta/info.json``; the largest robots need some kB."""

WIDEST = 256
"""Numbers in a list that are columns; longer ones are pictures."""

MOST_FILES = 100_000
"""Parquet files of a dataset that are looked at."""


@dataclass(frozen=True)
class LerobotColumns(VariableColumns):
    """Columns of an episode; ``origin`` says of which, ``files`` where it stands."""

    origin: str = ""
    read: tuple[Path, ...] = ()

    row_word = "frame"

    @property
    def files(self) -> tuple[Path, ...]:
        """The files of the dataset that were read."""
        return self.read

    @property
    def notes(self) -> tuple[str, ...]:
        """Which episode it is, and what was not used."""
        return (self.origin, *super().notes)


def is_dataset(path: Path) -> bool:
    """Whether a folder is a LeRobot dataset."""
    return (path / "meta" / "info.json").is_file() and (path / "data").is_dir()


def read_parquet_or_episode(path: Path, table: Table, wanted: Sequence[str]) -> Any:
    """Read a Parquet file; where it is one of a LeRobot dataset, the episode that ``[table]`` names.

    Raises:
        TableError: It cannot be read, or holds several episodes of which none is named.
    """
    arrow, parquet = _arrow(path)
    names = set(_opened(arrow, parquet, path).schema_arrow.names)
    if names >= set(MARKS):
        root = path.absolute().parents[2] if len(path.absolute().parents) > 2 else path.parent
        return _Dataset(arrow, parquet, path, root, [path]).columns(table.episode)
    if table.episode is not None:
        raise TableError(
            f"{path}: expected a file of a LeRobot dataset, as [table] episode counts its episodes, found a "
            f"Parquet file without a column {' or '.join(name for name in MARKS if name not in names)}"
        )
    return read_parquet(path)


def read_dataset(path: Path, table: Table, wanted: Sequence[str]) -> LerobotColumns:
    """Read the episode of a dataset that ``[table]`` names, or its only one.

    Raises:
        TableError: The dataset cannot be read, or has several episodes, or has not the one that is named.
    """
    arrow, parquet = _arrow(path)
    files = sorted((path / "data").rglob("*.parquet"))
    if not files or len(files) > MOST_FILES:
        found = f"{len(files)} of them" if files else "none"
        raise TableError(f"{path}: expected Parquet files of a LeRobot dataset below data, found {found}")
    return _Dataset(arrow, parquet, path, path, files).columns(table.episode)


def _arrow(path: Path) -> tuple[Any, Any]:
    purpose = f"{path}: a Parquet file"
    return load_optional("pyarrow", purpose), load_optional("pyarrow.parquet", purpose)


def _opened(arrow: Any, parquet: Any, path: Path) -> Any:
    try:
        return parquet.ParquetFile(path)
    except (arrow.ArrowException, OSError, ValueError) as error:
        raise TableError(
            f"{path}: expected a Parquet file, found one that cannot be read: {error}"
        ) from error


@dataclass
class _Dataset:
    arrow: Any
    parquet: Any
    path: Path
    root: Path
    files: list[Path]

    def columns(self, episode: int | None) -> LerobotColumns:
        """The columns of an episode; of the only one for None."""
        info = self._info()
        number = self._only_episode() if episode is None else episode
        found = [(file, table) for file in self._files_of(number) for table in self._tables(file, number)]
        if not found:
            raise TableError(f"{self.path}: expected an episode {number}, found {self._episodes_in_words()}")
        names: list[str] = []
        columns: list[FloatArray] = []
        labels: list[tuple[str, ...]] = []
        whole = self.arrow.concat_tables([table for _, table in found])
        for feature, column in zip(whole.column_names, whole.columns, strict=True):
            values = _values(self.arrow, column)
            titles = _names_in(info, feature, values.shape[1])
            for place in range(values.shape[1]):
                single = not _is_list(self.arrow, column.type)
                names.append(feature if single else f"{feature}.{titles[place]}")
                labels.append(() if single else (f"{feature}_{place}", f"{feature}[{place}]"))
                columns.append(values[:, place])
        rows = whole.num_rows
        return LerobotColumns(
            names=tuple(names),
            width=len(names),
            lines=np.arange(1, rows + 1),
            counts=np.full(rows, len(names)),
            values=columns,
            labels=tuple(labels),
            unused=self._skipped(found[0][0]),
            origin=_origin(info, number, rows),
            read=tuple(dict.fromkeys(file for file, _ in found)),
        )

    def _info(self) -> dict[str, Any]:
        """What ``meta/info.json`` says; nothing where a file stands alone."""
        file = self.root / "meta" / "info.json"
        if not file.is_file():
            return {}
        try:
            with file.open("rb") as stream:
                text = stream.read(LARGEST_INFO + 1)
            info = json.loads(text) if len(text) <= LARGEST_INFO else None
        except (OSError, ValueError, RecursionError) as error:
            raise TableError(
                f"{file}: expected the description of a LeRobot dataset, found a file that cannot be read: "
                f"{error}"
            ) from error
        if not isinstance(info, dict):
            raise TableError(f"{file}: expected the description of a LeRobot dataset, found no JSON object")
        return info

    def _files_of(self, number: int) -> list[Path]:
        """Where an episode may stand: version 2 names its files by episode."""
        named = [file for file in self.files if file.name == f"episode_{number:06d}.parquet"]
        return named or self.files

    def _tables(self, file: Path, number: int) -> Iterator[Any]:
        """The rows of an episode in a file, without what is no number."""
        opened = _opened(self.arrow, self.parquet, file)
        asked = [
            name
            for name, kind in zip(opened.schema_arrow.names, opened.schema_arrow.types, strict=True)
            if not _why_not(self.arrow, kind)
        ]
        if EPISODE not in asked:
            raise TableError(
                f"{file}: expected a file of a LeRobot dataset with a column {EPISODE}, found the columns "
                f"{', '.join(map(printable_name, opened.schema_arrow.names[:40]))}"
            )
        size = file.stat().st_size
        for group in range(opened.metadata.num_row_groups):
            least, most = _bounds(opened, group)
            if not least <= number <= most:
                continue
            refuse_claim(f"{file.name}: its row group {group}", _unpacked(opened, group, asked), size)
            try:
                table = opened.read_row_group(group, asked)
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
                f"rig file; found {self._episodes_in_words()}"
            )
        return least

    def _range(self) -> tuple[int, int]:
        """The lowest and the highest number of an episode, by the files' statistics or else their rows."""
        least, most = 2**62, -1
        # version 2 has a file for each episode, in the order of their names
        files = self.files if len(self.files) < 3 else [self.files[0], self.files[-1]]
        for file in files:
            opened = _opened(self.arrow, self.parquet, file)
            for group in range(opened.metadata.num_row_groups):
                low, high = _bounds(opened, group)
                if high == np.inf:
                    read = opened.read_row_group(group, [EPISODE])[EPISODE].to_numpy()
                    low, high = (read.min(), read.max()) if len(read) else (2**62, -1)
                least, most = min(least, int(low)), max(most, int(high))
        if most < 0:
            raise TableError(f"{self.path}: expected an episode, found none with frames")
        return least, most

    def _episodes_in_words(self) -> str:
        least, most = self._range()
        return f"the episodes {least} to {most}" if most > least else f"the episode {least}"

    def _skipped(self, file: Path) -> tuple[tuple[str, str], ...]:
        schema = _opened(self.arrow, self.parquet, file).schema_arrow
        reasons = [
            (name, _why_not(self.arrow, kind)) for name, kind in zip(schema.names, schema.types, strict=True)
        ]
        return tuple((name, reason) for name, reason in reasons if reason)


def _bounds(opened: Any, group: int) -> tuple[float, float]:
    """The lowest and the highest episode in a row group; infinite where the file does not say."""
    described = opened.metadata.row_group(group)
    for place in range(described.num_columns):
        column = described.column(place)
        if column.path_in_schema == EPISODE:
            statistics = column.statistics
            if statistics is not None and statistics.has_min_max:
                return statistics.min, statistics.max
    return -np.inf, np.inf


def _unpacked(opened: Any, group: int, asked: Sequence[str]) -> int:
    """Bytes that the columns asked for take in a row group."""
    described = opened.metadata.row_group(group)
    columns = (described.column(place) for place in range(described.num_columns))
    sizes = [
        column.total_uncompressed_size
        for column in columns
        if any(
            column.path_in_schema == name or column.path_in_schema.startswith(f"{name}.") for name in asked
        )
    ]
    return max(sum(sizes), 8 * described.num_rows * len(asked))


def _is_list(arrow: Any, kind: Any) -> bool:
    types = arrow.types
    return bool(types.is_list(kind) or types.is_large_list(kind) or types.is_fixed_size_list(kind))


def _why_not(arrow: Any, kind: Any) -> str:
    """Why a column is none of numbers; empty where it is."""
    types = arrow.types
    inner = kind.value_type if _is_list(arrow, kind) else kind
    if types.is_floating(inner) or types.is_integer(inner) or types.is_boolean(inner):
        return ""
    return "pictures" if types.is_struct(inner) else f"no numbers, {kind}"


def _values(arrow: Any, column: Any) -> FloatArray:
    """The numbers of a column, shape (rows, width); NaN for nulls and in lists shorter than others."""
    array = column.combine_chunks()
    if not _is_list(arrow, array.type):
        values: FloatArray = np.array(
            array.cast(arrow.float64(), safe=False).to_numpy(zero_copy_only=False), dtype=np.float64
        )
        return values[:, None]
    compute = load_optional("pyarrow.compute", "lists in a Parquet file")
    lengths = compute.fill_null(compute.list_value_length(array), 0)
    width = int(compute.max(lengths).as_py() or 0)
    if not 0 < width <= WIDEST:
        return np.empty((len(array), 0))
    full = compute.equal(lengths, width)
    flat = array.filter(full).flatten().cast(arrow.float64(), safe=False).to_numpy(zero_copy_only=False)
    values = np.full((len(array), width), np.nan)
    values[np.array(full.to_numpy(zero_copy_only=False), dtype=bool)] = np.reshape(flat, (-1, width))
    return values


def _names_in(info: dict[str, Any], feature: str, width: int) -> list[str]:
    """What the dataset calls the numbers of a list; their places where it has no name for each."""
    features = info.get("features")
    described = features.get(feature) if isinstance(features, dict) else None
    names = described.get("names") if isinstance(described, dict) else None
    if isinstance(names, dict) and len(names) == 1:  # {"motors": […]}, as of version 2
        names = next(iter(names.values()))
    stated = [name for name in names if isinstance(name, str) and name] if isinstance(names, list) else []
    good = len(stated) == len(set(stated)) == width
    return stated if good else [str(place) for place in range(width)]


def _origin(info: dict[str, Any], number: int, rows: int) -> str:
    robot, rate = info.get("robot_type"), info.get("fps")
    more = [f"robot {printable_name(robot)}"] if isinstance(robot, str) else []
    more += [f"{rate:g} frames a second as it says"] if isinstance(rate, (int, float)) else []
    return f"rows are the {rows} frames of episode {number} of a LeRobot dataset" + (
        f" ({', '.join(more)})" if more else ""
    )

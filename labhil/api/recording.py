"""``labhil.Recording``, and ``labhil.read``, which reads one from a file."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from labhil.api.inputs import PathLike, Progress, path_of, progress_reporter, rig_file
from labhil.api.model import Model
from labhil.api.render import axes_of, data_frame, data_set
from labhil.atomic_file import atomic_file
from labhil.errors import RecordingError, UsageError, suggestion
from labhil.extras import require
from labhil.recording.recording import Event, StreamData
from labhil.recording.recording import Recording as FileRecording
from labhil.rig import RigFile
from labhil.signals import FloatArray, Signal

if TYPE_CHECKING:
    from matplotlib.axes import Axes


class Recording:
    """A recording: samples of a rig over time, in SI units. Immutable.

    Made by :func:`labhil.read`, :func:`labhil.recording` and :func:`labhil.run`. Signals are read by name:
    ``rec["ball_position"]`` has shape (n,), a vector such as the six joints of an arm (n, 6).

    Example:
        >>> import labhil as lh
        >>> rec = lh.read("recordings/ball_beam_identify.mcap")
        >>> rec
        <Recording of ball_beam: 2803 samples, 28.02 s at 100 Hz; ball_position, servo_angle>
        >>> rec["ball_position"].shape, rec.t.shape
        ((2803,), (2803,))
        >>> rec.signals["servo_angle"].unit
        'rad'
        >>> rec.lost
        0
    """

    def __init__(
        self, file: FileRecording, notes: tuple[str, ...] = (), content: bytes | None = None
    ) -> None:
        self._file, self._notes, self._content = file, notes, content

    @property
    def file(self) -> FileRecording:
        """The content of the file: streams, clocks, attachments."""
        return self._file

    @property
    def path(self) -> Path:
        """The path of its file; for arrays, their name."""
        return self._file.path

    @property
    def model(self) -> Model | None:
        """The model of the rig file in the recording; None where it has none."""
        return None if self._file.rig is None else Model(self._file.rig)

    @property
    def main(self) -> StreamData:
        """The stream with the rig's outputs; without a rig file the longest one.

        Raises:
            RecordingError: The recording has no stream.
        """
        streams = [data for data in self._file.streams if len(data)] or list(self._file.streams)
        if not streams:
            raise RecordingError(f"{self.path}: {self._file.describe_missing_streams()}")
        outputs = set() if self._file.rig is None else {s.name for s in self._file.rig.kind.outputs}
        return max(streams, key=lambda data: (len(outputs & set(data.stream.names())), len(data)))

    @property
    def streams(self) -> Mapping[str, StreamData]:
        """All streams by ``device/stream``: ``t``, ``values``, ``rate``, ``lost`` and stamps of each."""
        return {f"{data.device}/{data.stream.name}": data for data in self._file.streams}

    @property
    def t(self) -> FloatArray:
        """Times of the samples, (n,) s from the first; read only, as all arrays here."""
        return _read_only(self.main.t)

    @property
    def signals(self) -> Mapping[str, Signal]:
        """The signals by name, each with its ``unit``, ``direction``, ``width`` and ``description``."""
        return {signal.name: signal for signal in self.main.stream.signals}

    @property
    def rate(self) -> float:
        """Measured rate, Hz."""
        return self.main.rate

    @property
    def duration(self) -> float:
        """Time from the first sample to the last, s."""
        return self._file.duration

    @property
    def events(self) -> tuple[Event, ...]:
        """Events during the recording, each with ``t`` (s), ``device``, ``topic`` and ``body``."""
        return self._file.events

    @property
    def lost(self) -> int:
        """Number of missing samples of all streams."""
        return sum(data.lost for data in self._file.streams)

    @property
    def notes(self) -> tuple[str, ...]:
        """Notes, a line each: how it was imported, missing data, faulty clocks."""
        return (*self._notes, *self._file.warnings())

    @property
    def doubts(self) -> tuple[str, ...]:
        """Implausible units, signs, times or columns, by the physics of the rig, a sentence each."""
        from labhil.analysis.doubts import doubts_in

        return tuple(doubts_in(self._file))

    def __len__(self) -> int:
        return len(self.main)

    def __getitem__(self, name: str) -> FloatArray:
        if name in self.signals:
            return _read_only(self.main[name])
        for data in self._file.streams:
            if name in data.stream.names():
                return _read_only(data[name])
        names = [known for data in self._file.streams for known in data.stream.names()]
        raise RecordingError(
            f"{self.path}: no signal {name!r}{suggestion(str(name), names)}; "
            f"found: {', '.join(dict.fromkeys(names))}"
        )

    def __repr__(self) -> str:
        kind = "" if self._file.rig is None else f" of {self._file.rig.kind.name}"
        if not self._file.streams:
            return f"<Recording{kind}: {self._file.describe_missing_streams()}>"
        return (
            f"<Recording{kind}: {len(self)} samples, {self.duration:.4g} s at {self.rate:.4g} Hz; "
            f"{', '.join(self.signals)}>"
        )

    def __eq__(self, other: object) -> bool:
        return isinstance(other, Recording) and self._file.sha256 == other._file.sha256

    def __hash__(self) -> int:
        return hash(self._file.sha256)

    def _columns(self) -> dict[str, FloatArray]:
        main = self.main
        return dict(zip(main.stream.columns(), main.values.T, strict=True))

    def to_pandas(self) -> Any:
        """Return the samples as a pandas DataFrame: index ``t`` (s), a column for each signal (SI units).

        Raises:
            MissingExtraError: pandas is not installed.
        """
        return data_frame(self._columns(), index=self.t, index_name="t")

    def to_xarray(self) -> Any:
        """Return the samples as an xarray Dataset over ``t`` (s); each variable has its ``units``.

        Raises:
            MissingExtraError: xarray is not installed.
        """
        units = {column: s.unit for s in self.main.stream.signals for column in s.columns()}
        variables = {name: (("t",), x, {"units": units[name]}) for name, x in self._columns().items()}
        return data_set(variables, {"t": self.t}, {"path": str(self.path), "sha256": self._file.sha256})

    def plot(self, name: str | None = None, ax: Axes | None = None) -> Axes:
        """Draw a signal over time.

        Args:
            name: The signal; by default the rig's first output.
            ax: Axes to draw into; by default new ones.

        Returns:
            The matplotlib axes.

        Raises:
            RecordingError: There is no such signal.
        """
        require("matplotlib", "a plot")
        from labhil.report.figure import MEASURED, finish

        signal = next(iter(self.signals)) if name is None else name
        values = self[signal]
        axes = axes_of(ax)
        t = next(data.t for data in (self.main, *self._file.streams) if signal in data.stream.names())
        lines = values if values.ndim == 2 else values[:, None]
        for i, column in enumerate(lines.T):
            single = lines.shape[1] == 1
            axes.plot(t, column, lw=1.0, color=MEASURED if single else None, label="" if single else f"{i}")
        unit = next(s.unit for data in self._file.streams for s in data.stream.signals if s.name == signal)
        finish(axes, signal, "t, s", f"{signal}, {unit}")
        return axes

    def save(self, path: PathLike) -> Path:
        """Write the recording as an MCAP file with its rig file.

        Args:
            path: A new file that ends in ``.mcap``.

        Returns:
            The path.

        Raises:
            UsageError: The file exists already, or cannot be written there.
        """
        file = path_of(path, "path")
        if file.suffix != ".mcap":
            raise UsageError(f"{file}: expected a name that ends in .mcap; `labhil export` writes tables")
        if file.exists():
            raise UsageError(f"{file}: expected a new file, found one that exists; nothing was written")
        content = self.path.read_bytes() if self._content is None else self._content
        with atomic_file(file, "the recording") as draft:
            draft.write_bytes(content)
        return file


def _read_only(values: FloatArray) -> FloatArray:
    """Return a read-only view of an array."""
    view = values.view()
    view.flags.writeable = False
    return view


def read(
    path: PathLike,
    *,
    rig: PathLike | Model | RigFile | None = None,
    device: str | None = None,
    run: int | None = None,
    progress: Progress = None,
) -> Recording:
    """Read a recording from a file.

    Text tables, MAT, Parquet, XLSX, NPZ, ROS 2 bags, LeRobot datasets and MCAP files of other programs are
    read by the rules of a rig file: its ``[table]`` and ``[channels]`` define signal and unit of each column.
    Recordings need no rules.

    Args:
        path: The file, or the folder of a ROS 2 bag.
        rig: A rig kind, the path of a rig file, or a model; needed for everything but a recording, which has
            its own.
        device: The device, where a recording has several.
        run: The run, from 1, where a file has several of one stream.
        progress: A function of a line about the current stage, or True for a line on stderr.

    Returns:
        The recording, in SI units.

    Raises:
        RecordingError: The file does not exist, is no recording, or lacks the device or the run.
        TableError: A table lacks a column, or its rows cannot be used.
        UsageError: The file is a table, and there is no ``rig``.

    Example:
        >>> import labhil as lh
        >>> rec = lh.read("recordings/ball_beam_test.mcap")
        >>> print(f"{rec.duration:.1f} s of {', '.join(rec.signals)}")
        28.1 s of ball_position, servo_angle
    """
    from labhil.recording.reader import read_recording

    file, resolved_rig = path_of(path, "path"), rig_file(rig)
    if _is_table(file):
        return _import(file, resolved_rig, "a table", progress)
    recording = read_recording(file, run)
    if recording.foreign and not recording.streams:
        return _import(file, resolved_rig, "an MCAP file of another program", progress)
    recording = recording.of_device(device)
    return Recording(recording if resolved_rig is None else replace(recording, rig=resolved_rig))


def _import(file: Path, rig: RigFile | None, what: str, progress: Progress) -> Recording:
    """Read a file by the rules of a rig file; UsageError where there is none."""
    if rig is None:
        raise UsageError(
            f"{file}: {what} needs a rig, which says what its columns are: "
            'labhil.read(…, rig="bench.toml"), or the kind where columns bear the names of signals'
        )
    from labhil.analysis.tables import read_table

    with progress_reporter(progress) as say:
        table, notes, content = read_table(file, rig, say)
    return Recording(table, tuple(notes), content)


def _is_table(path: Path) -> bool:
    """Whether a file is a table, not a recording; of a missing file, by its name."""
    from labhil.recording.chunks import is_mcap

    if path.is_dir():
        return True
    if path.name.endswith((".mcap", ".mcap.part")) or not path.is_file():
        return path.suffix not in (".mcap", ".part", "") and not path.name.endswith(".mcap.part")
    with path.open("rb") as file:
        return not is_mcap(file.read(16))

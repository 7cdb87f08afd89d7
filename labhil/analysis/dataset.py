"""Load the data of a fit or a diagnosis: recordings, their rig, training data and test data."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Sequence
from contextlib import AbstractContextManager, contextmanager
from dataclasses import dataclass
from pathlib import Path

from labhil.analysis.measured import measured_of, refuse_holes
from labhil.analysis.motion_check import constant
from labhil.analysis.results import Source
from labhil.analysis.rig_choice import common_rig
from labhil.analysis.rig_option import given_name
from labhil.analysis.stretch import MAX_SAMPLES, check_max_samples, stretch_note
from labhil.cores import linear_algebra_in_one_thread
from labhil.diagnose.fault import Fault
from labhil.diagnose.intake import replace_outliers
from labhil.diagnose.timing import detect_all_faults, unchecked_timing_note
from labhil.errors import OptionError, RecordingError
from labhil.identify.plausibility import doubts_of
from labhil.identify.windows import split
from labhil.physics.arm import ArmModel
from labhil.physics.joining import join_records
from labhil.physics.measured_input import smoothing_notes
from labhil.physics.model import Model
from labhil.physics.record import Record
from labhil.physics.rigs import model_for
from labhil.physics.several import model_of_one, several
from labhil.physics.solenoid import SolenoidModel
from labhil.recording.reader import read_recordings
from labhil.recording.recording import Recording
from labhil.rig import RigFile
from labhil.simulators.model import SimulatorModel

HOLDOUT = 0.3
"""Share of each recording that is held out as test data unless another one is given."""

MIN_TRAINING_SAMPLES = 40
"""Samples of a recording that must remain for training."""

MODELS_WITH_NOTES = (ArmModel, SolenoidModel, SimulatorModel)


@dataclass(frozen=True, slots=True)
class Dataset:
    """The data of a fit or a diagnosis, with the rig's model.

    Attributes:
        rig: The rig file.
        model: Model of the rig for these recordings.
        train: Training data, prepared for the model.
        test: Test data, prepared for the model; the training data where nothing is held out.
        test_is_separate: The test data are recordings of their own, not parts of the training recordings.
        measured: The training recordings as they were measured, held-out parts included.
        recordings: Each recording with its record and its role, "test" or "" for training.
        held_out: Whether the test data were not used for training.
        rig_name: The rig file, or simulator, that was given by name; None for the one in the recordings.
    """

    rig: RigFile
    model: Model
    train: Record
    test: Record
    test_is_separate: bool
    measured: Record
    recordings: tuple[tuple[Recording, Record, str], ...]
    held_out: bool = True
    rig_name: str | None = None

    def sources(self, training_role: str) -> list[Source]:
        """Describe the recordings for a result; ``training_role`` is the role of the training recordings."""
        numbers = Counter[str]()
        several = max(Counter(role for _, _, role in self.recordings).values()) > 1
        sources = []
        for recording, record, role in self.recordings:
            numbers[role] += 1
            sources.append(
                Source(
                    path=str(recording.path),
                    sha256=recording.sha256,
                    rig=self.rig.kind.name,
                    samples=len(record),
                    duration=record.duration,
                    role=role or training_role,
                    start=float(record.t[0]),
                    recording=numbers[role] if several else None,
                    rig_file=self.rig_name,
                )
            )
        return sources

    def notes(self) -> list[str]:
        """Describe assumptions of the model and limits of the data, a text each."""
        model = model_of_one(self.model)
        notes = list(model.notes) if isinstance(model, MODELS_WITH_NOTES) else []
        units = {signal.name: signal.unit for signal in self.rig.kind.inputs}
        used = [stretch_note(recording, record) for recording, record, _ in self.recordings]
        notes += [note for note in used if note is not None]
        notes += smoothing_notes(self.measured, units.get(self.measured.input_names[0], ""))
        if constant(self.train.inputs).all():
            names = ", ".join(self.train.input_names)
            notes.append(f"No input changes ({names}): only what the rig does by itself can be learnt.")
        untimed = self.untimed()
        return notes if untimed is None else [*notes, untimed]

    def untimed(self) -> str | None:
        """Why the delay of the input's stamps could not be checked; None where it was."""
        return unchecked_timing_note(self.model, self.measured)

    def faults(self) -> tuple[Fault, ...]:
        """Faults of the training recordings, held-out parts included."""
        return detect_all_faults(self.model, self.measured)

    def doubts(self, *, misfit: bool) -> list[str]:
        """Describe what is implausible by the rig's physics: units, signs, times or columns; a text each.

        Where the model has a ``misfit``, swaps of columns are checked as well.
        """
        columns = {recording.time_column for recording, _, role in self.recordings if not role}
        time = columns.pop() if len(columns) == 1 else "t"
        doubts = doubts_of(self.measured, self.rig, misfit=misfit, time_column=time)
        return [doubt.statement for doubt in doubts]

    def losses(self) -> list[str]:
        """Describe which device was chosen by default, and lost samples of the recordings; a line each."""
        recordings = [recording for recording, _, _ in self.recordings]
        return [
            line
            for recording in recordings
            for line in (*_device_notes(recording, self.rig), *recording.warnings())
        ]

    def naming(self) -> AbstractContextManager[None]:
        """Context in which a RecordingError gets the path of the recording."""
        return naming([recording for recording, _, _ in self.recordings])

    def refuse_holes(self) -> None:
        """Raise RecordingError where values of a recording are not finite, or times do not increase."""
        for recording, record, _ in self.recordings:
            refuse_holes(recording.path, record)


RecordingLike = Path | Recording
"""A recording to work on: its file, or what was read of it."""


@linear_algebra_in_one_thread()
def load_dataset(
    path: RecordingLike | Sequence[RecordingLike],
    rig_file: Path | RigFile | None = None,
    test_path: RecordingLike | Sequence[RecordingLike] | None = None,
    holdout: float = HOLDOUT,
    per_recording: Sequence[str] = (),
    *,
    span: tuple[float, float] | None = None,
    allow_no_holdout: bool = False,
    device: str | None = None,
    run: int | None = None,
    max_samples: int | None = MAX_SAMPLES,
) -> Dataset:
    """Read one recording or several, and split off or read test data.

    Args:
        path: Training recordings; those that were read already are used as they are.
        rig_file: The rig file; by default the one that the recordings carry.
        test_path: Test recordings; without them a part of each training recording is held out.
        holdout: Share at the end of each recording that is held out, after a gap of one scored horizon; 0,
            which needs ``allow_no_holdout``, holds nothing out.
        per_recording: Names of parameters that have a value of their own in each recording.
        span: Part of each training recording that is used, from … to, s.
        allow_no_holdout: Whether ``holdout`` may be 0.
        device: One of several devices in a recording.
        run: One of several runs in a file.
        max_samples: Number of samples of each recording that are used, those where its inputs change most;
            None for all. Not used for arms.

    Raises:
        UsageError: Options, recordings or the rig file do not fit together (also as OptionError,
            RecordingError or RigFileError).
    """
    if not (0.05 <= holdout <= 0.9 or (allow_no_holdout and holdout == 0.0)):
        nothing = ", or 0 to hold nothing out" if allow_no_holdout else ""
        raise OptionError("holdout", f": expected a share from 0.05 to 0.9{nothing}, found {holdout:g}")
    paths, test_paths = _as_tuple(path), _as_tuple(test_path)
    _refuse_counts(paths, test_paths, per_recording)
    check_max_samples(max_samples)
    loaded = [recording.of_device(device) for recording in read_all((*paths, *test_paths), run)]
    training, testing = loaded[: len(paths)], loaded[len(paths) :]
    _refuse_duplicates(training)
    rig, rig_name = common_rig(training, rig_file), given_name(rig_file)
    records, measured = measured_of(training, rig, span, most=max_samples)
    model = model_for(rig, measured, per_recording)
    train_entries = tuple(
        (recording, record, "") for recording, record in zip(training, records, strict=True)
    )
    if not test_paths and holdout == 0.0:
        with naming(training):
            train = model.prepare(replace_outliers(measured))
        return Dataset(
            rig, model, train, train, False, measured, train_entries, held_out=False, rig_name=rig_name
        )
    if not test_paths:
        with naming(training):
            train, test = _split_held_out(model, measured, training, holdout)
            _refuse_horizon(rig, test)
        return Dataset(rig, model, train, test, False, measured, train_entries, rig_name=rig_name)
    test_records, measured_test = measured_of(testing, rig, like=measured, of=training[0], most=max_samples)
    if len(test_records) > 1 and len(records) == 1:
        model = several(model, (), 1)
    test_entries = tuple(
        (recording, record, "test") for recording, record in zip(testing, test_records, strict=True)
    )
    with naming(training):
        train = model.prepare(replace_outliers(measured))
    with naming(testing):
        test = model.prepare(replace_outliers(measured_test))
        _refuse_horizon(rig, test)
    entries = (*train_entries, *test_entries)
    return Dataset(rig, model, train, test, True, measured, entries, rig_name=rig_name)


def _device_notes(recording: Recording, rig: RigFile) -> list[str]:
    """A line that names the used one of several devices."""
    devices = list(dict.fromkeys(data.device for data in recording.streams))
    if len(devices) < 2:
        return []
    wanted = {signal.name for signal in rig.kind.outputs}
    used = [data.device for data in recording.streams if wanted & set(data.stream.names())]
    return [
        f"{recording.path}: holds the devices {', '.join(devices)}; used: {', '.join(dict.fromkeys(used))}. "
        "The option device chooses another"
    ]


@contextmanager
def naming(recordings: Sequence[Recording]) -> Iterator[None]:
    """Put a recording's path before the message of a RecordingError; several are named by their numbers."""
    try:
        yield
    except RecordingError as error:
        path = str(recordings[0].path)
        if len(recordings) > 1 or path in str(error):
            raise
        raise RecordingError(f"{path}: {error}") from error


def _split_held_out(
    model: Model, measured: Record, recordings: Sequence[Recording], holdout: float
) -> tuple[Record, Record]:
    """Training data and the last share of each recording as test data, both prepared.

    RecordingError where a recording is too short for that.
    """
    # spikes are found in the whole recording, as its faults are
    parts = [split(record, holdout, model.horizon) for record in replace_outliers(measured).recordings()]
    if len(parts) > 1:
        # before they are joined, which an empty part would prevent
        for (train, _), recording in zip(parts, recordings, strict=True):
            _refuse_short(train, recording)
    train, test = (model.prepare(join_records(part)) for part in zip(*parts, strict=True))
    for record, recording in zip(train.recordings(), recordings, strict=True):
        _refuse_short(record, recording)
    return train, test


def _as_tuple(given: RecordingLike | Sequence[RecordingLike] | None) -> tuple[RecordingLike, ...]:
    """One item, several or none as a tuple."""
    if given is None:
        return ()
    return (given,) if isinstance(given, (Path, Recording)) else tuple(given)


def read_all(items: Sequence[RecordingLike], run: int | None) -> list[Recording]:
    """Read the recordings that are given by their paths, of each the ``run``; keep the others."""
    read = iter(read_recordings([item for item in items if isinstance(item, Path)], run))
    return [next(read) if isinstance(item, Path) else item for item in items]


def _refuse_counts(
    paths: Sequence[RecordingLike], tests: Sequence[RecordingLike], per_recording: Sequence[str]
) -> None:
    """Raise OptionError where it is not clear which recording a value belongs to."""
    if not per_recording:
        return
    if len(paths) < 2:
        raise OptionError(
            "per-recording",
            f" {','.join(per_recording)}: expected two recordings or more, found one; give "
            "them one after another",
        )
    if tests and len(tests) != len(paths):
        raise OptionError(
            "test",
            f": expected one for each of the {len(paths)} recordings, in their order, since "
            f"{', '.join(per_recording)} has a value in each of them; found {len(tests)}",
        )


def _refuse_horizon(rig: RigFile, test: Record) -> None:
    """Raise RecordingError where the rig file's horizon is longer than the test data."""
    horizon, shortest = rig.metric.horizon or 0.0, min(test.durations)
    if horizon > shortest:
        raise RecordingError(
            f"[metric] horizon: expected at most the {shortest:.3g} s that are judged on, found {horizon:g}"
        )


def _refuse_duplicates(recordings: Sequence[Recording]) -> None:
    """Raise RecordingError where the same recording is given twice."""
    seen: dict[str, Path] = {}
    for recording in recordings:
        if recording.sha256 in seen:
            raise RecordingError(
                f"{recording.path}: the same recording as {seen[recording.sha256]}; give it once, or errors "
                "come out too small"
            )
        seen[recording.sha256] = recording.path


def _refuse_short(train: Record, recording: Recording) -> None:
    """Raise RecordingError where too few samples remain for training."""
    if len(train) < MIN_TRAINING_SAMPLES:
        raise RecordingError(
            f"{recording.path}: too short to hold data out: {len(train)} samples are left to learn from, "
            f"at least {MIN_TRAINING_SAMPLES} are needed; give a separate recording with --test"
        )

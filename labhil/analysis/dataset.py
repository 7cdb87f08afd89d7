"""What a result is made from: recordings on disk, their rig, what is learnt from and what is judged on."""

from __future__ import annotations

import hashlib
from collections import Counter
from collections.abc import Iterator, Sequence
from contextlib import AbstractContextManager, contextmanager
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from labhil.analysis.results import Source
from labhil.analysis.simulator_names import refuse_other_names
from labhil.analysis.still import constant
from labhil.cores import linear_algebra_in_one_thread
from labhil.diagnose.fault import Fault
from labhil.diagnose.intake import with_censored, without_spikes
from labhil.diagnose.timing import all_faults, why_untimed
from labhil.errors import OptionError, RecordingError
from labhil.identify.plausibility import doubts_of
from labhil.identify.windows import FEWEST_SAMPLES, split, with_least_noise
from labhil.physics.arm import ArmModel
from labhil.physics.measured_input import smoothing_notes, with_input_smoothing
from labhil.physics.model import Model, Record, joined
from labhil.physics.rigs import model_for, record_of
from labhil.physics.several import several
from labhil.physics.solenoid import SolenoidModel
from labhil.recording.reader import read_recordings
from labhil.recording.recording import Recording
from labhil.recording.rig_attachments import rig_name
from labhil.rig import RigFile, load_rig
from labhil.simulators.model import SimulatorModel

HOLDOUT = 0.3
SPEAKING = (ArmModel, SolenoidModel, SimulatorModel)


@dataclass(frozen=True, slots=True)
class Dataset:
    """What a result is made from: the rig's model, the data to learn from and the data to be judged on.

    ``measured`` is what is learnt from and what is held out of it, as it was recorded. Where nothing is
    ``held_out``, what is judged on is what was learnt from.
    """

    rig: RigFile
    model: Model
    learn: Record
    judge: Record
    judge_is_test: bool
    measured: Record
    recordings: tuple[tuple[Recording, Record, str], ...]
    held_out: bool = True

    def sources(self, learning: str) -> list[Source]:
        """The recordings as results name them; ``learning`` is the role of those that are no tests."""
        numbers = Counter[str]()
        several = max(Counter(role for _, _, role in self.recordings).values()) > 1
        found = []
        for recording, record, role in self.recordings:
            numbers[role] += 1
            found.append(
                Source(
                    path=str(recording.path),
                    sha256=recording.sha256,
                    rig=self.rig.kind.name,
                    samples=len(record),
                    duration=record.duration,
                    role=role or learning,
                    start=float(record.t[0]),
                    recording=numbers[role] if several else None,
                )
            )
        return found

    def notes(self) -> list[str]:
        """What the model wants a person to know of what it took for known."""
        notes = list(self.model.notes) if isinstance(self.model, SPEAKING) else []
        units = {signal.name: signal.unit for signal in self.rig.kind.inputs}
        notes += smoothing_notes(self.measured, units.get(self.measured.input_names[0], ""))
        if constant(self.learn.inputs).all():
            names = ", ".join(self.learn.input_names)
            notes.append(f"No input changes ({names}): only what the rig does by itself can be learnt.")
        untimed = self.untimed()
        return notes if untimed is None else [*notes, untimed]

    def untimed(self) -> str | None:
        """Why nobody knows whether the input is stamped late; None where that was checked."""
        return why_untimed(self.model, self.measured)

    def faults(self) -> tuple[Fault, ...]:
        """What is wrong with the data that are learnt from, and with what is held out of them."""
        return all_faults(self.model, self.measured)

    def doubts(self, *, misfit: bool) -> list[str]:
        """What the physics of the rig calls implausible: units, signs, times or columns; a text each.

        Harder looked for where a model has a ``misfit``.
        """
        columns = {recording.time_column for recording, _, role in self.recordings if not role}
        time = columns.pop() if len(columns) == 1 else "t"
        found = doubts_of(self.measured, self.rig, misfit=misfit, time_column=time)
        return [doubt.statement for doubt in found]

    def losses(self) -> list[str]:
        """Which device was chosen where nobody said so, and what the recordings lack, a line each."""
        recordings = [recording for recording, _, _ in self.recordings]
        return [line for each in recordings for line in (*_unasked(each, self.rig), *each.losses())]

    def naming(self) -> AbstractContextManager[None]:
        """Names the file in what a fit or a diagnosis says of its recording."""
        return naming([recording for recording, _, _ in self.recordings])

    def refuse_holes(self) -> None:
        """RecordingError where a recording has numbers that are none, or times that do not increase."""
        for recording, record, _ in self.recordings:
            refuse_holes(recording.path, record)


Taken = Path | Recording
"""A recording to work on: its file, or what was read of it."""


@linear_algebra_in_one_thread()
def load_dataset(
    path: Taken | Sequence[Taken],
    rig_file: Path | RigFile | None = None,
    test_path: Taken | Sequence[Taken] | None = None,
    holdout: float = HOLDOUT,
    per_recording: Sequence[str] = (),
    *,
    span: tuple[float, float] | None = None,
    all_of_it: bool = False,
    device: str | None = None,
    run: int | None = None,
) -> Dataset:
    """Read one recording or several, or of each the ``span`` from … to (s), and what is to be judged on.

    Without ``test_path`` the last ``holdout`` of each recording is held out, after a gap of one scored
    horizon; nothing is where ``holdout`` is 0 and ``all_of_it`` allows that. The rig file is the given one,
    or the one that the recordings carry. What was read already is taken as it is. Of recordings of several
    devices ``device`` chooses one, of several runs in one file ``run``. What ``per_recording`` names has a
    value in each of several recordings. Raises UsageError (RecordingError, RigFileError) with what is
    missing.
    """
    if not (0.05 <= holdout <= 0.9 or (all_of_it and holdout == 0.0)):
        nothing = ", or 0 to hold nothing out" if all_of_it else ""
        raise OptionError("holdout", f": expected a share from 0.05 to 0.9{nothing}, found {holdout:g}")
    paths, test_paths = _paths(path), _paths(test_path)
    _refuse_counts(paths, test_paths, per_recording)
    everything = [each.of_device(device) for each in read_all((*paths, *test_paths), run)]
    found, tested = everything[: len(paths)], everything[len(paths) :]
    _refuse_twice(found)
    rig = common_rig(found, rig_file)
    records, measured = measured_of(found, rig, span)
    model = model_for(rig, measured, per_recording)
    learning = tuple((recording, record, "") for recording, record in zip(found, records, strict=True))
    if not test_paths and holdout == 0.0:
        with naming(found):
            learn = model.prepare(without_spikes(measured))
        return Dataset(rig, model, learn, learn, False, measured, learning, held_out=False)
    if not test_paths:
        with naming(found):
            learn, judge = _held_out(model, measured, found, holdout)
            _refuse_horizon(rig, judge)
        return Dataset(rig, model, learn, judge, False, measured, learning)
    tests, test = measured_of(tested, rig, like=measured, of=found[0])
    if len(tests) > 1 and len(records) == 1:
        model = several(model, (), 1)
    judging = tuple((recording, record, "test") for recording, record in zip(tested, tests, strict=True))
    with naming(found):
        learn = model.prepare(without_spikes(measured))
    with naming(tested):
        judge = model.prepare(without_spikes(test))
        _refuse_horizon(rig, judge)
    return Dataset(rig, model, learn, judge, True, measured, (*learning, *judging))


def _unasked(recording: Recording, rig: RigFile) -> list[str]:
    """A line that says which of several devices is used."""
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
    """Put a recording's name before what is said of it; several are told apart by their numbers."""
    try:
        yield
    except RecordingError as error:
        path = str(recordings[0].path)
        if len(recordings) > 1 or path in str(error):
            raise
        raise RecordingError(f"{path}: {error}") from error


def refuse_holes(path: Path, record: Record) -> None:
    """RecordingError where inputs or outputs are not finite, or times do not increase."""
    standing = np.flatnonzero(np.diff(record.t) <= 0.0)
    if len(standing):
        raise RecordingError(
            f"{path}: expected times that increase, found {len(standing)} that do not, the first after "
            f"{record.t[standing[0]]:g} s; `labhil diagnose` tells more of its faults"
        )
    names = (*record.input_names, *record.output_names)
    for name, values in zip(names, np.hstack([record.inputs, record.outputs]).T, strict=True):
        bad = np.flatnonzero(~np.isfinite(values))
        if len(bad):
            raise RecordingError(
                f"{path}: {name}: expected finite numbers, found {len(bad)} of {len(values)} samples that "
                f"are none, the first at {record.t[bad[0]]:g} s; `labhil export` to a table and `labhil "
                "import` of that drop such rows"
            )


def measured_of(
    recordings: Sequence[Recording],
    rig: RigFile,
    span: tuple[float, float] | None = None,
    like: Record | None = None,
    of: Recording | None = None,
) -> tuple[list[Record], Record]:
    """What a model sees of each recording, and of all of them as one record.

    Raises RecordingError where one has another input than the record ``like`` of the recording ``of``.
    """
    records = [
        _within(_marked(record_of(recording, rig.kind), rig), span, recording) for recording in recordings
    ]
    for recording, record in zip(recordings, records, strict=True):
        if like is not None and of is not None and record.input_names != like.input_names:
            raise RecordingError(
                f"{recording.path}: expected the input {like.input_names[0]} as in {of.path}, "
                f"found {record.input_names[0]}"
            )
    return records, joined(records, [str(recording.path) for recording in recordings])


def _marked(record: Record, rig: RigFile) -> Record:
    """A record with the holds that the rig file states, and what only the whole of it shows.

    That is the noise of channels that rest for a part of it, that of a measured input, and readings at the
    ends of their range.
    """
    record = with_least_noise(record.with_holds({n: c.hold for n, c in rig.channels.items() if c.hold}))
    record = with_input_smoothing(record)
    return record if any(joint is not None for joint in record.output_joints) else with_censored(record)


def _within(record: Record, span: tuple[float, float] | None, recording: Recording) -> Record:
    """The samples of a record within ``span`` (s, both ends counted); UsageError where hardly any are."""
    if span is None:
        return record
    first, last = np.searchsorted(record.t, span[0]), np.searchsorted(record.t, span[1], side="right")
    if last - first < FEWEST_SAMPLES:
        raise OptionError(
            "span",
            f" {span[0]:g} {span[1]:g}: expected at least {FEWEST_SAMPLES} samples of "
            f"{recording.path}, which reaches from {record.t[0]:g} to {record.t[-1]:g} s, "
            f"found {max(last - first, 0)}",
        )
    return record.part(int(first), int(last))


def _held_out(
    model: Model, measured: Record, recordings: Sequence[Recording], holdout: float
) -> tuple[Record, Record]:
    """What is learnt from, and the last share of each recording, both prepared.

    Raises RecordingError where too little is left of a recording.
    """
    # how many readings are wrong is a matter of the whole recording, as its faults are
    halves = [split(each, holdout, model.horizon) for each in without_spikes(measured).recordings()]
    if len(halves) > 1:
        # before they are put together, which none of them may be missing from
        for (learn, _), recording in zip(halves, recordings, strict=True):
            _long_enough(learn, recording)
    learn, judge = (model.prepare(joined(half)) for half in zip(*halves, strict=True))
    for part, recording in zip(learn.recordings(), recordings, strict=True):
        _long_enough(part, recording)
    return learn, judge


def _paths(given: Taken | Sequence[Taken] | None) -> tuple[Taken, ...]:
    if given is None:
        return ()
    return (given,) if isinstance(given, (Path, Recording)) else tuple(given)


def read_all(taken: Sequence[Taken], run: int | None) -> list[Recording]:
    """The recordings; those given by their paths are read, of each the ``run``."""
    read = iter(read_recordings([each for each in taken if isinstance(each, Path)], run))
    return [next(read) if isinstance(each, Path) else each for each in taken]


def _refuse_counts(paths: Sequence[Taken], tests: Sequence[Taken], per_recording: Sequence[str]) -> None:
    """Raise UsageError where it is not clear which recording a value belongs to."""
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


def _refuse_horizon(rig: RigFile, judge: Record) -> None:
    """Raise RecordingError where a stated horizon is longer than what is judged on."""
    horizon, there = rig.metric.horizon or 0.0, min(judge.durations)
    if horizon > there:
        raise RecordingError(
            f"[metric] horizon: expected at most the {there:.3g} s that are judged on, found {horizon:g}"
        )


def _refuse_twice(recordings: Sequence[Recording]) -> None:
    """Raise RecordingError where the same data are to count twice."""
    seen: dict[str, Path] = {}
    for recording in recordings:
        if recording.sha256 in seen:
            raise RecordingError(
                f"{recording.path}: the same recording as {seen[recording.sha256]}; give it once, or errors "
                "come out too small"
            )
        seen[recording.sha256] = recording.path


RIG_SECTIONS = ("known", "nominal", "metric")


def common_rig(recordings: Sequence[Recording], rig_file: Path | RigFile | None) -> RigFile:
    """The rig file of all recordings: the given one, or the one that each of them carries.

    Raises RecordingError where these are of different kinds, or state different things of the rig.
    """
    rigs = [rig_of(recording, rig_file) for recording in recordings]
    first, begin = rigs[0], recordings[0]
    for rig, recording in zip(rigs[1:], recordings[1:], strict=True):
        if rig.kind.name != first.kind.name:
            raise RecordingError(
                f"{recording.path}: expected a recording of {first.kind.name} as {begin.path}, found one of "
                f"{rig.kind.name}"
            )
        for section in RIG_SECTIONS:
            one, other = (_stated(each, section) for each in (first, rig))
            for name in sorted(one.keys() | other.keys()):
                if one.get(name) != other.get(name):
                    raise RecordingError(
                        f"{recording.path}: its rig file says [{section}] {name} = {_said(other.get(name))}, "
                        f"that of {begin.path} {_said(one.get(name))}; give one for all with --rig"
                    )
    return first


def _stated(rig: RigFile, section: str) -> dict[str, object]:
    """What a section says; of a file that travels with the rig file what is in it, wherever it stood."""
    stated: dict[str, object] = dict(rig.model_dump()[section])
    if section == "known":
        stated |= {
            name: f"a file with SHA-256 {hashlib.sha256(content).hexdigest()}"
            for name, content in rig.files.items()
        }
    return stated


def _said(value: object) -> str:
    return "nothing" if value is None else str(value)


def rig_of(recording: Recording, rig_file: Path | RigFile | None) -> RigFile:
    """The given rig file, or the one that the recording carries; RecordingError when it carries none."""
    if rig_file is not None:
        rig = rig_file if isinstance(rig_file, RigFile) else load_rig(rig_file)
        refuse_other_names(recording, rig)
        return rig
    if recording.rig is None:
        if rig_name() in recording.ambiguous:
            raise RecordingError(
                f"{recording.path}: expected one rig file, found several that differ, as in files that were "
                "merged; say which one holds with --rig RIG.toml"
            )
        damage = f" ({recording.damage})" if recording.damage else ""
        raise RecordingError(
            f"{recording.path}: carries no rig file{damage}; give one with --rig RIG.toml (that of a "
            "simulator of your own always has to be given: files that came with a recording are not loaded)"
        )
    return recording.rig


def _long_enough(learn: Record, recording: Recording) -> None:
    if len(learn) < 40:
        raise RecordingError(
            f"{recording.path}: too short to hold data out: {len(learn)} samples are left to learn from, "
            "at least 40 are needed; give a separate recording with --test"
        )

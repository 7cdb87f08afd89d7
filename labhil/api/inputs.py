"""Arguments converted and checked: paths, rigs, names; each error says what was expected."""

from __future__ import annotations

import difflib
import os
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from labhil.errors import OptionError, UsageError
from labhil.kinds import kind_names
from labhil.rig import RigFile, default_rig, is_simulator, load_rig

if TYPE_CHECKING:
    from labhil.analysis.dataset import Dataset
    from labhil.analysis.saved_model import SavedModel
    from labhil.api.diagnosis import Diagnosis
    from labhil.api.fit import Fit
    from labhil.api.model import Model
    from labhil.api.recording import Recording
    from labhil.recording.recording import Recording as FileRecording

PathLike = str | os.PathLike[str]
Progress = bool | Callable[[str], None] | None
"""Where progress goes: to a function of one text, with True to a line on stderr, with None nowhere."""
Warn = Callable[[Iterable[str]], object] | None
"""Where warnings of what recordings lack go: to a function of some lines, or nowhere."""

SHORTEST_LIKENESS = 0.6


def path_of(value: object, what: str) -> Path:
    """The path that was given for ``what``; UsageError where it is none."""
    if isinstance(value, (str, os.PathLike)) and str(value):
        return Path(value)
    raise UsageError(f"{what}: expected a path, found {value!r:.80} ({type(value).__name__})")


def rig_file(rig: PathLike | Model | RigFile | None) -> RigFile | None:
    """The rig file that a kind, a path, a simulator's file or a model stands for; None for None.

    Raises:
        UsageError: It is none of these, or neither a kind nor a file.
        RigFileError: The file cannot be used.
    """
    if rig is None or isinstance(rig, RigFile):
        return rig
    resolved = getattr(rig, "rig_file", None)
    if isinstance(resolved, RigFile):
        return resolved
    if isinstance(rig, str) and rig in kind_names():
        return default_rig(rig)
    path = path_of(rig, "rig")
    if not path.exists() and not is_simulator(str(path)):
        near = difflib.get_close_matches(str(rig), kind_names(), n=1, cutoff=SHORTEST_LIKENESS)
        hint = f" (did you mean {near[0]!r}?)" if near else ""
        raise UsageError(
            f"rig: expected a rig kind ({', '.join(kind_names())}) or the path of a rig file, found "
            f"{str(rig)!r}, which is neither{hint}"
        )
    return load_rig(path)


def names_of(value: Iterable[str] | str | None, what: str) -> tuple[str, ...] | None:
    """Names as a tuple; a text is split at its commas; UsageError where one is no text."""
    if value is None:
        return None
    if isinstance(value, str):
        return tuple(name.strip() for name in value.split(",") if name.strip())
    names = tuple(value) if isinstance(value, Iterable) else None
    if names is None or not all(isinstance(name, str) for name in names):
        raise UsageError(f"{what}: expected names, found {value!r:.80}")
    return names


def number_of(value: object, what: str) -> float:
    """A number; OptionError where it is none."""
    if isinstance(value, (int, float, np.integer, np.floating)) and not isinstance(value, bool):
        return float(value)
    raise OptionError(what, f": expected a number, found {value!r:.80} ({type(value).__name__})")


def number_or_none(value: object, what: str) -> float | None:
    """A number, or None for None."""
    return None if value is None else number_of(value, what)


def whole_number_of(value: object, what: str) -> int:
    """A whole number; OptionError where it is none."""
    if isinstance(value, (int, np.integer)) and not isinstance(value, bool):
        return int(value)
    raise OptionError(what, f": expected a whole number, found {value!r:.80} ({type(value).__name__})")


def span_of(value: object) -> tuple[float, float] | None:
    """A stretch of time, s; OptionError where it is no two numbers of which the second is larger."""
    if value is None:
        return None
    ends = tuple(value) if isinstance(value, Iterable) and not isinstance(value, str) else ()
    if len(ends) != 2:
        raise OptionError("span", f": expected two times, from … to, s, found {value!r:.80}")
    first, last = (number_of(end, "span") for end in ends)
    return first, last


def recordings_of(
    given: PathLike | Recording | Sequence[PathLike | Recording], what: str
) -> list[Path | FileRecording]:
    """One recording or several, given by path or read already."""
    several = list(given) if isinstance(given, (list, tuple)) else [given]
    if not several:
        raise UsageError(f"{what}: expected a recording, found an empty list")
    return [_recording_of(each, what) for each in several]


def load_inputs(
    rec: PathLike | Recording | Sequence[PathLike | Recording],
    model: PathLike | Model | RigFile | None,
    test: PathLike | Recording | Sequence[PathLike | Recording] | None,
    holdout: object,
    per_recording: Iterable[str] | str | None,
    *,
    span: object,
    device: str | None,
    run: int | None,
    warn: Warn,
    allow_no_holdout: bool = False,
) -> Dataset:
    """The data that a fit or a diagnosis is made from; ``warn`` gets what they lack."""
    from labhil.analysis.dataset import load_dataset

    dataset = load_dataset(
        recordings_of(rec, "rec"),
        rig_file(model),
        None if test is None else recordings_of(test, "test"),
        number_of(holdout, "holdout"),
        names_of(per_recording, "per_recording") or (),
        span=span_of(span),
        allow_no_holdout=allow_no_holdout,
        device=device,
        run=run,
    )
    if warn is not None:
        warn(dataset.losses())
    return dataset


def _recording_of(given: object, what: str) -> Path | FileRecording:
    from labhil.api.recording import Recording

    if isinstance(given, Recording):
        return given.file
    if isinstance(given, (str, os.PathLike)):
        return Path(given)
    raise UsageError(
        f"{what}: expected a recording (`labhil.read`, `labhil.recording`) or its path, found "
        f"{type(given).__name__}; arrays become a recording with "
        "`labhil.recording(t, inputs, outputs, rig=…)`"
    )


@contextmanager
def progress_reporter(progress: Progress) -> Iterator[Callable[[str], None]]:
    """What is called with a text about each stage of the work."""
    if callable(progress):
        yield progress
    elif progress:
        from labhil.terminal import status

        with status() as say:
            yield say
    else:
        yield _ignore_progress


def _ignore_progress(text: str) -> None:
    """Progress that is not shown."""


def reference_of(result: Fit | Diagnosis | PathLike | None, what: str) -> Path | SavedModel | None:
    """A result, or its file, as a model to start from or to compare with."""
    if result is None:
        return None
    saved = getattr(result, "saved", None)
    return path_of(result, what) if saved is None else saved

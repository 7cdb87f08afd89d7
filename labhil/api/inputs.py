"""Conversion and checks of arguments: paths, rigs, names, numbers."""

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
from labhil.unreadable import RIG, nearest_file

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
"""Receiver of progress: a function of a text, True for a line on stderr, or None."""
Warn = Callable[[Iterable[str]], object] | None
"""Receiver of warnings about lost data: a function of lines, or None."""


def path_of(value: object, argument: str) -> Path:
    """Return an argument as a path.

    Raises:
        UsageError: It is no path.
    """
    if isinstance(value, (str, os.PathLike)) and str(value):
        return Path(value)
    raise UsageError(f"{argument}: expected a path, found {value!r:.80} ({type(value).__name__})")


def rig_file(rig: PathLike | Model | RigFile | None) -> RigFile | None:
    """Return the rig file of a kind, a path, a simulator's file or a model; None for None.

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
        matches = difflib.get_close_matches(str(rig), kind_names(), n=1)
        hint = f" (did you mean {matches[0]!r}?)" if matches else nearest_file(path, RIG)
        raise UsageError(
            f"rig: expected a rig kind ({', '.join(kind_names())}) or the path of a rig file, found "
            f"{str(rig)!r}, which is neither{hint}"
        )
    return load_rig(path)


def names_of(value: Iterable[str] | str | None, argument: str) -> tuple[str, ...] | None:
    """Return names as a tuple; a text is split at its commas.

    Raises:
        UsageError: A name is no text.
    """
    if value is None:
        return None
    if isinstance(value, str):
        return tuple(name.strip() for name in value.split(",") if name.strip())
    names = tuple(value) if isinstance(value, Iterable) else None
    if names is None or not all(isinstance(name, str) for name in names):
        raise UsageError(f"{argument}: expected names, found {value!r:.80}")
    return names


def number_of(value: object, argument: str) -> float:
    """Return an argument as a number.

    Raises:
        OptionError: It is no number.
    """
    if isinstance(value, (int, float, np.integer, np.floating)) and not isinstance(value, bool):
        return float(value)
    raise OptionError(argument, f": expected a number, found {value!r:.80} ({type(value).__name__})")


def number_or_none(value: object, argument: str) -> float | None:
    """Return an argument as a number, None for None."""
    return None if value is None else number_of(value, argument)


def whole_number_of(value: object, argument: str) -> int:
    """Return an argument as an integer.

    Raises:
        OptionError: It is no integer.
    """
    if isinstance(value, (int, np.integer)) and not isinstance(value, bool):
        return int(value)
    raise OptionError(argument, f": expected a whole number, found {value!r:.80} ({type(value).__name__})")


def span_of(value: object) -> tuple[float, float] | None:
    """Return begin and end of a span of time, s; None for None.

    Raises:
        OptionError: It is not two numbers.
    """
    if value is None:
        return None
    limits = tuple(value) if isinstance(value, Iterable) and not isinstance(value, str) else ()
    if len(limits) != 2:
        raise OptionError("span", f": expected two times, from … to, s, found {value!r:.80}")
    first, last = (number_of(limit, "span") for limit in limits)
    return first, last


def max_samples_of(value: object) -> int | None:
    """Return a largest number of samples; None for None.

    Raises:
        OptionError: It is no integer.
    """
    return None if value is None else whole_number_of(value, "max_samples")


def recordings_of(
    values: PathLike | Recording | Sequence[PathLike | Recording], argument: str
) -> list[Path | FileRecording]:
    """Return one recording or several as paths or as recordings that were read.

    Raises:
        UsageError: There is none, or an item is no recording.
    """
    recordings = list(values) if isinstance(values, (list, tuple)) else [values]
    if not recordings:
        raise UsageError(f"{argument}: expected a recording, found an empty list")
    return [_recording_of(recording, argument) for recording in recordings]


def load_inputs(
    rec: PathLike | Recording | Sequence[PathLike | Recording],
    model: PathLike | Model | RigFile | None,
    test: PathLike | Recording | Sequence[PathLike | Recording] | None,
    holdout: object,
    per_recording: Iterable[str] | str | None,
    *,
    span: object,
    max_samples: object,
    device: str | None,
    run: int | None,
    warn: Warn,
    allow_no_holdout: bool = False,
) -> Dataset:
    """Load the data of a fit or a diagnosis from the arguments of :func:`labhil.fit`."""
    from labhil.analysis.dataset import load_dataset

    dataset = load_dataset(
        recordings_of(rec, "rec"),
        rig_file(model),
        None if test is None else recordings_of(test, "test"),
        number_of(holdout, "holdout"),
        names_of(per_recording, "per_recording") or (),
        span=span_of(span),
        max_samples=max_samples_of(max_samples),
        allow_no_holdout=allow_no_holdout,
        device=device,
        run=run,
    )
    if warn is not None:
        warn(dataset.losses())
    return dataset


def _recording_of(value: object, argument: str) -> Path | FileRecording:
    from labhil.api.recording import Recording

    if isinstance(value, Recording):
        return value.file
    if isinstance(value, (str, os.PathLike)):
        return Path(value)
    raise UsageError(
        f"{argument}: expected a recording (`labhil.read`, `labhil.recording`) or its path, found "
        f"{type(value).__name__}; arrays become a recording with "
        "`labhil.recording(t, inputs, outputs, rig=…)`"
    )


@contextmanager
def progress_reporter(progress: Progress) -> Iterator[Callable[[str], None]]:
    """Yield a function that reports the stages of the work."""
    if callable(progress):
        yield progress
    elif progress:
        from labhil.terminal import status

        with status() as say:
            yield say
    else:
        yield _ignore_progress


def _ignore_progress(text: str) -> None:
    """Ignore progress."""


def reference_of(result: Fit | Diagnosis | PathLike | None, argument: str) -> Path | SavedModel | None:
    """Return a result, or its file, as a model to start from or to compare with."""
    if result is None:
        return None
    saved = getattr(result, "saved", None)
    return path_of(result, argument) if saved is None else saved

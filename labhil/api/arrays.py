"""Recordings made of arrays, and the errors about arrays that cannot be one."""

from __future__ import annotations

import hashlib
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from labhil.api.inputs import PathLike, rig_file
from labhil.api.recording import Recording
from labhil.errors import UsageError, suggestion
from labhil.rig import RigFile
from labhil.signals import Direction, FloatArray, Signal, Stream

if TYPE_CHECKING:
    from labhil.api.model import Model

FEWEST_ROWS = 2


def recording(
    t: object,
    inputs: Mapping[str, object],
    outputs: Mapping[str, object],
    *,
    rig: PathLike | Model | RigFile,
    others: Mapping[str, object] | None = None,
    name: str = "arrays",
) -> Recording:
    """Make a recording of arrays.

    Args:
        t: Times of the samples, (n,) s, increasing.
        inputs: What acts on the rig, by signal name: each (n,), or (n, 6) for the joints of an arm, in the
            SI units of the rig kind.
        outputs: What is measured, likewise.
        rig: A rig kind, the path of a rig file, or a model; it says which signals there are.
        others: Further channels of the rig kind, such as a temperature.
        name: What messages and results call it.

    Returns:
        The recording; :meth:`Recording.save` makes a file of it.

    Raises:
        UsageError: Arrays of other lengths than ``t``, numbers that are not finite, times that do not
            increase, or a signal that the rig kind does not have.

    Example:
        >>> import numpy as np
        >>> import labhil as lh
        >>> t = np.arange(0.0, 5.0, 0.01)
        >>> u = 6.0 * np.sign(np.sin(3.0 * t))
        >>> w = 10.0 * u * (1.0 - np.exp(-t))
        >>> rec = lh.recording(t, {"voltage": u}, {"speed": w}, rig="dc_motor")
        >>> rec
        <Recording of dc_motor: 500 samples, 4.99 s at 100 Hz; voltage, speed>
    """
    from labhil.analysis.tables import recording_of_samples

    resolved_rig = rig_file(rig)
    if resolved_rig is None:
        raise UsageError("rig: expected a rig kind, the path of a rig file or a model, found None")
    times = _times(t)
    given = {**_mapping(inputs, "inputs"), **_mapping(outputs, "outputs"), **_mapping(others or {}, "others")}
    known = {signal.name: signal for signal in resolved_rig.kind.signals()}
    for signal in given:
        if signal not in known:
            raise UsageError(
                f"{signal}: a {resolved_rig.kind.name} has no such signal{suggestion(signal, known)}; "
                f"known: {', '.join(known)}"
            )
    signals = tuple(signal for signal in resolved_rig.kind.signals() if signal.name in given)
    _refuse_incomplete(resolved_rig, set(given))
    values = np.hstack([_values(given[s.name], s, len(times)) for s in signals])
    stream = Stream("state", signals, float(1.0 / np.median(np.diff(times))))
    digest = hashlib.sha256(times.tobytes() + values.tobytes()).hexdigest()
    file_recording, notes, content = recording_of_samples(
        Path(name), digest, resolved_rig, stream, times, values
    )
    return Recording(file_recording, tuple(notes), content)


def _mapping(given: object, what: str) -> Mapping[str, object]:
    if isinstance(given, Mapping):
        return given
    raise UsageError(f"{what}: expected a mapping of names to arrays, found {type(given).__name__}")


def _array(given: object, what: str) -> FloatArray:
    try:
        return np.asarray(given, dtype=np.float64)
    except (TypeError, ValueError) as error:
        raise UsageError(f"{what}: expected an array of numbers, found {given!r:.80}: {error}") from error


def _times(t: object) -> FloatArray:
    times = _array(t, "t")
    if times.ndim != 1 or len(times) < FEWEST_ROWS:
        raise UsageError(
            f"t: expected times of shape (n,), at least {FEWEST_ROWS}, found shape {times.shape}"
        )
    _refuse_holes("t", times)
    standing = np.flatnonzero(np.diff(times) <= 0.0)
    if len(standing):
        i = int(standing[0])
        raise UsageError(
            f"t: expected times that increase (s), found {len(standing)} that do not, the first "
            f"t[{i + 1}] = {times[i + 1]:g} after t[{i}] = {times[i]:g}"
        )
    return times


def _values(given: object, signal: Signal, n: int) -> FloatArray:
    values = _array(given, signal.name)
    wanted = f"({n},)" if signal.width == 1 else f"({n}, {signal.width})"
    columns = values[:, None] if values.ndim == 1 else values
    if columns.shape != (n, signal.width):
        raise UsageError(
            f"{signal.name}: expected shape {wanted}, one row for each of the {n} times in t, "
            f"found {values.shape}"
        )
    _refuse_holes(signal.name, columns)
    return columns


def _refuse_holes(name: str, values: FloatArray) -> None:
    bad = np.flatnonzero(~np.isfinite(values.reshape(len(values), -1)).all(axis=1))
    if len(bad):
        raise UsageError(
            f"{name}: expected finite numbers, found {len(bad)} of {len(values)} rows with NaN or infinity, "
            f"the first at index {bad[0]}; drop those rows of all arrays"
        )


def _refuse_incomplete(rig: RigFile, given: set[str]) -> None:
    """Raise UsageError where an input or an output is missing that every model of this kind needs."""
    kind = rig.kind
    if not any(given >= set(names) for names in kind.driven_by):
        wanted = " or ".join(" with ".join(names) for names in kind.driven_by)
        raise UsageError(f"inputs: a {kind.name} needs {wanted}, found {', '.join(sorted(given)) or 'none'}")
    outputs = [s.name for s in kind.outputs if s.direction is Direction.OUTPUT]
    missing = [name for name in outputs if name not in given]
    if len(missing) == len(outputs) or (missing and not kind.any_output):
        wanted = (" or " if kind.any_output else " and ").join(outputs)
        raise UsageError(f"outputs: a {kind.name} needs {wanted}, found {', '.join(sorted(given)) or 'none'}")

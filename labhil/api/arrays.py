"""``labhil.recording``: make a recording of arrays."""

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

MIN_ROWS = 2


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
        inputs: Inputs of the rig by signal name: each (n,), or (n, 6) for the joints of an arm, in the SI
            units of the rig kind.
        outputs: Measured signals, likewise.
        rig: A rig kind, the path of a rig file, or a model; it defines the signals.
        others: Further channels of the rig kind, such as a temperature.
        name: Name in messages and results.

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
    arrays = {
        **_mapping(inputs, "inputs"),
        **_mapping(outputs, "outputs"),
        **_mapping(others or {}, "others"),
    }
    known = {signal.name: signal for signal in resolved_rig.kind.signals()}
    for signal in arrays:
        if signal not in known:
            raise UsageError(
                f"{signal}: a {resolved_rig.kind.name} has no such signal{suggestion(signal, known)}; "
                f"known: {', '.join(known)}"
            )
    signals = tuple(signal for signal in resolved_rig.kind.signals() if signal.name in arrays)
    _check_complete(resolved_rig, set(arrays))
    values = np.hstack([_values(arrays[s.name], s, len(times)) for s in signals])
    stream = Stream("state", signals, float(1.0 / np.median(np.diff(times))))
    digest = hashlib.sha256(times.tobytes() + values.tobytes()).hexdigest()
    file_recording, notes, content = recording_of_samples(
        Path(name), digest, resolved_rig, stream, times, values
    )
    return Recording(file_recording, tuple(notes), content)


def _mapping(value: object, argument: str) -> Mapping[str, object]:
    if isinstance(value, Mapping):
        return value
    raise UsageError(f"{argument}: expected a mapping of names to arrays, found {type(value).__name__}")


def _array(values: object, argument: str) -> FloatArray:
    try:
        return np.asarray(values, dtype=np.float64)
    except (TypeError, ValueError) as error:
        raise UsageError(
            f"{argument}: expected an array of numbers, found {values!r:.80}: {error}"
        ) from error


def _times(t: object) -> FloatArray:
    times = _array(t, "t")
    if times.ndim != 1 or len(times) < MIN_ROWS:
        raise UsageError(f"t: expected times of shape (n,), at least {MIN_ROWS}, found shape {times.shape}")
    _check_finite("t", times)
    not_increasing = np.flatnonzero(np.diff(times) <= 0.0)
    if len(not_increasing):
        i = int(not_increasing[0])
        raise UsageError(
            f"t: expected times that increase (s), found {len(not_increasing)} that do not, the first "
            f"t[{i + 1}] = {times[i + 1]:g} after t[{i}] = {times[i]:g}"
        )
    return times


def _values(array: object, signal: Signal, n: int) -> FloatArray:
    values = _array(array, signal.name)
    expected_shape = f"({n},)" if signal.width == 1 else f"({n}, {signal.width})"
    columns = values[:, None] if values.ndim == 1 else values
    if columns.shape != (n, signal.width):
        raise UsageError(
            f"{signal.name}: expected shape {expected_shape}, one row for each of the {n} times in t, "
            f"found {values.shape}"
        )
    _check_finite(signal.name, columns)
    return columns


def _check_finite(name: str, values: FloatArray) -> None:
    bad = np.flatnonzero(~np.isfinite(values.reshape(len(values), -1)).all(axis=1))
    if len(bad):
        raise UsageError(
            f"{name}: expected finite numbers, found {len(bad)} of {len(values)} rows with NaN or infinity, "
            f"the first at index {bad[0]}; drop those rows of all arrays"
        )


def _check_complete(rig: RigFile, names_found: set[str]) -> None:
    """Raise UsageError where an input or an output is missing that every model of this kind needs."""
    kind = rig.kind
    if not any(names_found >= set(names) for names in kind.driven_by):
        expected = " or ".join(" with ".join(names) for names in kind.driven_by)
        raise UsageError(
            f"inputs: a {kind.name} needs {expected}, found {', '.join(sorted(names_found)) or 'none'}"
        )
    outputs = [s.name for s in kind.outputs if s.direction is Direction.OUTPUT]
    missing = [name for name in outputs if name not in names_found]
    if len(missing) == len(outputs) or (missing and not kind.any_output):
        expected = (" or " if kind.any_output else " and ").join(outputs)
        raise UsageError(
            f"outputs: a {kind.name} needs {expected}, found {', '.join(sorted(names_found)) or 'none'}"
        )

"""Refuse recordings without motion before a fit, which would return numbers for them all the same."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from labhil.errors import RecordingError
from labhil.identify.windows import noise_of
from labhil.physics.model import Metric
from labhil.physics.record import Record
from labhil.signals import FloatArray

Flags = NDArray[np.bool_]

MIN_RELATIVE_RANGE = 1e-9
"""Range of a channel over its largest value, up to which it is constant (rounding of its digits)."""


def require_motion(path: Path, record: Record, metric: Metric) -> None:
    """Check that a recording has motion to which a model can be fitted.

    A constant input alone is no fault: a rig that coasts or rolls down moves by itself.

    Args:
        path: The recording's file, for the message.
        record: What was measured.
        metric: How the rig is scored; inverse dynamics needs an input that changes.

    Raises:
        RecordingError: No output changes; or one of several outputs is constant, as of a sensor that is not
            connected; or no input changes and no output changes beyond its noise.
    """
    is_constant = constant(record.outputs)
    readings = f"found {_constant_readings(record, is_constant)} in all {len(record)} samples"
    if is_constant.all():
        raise RecordingError(
            f"{path}: expected an output that moves, {readings}: nothing can be fitted to that. See whether "
            "the sensor is connected and the right column is mapped, and record the rig while it moves"
        )
    joints = [joint for joint in record.output_joints if joint is not None]
    if is_constant.any() and not joints:
        which = ", ".join(name for name, flag in zip(record.output_names, is_constant, strict=True) if flag)
        # dry friction also holds a part at exactly zero
        rests = not record.outputs[:, is_constant].any()
        rest = ", and whether the part only stood still: then drive it beyond break-away" if rests else ""
        raise RecordingError(
            f"{path}: expected readings of {which}, {readings} while other outputs move. See whether its "
            f"sensor is connected{rest}; to fit without it, import the table without the column {which}"
        )
    if constant(record.inputs).all():
        _refuse_constant_input(path, record, metric)


def _refuse_constant_input(
    path: Path, record: Record, metric: Metric, *, min_spread_in_noise: float = 2.0
) -> None:
    """RecordingError where inputs are constant, and outputs have no more spread than their noise.

    Inverse dynamics needs an input that changes in any case.
    """
    pairs = zip(record.input_names, record.inputs[0], strict=True)
    inputs = ", ".join(f"{name} at {value:.4g}" for name, value in pairs)
    is_still = bool((np.std(record.outputs, axis=0) <= min_spread_in_noise * noise_of(record)).all())
    if metric is Metric.INVERSE_DYNAMICS or is_still:
        more = ", and outputs that show no more than their noise" if is_still else ""
        raise RecordingError(
            f"{path}: expected an input that changes, found {inputs} in all {len(record)} samples{more}: "
            "nothing can be learnt of how the rig answers. Excite it and record again"
        )


def constant(values: FloatArray) -> Flags:
    """Mark the columns (n, m) that never change, but for the rounding of their digits: (m,) of bool."""
    return np.asarray(np.ptp(values, axis=0) <= MIN_RELATIVE_RANGE * np.abs(values).max(axis=0))


def _constant_readings(record: Record, which: Flags) -> str:
    """The constant outputs with their values, as text."""
    columns = zip(record.output_names, record.outputs[0], record.output_units, which, strict=True)
    return ", ".join(f"{name} at {value:.4g} {unit}" for name, value, unit, flag in columns if flag)

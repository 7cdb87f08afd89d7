"""Recordings in which nothing happens: refused before a fit, which would return numbers all the same."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from labhil.errors import RecordingError
from labhil.identify.windows import noise_of
from labhil.physics.model import Metric, Record
from labhil.signals import FloatArray

Flags = NDArray[np.bool_]

ROUNDING = 1e-9
"""Of the largest value: what varies by less is constant."""
MOVES = 2.0
"""A channel moves when its standard deviation is so many times its noise."""


def refuse_still(path: Path, record: Record, metric: Metric) -> None:
    """RecordingError where there is nothing to fit; ``path`` is where the record came from.

    That is: no output changes; one of several outputs is a constant, as of a sensor that is not connected;
    no input changes, and no output beyond its noise, or a motion is needed. A constant input alone is no
    fault: a rig that coasts down, or rolls down, moves by itself.
    """
    stuck = constant(record.outputs)
    readings = f"found {_constant_readings(record, stuck)} in all {len(record)} samples"
    if stuck.all():
        raise RecordingError(
            f"{path}: expected an output that moves, {readings}: nothing can be fitted to that. See whether "
            "the sensor is connected and the right column is mapped, and record the rig while it moves"
        )
    joints = [joint for joint in record.output_joints if joint is not None]
    if stuck.any() and not joints:
        which = ", ".join(name for name, dead in zip(record.output_names, stuck, strict=True) if dead)
        # dry friction holds a part at exactly nothing, too
        rests = not record.outputs[:, stuck].any()
        rest = ", and whether the part only stood still: then drive it beyond break-away" if rests else ""
        raise RecordingError(
            f"{path}: expected readings of {which}, {readings} while other outputs move. See whether its "
            f"sensor is connected{rest}; to fit without it, import the table without the column {which}"
        )
    if constant(record.inputs).all():
        _refuse_unmoved(path, record, metric)


def _refuse_unmoved(path: Path, record: Record, metric: Metric) -> None:
    """RecordingError where no input changes and that matters."""
    pairs = zip(record.input_names, record.inputs[0], strict=True)
    inputs = ", ".join(f"{name} at {value:.4g}" for name, value in pairs)
    still = bool((np.std(record.outputs, axis=0) <= MOVES * noise_of(record)).all())
    if metric is Metric.INVERSE_DYNAMICS or still:
        more = ", and outputs that show no more than their noise" if still else ""
        raise RecordingError(
            f"{path}: expected an input that changes, found {inputs} in all {len(record)} samples{more}: "
            "nothing can be learnt of how the rig answers. Excite it and record again"
        )


def constant(values: FloatArray) -> Flags:
    """Which columns (n, m) never change, but for the rounding of their digits: (m,)."""
    return np.asarray(np.ptp(values, axis=0) <= ROUNDING * np.abs(values).max(axis=0))


def _constant_readings(record: Record, which: Flags) -> str:
    columns = zip(record.output_names, record.outputs[0], record.output_units, which, strict=True)
    return ", ".join(f"{name} at {value:.4g} {unit}" for name, value, unit, dead in columns if dead)

"""The stretch of a long recording that is fitted: where its inputs change most."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from labhil.errors import OptionError
from labhil.identify.windows import FEWEST_SAMPLES
from labhil.physics.record import Record
from labhil.recording.recording import Recording
from labhil.signals import FloatArray

MAX_SAMPLES = 100_000
"""Number of samples of a recording that are used unless another one is given.

Time and memory of a fit grow in proportion to the samples, errors of its estimates fall with their square
root: after so many, what a model lacks matters more than noise.
"""

STARTS = 1000
"""Number of evenly spaced stretches that are compared."""


def check_max_samples(most: int | None) -> None:
    """Raise OptionError for a number of samples that is too small for a fit; None is no limit."""
    if most is not None and most < 2 * FEWEST_SAMPLES:
        raise OptionError("max-samples", f": expected at least {2 * FEWEST_SAMPLES}, found {most}")


def liveliest_stretch(record: Record, most: int | None) -> Record:
    """Cut out the ``most`` consecutive samples of one recording in which its inputs change most.

    Args:
        record: One recording.
        most: Largest number of samples; None for all.

    Returns:
        A copy of the stretch; the record itself where it is no longer, and that of an arm: inverse dynamics
        is linear, and takes long recordings as they are.
    """
    if most is None or len(record) <= most or record.has_joints:
        return record
    travel = _travel(record.inputs)
    starts = np.linspace(0, len(record) - most, STARTS).astype(int)
    first = int(starts[np.argmax(travel[starts + most - 1] - travel[starts])])
    part = record.part(first, first + most)
    # views would keep the whole recording in memory
    return replace(
        part,
        begins=(replace(part.begins[0], left_out=len(record) - most),),
        t=part.t.copy(),
        inputs=part.inputs.copy(),
        outputs=part.outputs.copy(),
        auxiliary={name: values.copy() for name, values in part.auxiliary.items()},
    )


def _travel(inputs: FloatArray) -> FloatArray:
    """Distance (n,) that inputs (n, inputs) have moved up to each sample, each in its largest step."""
    travel = np.zeros(len(inputs))
    for column in inputs.T:
        steps = np.abs(np.diff(column, prepend=column[:1]))
        steps[~np.isfinite(steps)] = 0.0
        travel += steps / max(float(steps.max(initial=0.0)), 1e-300)
    return np.cumsum(travel, out=travel)


def stretch_note(recording: Recording, record: Record) -> str | None:
    """Say which part of a long recording is used; None for one that is used as it is."""
    left_out = record.begins[0].left_out
    if not left_out:
        return None
    return (
        f"{recording.path}: {len(record)} of {len(record) + left_out} samples are used, from "
        f"{record.t[0]:.6g} to {record.t[-1]:.6g} s, where the inputs change most; the option max-samples "
        "takes more, span others."
    )

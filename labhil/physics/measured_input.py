"""A measured input without the noise of its sensor: what was not there cannot push.

A model that is driven by a measured input simulates the noise of that measurement as if it had acted, and an
answer that follows is taken for what the model lacks (errors in variables). Where that noise is white, a
smoother of zero phase takes most of it away: the local cubic (Savitzky and Golay 1964) over as many samples
as take no more than the noise off, so that nothing of the input itself is lost beyond that.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from scipy.signal import savgol_coeffs, savgol_filter

from labhil.physics.model import Record
from labhil.signals import FloatArray, Hold

MEASURED_INPUTS = ("beam_angle", "coil_current")
"""Inputs that are no command but the reading of a sensor."""

DEGREE = 3

WIDTHS = (5, 7, 9, 11, 15, 21, 31, 41, 61, 81)
"""Samples that a cubic is fitted to."""

DIFFERENCES = 20.0
"""Variance of third differences of white noise over its own."""

NEIGHBOURS, WHITE = -0.75, 0.15
"""Correlation of neighbours among these, and by how much it may differ: those of a motion go together."""

NORMAL = 0.6745
"""Median size of normal noise over its standard deviation."""

SURE = 3.0
"""Standard deviations by which what is left may exceed the noise's own mean square by chance."""

LARGEST = 0.1
"""Of the input's own spread, beyond which such noise is no sensor's: it may be what drives the plant."""

EVEN = 0.1
"""Share of the period by which samples may stand beside their beat."""


@dataclass(frozen=True, slots=True)
class Smoothing:
    """White ``noise`` of an input, in its unit, and the ``width`` in samples that takes most of it away."""

    noise: float
    width: int

    @property
    def left(self) -> float:
        """Standard deviation of the noise that is left."""
        return self.noise * float(np.sqrt(_middle(self.width)))


def smoothing_of(record: Record) -> Smoothing | None:
    """How to smooth the first input of one recording; None where there is no white noise on it."""
    u = record.inputs[:, 0]
    if record.input_holds[0] is not Hold.LINEAR or len(u) < 4 * WIDTHS[-1]:
        return None
    steps = np.diff(record.t)
    if np.any(np.abs(steps - np.median(steps)) > EVEN * np.median(steps)):
        return None
    third = np.diff(u, 3)
    noise = float(np.median(np.abs(third))) / NORMAL / np.sqrt(DIFFERENCES)
    if not 0.0 < noise < LARGEST * float(np.std(u)):
        return None
    if abs(float(third[1:] @ third[:-1]) / float(third @ third) - NEIGHBOURS) > WHITE:
        return None
    # the median knows nothing of jumps, and is not known so well
    least, widest = noise**2 * (1.0 + SURE * np.sqrt(2.0 * DIFFERENCES / len(u))), None
    for width in WIDTHS:
        left = u - savgol_filter(u, width, DEGREE)
        level = float(np.mean(left**2)) / (1.0 - _middle(width))
        if level > least * (1.0 + SURE * np.sqrt(2.0 / len(u)) * (widest is not None)):
            break
        least, widest = min(least, level), Smoothing(noise, width)
    return widest


def without_noise(record: Record) -> Record:
    """A record whose measured input is smoothed, each recording by itself, where it has white noise."""
    if record.input_names[0] not in MEASURED_INPUTS:
        return record
    inputs = record.inputs.copy()
    row = 0
    for each in record.recordings():
        how = smoothing_of(each)
        if how is not None:
            inputs[row : row + len(each), 0] = smoothed(each.inputs[:, 0], how)
        row += len(each)
    return replace(record, inputs=inputs)


def smoothing_notes(record: Record, unit: str) -> list[str]:
    """What is done with a measured input that has white noise, for people; a line a recording."""
    if record.input_names[0] not in MEASURED_INPUTS:
        return []
    found = [how for each in record.recordings() if (how := smoothing_of(each)) is not None]
    return list(
        dict.fromkeys(
            f"{record.input_names[0]} is measured with white noise of {how.noise:.2g} {unit}; the model is "
            f"driven by it smoothed over {how.width} samples (a local cubic), which leaves "
            f"{how.left:.2g} {unit}."
            for how in found
        )
    )


def smoothed(u: FloatArray, how: Smoothing) -> FloatArray:
    """An input (n,) without most of its noise."""
    return np.asarray(savgol_filter(u, how.width, DEGREE))


def _middle(width: int) -> float:
    """Share of a sample's own noise in its smoothed value, which is the variance of that, too."""
    return float(savgol_coeffs(width, DEGREE)[width // 2])

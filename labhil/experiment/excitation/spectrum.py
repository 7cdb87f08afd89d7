"""What an excitation does to a rig, in figures and in a line of text: power over frequency."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from labhil.experiment.excitation.function import crest_factor
from labhil.signals import FloatArray

BARS = "▁▂▃▄▅▆▇█"
BAR_COUNT = 48
RANGE_DB = 40.0
"""What the bars reach down to, below the highest."""
SHARE = 0.9
FEWEST = 8


@dataclass(frozen=True, slots=True)
class Band:
    """From ``low`` to ``high`` Hz."""

    low: float
    high: float

    def __str__(self) -> str:
        return f"{self.low:.3g}–{self.high:.3g} Hz"


@dataclass(frozen=True, slots=True)
class Spectrum:
    """Figures of a sampled excitation.

    ``rms`` is about zero, ``crest_factor`` its peak over that (the worst column's of a vector).
    ``occupied`` holds 90 % of the power about the mean, 5 % lying below and above; ``half_power`` (−3 dB)
    reaches from the first to the last bar whose power density is at least half of the density at which
    the power lies on average (the highest would be an accident in a random sequence).
    Both are None for a constant. ``edges`` (bars + 1,) Hz, evenly spaced in the logarithm, and ``density``
    (bars,) unit²/Hz, NaN where a bar is narrower than the resolution, are what :meth:`bars` draws.
    """

    rms: float
    crest_factor: float
    occupied: Band | None
    half_power: Band | None
    edges: FloatArray
    density: FloatArray

    def bars(self) -> str:
        """Return the power density as a line of bars, 5 dB a step, blank from 40 dB below the highest."""
        top = float(np.nanmax(self.density)) if len(self.density) else 0.0
        if not top > 0:
            return ""
        with np.errstate(divide="ignore"):
            level = 1 + 10 * np.log10(_fill_narrow_bars(self.density) / top) / RANGE_DB
        steps = np.floor(np.clip(level, -1.0, 1.0) * len(BARS)).astype(int)
        return "".join(" " if step < 0 else BARS[min(step, len(BARS) - 1)] for step in steps.tolist())


def spectrum_of(values: FloatArray, rate: float) -> Spectrum:
    """Return the figures of ``values`` (n,) or (n, columns) at ``rate`` Hz; the columns' powers add up."""
    columns = values.reshape(len(values), -1)
    rms = float(np.sqrt(np.mean(np.square(columns))))
    crest = max(crest_factor(column) for column in columns.T)
    centred = columns - columns.mean(axis=0)
    power = float(np.mean(np.square(centred)))
    if len(values) < FEWEST or power <= 1e-24 * max(rms, 1e-300) ** 2:
        return Spectrum(rms, crest, None, None, np.empty(0), np.empty(0))
    frequencies = np.arange(1, len(values) // 2 + 1, dtype=np.float64) * (rate / len(values))
    transform = np.abs(np.fft.rfft(centred, axis=0)[1:])
    lines = np.asarray(np.sum(np.square(transform), axis=1), dtype=np.float64)
    lines *= power / float(lines.sum())
    edges, density = _by_bars(frequencies, lines)
    return Spectrum(
        rms, crest, _occupied_band(frequencies, lines), _half_power(edges, density), edges, density
    )


def _occupied_band(frequencies: FloatArray, lines: FloatArray) -> Band:
    below = np.cumsum(lines) / lines.sum()
    ends = np.searchsorted(below, [(1 - SHARE) / 2, (1 + SHARE) / 2])
    low, high = frequencies[np.minimum(ends, len(frequencies) - 1)]
    return Band(float(low), float(high))


def _by_bars(frequencies: FloatArray, lines: FloatArray) -> tuple[FloatArray, FloatArray]:
    spacing = float(frequencies[0])
    edges = np.geomspace(spacing / 2, frequencies[-1] + spacing / 2, BAR_COUNT + 1)
    bar = np.clip(np.searchsorted(edges, frequencies, side="right") - 1, 0, BAR_COUNT - 1)
    count = np.bincount(bar, minlength=BAR_COUNT)
    power = np.bincount(bar, weights=lines, minlength=BAR_COUNT)
    density = np.full(BAR_COUNT, np.nan)
    density[count > 0] = power[count > 0] / (count[count > 0] * spacing)
    return edges, density


def _fill_narrow_bars(density: FloatArray) -> FloatArray:
    """Give bars without a spectral line the density of their lower neighbour."""
    filled = np.flatnonzero(~np.isnan(density))
    return np.asarray(
        density[filled[np.maximum(np.searchsorted(filled, np.arange(len(density)), "right") - 1, 0)]]
    )


def _half_power(edges: FloatArray, density: FloatArray) -> Band:
    there = ~np.isnan(density)
    power = np.where(there, density * np.diff(edges), 0.0)
    usual = float(np.nansum(power * np.where(there, density, 0.0)) / power.sum())
    strong = np.flatnonzero(density >= usual / 2)
    return Band(float(edges[strong[0]]), float(edges[strong[-1] + 1]))

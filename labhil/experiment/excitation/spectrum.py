"""The power spectrum of a sampled excitation, in figures and as a line of text."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from labhil.experiment.excitation.function import crest_factor
from labhil.signals import FloatArray

BARS = "▁▂▃▄▅▆▇█"


@dataclass(frozen=True, slots=True)
class Band:
    """A frequency band from ``low`` to ``high``, Hz."""

    low: float
    high: float

    def __str__(self) -> str:
        return f"{self.low:.3g}–{self.high:.3g} Hz"


@dataclass(frozen=True, slots=True)
class Spectrum:
    """Figures of a sampled excitation.

    Attributes:
        rms: Root mean square about zero, in the unit of the signal.
        crest_factor: Peak over RMS; of a vector, that of the worst column.
        occupied: Band that holds 90 % of the power about the mean, 5 % below and 5 % above; None for a
            constant.
        half_power: Band from the first to the last bin whose density is at least half of the power-weighted
            mean density (the highest density of a random sequence would be an accident); None for a constant.
        edges: Edges of the bins (bins + 1,), Hz, evenly spaced in the logarithm.
        density: Power density of the bins (bins,), unit²/Hz; NaN where a bin is narrower than the resolution.
    """

    rms: float
    crest_factor: float
    occupied: Band | None
    half_power: Band | None
    edges: FloatArray
    density: FloatArray

    def bars(self, *, range_db: float = 40.0) -> str:
        """Return the power density as a line of bars; blank is ``range_db`` or more below the highest."""
        top = float(np.nanmax(self.density)) if len(self.density) else 0.0
        if not top > 0:
            return ""
        with np.errstate(divide="ignore"):
            level = 1 + 10 * np.log10(_fill_narrow_bins(self.density) / top) / range_db
        steps = np.floor(np.clip(level, -1.0, 1.0) * len(BARS)).astype(int)
        return "".join(" " if step < 0 else BARS[min(step, len(BARS) - 1)] for step in steps.tolist())


def spectrum_of(values: FloatArray, rate: float, *, min_samples: int = 8) -> Spectrum:
    """Compute the spectrum of a sampled excitation; the powers of the columns of a vector add up.

    Args:
        values: Samples (n,) or (n, columns).
        rate: Sample rate, Hz.
        min_samples: Fewer samples than this have no spectrum, as a constant has none.
    """
    columns = values.reshape(len(values), -1)
    rms = float(np.sqrt(np.mean(np.square(columns))))
    crest = max(crest_factor(column) for column in columns.T)
    centred = columns - columns.mean(axis=0)
    power = float(np.mean(np.square(centred)))
    if len(values) < min_samples or power <= 1e-24 * max(rms, 1e-300) ** 2:
        return Spectrum(rms, crest, None, None, np.empty(0), np.empty(0))
    frequencies = np.arange(1, len(values) // 2 + 1, dtype=np.float64) * (rate / len(values))
    transform = np.abs(np.fft.rfft(centred, axis=0)[1:])
    powers = np.asarray(np.sum(np.square(transform), axis=1), dtype=np.float64)
    powers *= power / float(powers.sum())
    edges, density = _bin_power(frequencies, powers)
    return Spectrum(
        rms, crest, _occupied_band(frequencies, powers), _half_power_band(edges, density), edges, density
    )


def _occupied_band(frequencies: FloatArray, powers: FloatArray, share: float = 0.9) -> Band:
    cumulative = np.cumsum(powers) / powers.sum()
    limits = np.searchsorted(cumulative, [(1 - share) / 2, (1 + share) / 2])
    low, high = frequencies[np.minimum(limits, len(frequencies) - 1)]
    return Band(float(low), float(high))


def _bin_power(
    frequencies: FloatArray, powers: FloatArray, n_bins: int = 48
) -> tuple[FloatArray, FloatArray]:
    """Return the edges (n_bins + 1,) and densities (n_bins,) of bins that are even in the logarithm."""
    spacing = float(frequencies[0])
    edges = np.geomspace(spacing / 2, frequencies[-1] + spacing / 2, n_bins + 1)
    index = np.clip(np.searchsorted(edges, frequencies, side="right") - 1, 0, n_bins - 1)
    count = np.bincount(index, minlength=n_bins)
    power = np.bincount(index, weights=powers, minlength=n_bins)
    density = np.full(n_bins, np.nan)
    density[count > 0] = power[count > 0] / (count[count > 0] * spacing)
    return edges, density


def _fill_narrow_bins(density: FloatArray) -> FloatArray:
    """Give bins without a spectral line the density of their lower neighbour."""
    filled = np.flatnonzero(~np.isnan(density))
    return np.asarray(
        density[filled[np.maximum(np.searchsorted(filled, np.arange(len(density)), "right") - 1, 0)]]
    )


def _half_power_band(edges: FloatArray, density: FloatArray) -> Band:
    has_lines = ~np.isnan(density)
    power = np.where(has_lines, density * np.diff(edges), 0.0)
    mean_density = float(np.nansum(power * np.where(has_lines, density, 0.0)) / power.sum())
    strong = np.flatnonzero(density >= mean_density / 2)
    return Band(float(edges[strong[0]]), float(edges[strong[-1] + 1]))

"""What a rig is moved by: functions of the step's own time.

No excitation is shaped behind the user's back: what stands here is what is requested, from the first
sample to the last. A rig is kept from jumping by the rate in its limits, and that is recorded.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields
from math import inf, isfinite, pi, sin, sqrt
from typing import Any, Protocol

import numpy as np

from labhil.errors import UnknownNameError
from labhil.signals import FloatArray


class Excitation(Protocol):
    """A function of time: s since the step began, to the unit of the signal that it drives."""

    def __call__(self, t: float) -> float:
        """Return the value at time ``t`` s."""
        ...


@dataclass(frozen=True, slots=True)
class Tones:
    """A sum of sines: Σ ``amplitudes``·sin(2π·``frequencies``·t + ``phases``) + ``offset``; Hz and rad."""

    frequencies: tuple[float, ...]
    amplitudes: tuple[float, ...]
    phases: tuple[float, ...]
    offset: float = 0.0

    def __call__(self, t: float) -> float:
        """Return the value at time ``t`` s."""
        total = self.offset
        for frequency, amplitude, phase in zip(self.frequencies, self.amplitudes, self.phases, strict=True):
            total += amplitude * sin(2 * pi * frequency * t + phase)
        return total


@dataclass(frozen=True, slots=True)
class Chirp:
    """A sine whose frequency rises linearly from ``start`` to ``stop`` Hz over ``duration`` s."""

    start: float
    stop: float
    amplitude: float
    duration: float
    phase: float = 0.0
    offset: float = 0.0

    def __call__(self, t: float) -> float:
        """Return the value at time ``t`` s."""
        turns = self.start * t + (self.stop - self.start) * t * t / (2 * self.duration)
        return self.offset + self.amplitude * sin(2 * pi * turns + self.phase)


@dataclass(frozen=True, slots=True)
class Steps:
    """``levels`` one after another, each held for ``dwell`` s, and again from the first."""

    levels: tuple[float, ...]
    dwell: float

    def __call__(self, t: float) -> float:
        """Return the value at time ``t`` s."""
        return self.levels[int(max(t, 0.0) / self.dwell) % len(self.levels)]


@dataclass(frozen=True, slots=True)
class Hold:
    """One value, ``level``, all the time."""

    level: float

    def __call__(self, t: float) -> float:
        """Return the value at time ``t`` s."""
        return self.level


def two_sine(
    frequencies: Sequence[float],
    amplitude: float | Sequence[float],
    phases: Sequence[float] | None = None,
    offset: float = 0.0,
) -> Tones:
    """Return the sum of two sines, both starting at zero unless ``phases`` (rad) says otherwise."""
    if len(frequencies) != 2:
        raise ValueError(f"`frequencies` has {len(frequencies)} values; two_sine takes two")
    return _tones(frequencies, amplitude, (0.0, 0.0) if phases is None else phases, offset)


def multisine(
    frequencies: Sequence[float],
    amplitude: float | Sequence[float],
    phases: Sequence[float] | None = None,
    offset: float = 0.0,
) -> Tones:
    """Return a sum of sines with Schroeder's phases, which keep its peak low, unless ``phases`` is given."""
    if phases is None:
        phases = schroeder_phases(_each(amplitude, len(frequencies), "amplitude"))
    return _tones(frequencies, amplitude, phases, offset)


def chirp(
    frequencies: Sequence[float],
    amplitude: float | Sequence[float],
    duration: float,
    phases: Sequence[float] | None = None,
    offset: float = 0.0,
) -> Chirp:
    """Return a sine that sweeps between two ``frequencies`` (Hz) in ``duration`` s."""
    if len(frequencies) != 2:
        raise ValueError(f"`frequencies` has {len(frequencies)} values; chirp takes two: from, to")
    _check_frequencies(frequencies)
    if not 0 < duration < inf:
        raise ValueError(f"`duration` must be positive, found {duration:g}")
    (phase,) = (0.0,) if phases is None else _each(phases, 1, "phases")
    (height,) = _each(amplitude, 1, "amplitude")
    return Chirp(frequencies[0], frequencies[1], height, duration, phase, offset)


def steps(levels: Sequence[float], dwell: float) -> Steps:
    """Return ``levels`` one after another, each held for ``dwell`` s."""
    if not levels:
        raise ValueError("`levels` is empty; steps takes at least one")
    if not 0 < dwell < inf:
        raise ValueError(f"`dwell` must be positive, found {dwell:g}")
    return Steps(tuple(levels), dwell)


def hold(level: float) -> Hold:
    """Return one value for the whole step."""
    return Hold(level)


@dataclass(frozen=True, slots=True)
class ExcitationKeys:
    """The settings of an experiment file's step that shape an excitation; None where not given."""

    frequencies: tuple[float, ...] | None = None
    amplitude: float | tuple[float, ...] | None = None
    phases: tuple[float, ...] | None = None
    offset: float | None = None
    level: float | None = None
    levels: tuple[float, ...] | None = None
    dwell: float | None = None

    def given(self) -> dict[str, Any]:
        """Return what was given, by name."""
        named = {field.name: getattr(self, field.name) for field in fields(self)}
        return {name: value for name, value in named.items() if value is not None}


_TONES = (("frequencies", "amplitude"), ("phases", "offset"))
EXCITATIONS: Mapping[str, tuple[Any, tuple[str, ...], tuple[str, ...]]] = {
    "two_sine": (two_sine, *_TONES),
    "multisine": (multisine, *_TONES),
    "chirp": (chirp, *_TONES),
    "steps": (steps, ("levels", "dwell"), ()),
    "hold": (hold, ("level",), ()),
}
"""By name: what makes it, the settings it needs, and those it can do without."""


def make_excitation(name: str, keys: ExcitationKeys, duration: float) -> Excitation:
    """Build the excitation ``name`` for a step of ``duration`` s.

    Raises UnknownNameError, with the names there are, and ValueError for a setting that is missing,
    does not belong to this excitation, or has a wrong value.
    """
    if name not in EXCITATIONS:
        raise UnknownNameError("excitation", name, EXCITATIONS)
    make, needed, optional = EXCITATIONS[name]
    given = keys.given()
    for key in needed:
        if key not in given:
            raise ValueError(f"excitation {name!r} needs the key `{key}`")
    for key in given:
        if key not in needed + optional:
            takes = ", ".join(needed + optional)
            raise ValueError(f"excitation {name!r} has no key `{key}`; it takes: {takes}")
    if name == "chirp":
        given["duration"] = duration
    made: Excitation = make(**given)
    return made


def schroeder_phases(amplitudes: Sequence[float]) -> tuple[float, ...]:
    """Return the phases (rad) φ_k = −2π Σ_{l<k} (k−l)·p_l, p the tones' shares of the power.

    Schroeder 1970: the instantaneous frequency then moves through the spectrum as the power does, so
    that the tones of an evenly spaced comb do not peak together.
    """
    power = np.square(np.asarray(amplitudes, dtype=np.float64))
    total = float(power.sum())
    if total == 0.0:
        return (0.0,) * len(power)
    phases = -2 * pi * np.concatenate(([0.0], np.cumsum(np.cumsum(power / total))[:-1]))
    return tuple(float(phase) for phase in phases)


def sampled(excitation: Excitation, duration: float, rate: float) -> FloatArray:
    """Return the values at ``rate`` Hz over ``duration`` s, the first at t = 0."""
    count = max(round(duration * rate), 1)
    return np.fromiter((excitation(i / rate) for i in range(count)), dtype=np.float64, count=count)


def crest_factor(values: FloatArray) -> float:
    """Return the peak of the absolute value over the root mean square; inf for a signal that is zero."""
    rms = sqrt(float(np.mean(np.square(values))))
    return float(np.max(np.abs(values))) / rms if rms > 0 else inf


def _tones(
    frequencies: Sequence[float], amplitude: float | Sequence[float], phases: Sequence[float], offset: float
) -> Tones:
    _check_frequencies(frequencies)
    count = len(frequencies)
    amplitudes = _each(amplitude, count, "amplitude")
    return Tones(tuple(frequencies), amplitudes, _each(phases, count, "phases"), offset)


def _check_frequencies(frequencies: Sequence[float]) -> None:
    if not frequencies:
        raise ValueError("`frequencies` is empty; give at least one, in Hz")
    for frequency in frequencies:
        if not (isfinite(frequency) and frequency > 0):
            raise ValueError(f"`frequencies` must be positive numbers of Hz, found {frequency:g}")


def _each(value: float | Sequence[float], count: int, name: str) -> tuple[float, ...]:
    if isinstance(value, (int, float)):
        return (float(value),) * count
    if len(value) != count:
        raise ValueError(f"`{name}` has {len(value)} values for {count} tones; give one, or one each")
    return tuple(float(item) for item in value)

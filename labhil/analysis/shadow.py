"""Simulate an accepted model beside a running rig: samples in, residuals and states of agreement out.

The model is simulated in short stretches along the samples. The initial state of each is estimated from the
samples before it, so that residuals show the model's error and not an accumulated drift. Time is that of the
samples; screen and bus are elsewhere (``tui``). ``agreement`` decides whether residuals stay within a band.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from labhil.analysis.agreement import Agreement
from labhil.analysis.saved_model import Reference
from labhil.analysis.simulate import model_on
from labhil.diagnose.intake import mark_censored
from labhil.errors import RecordingError
from labhil.identify.adequacy import NOISE_FLOOR_FACTOR
from labhil.identify.score import score
from labhil.identify.windows import FEWEST_SAMPLES, ScoredWindows, noise_of
from labhil.physics.model import Metric
from labhil.physics.record import Record, Windows
from labhil.physics.rigs import record_of_samples
from labhil.physics.terms import keyed
from labhil.rig import RigFile
from labhil.signals import FloatArray, Stream

BAND_QUANTILE = 0.999
"""Quantile of the absolute residuals of validated data at which the band ends."""

NORMAL_QUANTILE = 3.29
"""Two-sided quantile of normal noise at that level, in standard deviations; no band is narrower."""


@dataclass(frozen=True, slots=True)
class ShadowOptions:
    """Lengths of simulated stretches, and limits of the waiting samples (chosen values).

    Attributes:
        stretch_horizons: Length of a stretch, in horizons of the rig's metric: short, so that a change shows
            soon.
        lead_horizons: Length of the samples before it from which its initial state is estimated, in horizons,
            as in the metric.
        past_horizons: Length of the samples before those, along which states without a sensor are simulated,
            in horizons.
        calm_horizons: Time within the band after which the model agrees again, in horizons; long, so that a
            rig that passes the same place now and then leaves the band once.
        min_calm: The same of a fast rig, s.
        max_gap_periods: Time between two samples, in periods, from which the motion between them is unknown.
        max_wait: Time for which samples are kept before the model can start, s.
        inverse_horizon: Horizon of a rig whose metric is inverse dynamics, which has none, s.
        max_behind: Stretches that may wait; older samples are dropped and counted.
    """

    stretch_horizons: float = 0.25
    lead_horizons: float = 0.5
    past_horizons: float = 1.0
    calm_horizons: float = 2.0
    min_calm: float = 5.0
    max_gap_periods: float = 5.0
    max_wait: float = 10.0
    inverse_horizon: float = 2.0
    max_behind: float = 3.0


DEFAULT_OPTIONS = ShadowOptions()


@dataclass(frozen=True, slots=True)
class Stretch:
    """One simulated stretch.

    Attributes:
        t: (n,) times, s.
        residuals: (n, outputs) measured − simulated, in noise levels.
        noise: (outputs,) noise levels, in the outputs' units.
        names: Of the outputs, with the joint.
        units: Of the outputs.
    """

    t: FloatArray
    residuals: FloatArray
    noise: FloatArray
    names: tuple[str, ...]
    units: tuple[str, ...]


class Shadow:
    """Simulates an accepted model along the samples of a stream.

    Add samples with :meth:`take`, then call :meth:`step` until it returns None.
    """

    def __init__(
        self,
        saved: Reference,
        rig: RigFile,
        stream: Stream,
        bands: Sequence[float] | None = None,
        options: ShadowOptions = DEFAULT_OPTIONS,
    ) -> None:
        """Start without samples.

        Args:
            saved: The accepted model.
            rig: The rig file: its kind and known values.
            stream: Columns and rate of the samples.
            bands: Half widths of the bands of the outputs, in noise levels; by default those of noise alone.
            options: Lengths of stretches and limits.
        """
        self._saved, self._rig, self._stream, self._options = saved, rig, stream, options
        self._bands = None if bands is None else tuple(bands)
        self._t, self._values = np.empty(0), np.empty((0, stream.width))
        self._next: float | None = None
        self._horizon: float | None = None
        self.agreements: tuple[Agreement, ...] = ()
        """State of each output, once the first stretch was simulated."""
        self.dropped = 0.0
        """Seconds that were not simulated, since the simulation was too slow or samples were missing."""
        self.unjudged = ""
        """Why the newest stretch could not be scored, as of an arm at rest; empty where it could."""
        self.gaps = 0
        """Number of gaps in the samples after which the model started anew."""

    @property
    def agrees(self) -> bool:
        """Whether the model explains all outputs."""
        return all(agreement.agrees for agreement in self.agreements)

    @property
    def behind(self) -> float:
        """Seconds of samples that wait to be simulated."""
        return 0.0 if self._next is None or not len(self._t) else max(0.0, float(self._t[-1]) - self._next)

    def take(self, t: FloatArray, values: FloatArray) -> None:
        """Add samples.

        After a gap the model starts anew. Samples that are not newer than earlier ones, or not finite, are
        left out.

        Args:
            t: (n,) times in rising order, s.
            values: (n, columns) in SI units.
        """
        last = self._t[-1] if len(self._t) else -np.inf
        kept = (t > last) & np.isfinite(values).all(axis=1)
        t, values = t[kept], values[kept]
        if not len(t):
            return
        times, samples = np.concatenate([self._t, t]), np.concatenate([self._values, values])
        steps = np.diff(times)
        if len(steps):
            period = float(np.median(steps)) if self._stream.rate <= 0.0 else 1.0 / self._stream.rate
            longest = self._options.max_gap_periods * max(period, float(np.median(steps)))
            gap_rows = np.flatnonzero(steps > longest)
            if len(gap_rows):
                self._restart_after_gap(
                    float(times[gap_rows[-1] + 1]) - (self._next or float(times[gap_rows[-1] + 1]))
                )
                times, samples = times[gap_rows[-1] + 1 :], samples[gap_rows[-1] + 1 :]
        self._t, self._values = times, samples

    def _restart_after_gap(self, lost: float) -> None:
        """Count a gap of ``lost`` s; the next stretch starts after it."""
        self.gaps += 1
        self.dropped += max(0.0, lost)
        self._next = None

    def step(self) -> Stretch | None:
        """Simulate the next stretch; None where there are not enough samples yet.

        Raises:
            ModelFileError: The model is not one of this rig.
            RecordingError: The samples lack signals that the model needs.
        """
        options = self._options
        if len(self._t) < 2 * FEWEST_SAMPLES:
            return None
        horizon = self._metric_horizon()
        if horizon is None:
            self._forget(self._t[-1] - options.max_wait)
            return None
        length, lead = self._lengths(horizon)
        if self._next is None:
            self._next = float(self._t[0]) + lead
        late = self._next + options.max_behind * length
        if self._t[-1] > late + length:  # skip to the newest complete stretch; the gap counts as dropped
            newest = float(self._t[-1]) - length
            self.dropped += newest - self._next
            self._next = newest
        if self._t[-1] < self._next + length:
            return None
        begin, end = self._next, self._next + length
        self._next = end
        self.unjudged = ""
        used = (self._t >= begin - lead - options.past_horizons * horizon) & (self._t < end)
        stretch = self._simulate(self._t[used], self._values[used], begin, lead)
        self._forget(end - lead - options.past_horizons * horizon)
        self._update_agreements(stretch, max(options.calm_horizons * horizon, options.min_calm))
        return stretch

    def _forget(self, before: float) -> None:
        """Drop samples before a time, s."""
        kept = self._t >= before
        self._t, self._values = self._t[kept], self._values[kept]

    def _lengths(self, horizon: float) -> tuple[float, float]:
        """Lengths of a stretch and of its lead-in, s; both have enough samples."""
        period = float(np.median(np.diff(self._t)))
        length = max(self._options.stretch_horizons * horizon, 0.5 * FEWEST_SAMPLES * period)
        return length, max(self._options.lead_horizons * horizon, (FEWEST_SAMPLES + 1) * period)

    def _metric_horizon(self) -> float | None:
        """Horizon of the rig's metric with the model's values, s; None while there is too little motion."""
        if self._horizon is None:
            measured, stated = self._record(self._t, self._values), self._rig.metric.horizon
            try:
                model, _, theta = model_on(measured, self._rig, self._saved)
            except RecordingError as error:
                self.unjudged = str(error)
                return None
            is_inverse = model.metric is Metric.INVERSE_DYNAMICS
            model_horizon = self._options.inverse_horizon if is_inverse else model.horizon_at(theta)
            self._horizon = stated or model_horizon
        return self._horizon

    def _record(self, t: FloatArray, values: FloatArray) -> Record:
        """The samples as a record of the rig."""
        record = record_of_samples(self._stream, t, values, self._rig.kind)
        if record is None:
            raise RecordingError(
                f"{self._stream.name}: expected the signals of a {self._rig.kind.name}, found "
                f"{', '.join(self._stream.names())}"
            )
        record = record.with_holds({n: c.hold for n, c in self._rig.channels.items() if c.hold})
        return record if record.has_joints else mark_censored(record)

    def _simulate(self, t: FloatArray, values: FloatArray, begin: float, lead: float) -> Stretch:
        """Simulate from ``begin`` on, s; an empty stretch where that is not possible."""
        measured = self._record(t, values)
        try:
            return self._score_stretch(measured, begin, lead)
        except RecordingError as error:  # there is too little motion
            self.unjudged = str(error)
            names = tuple(keyed(*measured.channel(j)) for j in range(len(measured.output_names)))
            nothing = np.empty((0, len(names)))
            return Stretch(np.empty(0), nothing, noise_of(measured), names, measured.output_units)

    def _score_stretch(self, measured: Record, begin: float, lead: float) -> Stretch:
        """Simulate from ``begin`` on, with the ``lead`` s before as lead-in."""
        model, record, theta = model_on(measured, self._rig, self._saved)
        first, middle = (int(np.searchsorted(record.t, at)) for at in (begin - lead, begin))
        windows = ScoredWindows(
            Windows.of([(first, middle)]),
            Windows.of([(first, len(record))]),
            np.arange(first, len(record)) >= middle,
            float(record.t[-1] - begin),
        )
        result = score(model, theta, record, noise_of(record), windows=windows)
        new = record.t[result.rows] >= begin
        noise = np.array([channel.noise_floor for channel in result.channels])
        return Stretch(
            t=record.t[result.rows][new],
            residuals=-result.errors[new] / noise,
            noise=noise,
            names=tuple(keyed(channel.channel, channel.joint) for channel in result.channels),
            units=tuple(channel.unit for channel in result.channels),
        )

    def _update_agreements(self, stretch: Stretch, calm: float) -> None:
        """Update the state of each output; ``calm`` (s) is the time until a model agrees again."""
        if not self.agreements:
            bands = self._bands or (NOISE_FLOOR_FACTOR * NORMAL_QUANTILE,) * len(stretch.names)
            self.agreements = tuple(Agreement(band) for band in bands)
        self.agreements = tuple(
            agreement.after(stretch.t, stretch.residuals[:, j], calm)
            for j, agreement in enumerate(self.agreements)
        )


def validated_bands(
    saved: Reference, rig: RigFile, stream: Stream, t: FloatArray, values: FloatArray
) -> tuple[float, ...] | None:
    """Estimate the bands of a model's residuals from a recording on which it was validated.

    Args:
        saved: The accepted model.
        rig: The rig file.
        stream: Columns and rate of the samples.
        t: Times of the samples, (n,) s.
        values: Their values, (n, columns).

    Returns:
        Half width for each output, in noise levels: 1.15 times (the factor to which noise is known) the 99.9
        % quantile of its residuals, simulated in the same short stretches, and at least that of noise alone.
        None where the recording is too short.
    """
    shadow = Shadow(saved, rig, stream)
    sizes = []
    for rows in np.array_split(np.arange(len(t)), max(1, len(t) // 50)):
        shadow.take(t[rows], values[rows])
        while (stretch := shadow.step()) is not None:
            sizes.append(np.abs(stretch.residuals))
    if sum(map(len, sizes)) < FEWEST_SAMPLES:
        return None
    finite = np.nan_to_num(np.vstack(sizes), nan=np.inf)
    quantiles = np.quantile(finite, BAND_QUANTILE, axis=0, method="higher")
    return tuple(NOISE_FLOOR_FACTOR * max(NORMAL_QUANTILE, float(q)) for q in quantiles)

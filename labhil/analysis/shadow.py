"""An accepted model beside a rig: samples in, residuals and the state of agreement out.

The model is simulated in short stretches along the samples. Each begins from the state that the samples
before it suggest, so that what is seen is the model's error and not a drift that began long ago. Nothing
here knows a screen, a bus or a clock: time is that of the samples.
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
from labhil.identify.adequacy import FLOOR_KNOWN_TO
from labhil.identify.score import score
from labhil.identify.windows import FEWEST_SAMPLES, ScoredWindows, noise_of
from labhil.physics.model import Metric, Record, Windows
from labhil.physics.rigs import record_of_samples
from labhil.physics.terms import keyed
from labhil.rig import RigFile
from labhil.signals import FloatArray, Stream

STRETCH_IN_HORIZONS = 0.25
"""Length of a simulated stretch, in horizons of the rig's metric: short, so that news comes soon."""

LEAD_IN_HORIZONS = 0.5
"""Of the samples before it, from which its state is estimated; as in the metric."""

PAST_IN_HORIZONS = 1.0
"""Of the samples before those, which states that no sample shows are carried along."""

QUANTILE = 0.999
"""Of the model's own validated errors, in noise levels: the half width of the band."""

NORMAL = 3.29
"""The same of noise alone; no band is narrower."""

CALM_IN_HORIZONS = 2.0
"""How long residuals have to be back within the band until the model agrees again; a rig that comes by the
same place once in a while is to leave it once.
"""

SHORTEST_CALM = 5.0
"""The same in s, of a quick rig."""

LONGEST_STEP = 5.0
"""Periods between two samples from which on the motion between them is not known."""

LONGEST_WAIT = 10.0
"""How far back samples are kept while too little happens to begin, s."""

INVERSE_HORIZON = 2.0
"""Of a rig whose metric is inverse dynamics, which has none, s."""

MOST_BEHIND = 3.0
"""Stretches that may wait; older samples are dropped, and counted."""


@dataclass(frozen=True, slots=True)
class Stretch:
    """One simulated stretch: times (n,) s, residuals (n, outputs) in noise levels, noise levels in units."""

    t: FloatArray
    residuals: FloatArray
    noise: FloatArray
    names: tuple[str, ...]
    units: tuple[str, ...]


class Shadow:
    """Simulates the model of a result along samples of a stream.

    Give it samples with :meth:`take`, then call :meth:`step` until it returns None.
    """

    def __init__(
        self, saved: Reference, rig: RigFile, stream: Stream, bands: Sequence[float] | None = None
    ) -> None:
        """Begin without samples.

        Args:
            saved: The accepted model.
            rig: The rig file: its kind, and what is known of it.
            stream: What the samples are of.
            bands: Half widths of the bands of the outputs, in noise levels; those of noise when absent.
        """
        self._saved, self._rig, self._stream = saved, rig, stream
        self._bands = None if bands is None else tuple(bands)
        self._t, self._values = np.empty(0), np.empty((0, stream.width))
        self._next: float | None = None
        self._horizon: float | None = None
        self.agreements: tuple[Agreement, ...] = ()
        """Of each output, once the first stretch was simulated."""
        self.dropped = 0.0
        """Seconds that were not simulated, since the work was too slow or samples were missing."""
        self.unjudged = ""
        """Why the newest stretch says nothing, as of an arm at rest; empty where it does."""
        self.gaps = 0
        """How often samples were missing, so that the model began anew."""

    @property
    def agrees(self) -> bool:
        """Whether the model explains all outputs."""
        return all(each.agrees for each in self.agreements)

    @property
    def behind(self) -> float:
        """Seconds of samples that wait to be simulated."""
        return 0.0 if self._next is None or not len(self._t) else max(0.0, float(self._t[-1]) - self._next)

    def take(self, t: FloatArray, values: FloatArray) -> None:
        """Take samples: times (n,) s, increasing, and values (n, columns) in SI units.

        Where samples are missing the model begins anew after the gap. Samples that are not newer than those
        that are known are left out, and so are those that are not finite.
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
            gap_rows = np.flatnonzero(steps > LONGEST_STEP * max(period, float(np.median(steps))))
            if len(gap_rows):
                self._restart_after_gap(
                    float(times[gap_rows[-1] + 1]) - (self._next or float(times[gap_rows[-1] + 1]))
                )
                times, samples = times[gap_rows[-1] + 1 :], samples[gap_rows[-1] + 1 :]
        self._t, self._values = times, samples

    def _restart_after_gap(self, lost: float) -> None:
        self.gaps += 1
        self.dropped += max(0.0, lost)
        self._next = None

    def step(self) -> Stretch | None:
        """Simulate the next stretch; None where there are not enough samples yet.

        Raises:
            ModelFileError: The model is none of this rig.
            RecordingError: The samples lack what the model needs.
        """
        if len(self._t) < 2 * FEWEST_SAMPLES:
            return None
        horizon = self._metric_horizon()
        if horizon is None:
            self._forget(self._t[-1] - LONGEST_WAIT)
            return None
        length, lead = self._lengths(horizon)
        if self._next is None:
            self._next = float(self._t[0]) + lead
        late = self._next + MOST_BEHIND * length
        if self._t[-1] > late + length:  # skip to the newest complete stretch; the gap counts as dropped
            fresh = float(self._t[-1]) - length
            self.dropped += fresh - self._next
            self._next = fresh
        if self._t[-1] < self._next + length:
            return None
        begin, end = self._next, self._next + length
        self._next = end
        self.unjudged = ""
        used = (self._t >= begin - lead - PAST_IN_HORIZONS * horizon) & (self._t < end)
        stretch = self._simulate(self._t[used], self._values[used], begin, lead)
        self._forget(end - lead - PAST_IN_HORIZONS * horizon)
        self._update_agreements(stretch, max(CALM_IN_HORIZONS * horizon, SHORTEST_CALM))
        return stretch

    def _forget(self, before: float) -> None:
        kept = self._t >= before
        self._t, self._values = self._t[kept], self._values[kept]

    def _lengths(self, horizon: float) -> tuple[float, float]:
        """Of a stretch and of its lead-in, s; both have samples enough."""
        period = float(np.median(np.diff(self._t)))
        length = max(STRETCH_IN_HORIZONS * horizon, 0.5 * FEWEST_SAMPLES * period)
        return length, max(LEAD_IN_HORIZONS * horizon, (FEWEST_SAMPLES + 1) * period)

    def _metric_horizon(self) -> float | None:
        """The horizon of the rig's metric with the model's values, s; None while too little happens."""
        if self._horizon is None:
            measured, stated = self._record(self._t, self._values), self._rig.metric.horizon
            try:
                model, _, theta = model_on(measured, self._rig, self._saved)
            except RecordingError as error:
                self.unjudged = str(error)
                return None
            model_horizon = (
                INVERSE_HORIZON if model.metric is Metric.INVERSE_DYNAMICS else model.horizon_at(theta)
            )
            self._horizon = stated or model_horizon
        return self._horizon

    def _record(self, t: FloatArray, values: FloatArray) -> Record:
        record = record_of_samples(self._stream, t, values, self._rig.kind)
        if record is None:
            raise RecordingError(
                f"{self._stream.name}: expected the signals of a {self._rig.kind.name}, found "
                f"{', '.join(self._stream.names())}"
            )
        record = record.with_holds({n: c.hold for n, c in self._rig.channels.items() if c.hold})
        return record if any(joint is not None for joint in record.output_joints) else mark_censored(record)

    def _simulate(self, t: FloatArray, values: FloatArray, begin: float, lead: float) -> Stretch:
        measured = self._record(t, values)
        try:
            return self._score_stretch(measured, begin, lead)
        except RecordingError as error:  # too little happens to say anything of it
            self.unjudged = str(error)
            names = tuple(keyed(*measured.channel(j)) for j in range(len(measured.output_names)))
            nothing = np.empty((0, len(names)))
            return Stretch(np.empty(0), nothing, noise_of(measured), names, measured.output_units)

    def _score_stretch(self, measured: Record, begin: float, lead: float) -> Stretch:
        model, record, theta = model_on(measured, self._rig, self._saved)
        first, middle = (int(np.searchsorted(record.t, at)) for at in (begin - lead, begin))
        windows = ScoredWindows(
            Windows.of([(first, middle)]),
            Windows.of([(first, len(record))]),
            np.arange(first, len(record)) >= middle,
            float(record.t[-1] - begin),
        )
        scored = score(model, theta, record, noise_of(record), windows=windows)
        new = record.t[scored.rows] >= begin
        noise = np.array([channel.noise_floor for channel in scored.channels])
        return Stretch(
            t=record.t[scored.rows][new],
            residuals=-scored.errors[new] / noise,
            noise=noise,
            names=tuple(keyed(channel.channel, channel.joint) for channel in scored.channels),
            units=tuple(channel.unit for channel in scored.channels),
        )

    def _update_agreements(self, stretch: Stretch, calm: float) -> None:
        if not self.agreements:
            bands = self._bands or (FLOOR_KNOWN_TO * NORMAL,) * len(stretch.names)
            self.agreements = tuple(Agreement(band) for band in bands)
        self.agreements = tuple(
            agreement.after(stretch.t, stretch.residuals[:, j], calm)
            for j, agreement in enumerate(self.agreements)
        )


def validated_bands(
    saved: Reference, rig: RigFile, stream: Stream, t: FloatArray, values: FloatArray
) -> tuple[float, ...] | None:
    """Half widths of the bands of a model on a recording that it was judged on, in noise levels.

    Args:
        saved: The accepted model.
        rig: The rig file.
        stream: What the samples are of.
        t: Times of the samples, (n,) s.
        values: Their values, (n, columns).

    Returns:
        For each output 1.15 times (as well as noise is known) the 99.9 % quantile of its residuals over the
        noise, simulated in the same short stretches, and not less than that of noise; None where the
        recording is too short.
    """
    shadow = Shadow(saved, rig, stream)
    sizes = []
    for rows in np.array_split(np.arange(len(t)), max(1, len(t) // 50)):
        shadow.take(t[rows], values[rows])
        while (stretch := shadow.step()) is not None:
            sizes.append(np.abs(stretch.residuals))
    if sum(map(len, sizes)) < FEWEST_SAMPLES:
        return None
    quantiles = np.quantile(np.nan_to_num(np.vstack(sizes), nan=np.inf), QUANTILE, axis=0, method="higher")
    return tuple(FLOOR_KNOWN_TO * max(NORMAL, float(q)) for q in quantiles)

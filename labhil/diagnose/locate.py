"""Where a mismatch lives: in time, and along the physical coordinate that reveals it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from labhil.identify.fitted import Fitted
from labhil.identify.score import Score
from labhil.physics.extra_force import AcceptsExtraForce
from labhil.physics.model import Metric, Model, Record, Windows, index_of
from labhil.physics.terms import unkeyed
from labhil.signals import FloatArray

SHARE = 0.8
"""Of the excess squared error that a regime has to hold."""

BINS = 40
BLOCKS = 12
"""Into which a record of one window is cut to say when."""

MOST_SAMPLES = 0.6
"""Share of the samples beyond which a regime says nothing."""

MOST_RUNS = 3
"""Stretches of a coordinate that people can keep in mind."""

AS_WELL = 0.05
"""Share of an effect's variance by which a coordinate may say less of it than the best one does."""

CLEARER = 0.8
"""A coordinate comes before an earlier one when its regime has at most this share of that one's samples."""


@dataclass(frozen=True, slots=True)
class Regime:
    """A range of a coordinate where an effect lives, with the share of the excess squared error in it.

    Where no coordinate shows it, it is a range of the effect's own force, and the coordinate is its term.
    """

    coordinate: str
    low: float
    high: float
    share_of_excess: float
    unit: str = ""
    term: str = ""
    joint: int | None = None


@dataclass(frozen=True, slots=True)
class Location:
    """Where the excess error is; ``enters`` says at which place of the chain the missing effect acts.

    Of several recordings, ``recordings`` are the numbers of those in whose own time ``times`` (s) are.
    """

    channel: str
    joint: int | None
    enters: str
    times: tuple[tuple[float, float], ...]
    regimes: tuple[Regime, ...]
    statement: str
    recordings: tuple[int, ...] = ()


@dataclass(frozen=True, slots=True, eq=False)
class Abscissa:
    """What a curve is drawn over: the samples ``x`` (N,) of a coordinate, in ``unit``."""

    name: str
    x: FloatArray
    unit: str

    @property
    def label(self) -> str:
        """Name and unit."""
        return f"{self.name}, {self.unit}"


@dataclass(frozen=True, slots=True, eq=False)
class HeldOut:
    """Data that a search never saw, with scores on the same windows before and after."""

    record: Record
    before: Score
    after: Score

    @property
    def motion(self) -> Motion:
        """The scored samples as the better model has them."""
        return self.record, self.after.windows.whole, self.after.states, self.after.windows.scored

    def error_reduction(self, joint: int | None) -> FloatArray:
        """What the better model takes from the squared errors of each scored sample, in noise floors, (N,).

        Of the outputs of a ``joint`` and of those that belong to none.
        """
        columns = [j for j, c in enumerate(self.after.channels) if joint is None or c.joint in (None, joint)]
        return np.asarray(_excess(self.before, self.after)[:, columns].sum(axis=1))


Motion = tuple[Record, Windows, FloatArray, np.ndarray]
"""A record, windows with their states, and which of their rows count."""


@dataclass(frozen=True, slots=True)
class Contribution:
    """What one ``term`` adds along a motion, (N,), and the ``coordinates`` there, (N,) each.

    ``unit`` is that of a force, "" of anything else; ``joint`` the one that it acts on, of several.
    ``period`` is the coordinate along which it repeats, and how far.
    """

    term: str
    values: FloatArray
    unit: str
    coordinates: Mapping[str, FloatArray]
    units: Mapping[str, str]
    joint: int | None
    period: tuple[str, float] | None = None

    def regimes(self, explained: FloatArray | None = None) -> tuple[Regime, ...]:
        """Where most of it lives, as one to three stretches of one coordinate; none if it is everywhere.

        Where no coordinate holds it together, of a force its own sizes do: a ripple lives near its crests.
        It lives where it is so large that 80 % of ``explained`` (N,) is there (default: of its squares).
        """
        squares = self.values**2
        held = squares if explained is None or explained.sum() <= 0.0 else explained
        large = _level_set(squares, held)
        stretches = regimes({name: self.coordinates[name] for name in self.units}, large.astype(np.float64))
        return tuple(self._complete(regime, held) for regime in stretches or self._force_ranges(large))

    def abscissa(self, stretches: Sequence[Regime]) -> Abscissa:
        """The coordinate that it follows best; of several the one that its ``stretches`` are of.

        An effect that repeats is laid over one period.
        """
        if self.period is not None:
            name, length = self.period
            return Abscissa(f"{name} modulo {length:.3g}", self.coordinates[name] % length, self.units[name])
        followed = {name: _correlation_ratio(self.values, self.coordinates[name]) for name in self.units}
        near = [name for name in followed if followed[name] > max(followed.values()) - AS_WELL]
        lived = [regime.coordinate for regime in stretches if regime.coordinate in near]
        name = (lived or near)[0]
        return Abscissa(name, self.coordinates[name], self.units[name])

    def _force_ranges(self, large: np.ndarray) -> tuple[Regime, ...]:
        """The sizes of a force where it is ``large`` (N,), by sign; none if that is nearly everywhere."""
        if not self.unit or not 0.0 < np.mean(large) < MOST_SAMPLES:
            return ()
        signs = [self.values[large & (self.values < 0.0)], self.values[large & (self.values > 0.0)]]
        return tuple(
            Regime(self.term, float(values.min()), float(values.max()), 0.0)
            for values in signs
            if len(values)
        )

    def _complete(self, regime: Regime, held: FloatArray) -> Regime:
        """Complete a regime by its effect, its unit and its share of ``held`` (N,)."""
        over_force = regime.coordinate == self.term
        values = self.values if over_force else self.coordinates[regime.coordinate]
        inside = (values >= regime.low) & (values <= regime.high)
        share = float(np.clip(held[inside].sum() / held.sum(), 0.0, 1.0)) if held.sum() > 0.0 else 0.0
        unit = self.unit if over_force else self.units[regime.coordinate]
        term, joint = unkeyed(self.term)
        return replace(regime, share_of_excess=share, unit=unit, term=term, joint=joint)


def _level_set(size: FloatArray, held: FloatArray) -> np.ndarray:
    """Where a size (N,) is so large that the share of ``held`` (N,) is there, (N,) of bool."""
    order = np.argsort(-size, kind="stable")
    enough = np.cumsum(held[order]) >= SHARE * held.sum()
    return np.asarray((size >= size[order[int(np.argmax(enough))]]) & (size > 0.0))


def locate_terms(
    final: Fitted, terms: Sequence[str], held_out: HeldOut, joint: int | None
) -> tuple[dict[str, Contribution], dict[str, tuple[Regime, ...]]]:
    """The contribution of each of some terms to held-out data, and the regimes where it lives.

    A term that belongs to no joint of an arm is located on the ``joint`` with the largest error.
    """
    shares = {term: contribution(final, term, held_out.motion, joint) for term in terms}
    # where several terms explain the excess, no part of it belongs to one of them
    explained = held_out.error_reduction(next(iter(shares.values())).joint) if len(shares) == 1 else None
    return shares, {term: share.regimes(explained) for term, share in shares.items()}


def contribution(
    final: Fitted, term: str, motion: Motion | None = None, joint: int | None = None
) -> Contribution:
    """What a term of the model contributes where it acts, with the ``motion`` as it is (default: the fit's).

    A force as a difference of forces; what acts on the way in as the force that it changes, or else as what
    drives the motion; what acts on the way out as a difference of readings.
    What belongs to no joint of an arm does so on ``joint`` (default: where it does most).
    """
    model, problem = final.problem.model, final.problem
    if motion is None:
        all_rows = np.ones(len(problem.windows.rows), dtype=bool)
        motion = problem.record, problem.windows, final.solution.point.states, all_rows
    record, windows, states, counted = motion
    less = without_sizes(model, final.theta, term)
    along = model.coordinates(final.theta, record, windows, states)
    driven = model.drive_coordinates(less, record, windows, along)
    values = model.generalised_force(final.theta, along) - model.generalised_force(less, {**along, **driven})
    unit = model.force_unit if isinstance(model, AcceptsExtraForce) and np.any(values) else ""
    if not np.any(values) and driven:
        values = np.column_stack([along[name] - driven[name] for name in driven])
    if not np.any(values):
        values = model.simulate(final.theta, record, windows, states)
        values = values - model.simulate(less, record, windows, states)
    values = values.reshape(len(windows.rows), -1)[counted]
    along = {name: column[counted] for name, column in along.items()}
    term_joint = model.terms[term].joint
    return _of_one_joint(
        model, final.theta, term, values, along, unit, joint if term_joint is None else term_joint
    )


def without_sizes(model: Model, theta: FloatArray, term: str) -> FloatArray:
    """The vector with a term's sizes at neutral; what builds on the term keeps its own."""
    less = theta.copy()
    for i, parameter in enumerate(model.parameters):
        if parameter.term == term and not parameter.shape:
            less[i] = 0.0
    return less


def _of_one_joint(
    model: Model,
    theta: FloatArray,
    term: str,
    values: FloatArray,
    along: Mapping[str, FloatArray],
    unit: str,
    joint: int | None,
) -> Contribution:
    """The column of the joint that is acted on, with that joint's coordinates where each has its own."""
    strongest = int(np.argmax(np.sum(values**2, axis=0)))
    column = joint if joint is not None and joint < values.shape[1] else strongest
    units = {}
    for name in along:
        stem, _, number = name.rpartition("_")
        if name in model.coordinate_units:
            units[name] = model.coordinate_units[name]
        elif stem in model.coordinate_units and number == str(column):
            units[name] = model.coordinate_units[stem]
    several = values.shape[1] > 1
    period = _period(model, theta, term, units)
    return Contribution(term, values[:, column], unit, along, units, column if several else None, period)


def _period(model: Model, theta: FloatArray, term: str, units: Mapping[str, str]) -> tuple[str, float] | None:
    """Along which of these coordinates a term repeats, and how far; None where it does not."""
    order = model.terms[term].repeats
    if order is None:
        return None
    name = order.waves_over if order.joint is None else f"{order.waves_over}_{order.joint}"
    places = index_of(model.parameters)
    times = float(theta[places[order.key]]) if order.key in places else order.scale
    return (name, 2.0 * np.pi / times) if name in units and times > 0.0 else None


def regimes(coordinates: Mapping[str, FloatArray], excess: FloatArray) -> tuple[Regime, ...]:
    """The stretches of one coordinate that hold 80 % of ``excess`` (N,) with the fewest samples.

    Coordinates come in the order of their importance. None is named along which the excess takes 60 % of the
    samples or more.
    """
    best: tuple[float, tuple[Regime, ...]] = (MOST_SAMPLES, ())
    for name, values in coordinates.items():
        if np.ptp(values) <= 0.0 or not np.any(excess):
            continue
        samples, stretches = _densest(values, excess)
        needed = best[0] if not best[1] else CLEARER * best[0]
        if samples < needed:
            total = float(excess.sum())
            located = tuple(
                Regime(name, low, high, float(excess[(values >= low) & (values <= high)].sum()) / total)
                for low, high in stretches
            )
            best = (samples, located)
    return best[1]


def _correlation_ratio(values: FloatArray, coordinate: FloatArray) -> float:
    """The share of the variance of ``values`` (N,) that their means in bins of a ``coordinate`` (N,) have."""
    if np.ptp(coordinate) <= 0.0:
        return 0.0
    _, place = _quantile_bins(coordinate)
    count = np.maximum(np.bincount(place), 1)
    mean = np.bincount(place, values) / count
    return float(np.var(mean[place]) / max(np.var(values), 1e-300))


def _quantile_bins(values: FloatArray) -> tuple[FloatArray, np.ndarray]:
    """Edges of bins of equally many samples, and which bin each of ``values`` (N,), not all alike, is in."""
    edges = np.unique(np.quantile(values, np.linspace(0.0, 1.0, BINS + 1)))
    return edges, np.clip(np.searchsorted(edges, values, side="right") - 1, 0, len(edges) - 2)


def _densest(values: FloatArray, excess: FloatArray) -> tuple[float, list[tuple[float, float]]]:
    """Share of the samples in the densest stretches that hold the share, and their bounds.

    Bins of equally many samples are taken in the order of their density, and gaps filled until few runs are
    left.
    """
    edges, place = _quantile_bins(values)
    weight = np.bincount(place, excess, len(edges) - 1)
    count = np.bincount(place, minlength=len(edges) - 1)
    chosen = np.zeros(len(weight), dtype=bool)
    for k in np.argsort(-weight / np.maximum(count, 1)):
        if weight[chosen].sum() >= SHARE * weight.sum():
            break
        chosen[k] = True
    chosen = _in_few_runs(chosen, count)
    begins, ends = _runs(chosen)
    stretches = [(float(edges[a]), float(edges[b])) for a, b in zip(begins, ends, strict=True)]
    return float(count[chosen].sum() / len(values)), stretches


def _in_few_runs(chosen: np.ndarray, count: np.ndarray) -> np.ndarray:
    """The gaps of the fewest samples between chosen bins filled until at most three runs are left."""
    while True:
        begins, ends = _runs(chosen)
        narrow = [k for k in range(len(begins) - 1) if begins[k + 1] - ends[k] <= 1]
        if len(begins) <= MOST_RUNS and not narrow:
            return chosen
        gaps = [count[ends[k] : begins[k + 1]].sum() for k in range(len(begins) - 1)]
        k = narrow[0] if narrow else int(np.argmin(gaps))
        chosen[ends[k] : begins[k + 1]] = True


def _runs(chosen: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """First bin of every run of chosen bins, and the one after its last."""
    steps = np.diff(np.r_[0, chosen.astype(np.int64), 0])
    return np.flatnonzero(steps == 1), np.flatnonzero(steps == -1)


def times(
    before: Score, after: Score, record: Record, most: int = 5
) -> tuple[tuple[tuple[float, float], ...], tuple[int, ...]]:
    """The scored windows that together hold half of the excess squared error, worst first.

    Begin and end (s) of each, and, where there are several, the numbers of the recordings in whose time.
    """
    excess = _excess(before, after).sum(axis=1)
    pieces = [np.flatnonzero(before.window == w) for w in np.unique(before.window)]
    if len(pieces) == 1 or after.metric is Metric.INVERSE_DYNAMICS:
        blocks = max(BLOCKS // len(pieces), 1)
        pieces = [block for piece in pieces for block in np.array_split(piece, blocks)]
    sums = np.array([excess[piece].sum() for piece in pieces])
    order = np.argsort(sums)[::-1]
    spans, numbers, held = [], list[int](), 0.0
    for i in order[:most]:
        if sums[i] <= 0 or held > 0.5 * sums[sums > 0].sum():
            break
        rows = before.rows[pieces[i]]
        number, begin = record.own_time(int(rows[0]))
        spans.append((begin, record.own_time(int(rows[-1]))[1]))
        numbers.append(number)
        held += float(sums[i])
    return tuple(spans), tuple(numbers) if len(record.begins) > 1 else ()


def _excess(before: Score, after: Score) -> FloatArray:
    """What a better model takes from the squared errors of each scored sample, in noise floors, (N, c)."""
    floors = np.array([channel.noise_floor for channel in after.channels])
    return np.asarray((before.errors / floors) ** 2 - (after.errors / floors) ** 2)


def recording_shares(before: Score, after: Score) -> str:
    """A sentence: which of several recordings the excess squared error is in; nothing of one."""
    excess = _excess(before, after).sum(axis=1)
    sums = np.array([max(float(excess[recording.places].sum()), 0.0) for recording in after.recordings])
    if not np.any(sums):
        return ""
    shares = 100.0 * sums / sums.sum()
    parts = [f"{s:.0f} % in recording {r.recording}" for s, r in zip(shares, after.recordings, strict=True)]
    return f" Of the excess error {', '.join(parts)}."

"""Location of a mismatch: in which range of which physical coordinate it occurs; when, in ``error_times.py``.

``statements.py`` puts this into sentences; ``report/plots.py`` draws contributions over their coordinate.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from labhil.diagnose.error_times import error_reduction
from labhil.identify.fitted import Fitted
from labhil.identify.score import Score
from labhil.physics.extra_force import AcceptsExtraForce
from labhil.physics.model import Model, index_of
from labhil.physics.record import Record, Windows
from labhil.physics.terms import unkeyed
from labhil.signals import FloatArray


@dataclass(frozen=True, slots=True)
class RegimeOptions:
    """How ranges of a coordinate are chosen: people read them, so that they are few."""

    share: float = 0.8  # of the excess that the ranges hold
    max_samples: float = 0.6  # share of all samples from which ranges locate nothing
    max_ranges: int = 3  # as many as people keep in mind
    n_bins: int = 40  # of a coordinate, with equally many samples
    max_relative_samples: float = 0.8  # over those of an earlier coordinate, for a later one to be preferred


DEFAULT_OPTIONS = RegimeOptions()


@dataclass(frozen=True, slots=True)
class Regime:
    """A range of a coordinate where an effect acts, with the share of the excess squared error in it.

    Where no coordinate locates an effect, it is a range of its force, and ``coordinate`` is its term.
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
    """Where the excess error is; ``enters`` is the part of the model where the missing effect acts.

    ``times`` (s) are begin and end of windows, in the time of the ``recordings`` where there are several.
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
    """The horizontal axis of a plot: the samples ``x`` (N,) of a coordinate, in ``unit``."""

    name: str
    x: FloatArray
    unit: str

    @property
    def label(self) -> str:
        """Name and unit."""
        return f"{self.name}, {self.unit}"


@dataclass(frozen=True, slots=True, eq=False)
class HeldOut:
    """Held-out data with the scores of baseline and final model on the same windows."""

    record: Record
    before: Score
    after: Score

    @property
    def motion(self) -> Motion:
        """The scored samples with the window states of the final model."""
        return self.record, self.after.windows.whole, self.after.states, self.after.windows.scored

    def error_reduction(self, joint: int | None) -> FloatArray:
        """Reduction of the squared error of each scored sample, in squared noise floors, (N,).

        It is summed over the outputs of a ``joint`` and those that belong to none; None takes all outputs.
        """
        columns = [j for j, c in enumerate(self.after.channels) if joint is None or c.joint in (None, joint)]
        return np.asarray(error_reduction(self.before, self.after)[:, columns].sum(axis=1))


Motion = tuple[Record, Windows, FloatArray, np.ndarray]
"""A record, windows, their states, and a mask of the rows that count."""


@dataclass(frozen=True, slots=True)
class Contribution:
    """The contribution of one ``term`` along a motion: ``values`` (N,) and ``coordinates`` (N,) each.

    ``unit`` is that of a force, "" of anything else; ``joint`` is the one that it acts on, of several.
    ``period`` is the coordinate along which it repeats, and its period there.
    """

    term: str
    values: FloatArray
    unit: str
    coordinates: Mapping[str, FloatArray]
    units: Mapping[str, str]
    joint: int | None
    period: tuple[str, float] | None = None

    def regimes(
        self, explained: FloatArray | None = None, options: RegimeOptions = DEFAULT_OPTIONS
    ) -> tuple[Regime, ...]:
        """Locate the contribution in ranges of one coordinate, or of its own force; () if it acts everywhere.

        There it is so large that the share of ``explained`` is inside: the error reduction by the term at
        each sample, (N,), or its squares where that is None.
        """
        squares = self.values**2
        held = squares if explained is None or explained.sum() <= 0.0 else explained
        large = _level_set(squares, held, options.share)
        along = {name: self.coordinates[name] for name in self.units}
        ranges = regimes(along, large.astype(np.float64), options) or self._force_ranges(large, options)
        return tuple(self._complete(regime, held) for regime in ranges)

    def abscissa(self, ranges: Sequence[Regime], *, tolerance: float = 0.05) -> Abscissa:
        """The coordinate that explains most of its variance; one period of it for a periodic effect.

        Of coordinates within the ``tolerance`` (share of the variance) it is that of its ``ranges``.
        """
        if self.period is not None:
            name, length = self.period
            return Abscissa(f"{name} modulo {length:.3g}", self.coordinates[name] % length, self.units[name])
        ratios = {name: _correlation_ratio(self.values, self.coordinates[name]) for name in self.units}
        near = [name for name in ratios if ratios[name] > max(ratios.values()) - tolerance]
        located = [regime.coordinate for regime in ranges if regime.coordinate in near]
        name = (located or near)[0]
        return Abscissa(name, self.coordinates[name], self.units[name])

    def _force_ranges(self, large: np.ndarray, options: RegimeOptions) -> tuple[Regime, ...]:
        """The ranges of a force where it is ``large`` (N,), by sign; none if that is nearly everywhere."""
        if not self.unit or not 0.0 < np.mean(large) < options.max_samples:
            return ()
        signs = [self.values[large & (self.values < 0.0)], self.values[large & (self.values > 0.0)]]
        return tuple(
            Regime(self.term, float(values.min()), float(values.max()), 0.0)
            for values in signs
            if len(values)
        )

    def _complete(self, regime: Regime, held: FloatArray) -> Regime:
        """Add term, unit and share of ``held`` (N,) to a range."""
        over_force = regime.coordinate == self.term
        values = self.values if over_force else self.coordinates[regime.coordinate]
        inside = (values >= regime.low) & (values <= regime.high)
        share = float(np.clip(held[inside].sum() / held.sum(), 0.0, 1.0)) if held.sum() > 0.0 else 0.0
        unit = self.unit if over_force else self.units[regime.coordinate]
        term, joint = unkeyed(self.term)
        return replace(regime, share_of_excess=share, unit=unit, term=term, joint=joint)


def _level_set(size: FloatArray, held: FloatArray, share: float) -> np.ndarray:
    """Mask (N,) of the largest sizes (N,) that together have a share of ``held`` (N,)."""
    order = np.argsort(-size, kind="stable")
    enough = np.cumsum(held[order]) >= share * held.sum()
    return np.asarray((size >= size[order[int(np.argmax(enough))]]) & (size > 0.0))


def locate_terms(
    final: Fitted, terms: Sequence[str], held_out: HeldOut, joint: int | None
) -> tuple[dict[str, Contribution], dict[str, tuple[Regime, ...]]]:
    """Compute and locate the contributions of terms to held-out data, by term.

    Terms that belong to no joint of an arm are located on the ``joint``.
    """
    parts = {term: contribution(final, term, held_out.motion, joint) for term in terms}
    # where several terms explain the excess, no part of it belongs to one of them
    explained = held_out.error_reduction(next(iter(parts.values())).joint) if len(parts) == 1 else None
    return parts, {term: part.regimes(explained) for term, part in parts.items()}


def contribution(
    final: Fitted, term: str, motion: Motion | None = None, joint: int | None = None
) -> Contribution:
    """Compute what a term contributes at each sample of a motion.

    A force is a difference of forces. An effect at the input is the force that it changes, or else the
    change of what drives the motion. An effect of the measurement is a difference of readings.

    Args:
        final: the final fit.
        term: key of the term.
        motion: the samples; None takes those of the fit.
        joint: joint of a term that belongs to no joint of an arm; None takes the one where it is largest.
    """
    model, problem = final.problem.model, final.problem
    if motion is None:
        all_rows = np.ones(len(problem.windows.rows), dtype=bool)
        motion = problem.record, problem.windows, final.solution.point.states, all_rows
    record, windows, states, counted = motion
    reduced = without_sizes(model, final.theta, term)
    along = model.coordinates(final.theta, record, windows, states)
    driven = model.drive_coordinates(reduced, record, windows, along)
    values = _difference(
        model.generalised_force(final.theta, along), model.generalised_force(reduced, {**along, **driven})
    )
    unit = model.force_unit if isinstance(model, AcceptsExtraForce) and np.any(values) else ""
    if not np.any(values) and driven:
        values = np.column_stack([along[name] - driven[name] for name in driven])
    if not np.any(values):
        values = model.simulate(final.theta, record, windows, states)
        values = values - model.simulate(reduced, record, windows, states)
    values = values.reshape(len(windows.rows), -1)[counted]
    along = {name: column[counted] for name, column in along.items()}
    term_joint = model.terms[term].joint
    return _of_one_joint(
        model, final.theta, term, values, along, unit, joint if term_joint is None else term_joint
    )


def _difference(with_term: FloatArray, without_term: FloatArray) -> FloatArray:
    """The first less the second, (N, …); zero throughout where they differ by rounding only."""
    difference = with_term - without_term
    rounding = 1e-12 * np.max(np.abs(with_term), initial=0.0)
    return difference if np.max(np.abs(difference), initial=0.0) > rounding else np.zeros_like(difference)


def without_sizes(model: Model, theta: FloatArray, term: str) -> FloatArray:
    """Set the sizes of a term to zero in a parameter vector; terms that build on it keep theirs."""
    reduced = theta.copy()
    for i, parameter in enumerate(model.parameters):
        if parameter.term == term and not parameter.shape:
            reduced[i] = 0.0
    return reduced


def _of_one_joint(
    model: Model,
    theta: FloatArray,
    term: str,
    values: FloatArray,
    along: Mapping[str, FloatArray],
    unit: str,
    joint: int | None,
) -> Contribution:
    """The contribution of a joint's column, with that joint's coordinates where each has its own."""
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
    """The coordinate along which a term repeats, and its period; None of other terms."""
    order = model.terms[term].repeats
    if order is None:
        return None
    name = order.waves_over if order.joint is None else f"{order.waves_over}_{order.joint}"
    places = index_of(model.parameters)
    times = float(theta[places[order.key]]) if order.key in places else order.scale
    return (name, 2.0 * np.pi / times) if name in units and times > 0.0 else None


def regimes(
    coordinates: Mapping[str, FloatArray], excess: FloatArray, options: RegimeOptions = DEFAULT_OPTIONS
) -> tuple[Regime, ...]:
    """Find the ranges of one coordinate that hold most of an excess with the fewest samples.

    Args:
        coordinates: samples of each coordinate, (N,), in the order of their importance.
        excess: the excess at each sample, (N,).
        options: how ranges are chosen; () where every coordinate needs too many samples.
    """
    best: tuple[float, tuple[Regime, ...]] = (options.max_samples, ())
    for name, values in coordinates.items():
        if np.ptp(values) <= 0.0 or not np.any(excess):
            continue
        samples, ranges = _densest_ranges(values, excess, options)
        needed = best[0] if not best[1] else options.max_relative_samples * best[0]
        if samples < needed:
            total = float(excess.sum())
            located = tuple(
                Regime(name, low, high, float(excess[(values >= low) & (values <= high)].sum()) / total)
                for low, high in ranges
            )
            best = (samples, located)
    return best[1]


def _correlation_ratio(values: FloatArray, coordinate: FloatArray) -> float:
    """Pearson's correlation ratio: share of the variance of values (N,) between bins of a coordinate (N,)."""
    if np.ptp(coordinate) <= 0.0:
        return 0.0
    _, place = _quantile_bins(coordinate)
    count = np.maximum(np.bincount(place), 1)
    mean = np.bincount(place, values) / count
    return float(np.var(mean[place]) / max(np.var(values), 1e-300))


def _quantile_bins(values: FloatArray, n_bins: int = DEFAULT_OPTIONS.n_bins) -> tuple[FloatArray, np.ndarray]:
    """Edges of bins of equally many samples, and the bin of each of ``values`` (N,), which must vary."""
    edges = np.unique(np.quantile(values, np.linspace(0.0, 1.0, n_bins + 1)))
    return edges, np.clip(np.searchsorted(edges, values, side="right") - 1, 0, len(edges) - 2)


def _densest_ranges(
    values: FloatArray, excess: FloatArray, options: RegimeOptions
) -> tuple[float, list[tuple[float, float]]]:
    """Share of the samples in the ranges with the densest excess, and the bounds of these ranges."""
    edges, place = _quantile_bins(values, options.n_bins)
    weight = np.bincount(place, excess, len(edges) - 1)
    count = np.bincount(place, minlength=len(edges) - 1)
    chosen = np.zeros(len(weight), dtype=bool)
    for k in np.argsort(-weight / np.maximum(count, 1)):
        if weight[chosen].sum() >= options.share * weight.sum():
            break
        chosen[k] = True
    chosen = _fill_gaps(chosen, count, options.max_ranges)
    begins, ends = _runs(chosen)
    ranges = [(float(edges[a]), float(edges[b])) for a, b in zip(begins, ends, strict=True)]
    return float(count[chosen].sum() / len(values)), ranges


def _fill_gaps(chosen: np.ndarray, count: np.ndarray, max_runs: int) -> np.ndarray:
    """Fill gaps between chosen bins, those of fewest samples first, until few runs remain."""
    while True:
        begins, ends = _runs(chosen)
        narrow = [k for k in range(len(begins) - 1) if begins[k + 1] - ends[k] <= 1]
        if len(begins) <= max_runs and not narrow:
            return chosen
        gaps = [count[ends[k] : begins[k + 1]].sum() for k in range(len(begins) - 1)]
        k = narrow[0] if narrow else int(np.argmin(gaps))
        chosen[ends[k] : begins[k + 1]] = True


def _runs(chosen: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """First bin of each run of chosen bins, and the bin after its last."""
    steps = np.diff(np.r_[0, chosen.astype(np.int64), 0])
    return np.flatnonzero(steps == 1), np.flatnonzero(steps == -1)

"""``labhil.fit``: fit a white-box model to recordings."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

import numpy as np

from labhil.analysis.schema import (
    FitPart,
    Identifiability,
    Parameters,
    Score,
    WindowEstimate,
    validate,
)
from labhil.api.inputs import (
    PathLike,
    Progress,
    Warn,
    load_inputs,
    names_of,
    number_or_none,
    progress_reporter,
    reference_of,
    whole_number_of,
)
from labhil.api.render import axes_of, channel_of
from labhil.api.result import ComputedResult, parameter_frame, parameter_set
from labhil.api.simulation import Simulation, simulate
from labhil.extras import require, require_analysis
from labhil.physics.terms import keyed
from labhil.signals import FloatArray

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure
    from rich.console import RenderableType

    from labhil.analysis.study import FitResult
    from labhil.api.diagnosis import Diagnosis
    from labhil.api.model import Model
    from labhil.api.recording import Recording
    from labhil.rig import RigFile


class Fit(ComputedResult["FitPart", "FitResult"]):
    """A fitted model, with standard errors that allow for correlated residuals. Immutable.

    Made by :func:`labhil.fit` and :func:`labhil.load`.

    ``print(fit)`` is the report of ``labhil fit``.

    Example:
        >>> import labhil as lh
        >>> fit = lh.fit("recordings/ball_beam_identify.mcap", span=(0, 12), estimator="nlse",
        ...              terms=["viscous_friction", "coulomb_friction"])
        >>> level = fit.parameters["coulomb_friction.level"]
        >>> level.unit, level.identifiable, level.ci99[0] < level.value < level.ci99[1]
        ('N', True, True)
        >>> fit.verdict
        'unexplained'
        >>> sorted(fit.scores)
        ['test', 'train']
    """

    def __init__(
        self,
        data: Mapping[str, Any],
        study: FitResult | None = None,
        ended: str = "",
        name: str = "the fit",
    ) -> None:
        super().__init__(data, validate(FitPart, data, name), study, ended, name)

    @property
    def kind(self) -> str:
        """The rig kind."""
        return self._part.rig

    @property
    def terms(self) -> tuple[str, ...]:
        """The terms of the model; those of an arm with the joint in brackets."""
        return self._part.terms

    @property
    def parameters(self) -> Parameters:
        """The estimates, by name or by index; see :class:`labhil.Parameter`."""
        return self._part.parameters

    @property
    def verdict(self) -> Literal["explained", "unexplained", "worse_than_mean"] | None:
        """Whether the model explains its data to the noise."""
        return self._part.verdict

    @property
    def statement(self) -> str | None:
        """The verdict as a line."""
        return self._part.statement

    @property
    def train(self) -> Score:
        """Errors on the data that it was fitted to; see :class:`labhil.Score`."""
        return self._part.train

    @property
    def test(self) -> Score | None:
        """Errors on test data; None where nothing was held out."""
        return self._part.test

    @property
    def scores(self) -> Mapping[str, Score]:
        """Both by name, ``"train"`` and ``"test"``."""
        return {"train": self.train} | ({} if self.test is None else {"test": self.test})

    @property
    def covariance(self) -> FloatArray:
        """Covariance of the estimates, (P, P), in SI units; NaN where it is unknown."""
        return np.array(self._part.covariance, dtype=np.float64).reshape(2 * [len(self.parameters)])

    @property
    def identifiability(self) -> Identifiability:
        """Undetermined combinations of parameters: ``rank`` ``of``, ``combinations``, ``would_help``."""
        return self._part.identifiability

    @property
    def by_window(self) -> tuple[WindowEstimate, ...]:
        """The estimates on windows of other lengths."""
        return self._part.by_window

    @property
    def notes(self) -> tuple[str, ...]:
        """Faults of the data, doubts and assumptions of the model, a sentence each."""
        return (*(fault.statement for fault in self._part.faults), *self._part.doubts, *self._part.notes)

    def __repr__(self) -> str:
        rows = "\n".join(f"  {row}" for row in self.parameters)
        return f"<Fit of {self.kind}: {self.statement or ''}>\n{rows}"

    def _renderables(self) -> Sequence[RenderableType]:
        from labhil.report.text import fit_text

        return [fit_text(self._part)]

    def to_pandas(self) -> Any:
        """Return the parameters as a pandas DataFrame, a row each: value, unit, std_error, ci_low, ci_high, …

        Raises:
            MissingExtraError: pandas is not installed.
        """
        return parameter_frame(self.parameters)

    def to_xarray(self) -> Any:
        """Return the parameters with their covariance as an xarray Dataset.

        Raises:
            MissingExtraError: xarray is not installed.
        """
        return parameter_set(self.parameters, self.covariance, {"rig": self.kind, "verdict": self.verdict})

    def simulate(
        self,
        rec: PathLike | Recording,
        *,
        horizon: float | None = None,
        without: Iterable[str] = (),
    ) -> Simulation:
        """Run the fitted model on a recording.

        Args:
            rec: A recording of the same kind of rig, or its path.
            horizon: Length of the simulated windows, s; by default that of the score.
            without: Names of terms that are switched off; the other values stay.

        Returns:
            Measurement and simulation; see :class:`labhil.Simulation`.

        Raises:
            UsageError: The recording is of another rig, or too short, or the model has no such term.
        """
        return simulate(self.saved, rec, rig=self.kind, horizon=horizon, without=without)

    def plot(self, ax: Axes | None = None, *, channel: int | str = 0) -> Axes:
        """Draw model and measurement on test data, or else training data.

        Args:
            ax: Axes to draw into; by default new ones.
            channel: The output, by name or by index.

        Returns:
            The matplotlib axes.

        Raises:
            UsageError: The result was loaded, and has no samples.
        """
        require("matplotlib", "a plot")
        from labhil.report.fit_plot import draw_simulation

        study, axes = self._require_study("plot"), axes_of(ax)
        draw_simulation(axes, study.fit, study.dataset.test, self._channel_index(channel))
        return axes

    def plot_errors(self, ax: Axes | None = None, *, channel: int | str = 0) -> Axes:
        """Draw the errors of the simulation over time, with the noise floor, like :meth:`plot`."""
        require("matplotlib", "a plot")
        from labhil.report.fit_plot import draw_errors

        study, axes = self._require_study("plot_errors"), axes_of(ax)
        draw_errors(axes, study.fit, study.dataset.test, self._channel_index(channel))
        return axes

    def plot_residuals(self, ax: Axes | None = None, *, channel: int | str = 0) -> Axes:
        """Draw the autocorrelation of the residuals, with the 99 % band of white noise, like :meth:`plot`."""
        require("matplotlib", "a plot")
        from labhil.report.fit_plot import draw_autocorrelation

        study, axes = self._require_study("plot_residuals"), axes_of(ax)
        draw_autocorrelation(axes, study.fit, self._channel_index(channel))
        return axes

    def plot_intervals(self, ax: Axes | None = None) -> Axes:
        """Draw every 99 % interval in per cent of its estimate.

        Args:
            ax: Axes to draw into; by default new ones.

        Returns:
            The matplotlib axes.
        """
        require("matplotlib", "a plot")
        from labhil.report.intervals_plot import draw_intervals

        axes = axes_of(ax, (9.0, 0.9 + 0.3 * len(self.parameters)))
        draw_intervals(axes, self._part.judged_rows)
        return axes

    def figure(self) -> Figure:
        """Draw all panels of every output in one matplotlib figure, like ``labhil fit --plot``."""
        require("matplotlib", "a plot")
        from labhil.report.fit_plot import fit_figure

        study = self._require_study("figure")
        return fit_figure(study.fit, study.dataset.test)

    def _write_page(self, file: Path) -> None:
        require("matplotlib", "a page with plots")
        from labhil.report.html.fit import fit_page
        from labhil.report.html.page import write_page
        from labhil.report.html.picture import Album
        from labhil.report.html.study import foot_of, write_fit_page

        if self._study is not None:
            write_fit_page(self._study, file)
        else:
            write_page(fit_page(self._part, foot_of(self._part), Album()), file)

    def _channel_index(self, channel: int | str) -> int:
        return channel_of(channel, [keyed(row.channel, row.joint) for row in self.train.scored])


def fit(
    rec: PathLike | Recording | Sequence[PathLike | Recording],
    model: PathLike | Model | RigFile | None = None,
    *,
    terms: Iterable[str] | str | None = None,
    test: PathLike | Recording | Sequence[PathLike | Recording] | None = None,
    holdout: float = 0.3,
    start: Fit | Diagnosis | PathLike | None = None,
    per_recording: Iterable[str] | str | None = None,
    span: tuple[float, float] | None = None,
    max_samples: int | None = 100_000,
    estimator: str = "hybrid",
    seed: int = 0,
    window: float | None = None,
    intervals: str = "auto",
    simultaneous: bool = False,
    criterion: str | None = None,
    device: str | None = None,
    run: int | None = None,
    seconds: float | None = None,
    progress: Progress = None,
    warn: Warn = None,
) -> Fit:
    """Fit a white-box model to one recording or several, and test it on other data.

    Ctrl+C or the end of ``seconds`` ends it with the best result so far; :attr:`Fit.complete` is False then.

    Args:
        rec: A recording or its path; several of one rig are fitted together.
        model: A rig kind, the path of a rig file, or a :func:`labhil.model`; by default the rig file
            in the recording.
        terms: Names of the model's effects; by default those of the rig kind's general model.
        test: Test recordings; by default the last ``holdout`` of each recording is held out.
        holdout: Share that is held out, 0 for nothing.
        start: A fit or a diagnosis, or its file, to start from; its terms are the default of ``terms``.
        per_recording: Terms, parameters or sizes with a separate value in each recording.
        span: Begin and end of the part of every recording to use, s.
        max_samples: Number of samples of every recording to use, those where its inputs change most; None
            for all. Arms always use all.
        estimator: The global search: ``hybrid``, ``nlse``, ``pso``, ``cma_es``, ``mcmc``, …; all end with
            least squares.
        seed: Seed of the estimator.
        window: Length of the fitted windows, s; by default several are compared.
        intervals: ``auto``, ``wald``, ``profile`` or ``bootstrap``.
        simultaneous: Whether the intervals hold for all parameters together.
        criterion: The error that is minimised: ``windowed_simulation`` or ``inverse_dynamics``; by default
            that of the rig kind.
        device: The device, where recordings have several.
        run: The run, from 1, where a file has several.
        seconds: Time limit, s; the answer is then the best result so far.
        progress: A function of a line about the current stage, or True for a line on stderr.
        warn: A function of lines about lost data of the recordings, called before the work begins.

    Returns:
        The fit: ``print`` it, read :attr:`Fit.parameters` and :attr:`Fit.scores`.

    Raises:
        RecordingError: The recording does not move, or lacks signals of the model.
        UnknownNameError: A term, an estimator or a criterion does not exist.
        RunStoppedError: It was ended before there was a result.

    Example:
        >>> import labhil as lh
        >>> fit = lh.fit("recordings/ball_beam_identify.mcap", span=(0, 12), estimator="nlse",
        ...              terms=["viscous_friction", "coulomb_friction", "stribeck_friction", "dead_zone"])
        >>> fit.verdict
        'explained'
    """
    require_analysis("a fit")
    from labhil.analysis.early import ending_early
    from labhil.analysis.study import fit_study
    from labhil.identify.estimators import check_estimator
    from labhil.identify.fit import Options, criterion_named
    from labhil.identify.intervals import interval_method

    method, metric = interval_method(intervals), criterion_named(criterion)
    dataset = load_inputs(
        rec,
        model,
        test,
        holdout,
        per_recording,
        span=span,
        max_samples=max_samples,
        allow_no_holdout=True,
        device=device,
        run=run,
        warn=warn,
    )
    with progress_reporter(progress) as say, ending_early(number_or_none(seconds, "seconds")) as deadline:
        length, draw = number_or_none(window, "window"), whole_number_of(seed, "seed")
        options = Options(length, method, simultaneous, check_estimator(estimator), draw, say, metric)
        study = fit_study(
            dataset, terms=names_of(terms, "terms"), start=reference_of(start, "start"), options=options
        )
    return Fit(study.json, study, "" if study.fit.complete else deadline.reason)

"""Fitting a white-box model to recordings."""

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
    """A fitted model, with errors that allow for correlated residuals. Made by :func:`labhil.fit` and
    :func:`labhil.load`; immutable.

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
        """The estimates, by name or by place; see :class:`labhil.Parameter`."""
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
        """Errors on data that it has not seen; None where nothing was held out."""
        return self._part.test

    @property
    def scores(self) -> Mapping[str, Score]:
        """Both by name, ``"train"`` and ``"test"``."""
        return {"train": self.train} | ({} if self.test is None else {"test": self.test})

    @property
    def covariance(self) -> FloatArray:
        """Covariance of the estimates, (P, P), in SI units; NaN where it is not known."""
        return np.array(self._part.covariance, dtype=np.float64).reshape(2 * [len(self.parameters)])

    @property
    def identifiability(self) -> Identifiability:
        """What the data cannot know: ``rank`` ``of``, ``combinations``, ``would_help``."""
        return self._part.identifiability

    @property
    def by_window(self) -> tuple[WindowEstimate, ...]:
        """The estimates on windows of other lengths."""
        return self._part.by_window

    @property
    def notes(self) -> tuple[str, ...]:
        """What is doubtful in the data, or was taken for known, a sentence each."""
        return (*(fault.statement for fault in self._part.faults), *self._part.doubts, *self._part.notes)

    def __repr__(self) -> str:
        rows = "\n".join(f"  {row}" for row in self.parameters)
        return f"<Fit of {self.kind}: {self.statement or ''}>\n{rows}"

    def _renderables(self) -> Sequence[RenderableType]:
        from labhil.report.text import fit_text

        return [fit_text(self._part)]

    def to_pandas(self) -> Any:
        """The parameters as a pandas DataFrame, a row each: value, unit, std_error, ci_low, ci_high, …

        Raises:
            MissingExtraError: pandas is not installed.
        """
        return parameter_frame(self.parameters)

    def to_xarray(self) -> Any:
        """The parameters with their covariance as an xarray Dataset.

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
            horizon: Length of the simulated windows, s; that of the score when absent.
            without: Terms of the model that are switched off, by name; the other values stay as they are.

        Returns:
            Measurement and simulation; see :class:`labhil.Simulation`.

        Raises:
            UsageError: The recording is of another rig, or too short, or the model has no such term.
        """
        return simulate(self.saved, rec, rig=self.kind, horizon=horizon, without=without)

    def plot(self, ax: Axes | None = None, *, channel: int | str = 0) -> Axes:
        """Draw the model beside the measurement, on the data that it is judged on.

        Args:
            ax: Axes to draw into; new ones when absent.
            channel: Which output, by name or by place, from 0.

        Returns:
            The matplotlib axes.

        Raises:
            UsageError: The result was loaded, and holds no samples.
        """
        require("matplotlib", "a plot")
        from labhil.report.fit_plot import draw_simulation

        study, axes = self._require_study("plot"), axes_of(ax)
        draw_simulation(axes, study.fit, study.dataset.test, self._place(channel))
        return axes

    def plot_errors(self, ax: Axes | None = None, *, channel: int | str = 0) -> Axes:
        """Draw the errors of the simulation over time, with the noise floor; as :meth:`plot`."""
        require("matplotlib", "a plot")
        from labhil.report.fit_plot import draw_errors

        study, axes = self._require_study("plot_errors"), axes_of(ax)
        draw_errors(axes, study.fit, study.dataset.test, self._place(channel))
        return axes

    def plot_residuals(self, ax: Axes | None = None, *, channel: int | str = 0) -> Axes:
        """Draw the autocorrelation of the fitted residuals, with white noise's 99 % band; as :meth:`plot`."""
        require("matplotlib", "a plot")
        from labhil.report.fit_plot import draw_autocorrelation

        study, axes = self._require_study("plot_residuals"), axes_of(ax)
        draw_autocorrelation(axes, study.fit, self._place(channel))
        return axes

    def plot_intervals(self, ax: Axes | None = None) -> Axes:
        """Draw every 99 % interval in per cent of its estimate.

        Args:
            ax: Axes to draw into; new ones when absent.

        Returns:
            The matplotlib axes.
        """
        require("matplotlib", "a plot")
        from labhil.report.intervals_plot import draw_intervals

        axes = axes_of(ax, (9.0, 0.9 + 0.3 * len(self.parameters)))
        draw_intervals(axes, self._part.judged_rows)
        return axes

    def figure(self) -> Figure:
        """All panels of every output in one matplotlib figure, as ``labhil fit --plot`` writes it."""
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

    def _place(self, channel: int | str) -> int:
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
    """Fit a white-box model to one recording or several, and test it on data that it has not seen.

    Ctrl+C, or the end of ``seconds``, ends the work with the best so far; :attr:`Fit.complete` is False then.

    Args:
        rec: A recording or its path; several of one rig are fitted together.
        model: A rig kind, the path of a rig file, or what :func:`labhil.model` made; the rig file that the
            recording carries when absent.
        terms: The effects that the model has, by name; the rig kind's general model when absent.
        test: Recordings to judge on. Without them the last ``holdout`` of each recording is held out.
        holdout: Share that is held out, 0 for nothing.
        start: A fit or a diagnosis, or its file, to begin at; its terms are taken when none are named.
        per_recording: Terms, parameters or sizes that have a value of their own in each recording.
        span: Use only this stretch of every recording, from … to, s.
        estimator: Where the search begins: ``hybrid``, ``nlse``, ``pso``, ``cma_es``, ``mcmc``, …; all end
            with least squares.
        seed: Seed of the estimator's draws.
        window: Length of the fitted windows, s; several are compared when absent.
        intervals: ``auto``, ``wald``, ``profile`` or ``bootstrap``.
        simultaneous: Whether the intervals hold for all parameters together.
        criterion: What is made small: ``windowed_simulation`` or ``inverse_dynamics``; the rig kind's own
            when absent.
        device: Which device, where recordings hold several.
        run: Which run, from 1, where a file holds several.
        seconds: End after so many seconds, with the best so far.
        progress: A function of a line about what is being done, or True for a line on stderr.
        warn: A function of the lines that say, before the work begins, what the recordings lack.

    Returns:
        The fit: ``print`` it, read :attr:`Fit.parameters` and :attr:`Fit.scores`.

    Raises:
        RecordingError: There is nothing to fit in the recording, or it lacks what the model needs.
        UnknownNameError: A term, an estimator or a criterion that does not exist.
        RunStoppedError: It was ended before there was anything.

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

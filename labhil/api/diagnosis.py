"""``labhil.diagnose``: find the physics that a model lacks."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from labhil.analysis.schema import (
    ChangedParameter,
    DiagnosisPart,
    EstimatedCurve,
    ExcludedEffect,
    Fault,
    FittedModel,
    Improvement,
    Location,
    MissingEffect,
    Rival,
    UndecidedEffect,
    Verdict,
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
)
from labhil.api.render import axes_of, channel_of
from labhil.api.result import ComputedResult, parameter_frame, parameter_set
from labhil.api.simulation import Simulation, simulate
from labhil.errors import UnknownNameError
from labhil.extras import require, require_analysis
from labhil.physics.terms import keyed

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure
    from rich.console import RenderableType

    from labhil.analysis.study import DiagnosisResult
    from labhil.api.fit import Fit
    from labhil.api.model import Model
    from labhil.api.recording import Recording
    from labhil.rig import RigFile


class Diagnosis(ComputedResult["DiagnosisPart", "DiagnosisResult"]):
    """The physics that a model lacks, its location and the improvement by it. Immutable.

    Made by :func:`labhil.diagnose` and :func:`labhil.load`.

    ``print(dx)`` is the report of ``labhil diagnose``.

    Example:
        >>> import labhil as lh
        >>> dx = lh.load("examples/diagnosis.json")
        >>> dx.verdict
        'missing_physics'
        >>> [effect.term for effect in dx.missing]
        ['dead_zone', 'coulomb_friction', 'stribeck_friction']
        >>> print(dx.missing[1].parameters[0].name)
        coulomb_friction.level
        >>> dx.improvement.rmse_after < dx.improvement.rmse_before
        True
    """

    def __init__(
        self,
        data: Mapping[str, Any],
        study: DiagnosisResult | None = None,
        ended: str = "",
        name: str = "the diagnosis",
    ) -> None:
        super().__init__(data, validate(DiagnosisPart, data, name), study, ended, name)

    @property
    def verdict(self) -> Verdict:
        """``no_mismatch``, ``parameter_change``, ``missing_physics``, ``unexplained_mismatch``,
        ``data_fault`` or ``not_decidable``."""
        return self._part.verdict

    @property
    def p_value(self) -> float | None:
        """Probability of data like these if the baseline were complete."""
        return self._part.p_value

    @property
    def missing(self) -> tuple[MissingEffect, ...]:
        """Missing effects, by evidence; see :class:`labhil.MissingEffect`."""
        return self._part.missing

    @property
    def rivals(self) -> tuple[Rival, ...]:
        """Effects that explain the data about as well as a named one, and experiments to distinguish them."""
        return self._part.rivals

    @property
    def excluded(self) -> tuple[ExcludedEffect, ...]:
        """Absent effects, each with an upper limit of its size."""
        return self._part.excluded

    @property
    def undecided(self) -> tuple[UndecidedEffect, ...]:
        """Effects that these data cannot decide on, with the reason and the needed channels."""
        return self._part.undecided

    @property
    def changed(self) -> tuple[ChangedParameter, ...]:
        """Parameters whose values differ from those of the user's own model."""
        return self._part.changed

    @property
    def where(self) -> Location | None:
        """Location of the mismatch: channel, times, regimes, and a ``statement``."""
        return self._part.location

    @property
    def improvement(self) -> Improvement | None:
        """Errors before and after on data that the search did not use; see :class:`labhil.Improvement`."""
        return self._part.improvement

    @property
    def baseline(self) -> FittedModel:
        """The model at the start of the search: ``terms`` and ``parameters``."""
        return self._part.baseline

    @property
    def final(self) -> FittedModel:
        """The model with the missing effects: ``terms`` and ``parameters``."""
        return self._part.final

    @property
    def faults(self) -> tuple[Fault, ...]:
        """Faults of the data, each with a ``kind`` and a ``statement``."""
        return self._part.faults

    @property
    def curves(self) -> tuple[EstimatedCurve, ...]:
        """Estimated forces that no effect of the catalogue explains."""
        return tuple(curve for curve in (self._part.curve, *self._part.further_curves) if curve is not None)

    @property
    def next_steps(self) -> tuple[str, ...]:
        """The next steps, the most useful first: a sentence or two each."""
        return self._part.next_steps

    @property
    def notes(self) -> tuple[str, ...]:
        """Doubts about the data and assumptions of the model, a sentence each."""
        return (*self._part.doubts, *self._part.notes)

    def __repr__(self) -> str:
        effects = "\n".join(f"  {effect}" for effect in self.missing)
        return f"<Diagnosis: {self.verdict}>" + (f"\n{effects}" if effects else "")

    def _renderables(self) -> Sequence[RenderableType]:
        from labhil.report.text import diagnosis_text

        return [diagnosis_text(self._part)]

    def to_pandas(self) -> Any:
        """Return the parameters of the final model as a pandas DataFrame, a row each.

        Raises:
            MissingExtraError: pandas is not installed.
        """
        return parameter_frame(self.final.parameters)

    def to_xarray(self) -> Any:
        """Return the parameters of the final model as an xarray Dataset.

        Raises:
            MissingExtraError: xarray is not installed.
        """
        return parameter_set(self.final.parameters, None, {"verdict": self.verdict})

    def simulate(
        self,
        rec: PathLike | Recording,
        *,
        horizon: float | None = None,
        without: Iterable[str] = (),
    ) -> Simulation:
        """Run the final model on a recording, like :meth:`labhil.Fit.simulate`."""
        rigs = {source.rig for source in self.recordings if source.rig}
        return simulate(
            self.saved, rec, rig=rigs.pop() if len(rigs) == 1 else None, horizon=horizon, without=without
        )

    def plot(self, ax: Axes | None = None, *, channel: int | str | None = None) -> Axes:
        """Draw measurement, baseline and final model on data that the search did not use.

        Args:
            ax: Axes to draw into; by default new ones.
            channel: The output, by name or by index; by default that with the largest error.

        Returns:
            The matplotlib axes.

        Raises:
            UsageError: The result was loaded, and has no samples.
        """
        require("matplotlib", "a plot")
        from labhil.report.plots import draw_windows, worst_output

        diagnosis, axes = self._require_study("plot").diagnosis, axes_of(ax)
        draw_windows(
            axes, diagnosis, worst_output(diagnosis) if channel is None else self._channel_index(channel)
        )
        return axes

    def plot_errors(self, ax: Axes | None = None, *, channel: int | str | None = None) -> Axes:
        """Draw the errors before and after, with the noise floor, like :meth:`plot`."""
        require("matplotlib", "a plot")
        from labhil.report.plots import draw_errors, worst_output

        diagnosis, axes = self._require_study("plot_errors").diagnosis, axes_of(ax)
        draw_errors(
            axes, diagnosis, worst_output(diagnosis) if channel is None else self._channel_index(channel)
        )
        return axes

    def plot_effect(self, term: str, ax: Axes | None = None) -> Axes:
        """Draw the contribution of a missing effect over the coordinate that shows it best.

        Args:
            term: Its name; with the joint in brackets where there are joints: ``"payload"``,
                ``"coulomb_friction[2]"``.
            ax: Axes to draw into; by default new ones.

        Returns:
            The matplotlib axes.

        Raises:
            UnknownNameError: There is no such missing effect.
            UsageError: The result was loaded, and has no samples.
        """
        require("matplotlib", "a plot")
        from labhil.report.plots import draw_named_effect

        diagnosis = self._require_study("plot_effect").diagnosis
        if term not in diagnosis.named:
            raise UnknownNameError("found effect", term, diagnosis.named)
        axes = axes_of(ax)
        draw_named_effect(axes, diagnosis, term)
        return axes

    def figure(self) -> Figure:
        """Draw all panels in one matplotlib figure, like ``labhil diagnose --plot``."""
        require("matplotlib", "a plot")
        from labhil.report.plots import diagnosis_figure

        return diagnosis_figure(self._require_study("figure").diagnosis)

    def _write_page(self, file: Path) -> None:
        require("matplotlib", "a page with plots")
        from labhil.report.html.diagnosis import diagnosis_page
        from labhil.report.html.page import write_page
        from labhil.report.html.picture import Album
        from labhil.report.html.study import foot_of, write_diagnosis_page

        if self._study is not None:
            write_diagnosis_page(self._study, file)
        else:
            write_page(diagnosis_page(self._part, foot_of(self._part), Album()), file)

    def _channel_index(self, channel: int | str) -> int:
        rows = self.improvement.after.scored if self.improvement is not None else ()
        return channel_of(channel, [keyed(row.channel, row.joint) for row in rows])


def diagnose(
    rec: PathLike | Recording | Sequence[PathLike | Recording],
    model: PathLike | Model | RigFile | None = None,
    *,
    baseline: Iterable[str] | str | None = None,
    test: PathLike | Recording | Sequence[PathLike | Recording] | None = None,
    holdout: float = 0.3,
    reference: Fit | Diagnosis | PathLike | None = None,
    per_recording: Iterable[str] | str | None = None,
    span: tuple[float, float] | None = None,
    max_samples: int | None = 100_000,
    device: str | None = None,
    run: int | None = None,
    seconds: float | None = None,
    progress: Progress = None,
    warn: Warn = None,
) -> Diagnosis:
    """Find where model and recording disagree, which physics is missing, and how much it would improve.

    Takes from seconds to minutes. Ctrl+C, or the end of ``seconds``, ends it with the best result so far.

    Args:
        rec: A recording or its path; several of one rig are searched together.
        model: A rig kind, the path of a rig file, or a :func:`labhil.model`; by default the rig file
            in the recording.
        baseline: The effects that your simulation has; by default the rig kind's baseline.
        test: Test recordings; by default the last ``holdout`` of each recording is held out.
        holdout: Share that is held out.
        reference: A fit or a diagnosis, or its file, that describes your simulation: only with one, or with
            nominal values in the model, can a changed value be distinguished from missing physics.
        per_recording: Terms, parameters or sizes with a separate value in each recording.
        span: Begin and end of the part of every recording to use, s.
        max_samples: Number of samples of every recording to use, those where its inputs change most; None
            for all. Arms always use all.
        device: The device, where recordings have several.
        run: The run, from 1, where a file has several.
        seconds: Time limit, s; the answer is then the best result so far.
        progress: A function of a line about the current stage, or True for a line on stderr.
        warn: A function of lines about lost data of the recordings, called before the work begins.

    Returns:
        The diagnosis: ``print`` it, read :attr:`Diagnosis.missing` and :attr:`Diagnosis.improvement`.

    Raises:
        RecordingError: The recording lacks signals of the model, or cannot be used.
        UnknownNameError: A term does not exist.
        RunStoppedError: It was ended before there was a result.

    Example:
        >>> import labhil as lh
        >>> dx = lh.diagnose("recordings/ball_beam_identify.mcap", baseline=[
        ...     "viscous_friction", "coulomb_friction", "stribeck_friction", "dead_zone"])
        >>> dx.verdict
        'no_mismatch'
    """
    require_analysis("a diagnosis")
    from labhil.analysis.early import ending_early
    from labhil.analysis.study import diagnose_study

    dataset = load_inputs(
        rec,
        model,
        test,
        holdout,
        per_recording,
        span=span,
        max_samples=max_samples,
        device=device,
        run=run,
        warn=warn,
    )
    with progress_reporter(progress) as say, ending_early(number_or_none(seconds, "seconds")) as deadline:
        study = diagnose_study(
            dataset,
            baseline=names_of(baseline, "baseline"),
            reference=reference_of(reference, "reference"),
            progress=say,
        )
    return Diagnosis(study.json, study, "" if study.diagnosis.complete else deadline.reason)

"""``labhil.compare``: compare models on the same recordings."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

from labhil.analysis.schema import ComparedModel, ComparisonPart, SharedParameter, Source, validate
from labhil.api.inputs import (
    PathLike,
    Progress,
    Warn,
    number_or_none,
    path_of,
    progress_reporter,
    recordings_of,
    rig_file,
)
from labhil.api.render import data_frame
from labhil.api.result import Result, no_samples_error
from labhil.extras import require, require_analysis

if TYPE_CHECKING:
    from rich.console import RenderableType

    from labhil.analysis.comparison import ComparisonResult
    from labhil.analysis.saved_model import SavedModel
    from labhil.api.diagnosis import Diagnosis
    from labhil.api.fit import Fit
    from labhil.api.model import Model
    from labhil.api.recording import Recording
    from labhil.api.verification import Verification
    from labhil.rig import RigFile


class Comparison(Result):
    """A comparison of models on the same recordings, made by :func:`labhil.compare`. Immutable.

    ``print(it)`` is the report of ``labhil compare``.

    Example:
        >>> import labhil as lh
        >>> comparison = lh.compare("examples/fit.json", "examples/diagnosis.json")
        >>> comparison.verdict, sorted(comparison.models)
        ('alike', ['diagnosis.json', 'fit.json'])
        >>> comparison.parameters[0].name, comparison.parameters[0].agree
        ('viscous_friction.coefficient', True)
    """

    def __init__(
        self,
        data: Mapping[str, Any],
        study: ComparisonResult | None = None,
        name: str = "the comparison",
    ) -> None:
        super().__init__(data, name)
        self._part, self._study = validate(ComparisonPart, data, name), study

    @property
    def part(self) -> ComparisonPart:
        """The JSON as typed data."""
        return self._part

    @property
    def verdict(self) -> Literal["one_best", "alike"]:
        """``one_best``, or ``alike`` where another model is as good as the best within noise."""
        return self._part.verdict

    @property
    def statement(self) -> str:
        """The verdict as a line."""
        return self._part.statement

    @property
    def best(self) -> str:
        """The name of the model with the smallest error."""
        return self._part.best

    @property
    def preferred(self) -> str:
        """The name of the preferred model: of those as good as the best, that with the fewest parameters."""
        return self._part.preferred

    @property
    def models(self) -> Mapping[str, ComparedModel]:
        """Each model by its name: ``terms``, ``n_parameters``, ``per_channel``, ``rmse_over_noise``,
        ``times_best``, ``p_value``.
        """
        return {model.name: model for model in self._part.models}

    @property
    def parameters(self) -> tuple[SharedParameter, ...]:
        """Parameters that models share: ``values``, and whether they ``agree``."""
        return self._part.parameters

    @property
    def next_steps(self) -> tuple[str, ...]:
        """The next steps, a sentence or two each."""
        return self._part.next_steps

    @property
    def notes(self) -> tuple[str, ...]:
        """Notes on the comparison, a sentence or two each."""
        return self._part.notes

    @property
    def recordings(self) -> tuple[Source, ...]:
        """The recordings that the models are compared on, with the span of each."""
        return self._part.recordings

    @property
    def study(self) -> ComparisonResult:
        """The computation with its samples.

        Raises:
            UsageError: The result was loaded or pickled.
        """
        if self._study is None:
            raise no_samples_error("study")
        return self._study

    def __repr__(self) -> str:
        return f"<Comparison: {self.statement}>"

    def _renderables(self) -> Sequence[RenderableType]:
        from labhil.report.comparison import comparison_text

        return [comparison_text(self._part)]

    def _write_page(self, file: Path) -> None:
        require("matplotlib", "a page with plots")
        from labhil.report.html.comparison import comparison_page
        from labhil.report.html.overlay import overlays
        from labhil.report.html.page import write_page
        from labhil.report.html.picture import Album
        from labhil.report.html.study import foot_of

        drawn = () if self._study is None else overlays(self._study, Album())
        write_page(comparison_page(self._part, foot_of(self._part), drawn), file)

    def to_pandas(self) -> Any:
        """Return a row for each model and output as a pandas DataFrame.

        Raises:
            MissingExtraError: pandas is not installed.
        """
        rows = [(model, row) for model in self._part.models for row in model.per_channel]
        columns = {
            name: [getattr(row, name) for _, row in rows]
            for name in ("channel", "joint", "unit", "rmse", "noise_floor", "rmse_over_noise", "r2")
        }
        of_models = ("n_parameters", "adequacy", "times_best", "p_value", "worse_than_best")
        columns |= {name: [getattr(model, name) for model, _ in rows] for name in of_models}
        return data_frame(columns, index=[model.name for model, _ in rows], index_name="model")


def compare(
    *results: Fit | Diagnosis | Verification | PathLike,
    recording: PathLike | Recording | Sequence[PathLike | Recording] | None = None,
    model: PathLike | Model | RigFile | None = None,
    horizon: float | None = None,
    device: str | None = None,
    run: int | None = None,
    progress: Progress = None,
    warn: Warn = None,
) -> Comparison:
    """Compare models on the same recordings: which explains them best, by how much, and whether that is
    more than noise.

    Every model is simulated in the same windows, each from the state estimated from its lead-in, as models
    are scored.

    Args:
        results: Two to eight models of one kind of rig: fits, diagnoses (their final model), verifications
            (the model that was verified), or their files.
        recording: The recordings to compare on; by default the test recording of the first result, or the
            part that it held out.
        model: A rig kind, the path of a rig file, or a :func:`labhil.model`; by default the rig file
            in the recording.
        horizon: Length of the simulated windows, s; by default the longest of the models' scored horizons.
        device: The device, where a recording has several.
        run: The run, from 1, where a file has several.
        progress: A function of a line about the current stage, or True for a line on stderr.
        warn: A function of lines about lost data of the recordings.

    Returns:
        The comparison: ``print`` it, read :attr:`Comparison.verdict` and :attr:`Comparison.models`, make a
        page of it with ``report("page.html")``.

    Raises:
        UsageError: There are fewer than two results, or more than eight, or they are of different rigs.
        ModelFileError: A file is no result.
        RecordingError: There is no recording to compare on, or it is of another rig or too short.

    Example:
        >>> import labhil as lh
        >>> comparison = lh.compare("examples/fit.json", "examples/diagnosis.json")
        >>> model = comparison.models[comparison.best]
        >>> print(f"{model.per_channel[0].rmse:.2g} {model.per_channel[0].unit}, {model.adequacy}")
        0.00042 m, explained
    """
    require_analysis("a comparison")
    from labhil.analysis.comparison import compare_study

    recordings = [] if recording is None else recordings_of(recording, "recording")
    with progress_reporter(progress) as say:
        study = compare_study(
            [_model_of(result) for result in results],
            recordings,
            rig_file(model),
            horizon=number_or_none(horizon, "horizon"),
            device=device,
            run=run,
            progress=say,
        )
    if warn is not None:
        warn(study.losses)
    return Comparison(study.json, study)


def _model_of(result: Fit | Diagnosis | Verification | PathLike) -> Path | SavedModel:
    """The model of a result, or the path of its file."""
    return result.as_reference if isinstance(result, Result) else path_of(result, "results")

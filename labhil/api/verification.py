"""``labhil.verify``: test whether a recording contradicts an accepted model."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from labhil.analysis.schema import ChannelVerdict, Source, ValueChange, VerificationPart, validate
from labhil.api.inputs import (
    PathLike,
    Progress,
    Warn,
    max_samples_of,
    number_of,
    progress_reporter,
    recordings_of,
    reference_of,
    rig_file,
    span_of,
)
from labhil.api.render import data_frame
from labhil.api.result import Result
from labhil.errors import UsageError
from labhil.extras import require_analysis

if TYPE_CHECKING:
    from rich.console import RenderableType

    from labhil.api.diagnosis import Diagnosis
    from labhil.api.fit import Fit
    from labhil.api.model import Model
    from labhil.api.recording import Recording
    from labhil.rig import RigFile


class Verification(Result):
    """The test whether a recording contradicts a model. Immutable.

    Made by :func:`labhil.verify` and :func:`labhil.load`.

    ``print(it)`` is the report of ``labhil verify``.

    Example:
        >>> import labhil as lh
        >>> verification = lh.verify("recordings/ball_beam_test.mcap", "examples/fit.json")
        >>> verification.contradicted, verification.reasons
        (False, ())
    """

    def __init__(self, data: Mapping[str, Any], name: str = "the verification") -> None:
        super().__init__(data, name)
        self._part = validate(VerificationPart, data, name)

    @property
    def part(self) -> VerificationPart:
        """The JSON as typed data."""
        return self._part

    @property
    def contradicted(self) -> bool:
        """Whether the recording contradicts the model."""
        return not self._part.consistent

    @property
    def p_value(self) -> float | None:
        """Probability of a deviation at least as large as this one, if the model were right."""
        return self._part.p_value

    @property
    def alpha(self) -> float:
        """Level of the test: the probability of a false alarm."""
        return self._part.alpha

    @property
    def reasons(self) -> tuple[str, ...]:
        """Reasons of a contradiction, a sentence each."""
        return self._part.reasons

    @property
    def notes(self) -> tuple[str, ...]:
        """Notes on missing information, a sentence each."""
        return self._part.notes

    @property
    def channels(self) -> tuple[ChannelVerdict, ...]:
        """The tests of each output: RMSE, noise floor, their ratio and its limit."""
        return self._part.channels

    @property
    def changes(self) -> tuple[ValueChange, ...]:
        """Each parameter as accepted and as refitted to this recording."""
        return self._part.parameters

    @property
    def recordings(self) -> tuple[Source, ...]:
        """The recording of the test."""
        return self._part.recordings

    def __repr__(self) -> str:
        verdict = "contradicted" if self.contradicted else "consistent"
        return f"<Verification: {verdict}, p = {self.p_value}>"

    def _renderables(self) -> Sequence[RenderableType]:
        from labhil.report.verification import verification_text

        return [verification_text(self._part)]

    def _write_page(self, file: Path) -> None:
        from labhil.report.html.page import write_page
        from labhil.report.html.study import foot_of
        from labhil.report.html.verification import verification_page

        write_page(verification_page(self._part, foot_of(self._part)), file)

    def to_pandas(self) -> Any:
        """Return the parameters, accepted and refitted, as a pandas DataFrame.

        Raises:
            MissingExtraError: pandas is not installed.
        """
        names = ("before", "after", "unit", "std_error", "z", "p_value", "changed")
        columns = {name: [getattr(row, name) for row in self.changes] for name in names}
        return data_frame(columns, index=[row.name for row in self.changes], index_name="parameter")


def verify(
    rec: PathLike | Recording,
    accepted: Fit | Diagnosis | PathLike,
    model: PathLike | Model | RigFile | None = None,
    *,
    alpha: float = 1e-3,
    span: tuple[float, float] | None = None,
    max_samples: int | None = 100_000,
    device: str | None = None,
    run: int | None = None,
    progress: Progress = None,
    warn: Warn = None,
) -> Verification:
    """Test whether a recording contradicts an accepted model.

    Three tests share the level: is the simulation with the accepted values worse than noise and the errors of
    the values explain, are residuals of the refitted model correlated with the input, and do refitted values
    differ?

    Args:
        rec: A recording or its path.
        accepted: The accepted model: a fit or a diagnosis, or its file.
        model: A rig kind, the path of a rig file, or a :func:`labhil.model`; by default the rig file
            in the recording.
        alpha: Probability of a false alarm.
        span: Begin and end of the part of the recording to use, s.
        max_samples: Number of samples to use, those where the inputs change most; None for all. Arms always
            use all.
        device: The device, where the recording has several.
        run: The run, from 1, where the file has several.
        progress: A function of a line about the current stage, or True for a line on stderr.
        warn: A function of lines about lost data of the recording.

    Returns:
        The verification; :attr:`Verification.contradicted` is the answer.

    Raises:
        UsageError: The recording is too short or of another rig, or ``accepted`` is no model.

    Example:
        >>> import labhil as lh
        >>> lh.verify("recordings/ball_beam_test.mcap", "examples/fit.json").contradicted
        False
    """
    require_analysis("a verification")
    from labhil.analysis.verification import verify_study

    reference = reference_of(accepted, "accepted")
    if reference is None:
        raise UsageError("accepted: expected a fit or a diagnosis, or its file, found None")
    recordings = recordings_of(rec, "rec")
    if len(recordings) != 1:
        raise UsageError(f"rec: expected one recording, found {len(recordings)}")
    with progress_reporter(progress) as say:
        study = verify_study(
            recordings[0],
            reference,
            rig_file(model),
            alpha=number_of(alpha, "alpha"),
            span=span_of(span),
            max_samples=max_samples_of(max_samples),
            device=device,
            run=run,
            progress=say,
        )
    if warn is not None:
        warn(study.losses)
    return Verification(study.json)

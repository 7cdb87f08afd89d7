"""Results as they stand in JSON files: read, checked, and with names that a type checker knows.

Only what a page shows is asked for; keys that are not known here pass unseen, so that a page can be made
of a result with more in it.
"""

from __future__ import annotations

from typing import Any, Literal, TypeVar

from pydantic import BaseModel, ConfigDict, ValidationError

from labhil.analysis.verdicts import fit_verdict
from labhil.documents import parse_json
from labhil.errors import ModelFileError
from labhil.physics.terms import keyed

Number = float | None
Interval = tuple[Number, Number]


class Part(BaseModel):
    """A piece of a result; no number in it is infinite."""

    model_config = ConfigDict(frozen=True, extra="ignore", allow_inf_nan=False)


class Source(Part):
    """A recording that a result comes from."""

    path: str
    sha256: str = ""
    rig: str = ""
    samples: int
    duration: Number = None
    role: str = ""
    recording: int | None = None


class ParameterRow(Part):
    """One estimated parameter."""

    name: str
    term: str | None = None
    joint: int | None = None
    value: Number
    unit: str = ""
    std_error: Number = None
    std_error_reference: Number = None
    ci99: Interval | None = None
    z: Number = None
    p_value: Number = None
    significant: bool | None = None
    identifiable: bool = True
    at_bound: bool = False
    recording: int | None = None

    @property
    def key(self) -> str:
        """Its name with joint and recording, where it has them."""
        return keyed(self.name, self.joint, self.recording)


class ChannelErrors(Part):
    """How well one channel is simulated."""

    channel: str
    joint: int | None = None
    unit: str = ""
    mse: Number = None
    rmse: Number
    max_abs_error: Number = None
    r2: Number = None
    noise_floor: Number = None
    metric: str | None = None
    relative_error: Number = None


class RecordingErrors(Part):
    """Errors on one of several recordings."""

    recording: int
    per_channel: tuple[ChannelErrors, ...]


class ScorePart(Part):
    """Errors on one set of data."""

    metric: str = "windowed_simulation"
    horizon: Number = None
    rmse: Number
    r2: Number = None
    noise_floor: Number = None
    per_channel: tuple[ChannelErrors, ...]
    per_recording: tuple[RecordingErrors, ...] = ()

    @property
    def unit(self) -> str:
        """Of the headline, which is in multiples of noise floors where it is of several channels."""
        own = [row for row in self.per_channel if row.metric in (None, self.metric)]
        return own[0].unit if len(own) == 1 else ""


class IdentifiabilityPart(Part):
    """What the data cannot know."""

    rank: int
    of: int
    combinations: tuple[str, ...] = ()
    would_help: tuple[str, ...] = ()


class ResidualTests(Part):
    """Whether residuals are white and free of the input."""

    ljung_box_p: Number = None
    input_crosscorrelation_p: Number = None


class IntervalsPart(Part):
    """How intervals were made."""

    method: str = "wald"
    simultaneous: bool = False


class WindowPart(Part):
    """Estimates with fitted windows of one length."""

    window: float
    residual: Number = None
    values: dict[str, Number]
    std_errors: dict[str, Number]


class FitPart(Part):
    """`labhil.fit/1`."""

    recordings: tuple[Source, ...]
    rig: str
    estimator: str = ""
    seed: int = 0
    verdict: Literal["explained", "unexplained", "worse_than_mean"] | None = None
    residual_over_noise: dict[str, Number] = {}
    doubts: tuple[str, ...] = ()
    terms: tuple[str, ...]
    parameters: tuple[ParameterRow, ...]
    covariance: tuple[tuple[Number, ...], ...] = ()
    identifiability: IdentifiabilityPart
    train: ScorePart
    test: ScorePart | None = None
    residuals: ResidualTests = ResidualTests()
    intervals: IntervalsPart = IntervalsPart()
    window: Number = None
    by_window: tuple[WindowPart, ...] = ()
    converged: bool = True
    evaluations: int = 0
    seconds: Number = None

    @property
    def statement(self) -> str | None:
        """The verdict as a line; None of a result that has none."""
        if self.verdict is None:
            return None
        scores = [self.train] if self.test is None else [self.train, self.test]
        r2 = [row.r2 for score in scores for row in score.per_channel if row.r2 is not None]
        return fit_verdict(self.verdict, self.residual_over_noise, min(r2, default=None))

    @property
    def judged_rows(self) -> tuple[ParameterRow, ...]:
        """The parameters; of a model that does not explain its data none is called significant or not."""
        if self.verdict in (None, "explained"):
            return self.parameters
        return tuple(row.model_copy(update={"significant": None}) for row in self.parameters)


class BaselinePart(Part):
    """A model: its terms and parameters."""

    terms: tuple[str, ...]
    parameters: tuple[ParameterRow, ...]


class ChangePart(Part):
    """A parameter that is not what the reference says."""

    name: str
    joint: int | None = None
    before: Number
    after: Number
    unit: str = ""
    ci99: Interval | None = None
    p_value: Number = None
    recording: int | None = None


class RegimePart(Part):
    """A range of a coordinate in which an effect lives."""

    coordinate: str
    low: Number
    high: Number
    share_of_excess: Number = None
    unit: str = ""
    term: str = ""
    joint: int | None = None


class LocationPart(Part):
    """Where the mismatch is."""

    channel: str
    joint: int | None = None
    enters: str
    times: tuple[Interval, ...] = ()
    times_in: tuple[int, ...] = ()
    regimes: tuple[RegimePart, ...] = ()
    statement: str


class EvidencePart(Part):
    """How strongly the data speak for a term."""

    delta_bic: Number = None
    p_value: Number = None
    heldout_loglik_gain: Number = None


class MissingPart(Part):
    """A found effect."""

    term: str
    joint: int | None = None
    statement: str
    equation: str = ""
    probability: Number = None
    parameters: tuple[ParameterRow, ...] = ()
    evidence: EvidencePart = EvidencePart()


class RivalPart(Part):
    """What might stand in the place of a found effect."""

    term: str
    instead_of: str
    joint: int | None = None
    probability: Number = None
    delta_bic: Number = None
    distinguishable: bool = False
    experiment: str = ""


class UndecidedPart(Part):
    """A term of which the data cannot speak."""

    term: str
    joint: int | None = None
    needs: tuple[str, ...] = ()
    reason: str = ""


class ExcludedPart(Part):
    """A term that is not there, or smaller than this."""

    term: str
    joint: int | None = None
    largest_hidden: Number
    unit: str = ""
    confidence: Number = None
    recording: int | None = None


class ChannelImprovement(Part):
    """One channel before and after."""

    channel: str
    joint: int | None = None
    unit: str = ""
    rmse_before: Number
    rmse_after: Number
    noise_floor: Number = None
    r2_before: Number = None
    r2_after: Number = None
    metric: str | None = None


class RecordingImprovement(Part):
    """One of several recordings before and after."""

    recording: int
    per_channel: tuple[ChannelImprovement, ...]


class ImprovementPart(Part):
    """How much better the final model predicts data that the search never saw.

    ``parts``: of a recording of which it saw the parts between.
    """

    data: str = "heldout"
    parts: bool = False
    metric: str = "windowed_simulation"
    horizon: Number = None
    rmse_before: Number
    rmse_after: Number
    noise_floor: Number = None
    mse_before: Number = None
    mse_after: Number = None
    r2_before: Number = None
    r2_after: Number = None
    per_channel: tuple[ChannelImprovement, ...] = ()
    per_recording: tuple[RecordingImprovement, ...] = ()

    @property
    def unit(self) -> str:
        """Of the headline, which is in multiples of noise floors where it is of several channels."""
        own = [row for row in self.per_channel if row.metric in (None, self.metric)]
        return own[0].unit if len(own) == 1 else ""


class CurvePart(Part):
    """An estimated curve with its band, of a term that has no name."""

    depends_on: tuple[str, ...]
    x: tuple[tuple[Number, ...], ...]
    value: tuple[Number, ...]
    ci99: tuple[tuple[Number, ...], ...] = ()
    unit: str = ""
    joint: int | None = None


Verdict = Literal[
    "no_mismatch",
    "parameter_change",
    "missing_physics",
    "unexplained_mismatch",
    "data_fault",
    "not_decidable",
]


class FaultPart(Part):
    """A fault of the data."""

    kind: str
    statement: str


class DiagnosisPart(Part):
    """`labhil.diagnosis/1`."""

    recordings: tuple[Source, ...]
    verdict: Verdict
    faults: tuple[FaultPart, ...] = ()
    p_value: Number
    p_value_method: str = ""
    p_value_floor: Number = None
    baseline: BaselinePart
    changed: tuple[ChangePart, ...] = ()
    location: LocationPart | None = None
    missing: tuple[MissingPart, ...] = ()
    rivals: tuple[RivalPart, ...] = ()
    undecided: tuple[UndecidedPart, ...] = ()
    excluded: tuple[ExcludedPart, ...] = ()
    improvement: ImprovementPart | None = None
    final: BaselinePart
    curve: CurvePart | None = None
    further_curves: tuple[CurvePart, ...] = ()
    seconds: Number = None


Result = TypeVar("Result", bound=Part)

FIT, DIAGNOSIS = "labhil.fit/1", "labhil.diagnosis/1"


def result_of(data: Any, origin: str) -> FitPart | DiagnosisPart:
    """A result of plain JSON data; ModelFileError names ``origin``, the field and what was expected."""
    schema = data.get("schema") if isinstance(data, dict) else None
    if schema == FIT:
        return checked(FitPart, data, origin)
    if schema == DIAGNOSIS:
        return checked(DiagnosisPart, data, origin)
    found = repr(schema) if schema else "no schema"
    raise ModelFileError(f"{origin}: expected a result of schema {FIT} or {DIAGNOSIS}, found {found:.80}")


def checked(kind: type[Result], data: Any, origin: str) -> Result:
    """A result of this kind; ModelFileError names ``origin``, the field and what was expected."""
    try:
        return kind.model_validate(data)
    except ValidationError as error:
        first = error.errors(include_url=False)[0]
        field = ".".join(str(place) for place in first["loc"])
        raise ModelFileError(f"{origin}: {field}: {first['msg']}, found {first['input']!r:.80}") from error


def json_of(text: bytes, origin: str) -> Any:
    """Parsed JSON with None for NaN and infinities; ModelFileError when it is none."""
    try:
        return parse_json(text.decode("utf-8"), constant=lambda name: None)
    except ValueError as error:
        raise ModelFileError(
            f"{origin}: expected a recording (MCAP) or the JSON of `labhil fit` or `labhil diagnose`: {error}"
        ) from error

"""Typed data of results in JSON: read and validated.

Only the fields that reports show are required; unknown keys are ignored.
"""

from __future__ import annotations

from typing import Any, TypeVar

from pydantic import ValidationError

from labhil.analysis.schema.comparison import (
    ComparedChannel,
    ComparedModel,
    ComparisonPart,
    SharedParameter,
    ValueOfModel,
)
from labhil.analysis.schema.diagnosis import (
    ChangedParameter,
    CollapsedSize,
    DiagnosisPart,
    Evidence,
    ExcludedEffect,
    FittedModel,
    Location,
    MissingEffect,
    Regime,
    Remainder,
    Rival,
    UndecidedEffect,
    Verdict,
)
from labhil.analysis.schema.fit import (
    FitPart,
    FittedChannel,
    Identifiability,
    Intervals,
    ResidualTests,
    WindowEstimate,
)
from labhil.analysis.schema.improvement import (
    ChannelImprovement,
    Improvement,
    RecordingImprovement,
    ShorterWindows,
)
from labhil.analysis.schema.parts import (
    ChannelErrors,
    EstimatedCurve,
    Fault,
    Interval,
    Number,
    Parameter,
    Parameters,
    Part,
    RecordingErrors,
    Score,
    Source,
)
from labhil.analysis.schema.verification import (
    ChannelVerdict,
    ValueChange,
    VerificationPart,
    WorstWindow,
)
from labhil.documents import LARGEST, DocumentError, parse_json
from labhil.errors import ModelFileError
from labhil.validation_errors import expectation

__all__ = [
    "COMPARISON",
    "ChangedParameter",
    "ChannelErrors",
    "ChannelImprovement",
    "ChannelVerdict",
    "CollapsedSize",
    "ComparedChannel",
    "ComparedModel",
    "ComparisonPart",
    "DiagnosisPart",
    "EstimatedCurve",
    "Evidence",
    "ExcludedEffect",
    "Fault",
    "FitPart",
    "FittedChannel",
    "FittedModel",
    "Identifiability",
    "Improvement",
    "Interval",
    "Intervals",
    "Location",
    "MissingEffect",
    "Number",
    "Parameter",
    "Parameters",
    "Part",
    "RecordingErrors",
    "RecordingImprovement",
    "Regime",
    "Remainder",
    "ResidualTests",
    "Rival",
    "Score",
    "SharedParameter",
    "ShorterWindows",
    "Source",
    "UndecidedEffect",
    "ValueChange",
    "ValueOfModel",
    "Verdict",
    "VerificationPart",
    "WindowEstimate",
    "WorstWindow",
    "any_result_of",
    "json_of",
    "result_of",
    "validate",
]

Result = TypeVar("Result", bound=Part)

FIT, DIAGNOSIS, VERIFICATION = "labhil.fit/1", "labhil.diagnosis/1", "labhil.verification/1"
COMPARISON = "labhil.comparison/1"


def any_result_of(data: Any, origin: str) -> FitPart | DiagnosisPart | VerificationPart:
    """Return plain JSON data as a fit, a diagnosis or a verification; see :func:`result_of`."""
    if isinstance(data, dict) and data.get("schema") == VERIFICATION:
        return validate(VerificationPart, data, origin)
    return result_of(data, origin)


def result_of(data: Any, origin: str) -> FitPart | DiagnosisPart:
    """Return plain JSON data as a fit or a diagnosis.

    Raises:
        ModelFileError: The data are neither; the message names ``origin`` and the field.
    """
    schema = data.get("schema") if isinstance(data, dict) else None
    if schema == FIT:
        return validate(FitPart, data, origin)
    if schema == DIAGNOSIS:
        return validate(DiagnosisPart, data, origin)
    schema_text = repr(schema) if schema else "no schema"
    raise ModelFileError(
        f"{origin}: expected a result of schema {FIT} or {DIAGNOSIS}, found {schema_text:.80}"
    )


def validate(kind: type[Result], data: Any, origin: str) -> Result:
    """Return plain JSON data as a result of this kind.

    Raises:
        ModelFileError: A field is missing or wrong; the message names ``origin`` and the field.
    """
    try:
        return kind.model_validate(data)
    except ValidationError as error:
        first = error.errors(include_url=False)[0]
        field = ".".join(str(place) for place in first["loc"])
        raise ModelFileError(
            f"{origin}: {field}: {expectation(first['msg'])}, found {first['input']!r:.80}"
        ) from error


def json_of(text: bytes, origin: str) -> Any:
    """Parse JSON, with None for NaN and infinities.

    Raises:
        ModelFileError: The text is no JSON, or too long.
    """
    try:
        if len(text) > LARGEST:
            raise DocumentError(f"expected at most {LARGEST} bytes, found {len(text)}")
        return parse_json(text, constant=lambda name: None)
    except ValueError as error:
        raise ModelFileError(
            f"{origin}: expected a recording (MCAP) or the JSON of `labhil fit` or `labhil diagnose`: {error}"
        ) from error

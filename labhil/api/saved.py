"""``labhil.load``: read a saved result."""

from __future__ import annotations

from typing import TYPE_CHECKING

from labhil.analysis.schema import json_of
from labhil.api.comparison import Comparison
from labhil.api.diagnosis import Diagnosis
from labhil.api.fit import Fit
from labhil.api.inputs import PathLike, path_of
from labhil.api.verification import Verification
from labhil.bounds import read_file
from labhil.errors import ModelFileError
from labhil.recording.chunks import is_mcap
from labhil.unreadable import RESULT, reason_unreadable

if TYPE_CHECKING:
    from collections.abc import Mapping

KINDS: Mapping[str, type[Fit | Diagnosis | Verification | Comparison]] = {
    "labhil.fit/1": Fit,
    "labhil.diagnosis/1": Diagnosis,
    "labhil.verification/1": Verification,
    "labhil.comparison/1": Comparison,
}


def load(path: PathLike) -> Fit | Diagnosis | Verification | Comparison:
    """Read a result that was saved in Python or by a command's ``--json``.

    Args:
        path: The JSON file.

    Returns:
        A :class:`Fit`, :class:`Diagnosis`, :class:`Verification` or :class:`Comparison`, by its schema.
        It has no samples: it prints, simulates and makes pages, but does not draw its recording.

    Raises:
        ModelFileError: The file cannot be read, or is no result.

    Example:
        >>> import labhil as lh
        >>> fit = lh.load("examples/fit.json")
        >>> print(fit.parameters["coulomb_friction.level"])
        coulomb_friction.level = 0.089918 ± 0.00025 N
    """
    file = path_of(path, "path")
    try:
        content = read_file(file)
    except OSError as error:
        reason = reason_unreadable(file, error, RESULT)
        raise ModelFileError(f"{file}: expected the JSON of a result, cannot be read: {reason}") from error
    if is_mcap(content):
        raise ModelFileError(
            f"{file}: expected the JSON of a result, found a recording (MCAP); labhil.read reads recordings"
        )
    data = json_of(content, str(file))
    schema = data.get("schema") if isinstance(data, dict) else None
    kind = KINDS.get(str(schema))
    if kind is None:
        raise ModelFileError(
            f"{file}: expected a result of schema {', '.join(KINDS)}, found {schema or 'no schema'!r:.80}"
        )
    return kind(data, name=str(file))

"""A repaired file and its companion: what was changed, which error is left, and how both are written."""

from __future__ import annotations

import difflib
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from labhil.errors import UsageError
from labhil.simulators.xml_text import Change, XmlText
from labhil.whole import whole

KEPT = 1.05
"""Times the diagnosed model's error that the repaired file may make on the same held-out data."""

OTHERS = 1.25
"""Times the promised error beyond which file and data are not those that the diagnosis was made of."""


FIRM = "firm dry friction"
"""The remedy beside the values where a file's own dry friction is too soft."""


@dataclass(frozen=True, slots=True)
class Attempt:
    """A repaired file as tried: its remedy ``beside`` the values, its error, ``ratio`` to the model's."""

    beside: str
    rmse: float
    ratio: float


@dataclass(frozen=True, slots=True)
class Joint:
    """RMS errors of one joint in ``unit``: of the file as it was, the diagnosed model, the repaired file."""

    name: str
    unit: str
    before: float
    model: float
    after: float


@dataclass(frozen=True, slots=True)
class Patch:
    """A repaired file, what was changed, and how it does on the held-out data.

    ``promised`` is the error that the result states, ``model`` that of the diagnosed model on the windows on
    which the file was run, ``before`` that of the file as it was; all in ``unit``. Of an arm ``joints`` are
    the errors of each joint, and ``unheld`` what neither file nor companion holds.
    """

    path: Path
    companion: Path | None
    changes: tuple[Change, ...]
    left: tuple[str, ...]
    diff: str
    promised: float
    model: float
    before: float
    attempts: tuple[Attempt, ...]
    unit: str
    joints: tuple[Joint, ...] = ()
    unheld: tuple[str, ...] = ()

    def to_dict(self) -> dict[str, Any]:
        """The whole result as plain data (``labhil.patch/1``)."""
        return {
            "schema": "labhil.patch/1",
            "path": str(self.path),
            "companion": None if self.companion is None else str(self.companion),
            "changes": [asdict(change) for change in self.changes],
            "left": list(self.left),
            "rmse_before": self.before,
            "rmse_promised": self.promised,
            "rmse_model": self.model,
            "rmse_after": self.attempts[-1].rmse,
            "ratio": self.attempts[-1].ratio,
            "unit": self.unit,
            "attempts": [asdict(attempt) for attempt in self.attempts],
            "joints": [asdict(joint) for joint in self.joints],
            "unheld": list(self.unheld),
            "diff": self.diff,
        }


@contextmanager
def drafts(out: Path) -> Iterator[tuple[Path, Path]]:
    """Names beside ``out`` for a file and its code while they are tried; both are gone at the end.

    UsageError where they cannot be written.
    """
    draft, code = out.with_name(f"{out.stem}.part{out.suffix}"), out.with_name(f"{out.stem}_part.py")
    try:
        yield draft, code
    except OSError as error:
        raise UsageError(f"{out}: cannot be written: {error.strerror}") from error
    finally:
        for path in (draft, code):
            with suppress(OSError):
                path.unlink(missing_ok=True)


def write(text: XmlText, companion: str, out: Path, code: Path) -> None:
    """Write the file and its companion, whole or not at all."""
    with whole(out) as draft:
        draft.write_bytes(text.changed())
    if companion:
        with whole(code) as draft:
            draft.write_text(companion, encoding="utf-8")


def difference(text: XmlText, out: Path) -> str:
    """The difference of the file to what was there, as ``diff -u`` shows it."""
    before, after = (
        content.decode("utf-8", "replace").splitlines(keepends=True)
        for content in (text.content, text.changed())
    )
    return "".join(difflib.unified_diff(before, after, str(text.path), str(out), n=1))

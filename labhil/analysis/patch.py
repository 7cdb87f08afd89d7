"""A repaired file and its companion: changes, errors, and the functions that write both."""

from __future__ import annotations

import difflib
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, Protocol

from labhil.atomic_file import atomic_file
from labhil.errors import UsageError
from labhil.simulators.xml_text import Change

MAX_ERROR_RATIO = 1.05
"""Largest error of a repaired file on the held-out data, over that of the diagnosed model."""

MAX_STATED_RATIO = 1.25
"""Largest error of the diagnosed model over the stated one; beyond it, file or data are others."""

STEP_DIVISORS = (2, 4, 8, 16)
"""By which a simulator's time step is divided, in turn, where it is too long."""

FIRM_FRICTION = "firm dry friction"
"""The remedy where the dry friction of a file is too soft."""


@dataclass(frozen=True, slots=True)
class Attempt:
    """A candidate: its remedy ``beside`` the values, its error, and the ratio to the model's error."""

    beside: str
    rmse: float
    ratio: float


@dataclass(frozen=True, slots=True)
class Joint:
    """RMS errors of a joint in ``unit``: of the original file, the diagnosed model, the repaired file."""

    name: str
    unit: str
    before: float
    model: float
    after: float


@dataclass(frozen=True, slots=True)
class Patch:
    """A repaired file with its changes and its errors on the held-out data.

    Attributes:
        path: The repaired file.
        companion: A Python file with the effects that the file cannot hold.
        changes: The changes of the file.
        left: Effects in the companion.
        diff: The changes as a unified diff.
        promised: The error that the result states, in ``unit``.
        model: The error of the diagnosed model on the windows on which the file was run.
        before: The error of the original file.
        attempts: The candidates for the repaired file; the last one was written.
        unit: Unit of the errors.
        joints: Errors of each joint of an arm.
        unheld: Effects that neither file nor companion holds.
        run_by: What simulated the repaired file.
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
    run_by: str = "MuJoCo"

    def __str__(self) -> str:
        """The difference, what is beside the file, and the errors."""
        lines = [self.diff.rstrip("\n")]
        if self.companion is not None:
            lines.append(f"{self.companion}: terms that the file cannot express: {', '.join(self.left)}")
        last = self.attempts[-1]
        remedy = f", with {last.beside}" if last.beside else ""
        lines.append(
            f"On held-out data, run by {self.run_by} itself: RMSE {self.before:.4g} → {last.rmse:.4g} "
            f"{self.unit}, {last.ratio:.3f} times the diagnosed model's {self.model:.4g}{remedy}."
        )
        lines += [
            f"  {j.name}: {j.before:.4g} → {j.after:.4g} {j.unit}, the diagnosed model {j.model:.4g}"
            for j in self.joints
        ]
        if self.unheld:
            lines.append(f"Neither file expresses {', '.join(self.unheld)}; both were run without.")
        lines += [
            f"  {attempt.beside or 'values alone'}: {attempt.ratio:.3f} times"
            for attempt in self.attempts[:-1]
        ]
        return "\n".join(lines)

    def to_dict(self) -> dict[str, Any]:
        """Return the result as plain data (``labhil.patch/1``)."""
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
            "run_by": self.run_by,
            "diff": self.diff,
        }


def companion_path(out: Path) -> Path:
    """Return the path of the companion of a repaired file."""
    return out.with_name(f"{out.stem}_effects.py")


@contextmanager
def temporary_files(out: Path) -> Iterator[tuple[Path, Path]]:
    """Yield temporary names beside ``out`` for a file and its companion, and delete both files at the end.

    Raises:
        UsageError: They cannot be written.
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


class EditedText(Protocol):
    """The text of a file with changes to make."""

    @property
    def path(self) -> Path:
        """The file."""
        ...

    @property
    def content(self) -> bytes:
        """Its bytes."""
        ...

    def changed(self) -> bytes:
        """Return its bytes with all changes."""
        ...


def write_patched(content: bytes, companion: str, out: Path, code: Path | None) -> None:
    """Write a file and its companion (None for none), each completely or not at all."""
    with atomic_file(out) as draft:
        draft.write_bytes(content)
    if code is not None:
        with atomic_file(code) as draft:
            draft.write_text(companion, encoding="utf-8")


def unified_diff(text: EditedText, out: Path, *, by_element: bool = False) -> str:
    """Return the changes of a file as a unified diff, with a line for each element where that is wanted."""
    before, after = (
        (content.replace(b"><", b">\n<") if by_element else content)
        .decode("utf-8", "replace")
        .splitlines(keepends=True)
        for content in (text.content, text.changed())
    )
    return "".join(difflib.unified_diff(before, after, str(text.path), str(out), n=1))

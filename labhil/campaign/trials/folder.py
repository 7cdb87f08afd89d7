"""The folder of a set of trials: recordings, seals, and the diagnosis of each."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from labhil.documents import parse_json, read_document
from labhil.errors import UnknownNameError, UsageError

SCHEMA = "labhil.trials/1"
INDEX = "trials.json"
RIG = "rig.toml"
DIAGNOSE, STEPWISE = "diagnose", "stepwise"
METHODS = (DIAGNOSE, STEPWISE)
"""How trials may be answered: by a diagnosis, or by what it is compared with."""


@dataclass(frozen=True, slots=True)
class Listed:
    """A trial as the index has it: its name, its seal, and the SHA-256 of its recordings by role."""

    name: str
    seal: str
    recordings: Mapping[str, str]


@dataclass(frozen=True, slots=True)
class Index:
    """The index of a folder; ``fixed_seed`` says that anyone with the seed could draw the same trials."""

    rig: str
    fixed_seed: bool
    trials: tuple[Listed, ...]

    def write(self, folder: Path) -> None:
        """Write it in place of an earlier one."""
        data = {
            "schema": SCHEMA,
            "rig": self.rig,
            "fixed_seed": self.fixed_seed,
            "trials": [
                {"name": t.name, "seal": t.seal, "recordings": dict(t.recordings)} for t in self.trials
            ],
        }
        replace_text(folder / INDEX, json.dumps(data, indent=1) + "\n")


def read_index(folder: Path) -> Index:
    """Read a folder's index; UsageError where it is none of ``labhil trial make``."""
    path = folder / INDEX
    data = read_object(path, SCHEMA)
    try:
        trials = tuple(Listed(t["name"], t["seal"], t["recordings"]) for t in data["trials"])
        return Index(str(data["rig"]), bool(data["fixed_seed"]), trials)
    except (KeyError, TypeError) as error:
        raise UsageError(f"{path}: expected the index of `labhil trial make`, found none: {error}") from error


def read_object(path: Path, schema: str) -> dict[str, Any]:
    """JSON of a schema; UsageError with what was expected and what was found."""
    try:
        data = parse_json(read_document(path))
    except (OSError, ValueError) as error:
        raise UsageError(f"{path}: expected JSON of schema {schema}: {error}") from error
    actual = data.get("schema") if isinstance(data, dict) else None
    if actual != schema:
        raise UsageError(f"{path}: expected schema {schema}, found {actual or 'none'}")
    return dict(data)


def recording(folder: Path, name: str, role: str) -> Path:
    """Where a trial's recording stands; ``role`` is "search" or "test"."""
    return folder / name / f"{role}.mcap"


def replace_text(path: Path, text: str) -> None:
    """Write a file whole or not at all."""
    part = path.with_name(path.name + ".part")
    part.write_text(text, encoding="utf-8")
    part.replace(path)


@dataclass(frozen=True, slots=True)
class Results:
    """Where the answers of one method stand in a folder of trials, and their hashes.

    Raises UnknownNameError for a method that is none.
    """

    folder: Path
    method: str = DIAGNOSE

    def __post_init__(self) -> None:
        if self.method not in METHODS:
            raise UnknownNameError("--method", self.method, METHODS)

    @property
    def name(self) -> str:
        """Of their folder."""
        return "results" if self.method == DIAGNOSE else f"results-{self.method}"

    @property
    def hashes(self) -> Path:
        """The file of hashes."""
        return self.folder / f"{self.name}.sha256"

    def of(self, trial: str) -> Path:
        """The answer to one trial."""
        return self.folder / self.name / f"{trial}.json"

    def read_hashes(self) -> dict[str, str]:
        """SHA-256 of each answer by the trial's name; UsageError for a line that is not ``hash  path``."""
        if not self.hashes.exists():
            return {}
        hashes = {}
        for line in self.hashes.read_text(encoding="utf-8").splitlines():
            digest, _, place = line.partition("  ")
            if len(digest) != 64 or not place:
                raise UsageError(f"{self.hashes}: expected lines of a SHA-256 and a path, found {line!r}")
            hashes[Path(place).stem] = digest
        return hashes

    def write_hashes(self, hashes: Mapping[str, str]) -> None:
        """Write them as ``sha256sum -c`` reads them, sorted."""
        lines = [f"{hashes[trial]}  {self.name}/{trial}.json\n" for trial in sorted(hashes)]
        replace_text(self.hashes, "".join(lines))

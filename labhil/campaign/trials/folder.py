"""The folder of a set of trials: index, recordings, and the results of each method with their hashes."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from labhil.campaign.trials.seal import sha256_of
from labhil.documents import parse_json, read_document
from labhil.errors import UnknownNameError, UsageError
from labhil.rig import is_simulator

SCHEMA = "labhil.trials/1"
INDEX = "trials.json"
RIG = "rig.toml"
DIAGNOSE, STEPWISE = "diagnose", "stepwise"
METHODS = (DIAGNOSE, STEPWISE)
"""How trials may be answered, beside a diagnosis with a user's own simulator: by a diagnosis with labhil's
model, or by what it is compared with."""


@dataclass(frozen=True, slots=True)
class IndexEntry:
    """A trial in the index: its name, its seal, and the SHA-256 of its recordings by role."""

    name: str
    seal: str
    recordings: Mapping[str, str]


@dataclass(frozen=True, slots=True)
class Index:
    """The index of a folder; ``fixed_seed`` is whether anyone with the seed can draw the same trials."""

    rig: str
    fixed_seed: bool
    trials: tuple[IndexEntry, ...]

    def write(self, folder: Path) -> None:
        """Write the index to a folder, in place of an earlier one."""
        data = {
            "schema": SCHEMA,
            "rig": self.rig,
            "fixed_seed": self.fixed_seed,
            "trials": [
                {"name": t.name, "seal": t.seal, "recordings": dict(t.recordings)} for t in self.trials
            ],
        }
        write_text_atomically(folder / INDEX, json.dumps(data, indent=1) + "\n")


def read_index(folder: Path) -> Index:
    """Read a folder's index.

    Raises:
        UsageError: the folder has no index of ``labhil trial make``.
    """
    path = folder / INDEX
    data = read_json_object(path, SCHEMA)
    try:
        trials = tuple(IndexEntry(t["name"], t["seal"], t["recordings"]) for t in data["trials"])
        return Index(str(data["rig"]), bool(data["fixed_seed"]), trials)
    except (KeyError, TypeError) as error:
        raise UsageError(f"{path}: expected the index of `labhil trial make`, found none: {error}") from error


def read_json_object(path: Path, schema: str) -> dict[str, Any]:
    """Read a JSON object.

    Raises:
        UsageError: the file cannot be read or has another schema.
    """
    try:
        data = parse_json(read_document(path))
    except (OSError, ValueError) as error:
        raise UsageError(f"{path}: expected JSON of schema {schema}: {error}") from error
    actual = data.get("schema") if isinstance(data, dict) else None
    if actual != schema:
        raise UsageError(f"{path}: expected schema {schema}, found {actual or 'none'}")
    return dict(data)


def recording_path(folder: Path, name: str, role: str) -> Path:
    """Return the path of a trial's recording; ``role`` is "search" or "test"."""
    return folder / name / f"{role}.mcap"


def check_recordings(folder: Path, entry: IndexEntry) -> None:
    """Check the recordings of a trial against their hashes.

    Raises:
        UsageError: a recording is not the sealed one.
    """
    for role, expected in entry.recordings.items():
        path = recording_path(folder, entry.name, role)
        actual = sha256_of(path)
        if actual != expected:
            raise UsageError(f"{path}: not the sealed recording: expected SHA-256 {expected}, found {actual}")


def write_text_atomically(path: Path, text: str) -> None:
    """Write a file completely or not at all."""
    part = path.with_name(path.name + ".part")
    part.write_text(text, encoding="utf-8")
    part.replace(path)


@dataclass(frozen=True, slots=True)
class Results:
    """The results of one method in a folder of trials, and their hashes.

    The method is one of ``METHODS``, or names a simulator (``bench.py:cart``, ``cart.xml``, ``cart.fmu``).

    Raises:
        UnknownNameError: there is no such method.
    """

    folder: Path
    method: str = DIAGNOSE

    def __post_init__(self) -> None:
        if self.method not in METHODS and not is_simulator(self.method):
            raise UnknownNameError("--method", self.method, METHODS)

    @property
    def name(self) -> str:
        """The name of their folder."""
        short = Path(self.method).name.replace(":", "-")
        return "results" if self.method == DIAGNOSE else f"results-{short}"

    @property
    def hashes(self) -> Path:
        """The file of hashes."""
        return self.folder / f"{self.name}.sha256"

    def path_of(self, trial: str) -> Path:
        """Return the path of the result of one trial."""
        return self.folder / self.name / f"{trial}.json"

    def read_hashes(self) -> dict[str, str]:
        """Read the SHA-256 of each result, by the trial's name.

        Raises:
            UsageError: a line is not ``hash  path``.
        """
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
        """Write the hashes, sorted, in the format of ``sha256sum -c``."""
        lines = [f"{hashes[trial]}  {self.name}/{trial}.json\n" for trial in sorted(hashes)]
        write_text_atomically(self.hashes, "".join(lines))

"""Policies of a lab: which studies its worker does of a recording, by the kind of rig."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from queue import Queue
from typing import Any

from labhil.analysis.schema import json_of, result_of
from labhil.campaign.studies.catalogue import MODULE, Catalogue
from labhil.campaign.studies.process import Helper
from labhil.campaign.studies.study import Task
from labhil.errors import ExperimentFileError, LabhilError, suggestion
from labhil.experiment.lab import Lab, Policy
from labhil.recording.metadata import read_rig_kinds


@dataclass(frozen=True, slots=True)
class Policies:
    """The policies of a lab by kind of rig, and the default for other kinds."""

    by_kind: Mapping[str, Policy]
    default: Policy

    @classmethod
    def of_lab(cls, lab: Lab) -> Policies:
        """Return the policies of a lab file; their paths are relative to that file."""
        default = Policy(analyse=lab.lab.analyse)
        folder = lab.path.parent
        return cls(
            {
                kind: policy.model_copy(
                    update={
                        "analyse": default.analyse if policy.analyse is None else policy.analyse,
                        "model": None if policy.model is None else str(folder / policy.model),
                    }
                )
                for kind, policy in lab.policies.items()
            },
            default,
        )

    def of_kind(self, kind: str | None) -> Policy:
        """Return the policy for a kind of rig."""
        return self.by_kind.get(kind or "", self.default)

    def tasks(self, recording: Path) -> Iterator[Task]:
        """Yield the studies of a recording: for each of its devices, those of its policy.

        Raises:
            RecordingError: the recording cannot be read.
        """
        kinds = read_rig_kinds(recording)
        for device, kind in kinds.items():
            yield from tasks_of(self.of_kind(kind), recording, device if len(kinds) > 1 else None)


def tasks_of(policy: Policy, recording: Path, device: str | None) -> Iterator[Task]:
    """Yield the studies of a policy, in its order."""
    model = None if policy.model is None else Path(policy.model)
    for kind in policy.analyse or ():
        terms = {"fit": policy.terms, "diagnose": policy.baseline}.get(kind)
        yield Task(
            kind,
            (recording,),
            # a fit does not depend on an earlier model
            model=None if kind == "fit" else model,
            terms=terms,
            estimator=policy.estimator if kind == "fit" else None,
            seconds=policy.seconds if kind in ("fit", "diagnose") else None,
            device=device,
        )


def check_policies(lab: Lab) -> None:
    """Check the terms, estimators and models of a lab file's policies.

    Raises:
        ExperimentFileError: the rig kind does not have a term or an estimator, or a model cannot be read or
            is of another kind of rig.
    """
    for kind, policy in Policies.of_lab(lab).by_kind.items():
        where = f"{lab.path}: policies.{kind}"
        if policy.model is not None:
            _check_model(Path(policy.model), kind, f"{where}.model")
        if policy.terms or policy.baseline or policy.estimator:
            catalogue = _read_catalogue(kind, where)
            terms = [effect.name for effect in catalogue.effects]
            _check_names(policy.terms or (), terms, "term", f"{where}.terms")
            _check_names(policy.baseline or (), terms, "term", f"{where}.baseline")
            estimators = () if policy.estimator is None else (policy.estimator,)
            _check_names(estimators, catalogue.estimators, "estimator", f"{where}.estimator")


def _check_model(path: Path, kind: str, where: str) -> None:
    try:
        result = result_of(json_of(path.read_bytes(), str(path)), str(path))
    except OSError as error:
        raise ExperimentFileError(
            f"{where}: expected a fit or a diagnosis (JSON), found {path}: {error.strerror}"
        ) from error
    except LabhilError as error:
        raise ExperimentFileError(f"{where}: {error}") from error
    kinds = {source.rig for source in result.recordings if source.rig}
    if kinds and kind not in kinds:
        raise ExperimentFileError(
            f"{where}: expected a model of {kind}, found one of {', '.join(kinds)}: {path}"
        )


def _check_names(names: Sequence[str], known: Sequence[str], noun: str, where: str) -> None:
    for name in names:
        if name not in known:
            raise ExperimentFileError(
                f"{where}: unknown {noun} {name!r}{suggestion(name, known)}; known: {', '.join(known)}"
            )


def _read_catalogue(kind: str, where: str) -> Catalogue:
    """Read the catalogue in another process: this one loads no models."""
    lines: Queue[dict[str, Any]] = Queue()
    helper = Helper("the catalogue", MODULE, {"rig": kind}, lines.put)
    try:
        while True:
            line = lines.get()
            if "done" in line:
                return Catalogue.from_json(line["done"])
            if "failed" in line or "ended" in line:
                raise ExperimentFileError(f"{where}: {line.get('failed') or line.get('complaint')}")
    finally:
        helper.close()

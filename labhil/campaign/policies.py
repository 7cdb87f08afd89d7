"""What the worker of a lab does with a recording: as the lab file says for its kind of rig."""

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
    """The policies of a lab by the kind of rig, and what a recording of any other kind gets."""

    by_kind: Mapping[str, Policy]
    default: Policy

    @classmethod
    def of(cls, lab: Lab) -> Policies:
        """Read those of a lab file; paths in them are relative to that file."""
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
        """The policy for a kind of rig."""
        return self.by_kind.get(kind or "", self.default)

    def tasks(self, recording: Path) -> Iterator[Task]:
        """Yield what is done with a recording: for each of its devices, each study of its policy.

        Raises:
            RecordingError: The recording cannot be read.
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
            # what is fitted is not to depend on what was accepted before
            model=None if kind == "fit" else model,
            terms=terms,
            estimator=policy.estimator if kind == "fit" else None,
            seconds=policy.seconds if kind in ("fit", "diagnose") else None,
            device=device,
        )


def check_policies(lab: Lab) -> None:
    """Look at what a lab file's policies name, before anything starts.

    Raises:
        ExperimentFileError: A term or an estimator that the rig kind does not have, or a model that is none,
            or one of another kind of rig.
    """
    for kind, policy in Policies.of(lab).by_kind.items():
        where = f"{lab.path}: policies.{kind}"
        if policy.model is not None:
            _check_model(Path(policy.model), kind, f"{where}.model")
        if policy.terms or policy.baseline or policy.estimator:
            known = _catalogue(kind, where)
            terms = [effect.name for effect in known.effects]
            _check_names(policy.terms or (), terms, "term", f"{where}.terms")
            _check_names(policy.baseline or (), terms, "term", f"{where}.baseline")
            chosen = () if policy.estimator is None else (policy.estimator,)
            _check_names(chosen, known.estimators, "estimator", f"{where}.estimator")


def _check_model(path: Path, kind: str, where: str) -> None:
    try:
        part = result_of(json_of(path.read_bytes(), str(path)), str(path))
    except OSError as error:
        raise ExperimentFileError(
            f"{where}: expected a fit or a diagnosis (JSON), found {path}: {error.strerror}"
        ) from error
    except LabhilError as error:
        raise ExperimentFileError(f"{where}: {error}") from error
    kinds = {source.rig for source in part.recordings if source.rig}
    if kinds and kind not in kinds:
        raise ExperimentFileError(
            f"{where}: expected a model of {kind}, found one of {', '.join(kinds)}: {path}"
        )


def _check_names(names: Sequence[str], known: Sequence[str], what: str, where: str) -> None:
    for name in names:
        if name not in known:
            raise ExperimentFileError(
                f"{where}: unknown {what} {name!r}{suggestion(name, known)}; known: {', '.join(known)}"
            )


def _catalogue(kind: str, where: str) -> Catalogue:
    """Read the catalogue in a process of its own: this one loads no models."""
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

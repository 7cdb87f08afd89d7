"""The file of a lab (TOML): devices that stay up, and how what they say is recorded."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Annotated

from pydantic import BaseModel, ConfigDict, Field

from labhil.documents import DocumentError, read_document
from labhil.errors import ExperimentFileError, UsageError
from labhil.experiment.experiment import DeviceSection, WithDevices, parse_devices
from labhil.kinds import kind_named

SHORTEST_ROLL = 1.0


class LabSection(BaseModel):
    """``[lab]``: its name, and where recordings go; a new one is begun every ``roll`` s of the host's clock.

    ``analyse`` says what is done with each finished recording of that folder: "fit", "diagnose", both, or
    nothing.
    """

    model_config = ConfigDict(extra="forbid", frozen=True)

    name: Annotated[str, Field(min_length=1)] = "lab"
    folder: str = "."
    record: bool = True
    roll: Annotated[float, Field(ge=SHORTEST_ROLL, allow_inf_nan=False)] = 600.0
    analyse: tuple[str, ...] = ("fit", "diagnose")


class Policy(BaseModel):
    """``[policies.KIND]``: what recordings of that kind of rig get; where a key is absent, the kind's own.

    ``analyse``: "fit", "diagnose", "verify", in that order or another; that of ``[lab]`` where absent.
    ``terms``: of the model that is fitted. ``baseline``: the terms that a diagnosis takes for given.
    ``model``: the accepted model, the JSON of a fit or a diagnosis: what a diagnosis compares with, and what
    is verified. ``estimator``: of a fit. ``seconds``: how long a study may take before it ends with the best
    so far.
    """

    model_config = ConfigDict(extra="forbid", frozen=True)

    analyse: tuple[str, ...] | None = None
    terms: tuple[str, ...] | None = None
    baseline: tuple[str, ...] | None = None
    model: str | None = None
    estimator: str | None = None
    seconds: Annotated[float, Field(gt=0, allow_inf_nan=False)] | None = None


class Lab(WithDevices):
    """A whole lab file; without ``[devices]`` a lab only analyses what others record in its folder."""

    lab: LabSection = LabSection()
    devices: dict[str, DeviceSection] = Field(default_factory=dict)
    policies: dict[str, Policy] = Field(default_factory=dict)


ANALYSES = ("fit", "diagnose")
POLICY_ANALYSES = (*ANALYSES, "verify")


def load_lab(path: Path) -> Lab:
    """Read a lab file; ExperimentFileError names the file, the field and what was expected."""
    try:
        text = read_document(path)
    except (OSError, DocumentError) as error:
        raise ExperimentFileError(f"{path}: cannot be read as a lab file (TOML): {error}") from error
    lab = parse_devices(text, path, Lab)
    _check_analyses(lab.lab.analyse, ANALYSES, f"{path}: lab.analyse")
    for kind, policy in lab.policies.items():
        where = f"{path}: policies.{kind}"
        try:
            kind_named(kind)
        except UsageError as error:
            raise ExperimentFileError(f"{where}: {error}") from error
        _check_analyses(policy.analyse or (), POLICY_ANALYSES, f"{where}.analyse")
        if "verify" in (policy.analyse or ()) and policy.model is None:
            raise ExperimentFileError(f'{where}.analyse: verify needs the accepted model: model = "FIT.json"')
    return lab


def _check_analyses(names: Sequence[str], known: Sequence[str], where: str) -> None:
    for name in names:
        if name not in known:
            raise ExperimentFileError(f"{where}: expected {' or '.join(known)}, found {name!r}")

"""The lab file (TOML): devices that stay up, how they are recorded, and what is done with the recordings."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Annotated

from pydantic import Field

from labhil.documents import DocumentError, read_document
from labhil.errors import ExperimentFileError, UsageError
from labhil.experiment.device_sections import DeviceSection, Section, WithDevices, parse_devices
from labhil.kinds import kind_named
from labhil.unreadable import LAB, reason_unreadable

MIN_ROLL = 1.0
"""Shortest recording of a lab, s."""


class LabSection(Section):
    """``[lab]``: its name and the folder of its recordings, one for every ``roll`` s of the host's clock.

    ``analyse`` lists the analyses of each finished recording in that folder: "fit", "diagnose", both or none.
    """

    name: Annotated[str, Field(min_length=1)] = "lab"
    folder: str = "."
    record: bool = True
    roll: Annotated[float, Field(ge=MIN_ROLL, allow_inf_nan=False)] = 600.0
    analyse: tuple[str, ...] = ("fit", "diagnose")


class Policy(Section):
    """``[policies.KIND]``: how recordings of a kind of rig are analysed; defaults are those of the kind.

    ``analyse``: any of "fit", "diagnose", "verify", in the order in which they run; by default that of
    ``[lab]``. ``terms``: the terms of the fitted model. ``baseline``: the known terms of a diagnosis.
    ``model``: the accepted model, the JSON of a fit or a diagnosis, which a diagnosis compares with and
    "verify" checks. ``estimator``: that of a fit. ``seconds``: how long an analysis may take, s, before it
    ends with the best result so far.
    """

    analyse: tuple[str, ...] | None = None
    terms: tuple[str, ...] | None = None
    baseline: tuple[str, ...] | None = None
    model: str | None = None
    estimator: str | None = None
    seconds: Annotated[float, Field(gt=0, allow_inf_nan=False)] | None = None


class Lab(WithDevices):
    """The contents of a lab file; without ``[devices]`` a lab only analyses the recordings in its folder."""

    lab: LabSection = LabSection()
    devices: dict[str, DeviceSection] = Field(default_factory=dict)
    policies: dict[str, Policy] = Field(default_factory=dict)


ANALYSES = ("fit", "diagnose")
POLICY_ANALYSES = (*ANALYSES, "verify")


def load_lab(path: Path) -> Lab:
    """Read a lab file.

    Raises:
        ExperimentFileError: The message gives the file, the field and what was expected.
    """
    try:
        text = read_document(path)
    except (OSError, DocumentError) as error:
        reason = reason_unreadable(path, error, LAB)
        raise ExperimentFileError(f"{path}: cannot be read as a lab file (TOML): {reason}") from error
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

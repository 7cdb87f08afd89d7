"""The file of a lab (TOML): devices that stay up, and how what they say is recorded."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

from pydantic import BaseModel, ConfigDict, Field

from labhil.documents import DocumentError, read_document
from labhil.errors import ExperimentFileError
from labhil.experiment.experiment import DeviceSection, WithDevices, parse_devices

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


class Lab(WithDevices):
    """A whole lab file; without ``[devices]`` a lab only analyses what others record in its folder."""

    lab: LabSection = LabSection()
    devices: dict[str, DeviceSection] = Field(default_factory=dict)


ANALYSES = ("fit", "diagnose")


def load_lab(path: Path) -> Lab:
    """Read a lab file; ExperimentFileError names the file, the field and what was expected."""
    try:
        text = read_document(path)
    except (OSError, DocumentError) as error:
        raise ExperimentFileError(f"{path}: cannot be read as a lab file (TOML): {error}") from error
    lab = parse_devices(text, path, Lab)
    for name in lab.lab.analyse:
        if name not in ANALYSES:
            raise ExperimentFileError(
                f"{path}: lab.analyse: expected {' or '.join(ANALYSES)}, found {name!r}"
            )
    return lab

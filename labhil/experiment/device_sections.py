"""The sections of a file with ``[devices]``, which an experiment file and a lab file have in common."""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Annotated, Any, Literal, TypeVar

from pydantic import BaseModel, ConfigDict, Field, ValidationError, field_validator

from labhil.documents import DocumentError, parse_toml
from labhil.errors import ExperimentFileError
from labhil.rig import RigFile, default_rig, is_simulator, load_rig
from labhil.unreadable import RIG, nearest_file
from labhil.validation_errors import format_validation_error

Positive = Annotated[float, Field(gt=0, allow_inf_nan=False)]
Finite = Annotated[float, Field(allow_inf_nan=False)]
Natural = Annotated[int, Field(ge=0)]

DEVICE_NAME = re.compile(r"[A-Za-z][A-Za-z0-9_-]*\Z")
RESERVED_NAMES = ("run", "recorder")
"""Names that a recording uses for itself, so that no device may have them."""


class Section(BaseModel):
    """A section of a file; unknown keys are refused."""

    model_config = ConfigDict(extra="forbid", frozen=True)


class TwinSection(Section):
    """``twin = { … }``: the model of the simulated device. A recording never contains it.

    ``terms`` are its effects, by default those of the twin; ``set`` overrides single values (SI); ``speed``
    is its simulated time per real time; ``tables`` are files with measured maps. ``host`` is the address of
    this machine for a networked twin, ``series`` the generation of its controller.
    """

    speed: Positive = 1.0
    seed: Natural = 0
    terms: tuple[str, ...] | None = None
    set: dict[str, Finite] = {}
    tables: dict[str, str] = {}
    wire: Literal["pty", "tcp"] = "pty"
    host: str | None = None
    series: str | None = None

    @field_validator("set", mode="before")
    @classmethod
    def _flatten_set(cls, value: object) -> object:
        return dict(_flatten(value)) if isinstance(value, Mapping) else value


class DeviceSection(Section):
    """``[devices.NAME]``: a driver plugin, the address of its device, and its rig file.

    ``reconnect`` lets a run wait for a device that was lost or booted again, and resume when it is back.
    """

    plugin: str
    address: Annotated[str, Field(min_length=1)]
    rig: str | None = None
    reconnect: bool = False
    twin: TwinSection = TwinSection()


class WithDevices(Section):
    """A file with ``[devices]``; its relative paths begin in the directory of ``path``."""

    devices: dict[str, DeviceSection]
    path: Path = Field(default=Path("experiment.toml"), exclude=True)

    @field_validator("devices")
    @classmethod
    def _check_device_names(cls, value: dict[str, DeviceSection]) -> dict[str, DeviceSection]:
        for name in value:
            if not DEVICE_NAME.match(name) or name in RESERVED_NAMES:
                raise ValueError(
                    f"device name {name!r}: letters, digits, - and _, starting with a letter, "
                    f"and none of {', '.join(RESERVED_NAMES)}"
                )
        return value

    def rig_of(self, device: str, kind: str) -> RigFile:
        """Return the rig file of a device, or an empty one of its kind where it has none.

        Args:
            device: Name of the device.
            kind: Kind of rig that its driver drives.

        Raises:
            RigFileError: The rig file is wrong.
            ExperimentFileError: The rig file does not exist or is of another kind.
        """
        name = self.devices[device].rig
        if name is None:
            return default_rig(kind)
        file = self.path.parent / name
        if not is_simulator(str(file)) and not file.is_file():
            actual = "something else" if file.exists() else f"none{nearest_file(file, RIG)}"
            raise ExperimentFileError(
                f"{self.path}: devices.{device}.rig: expected the rig file {file}, found {actual}"
            )
        rig = load_rig(file)
        if rig.kind.name != kind:
            raise ExperimentFileError(
                f"{self.path}: devices.{device}.rig: {name} is of kind {rig.kind.name!r}, "
                f"but plugin {self.devices[device].plugin!r} drives {kind!r}"
            )
        return rig


FileModel = TypeVar("FileModel", bound=WithDevices)


def parse_devices(text: str, path: Path, form: type[FileModel]) -> FileModel:
    """Read the text of a file with ``[devices]`` as the model ``form``; see :func:`parse_experiment`."""
    try:
        data = parse_toml(text)
    except DocumentError as error:
        raise ExperimentFileError(f"{path}: not TOML: {error}") from error
    if "path" in data:
        raise ExperimentFileError(f"{path}: path: unknown key; did you mean record.path?")
    try:
        return form.model_validate({**data, "path": path})
    except ValidationError as error:
        raise ExperimentFileError(format_validation_error(error, path, form)) from error


def _flatten(value: Mapping[str, Any], prefix: str = "") -> Iterator[tuple[str, Any]]:
    for key, inner in value.items():
        if isinstance(inner, Mapping):
            yield from _flatten(inner, f"{prefix}{key}.")
        else:
            yield f"{prefix}{key}", inner

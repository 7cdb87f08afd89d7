"""A first rig file and experiment file for a device, from the examples that come with labhil."""

from __future__ import annotations

import json
from collections.abc import Iterator
from importlib.resources import files
from pathlib import Path

from labhil.atomic_file import write_error
from labhil.errors import UnknownNameError, UsageError
from labhil.experiment.experiment import TWIN, load_experiment
from labhil.experiment.plan import make_plan

EXAMPLES = files("labhil.experiment") / "examples"


def example_drivers() -> tuple[str, ...]:
    """Return the names of the drivers that have an example, sorted."""
    names = (entry.name for entry in EXAMPLES.iterdir())
    return tuple(sorted(name.removesuffix("_identify.toml") for name in names if "_identify.toml" in name))


def check_kind(kind: str) -> None:
    """Raise UnknownNameError where there is no example for a driver."""
    if kind not in example_drivers():
        raise UnknownNameError("driver", kind, example_drivers())


def files_of(kind: str, folder: Path) -> tuple[Path, Path]:
    """Return the paths of a driver's rig file and experiment file in a folder, whether they exist or not."""
    return folder / f"{kind}.toml", folder / f"{kind}_identify.toml"


def write_new(kind: str, address: str, folder: Path) -> tuple[Path, Path]:
    """Write ``KIND.toml`` (the rig) and ``KIND_identify.toml`` (the experiment) into a folder.

    For a real device the known values of the simulated one are commented out.

    Args:
        kind: Name of the driver.
        address: Address of the device, or "twin".
        folder: Where the files go; it is made if need be.

    Returns:
        The paths of the rig file and the experiment file.

    Raises:
        UnknownNameError: There is no example for this driver.
        UsageError: A file exists already, or the folder cannot be written to.
    """
    check_kind(kind)
    if not address.strip() or any(character.isspace() for character in address.strip()):
        raise UsageError(f'address: expected "twin", a serial port or an address, found {address!r}')
    rig, experiment = files_of(kind, folder)
    for path in (rig, experiment):
        if path.exists():
            raise UsageError(f"{path}: is there already and stays as it is; choose another folder with --out")
    try:
        folder.mkdir(parents=True, exist_ok=True)
        rig.write_text(_rig_text(kind, address), encoding="utf-8")
        experiment.write_text(_experiment_text(kind, address), encoding="utf-8")
    except OSError as error:
        raise write_error(Path(str(error.filename or folder)), error) from error
    make_plan(load_experiment(experiment))
    return rig, experiment


def _rig_text(kind: str, address: str) -> str:
    text = (EXAMPLES / f"{kind}.toml").read_text(encoding="utf-8")
    return text if address == TWIN else "\n".join(_comment_out_known(text.splitlines())) + "\n"


def _comment_out_known(lines: list[str]) -> Iterator[str]:
    """Comment out the known values of the simulated device: a real one has others."""
    section = ""
    for number, line in enumerate(lines):
        if line.startswith("["):
            section = line
        if number == 0 and line.startswith("#"):
            yield "# A first rig file: state what you know of your device, and look at the limits."
        elif section == "[known]" and line.strip() and line[0] not in "[#":
            yield f"# {line}"
        else:
            yield line


def _experiment_text(kind: str, address: str) -> str:
    text = (EXAMPLES / f"{kind}_identify.toml").read_text(encoding="utf-8")
    if address == TWIN:
        return text
    lines = []
    for line in text.splitlines():
        if line.startswith("address ="):
            lines.append(f"address = {json.dumps(address)}")
        elif line.startswith("twin ="):
            lines.append(f"# {line}")
        else:
            lines.append(line)
    return "\n".join(lines) + "\n"

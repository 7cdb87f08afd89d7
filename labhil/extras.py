"""Packages that an installation may lack: which extra brings each, and the one message where one is missing.

Extras are installed by wing: a rack PC that records needs no compiler, a laptop no robot's client library.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from importlib import import_module
from importlib.util import find_spec
from typing import Any

from labhil.errors import MissingExtraError


@dataclass(frozen=True, slots=True)
class Package:
    """An optional package: its name for pip, the extra that brings it, and what else one has to know."""

    name: str
    extra: str
    note: str = ""


UR_RTDE = Package(
    "ur_rtde",
    "ur5",
    "it has wheels for Linux on x86-64 and Python up to 3.12; elsewhere it is built from source, see"
    " https://sdurobotics.gitlab.io/ur_rtde/installation/installation.html",
)

PACKAGES: Mapping[str, Package] = {
    "zenoh": Package("eclipse-zenoh", "acquisition"),
    "serial": Package("pyserial", "acquisition"),
    "cobs": Package("cobs", "acquisition"),
    "numba": Package("numba", "analysis"),
    "scipy": Package("scipy", "analysis"),
    "matplotlib": Package("matplotlib", "plots"),
    "textual": Package("textual", "tui"),
    "textual_serve": Package("textual-serve", "web"),
    "aiohttp": Package("aiohttp", "web"),
    "rtde_control": UR_RTDE,
    "rtde_io": UR_RTDE,
    "mujoco": Package("mujoco", "arm"),
    "fmpy": Package("fmpy", "fmu"),
    "cma": Package("cma", "search"),
    "emcee": Package("emcee", "search"),
    "cryptography": Package("cryptography", "security"),
    "skfem": Package("scikit-fem", "field"),
    "h5py": Package("h5py", "formats"),
    "openpyxl": Package("openpyxl", "formats"),
    "pyarrow": Package("pyarrow", "formats"),
    "rosbags": Package("rosbags", "formats"),
    "pandas": Package("pandas", "frames"),
    "xarray": Package("xarray", "frames"),
    "pytest": Package("pytest", "test"),
}
"""By the name under which it is imported."""


def load_optional(module: str, purpose: str) -> Any:
    """Import a module of an optional package.

    Args:
        module: Its name, "pyarrow.parquet".
        purpose: What needs it, as the beginning of a sentence: "a Parquet file".

    Raises:
        MissingExtraError: The package is not installed.
    """
    try:
        return import_module(module)
    except ModuleNotFoundError as error:
        raise missing_extra(error, purpose) or error from error


def require(module: str, purpose: str) -> None:
    """MissingExtraError where the package is not installed; nothing is imported."""
    if not is_installed(module):
        raise _missing(PACKAGES[module.partition(".")[0]], purpose)


def require_analysis(purpose: str) -> None:
    """MissingExtraError where a package of the analysis wing is not installed; nothing is imported."""
    for module in ("numba", "scipy"):
        require(module, purpose)


def is_installed(module: str) -> bool:
    """Whether the package of a module is there; nothing is imported."""
    return find_spec(module.partition(".")[0]) is not None


def missing_extra(error: ModuleNotFoundError, purpose: str) -> MissingExtraError | None:
    """The error for a module that is not installed; None where no extra would bring it."""
    root = (error.name or "").partition(".")[0]
    return _missing(PACKAGES[root], purpose) if root in PACKAGES else None


def _missing(package: Package, purpose: str) -> MissingExtraError:
    return MissingExtraError(package.name, package.extra, purpose, package.note)

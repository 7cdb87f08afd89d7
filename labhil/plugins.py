"""Drivers, twins and terms are found by entry points; names are listed without importing any of them."""

from __future__ import annotations

from functools import cache
from importlib.metadata import EntryPoint, entry_points
from importlib.util import find_spec
from pathlib import Path
from typing import cast

from labhil.driver import AddressFinder, Driver, FoundAddress, Twin
from labhil.errors import OptionError, UnknownNameError, UsageError
from labhil.extras import missing_extra

DRIVERS = "labhil.drivers"
TWINS = "labhil.twins"
TERMS = "labhil.terms"


def names(group: str) -> tuple[str, ...]:
    """Names registered under an entry-point group, sorted; nothing is imported."""
    return tuple(sorted({point.name for point in entry_points(group=group)}))


def load_driver(name: str) -> type[Driver]:
    """Import the driver plugin ``name``; UnknownNameError names those that are installed."""
    return cast("type[Driver]", _load(DRIVERS, name, "driver plugin"))


def find_addresses(name: str, search: str | None = None) -> tuple[FoundAddress, ...]:
    """Ask the driver plugin ``name`` for addresses of its devices; nothing where it finds none by itself.

    Args:
        name: Name of the driver.
        search: A network to look through, such as "192.168.1.0/24".

    Raises:
        UnknownNameError: There is no such driver.
        OptionError: The driver cannot search that network, or none at all.
    """
    driver = load_driver(name)
    if isinstance(driver, AddressFinder):
        return driver.find_addresses(search)
    if search is not None:
        raise OptionError("search", f": expected a driver that searches a network, found {name!r}")
    return ()


def load_twin(name: str) -> Twin:
    """Import the twin plugin ``name``; UnknownNameError names those that are installed."""
    return cast(Twin, _load(TWINS, name, "twin"))


@cache
def installed_terms() -> tuple[tuple[str, object], ...]:
    """What packages provide as terms, each with the package and the name by which it does, sorted.

    Imported once in a process. UsageError names the one that cannot be.
    """
    points = sorted(entry_points(group=TERMS), key=_place)
    return tuple((_place(point), _imported(point, "term")) for point in points)


def _place(point: EntryPoint) -> str:
    package = "" if point.dist is None else point.dist.name
    return f"{package}:{point.name}"


def firmware_folder(driver: str) -> Path | None:
    """Folder with the firmware that the package of a driver plugin brings (``firmware/Makefile``), if any.

    Nothing is imported. UnknownNameError names the drivers that are installed.
    """
    package = _find(DRIVERS, driver, "driver plugin").module.partition(".")[0]
    spec = find_spec(package)
    places = [] if spec is None else spec.submodule_search_locations or []
    folders = [Path(place) / "firmware" for place in places]
    return next((folder for folder in folders if (folder / "Makefile").is_file()), None)


def _load(group: str, name: str, what: str) -> object:
    return _imported(_find(group, name, what), what)


def _imported(point: EntryPoint, what: str) -> object:
    name = point.name
    try:
        return point.load()
    except (ImportError, AttributeError) as error:
        missing = missing_extra(error, f"{what} {name!r}") if isinstance(error, ModuleNotFoundError) else None
        if missing is not None:
            raise missing from error
        raise UsageError(f"{what} {name!r} ({point.value}) could not be imported: {error}") from error


def _find(group: str, name: str, what: str) -> EntryPoint:
    for point in entry_points(group=group):
        if point.name == name:
            return point
    raise UnknownNameError(what, name, names(group))

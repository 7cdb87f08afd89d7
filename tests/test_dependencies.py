"""What is declared, what is locked for development, and what the bill of materials says."""

from __future__ import annotations

import importlib.util
import json
import tomllib
from pathlib import Path
from types import ModuleType

import pytest

from labhil.doctor.packages import _BOUND, _meets

ROOT = Path(__file__).parents[1]
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
BOUNDED = {"eclipse-zenoh": "<2", "numpy": "<3", "pydantic": "<3", "textual": "<9"}


@pytest.fixture(scope="module")
def maker() -> ModuleType:
    """Return the script that makes the bill of materials."""
    spec = importlib.util.spec_from_file_location("make_sbom", ROOT / "requirements" / "make_sbom.py")
    assert spec is not None and spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def test_every_package_is_locked_to_a_version_within_its_bounds(maker: ModuleType) -> None:
    locked = maker.locked()
    everything = {
        extra: PROJECT["optional-dependencies"][extra] for extra in PROJECT["optional-dependencies"]
    }
    requirements = [*PROJECT["dependencies"], *(one for extra in everything.values() for one in extra)]
    outside = []
    for requirement in requirements:
        name = maker.NAME.match(requirement).group()
        if name == "labhil":
            continue
        version = locked.get(maker.plain(name))
        bounds = _BOUND.findall(requirement.split(";")[0])
        if version is None or not all(_meets(version, sign, bound) for sign, bound in bounds):
            outside.append(f"{requirement}: locked {version}")
    assert outside == []


def test_an_upper_bound_stands_where_a_major_version_broke_something(maker: ModuleType) -> None:
    bounds = {name: stated for name, (stated, _) in maker.needed(PROJECT).items() if "<" in stated}
    assert set(bounds) == set(BOUNDED)
    assert all(bounds[name].endswith(f",{upper}") for name, upper in BOUNDED.items())


def test_the_bill_of_materials_names_what_is_declared(maker: ModuleType) -> None:
    told = json.loads((ROOT / "labhil" / "sbom.cdx.json").read_text(encoding="utf-8"))
    assert (told["bomFormat"], told["metadata"]["component"]["version"]) == ("CycloneDX", PROJECT["version"])
    found = {
        one["name"]: (one["version"], one["scope"] == "required", one["properties"][0]["value"])
        for one in told["components"]
    }
    locked = maker.locked()
    meant = {name: (locked[name], always, bounds) for name, (bounds, always) in maker.needed(PROJECT).items()}
    assert found == meant
    assert told["dependencies"][0]["dependsOn"] == [one["bom-ref"] for one in told["components"]]

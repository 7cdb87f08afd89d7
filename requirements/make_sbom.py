"""What a wheel needs, as CycloneDX: ``python requirements/make_sbom.py`` writes ``labhil/sbom.cdx.json``.

Licences are what the installed packages say of themselves, versions those of ``development.txt``.
"""

from __future__ import annotations

import json
import re
import tomllib
from importlib.metadata import PackageNotFoundError, metadata
from pathlib import Path
from typing import Any

ROOT = Path(__file__).parents[1]
OUT = ROOT / "labhil" / "sbom.cdx.json"
NAME = re.compile(r"[A-Za-z0-9._-]+")
FOR_DEVELOPMENT = ("test", "docs", "all")
"""Extras that nobody needs who uses labhil, and the sum of the others."""


def plain(name: str) -> str:
    """A package's name as the index compares it."""
    return re.sub(r"[-_.]+", "-", name).lower()


def locked() -> dict[str, str]:
    """The versions of ``development.txt``, by plain name."""
    lines = (ROOT / "requirements" / "development.txt").read_text(encoding="utf-8").splitlines()
    pairs = [line.split("==") for line in lines if "==" in line and not line.startswith("#")]
    return {plain(name): version for name, version in pairs}


def needed(project: dict[str, Any]) -> dict[str, tuple[str, bool]]:
    """What is declared: the bounds of each package, and whether every installation needs it."""
    found: dict[str, tuple[str, bool]] = {}
    extras = {
        requirement
        for extra, requirements in project["optional-dependencies"].items()
        for requirement in requirements
        if extra not in FOR_DEVELOPMENT
    }
    for requirement in [*project["dependencies"], *sorted(extras)]:
        name = NAME.match(requirement)
        assert name is not None, requirement
        always = requirement in project["dependencies"]
        bounds = requirement[name.end() :].split(";")[0].strip()
        found.setdefault(plain(name.group()), (bounds, always))
    return found


def sbom() -> dict[str, Any]:
    """The whole document."""
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    versions, packages = locked(), needed(project)
    root = f"pkg:pypi/labhil@{project['version']}"
    components = [
        component(name, versions[name], bounds, always=always)
        for name, (bounds, always) in sorted(packages.items())
    ]
    return {
        "bomFormat": "CycloneDX",
        "specVersion": "1.5",
        "version": 1,
        "metadata": {
            "component": {
                "type": "application",
                "bom-ref": root,
                "name": "labhil",
                "version": project["version"],
                "purl": root,
                "licenses": [{"license": {"id": project["license"]}}],
            }
        },
        "components": components,
        "dependencies": [{"ref": root, "dependsOn": [one["bom-ref"] for one in components]}],
    }


def component(name: str, version: str, bounds: str, *, always: bool) -> dict[str, Any]:
    """One package."""
    purl = f"pkg:pypi/{name}@{version}"
    stated = licence_of(name)
    return {
        "type": "library",
        "bom-ref": purl,
        "name": name,
        "version": version,
        "purl": purl,
        "scope": "required" if always else "optional",
        "licenses": [{"license": {"name": stated}}] if stated else [],
        "properties": [{"name": "labhil:bounds", "value": bounds}],
    }


def licence_of(name: str) -> str:
    """What a package says of its licence, in a few words; empty where it says nothing."""
    try:
        said = metadata(name)
    except PackageNotFoundError:
        return ""
    stated = [said[key] for key in ("License-Expression", "License") if said.get(key)]
    classified = [
        line.split(" :: ")[-1]
        for line in said.get_all("Classifier") or []
        if line.startswith("License :: ") and line != "License :: OSI Approved"
    ]
    return next((text.strip() for text in [*stated, *classified] if len(text) < 100), "")


if __name__ == "__main__":
    OUT.write_text(json.dumps(sbom(), indent=1) + "\n", encoding="utf-8")

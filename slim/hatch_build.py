"""How labhil-slim is built: labhil's code and metadata, without what extras of wings name."""

from __future__ import annotations

import tomllib
from pathlib import Path
from typing import Any

from hatchling.builders.hooks.plugin.interface import BuildHookInterface
from hatchling.metadata.plugin.interface import MetadataHookInterface

WINGS = ("acquisition", "analysis", "plots", "tui")
SAME = (
    "authors",
    "classifiers",
    "entry-points",
    "keywords",
    "license",
    "requires-python",
    "scripts",
    "version",
)


def metadata_of(labhil: dict[str, Any]) -> dict[str, Any]:
    """The fields of a ``[project]`` table, from labhil's."""
    extras: dict[str, list[str]] = labhil["optional-dependencies"]
    of_wings = {requirement for wing in WINGS for requirement in extras[wing]}
    named = {
        extra: [requirement.replace("labhil[", "labhil-slim[") for requirement in requirements]
        for extra, requirements in extras.items()
    }
    return {
        **{field: labhil[field] for field in SAME},
        "description": f"{labhil['description']} Without the packages of the wings that you do not use.",
        "dependencies": [each for each in labhil["dependencies"] if each not in of_wings],
        "optional-dependencies": named,
    }


def project_of(folder: str) -> dict[str, Any]:
    """labhil's pyproject.toml, beside the folder of this one."""
    return tomllib.loads((Path(folder).parent / "pyproject.toml").read_text(encoding="utf-8"))


class Metadata(MetadataHookInterface):
    """Fills in what the pyproject.toml beside this file calls dynamic."""

    def update(self, metadata: dict[str, Any]) -> None:
        """Called by hatchling."""
        metadata.update(metadata_of(project_of(self.root)["project"]))
        text = (Path(self.root) / "README.md").read_text(encoding="utf-8")
        metadata["readme"] = {"content-type": "text/markdown", "text": text}


class Build(BuildHookInterface[Any]):
    """Takes labhil's packages into the wheel."""

    def initialize(self, version: str, build_data: dict[str, Any]) -> None:
        """Called by hatchling."""
        packages = project_of(self.root)["tool"]["hatch"]["build"]["targets"]["wheel"]["packages"]
        for package in packages:
            place = Path(self.root).parent / package
            build_data["force_include"][str(place)] = place.name
        build_data["force_include"][str(Path(self.root).parent / "LICENSE")] = "labhil/LICENSE"

"""The runs that an experiment file with ``repeat`` or ``[sweep]`` stands for."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Iterator, Mapping
from copy import deepcopy
from dataclasses import dataclass
from typing import Any

from pydantic import ValidationError

from labhil.complaints import explain
from labhil.errors import ExperimentFileError
from labhil.experiment.experiment import Experiment
from labhil.experiment.sweep import MOST_RUNS, replace_value

FREE_TEXT = ("operator", "sample", "notes", "tags")
"""Keys of ``[experiment]`` that change nothing about the runs."""


@dataclass(frozen=True, slots=True)
class Point:
    """One run of a campaign: number ``number`` of ``of``, and repetition ``repetition`` of ``repeat``.

    ``settings`` are the swept values by place; ``experiment`` is the file of this run alone.
    """

    number: int
    of: int
    repetition: int
    repeat: int
    settings: Mapping[str, Any]
    experiment: Experiment

    def describe(self) -> str:
        """Return which run this is, for a person."""
        words = ", ".join(f"{place} = {json.dumps(value)}" for place, value in self.settings.items())
        again = f"repetition {self.repetition} of {self.repeat}" if self.repeat > 1 else ""
        return ", ".join(part for part in (f"run {self.number} of {self.of}", words, again) if part)

    def public_settings(self) -> dict[str, str]:
        """Return the settings as a recording may hold them: nothing of what a twin is made of."""
        return {place: json.dumps(value) for place, value in self.settings.items() if not _is_of_twin(place)}


def is_campaign(experiment: Experiment) -> bool:
    """Whether the file stands for several recordings."""
    return experiment.sweep is not None or experiment.experiment.repeat > 1


def points_of(experiment: Experiment) -> tuple[Point, ...]:
    """Return the runs in their order, each repetition after the other.

    Raises ExperimentFileError for a place that is not in the file, a value that does not belong there, or
    too many runs.
    """
    repeat = experiment.experiment.repeat
    combinations = [{}] if experiment.sweep is None else list(experiment.sweep.combinations())
    count = len(combinations) * repeat
    if count > MOST_RUNS:
        raise ExperimentFileError(
            f"{experiment.path}: expected at most {MOST_RUNS} runs, found {len(combinations)} combinations, "
            f"each repeated {repeat} times"
        )
    return tuple(_number_points(experiment, combinations, repeat, count))


def _number_points(
    experiment: Experiment, combinations: list[dict[str, Any]], repeat: int, count: int
) -> Iterator[Point]:
    data = experiment.model_dump(mode="json", exclude_none=True, exclude={"sweep"})
    number = 0
    for settings in combinations:
        variant = _with_settings(experiment, data, settings)
        for repetition in range(1, repeat + 1):
            number += 1
            yield Point(number, count, repetition, repeat, settings, variant)


def _with_settings(
    experiment: Experiment, data: Mapping[str, Any], settings: Mapping[str, Any]
) -> Experiment:
    changed = deepcopy(dict(data))
    changed["experiment"]["repeat"] = 1  # a recording holds the file of its own run
    for place, value in settings.items():
        try:
            replace_value(changed, place, value)
        except ValueError as error:
            raise ExperimentFileError(f"{experiment.path}: sweep.over: {error}") from error
    try:
        return Experiment.model_validate({**changed, "path": experiment.path})
    except ValidationError as error:
        what = ", ".join(f"{place} = {json.dumps(value)}" for place, value in settings.items())
        raise ExperimentFileError(f"with {what}: {explain(error, experiment.path, Experiment)}") from error


def _is_of_twin(place: str) -> bool:
    parts = place.split(".")
    return parts[0] == "devices" and parts[2:3] == ["twin"]


def fingerprint(experiment: Experiment, points: tuple[Point, ...]) -> str:
    """Return the SHA-256 of what the runs are: the file without its free text, and its rig files."""
    digest = hashlib.sha256()
    for point in points:
        data = point.experiment.model_dump(mode="json", exclude_none=True)
        for name in FREE_TEXT:
            data["experiment"].pop(name, None)
        digest.update(json.dumps([point.repetition, data], sort_keys=True).encode())
    rigs = {device.rig for point in points for device in point.experiment.devices.values()}
    for rig in sorted(name for name in rigs if name is not None):
        try:
            digest.update((experiment.path.parent / rig).read_bytes())
        except OSError as error:
            raise ExperimentFileError(
                f"{experiment.path}: rig {rig!r} cannot be read: {error.strerror}"
            ) from error
    return digest.hexdigest()

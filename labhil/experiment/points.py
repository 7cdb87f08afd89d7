"""The runs of a campaign: an experiment file with ``repeat`` or ``[sweep]``, expanded."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Iterator, Mapping
from copy import deepcopy
from dataclasses import dataclass
from typing import Any

from pydantic import ValidationError

from labhil.errors import ExperimentFileError
from labhil.experiment.experiment import Experiment
from labhil.experiment.sweep import MAX_RUNS, replace_value
from labhil.validation_errors import format_validation_error

FREE_TEXT = ("operator", "sample", "notes", "tags")
"""Keys of ``[experiment]`` that do not change the runs."""


@dataclass(frozen=True, slots=True)
class Point:
    """One run of a campaign.

    Attributes:
        number: Its number, from 1.
        of: How many runs there are.
        repetition: Which repetition of its settings it is, from 1.
        repeat: How many repetitions there are.
        settings: The swept values, by place.
        experiment: The experiment of this run alone.
    """

    number: int
    of: int
    repetition: int
    repeat: int
    settings: Mapping[str, Any]
    experiment: Experiment

    def describe(self) -> str:
        """Describe the run in one line for a person."""
        repetition = f"repetition {self.repetition} of {self.repeat}" if self.repeat > 1 else ""
        parts = (f"run {self.number} of {self.of}", _format_settings(self.settings), repetition)
        return ", ".join(part for part in parts if part)

    def public_settings(self) -> dict[str, str]:
        """Return the settings that a recording may hold, as JSON: without those of a simulated device."""
        return {place: json.dumps(value) for place, value in self.settings.items() if not _is_of_twin(place)}


def is_campaign(experiment: Experiment) -> bool:
    """Return whether the file describes several runs."""
    return experiment.sweep is not None or experiment.experiment.repeat > 1


def count_runs(experiment: Experiment) -> int:
    """Return the number of runs that the file describes; unlike ``points_of`` it checks none of them."""
    combinations = 1 if experiment.sweep is None else experiment.sweep.count
    return combinations * experiment.experiment.repeat


def points_of(experiment: Experiment) -> tuple[Point, ...]:
    """Return the runs in their order, the repetitions of each after one another.

    Raises:
        ExperimentFileError: A swept place is not in the file, a value does not belong there, or there are too
            many runs.
    """
    repeat = experiment.experiment.repeat
    combinations = [{}] if experiment.sweep is None else list(experiment.sweep.combinations())
    count = len(combinations) * repeat
    if count > MAX_RUNS:
        raise ExperimentFileError(
            f"{experiment.path}: expected at most {MAX_RUNS} runs, found {len(combinations)} combinations, "
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
        explanation = format_validation_error(error, experiment.path, Experiment)
        raise ExperimentFileError(f"with {_format_settings(settings)}: {explanation}") from error


def _format_settings(settings: Mapping[str, Any]) -> str:
    return ", ".join(f"{place} = {json.dumps(value)}" for place, value in settings.items())


def _is_of_twin(place: str) -> bool:
    parts = place.split(".")
    return parts[0] == "devices" and parts[2:3] == ["twin"]


def fingerprint(experiment: Experiment, points: tuple[Point, ...]) -> str:
    """Return the SHA-256 of what defines the runs: the file without its free text, and its rig files.

    Raises:
        ExperimentFileError: A rig file cannot be read.
    """
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

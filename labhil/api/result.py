"""The base of all results: they are printed, compared, saved and immutable."""

from __future__ import annotations

import copy
from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING, Any, Generic, Protocol, Self, TypeVar

from labhil.api.inputs import PathLike, path_of, rig_file
from labhil.api.render import WIDTH, data_frame, data_set, html_of, text_of
from labhil.atomic_file import write_json_file
from labhil.errors import ModelFileError, UsageError
from labhil.extras import require_analysis

if TYPE_CHECKING:
    from rich.console import Console, RenderableType

    from labhil.analysis.dataset import Dataset
    from labhil.analysis.patch import Patch
    from labhil.analysis.saved_model import SavedModel
    from labhil.analysis.schema import Parameters, Source
    from labhil.api.model import Model
    from labhil.recording.recording import Recording as FileRecording
    from labhil.rig import RigFile


class Result(ABC):
    """A result with its JSON. ``print`` shows the report of the command line; notebooks show it in colour."""

    def __init__(self, data: Mapping[str, Any], name: str) -> None:
        self._data, self._name = data, name

    @abstractmethod
    def _renderables(self) -> Sequence[RenderableType]:
        """Return the parts of the report."""

    @property
    @abstractmethod
    def recordings(self) -> tuple[Source, ...]:
        """The recordings of the result: ``path``, ``sha256``, ``samples``, ``duration`` (s) of each."""

    def to_dict(self) -> dict[str, Any]:
        """Return the complete result as plain data, as it is saved."""
        return copy.deepcopy(dict(self._data))

    @property
    def as_reference(self) -> SavedModel:
        """Its data under its name, in the place of a file of the result."""
        require_analysis("a model")
        from labhil.analysis.saved_model import SavedModel

        return SavedModel(self._name, self._data)

    @classmethod
    def load(cls, path: PathLike) -> Self:
        """Read a saved result of this kind; :func:`labhil.load` reads every kind.

        Args:
            path: The JSON file.

        Returns:
            The result.

        Raises:
            ModelFileError: The file cannot be read, or holds another kind of result.
        """
        from labhil.api.saved import load

        result = load(path)
        if not isinstance(result, cls):
            raise ModelFileError(f"{path}: expected a {cls.__name__}, found a {type(result).__name__}")
        return result

    def save(self, path: PathLike) -> Path:
        """Write the complete result as JSON, as ``--json`` does; :func:`labhil.load` reads it.

        Args:
            path: The file; an existing one is replaced.

        Returns:
            The path.

        Raises:
            UsageError: It cannot be written there.
        """
        file = path_of(path, "path")
        if not file.parent.is_dir():
            raise UsageError(f"{file}: expected a folder {file.parent} to write into, found none")
        write_json_file(dict(self._data), file)
        return file

    def report(self, path: PathLike) -> Path:
        """Write an HTML page about the result, in a single file.

        Args:
            path: The file to write.

        Returns:
            The path.

        Raises:
            UsageError: It cannot be written there.
        """
        file = path_of(path, "path")
        self._write_page(file)
        return file

    @abstractmethod
    def _write_page(self, file: Path) -> None:
        """Write the HTML page."""

    def text(self, width: int = WIDTH) -> str:
        """Return the report as text.

        Args:
            width: Characters of a line.
        """
        return text_of([*self._early_note(), *self._renderables()], width)

    def show(self, console: Console) -> None:
        """Print the report on a console of rich."""
        for renderable in self._renderables():
            console.print(renderable)

    def __str__(self) -> str:
        return self.text()

    def _repr_html_(self) -> str:
        return html_of([*self._early_note(), *self._renderables()])

    def _early_note(self) -> list[str]:
        """First line of the report of a result that was ended early."""
        if self._data.get("complete", True):
            return []
        return ["ENDED EARLY: the best so far; more time may change it."]

    def __eq__(self, other: object) -> bool:
        return isinstance(other, type(self)) and self._data == other._data

    def __hash__(self) -> int:
        return hash((type(self).__name__, *(source.sha256 for source in self.recordings)))

    def __reduce__(self) -> tuple[Any, ...]:
        return _restore, (type(self), self._data, self._name)


class ComputedPart(Protocol):
    """The JSON of a computed result as typed data."""

    @property
    def recordings(self) -> tuple[Source, ...]:
        """The recordings of the result."""

    @property
    def complete(self) -> bool:
        """Whether it was not ended early."""


class ComputedStudy(Protocol):
    """What the samples of all computed results have."""

    @property
    def dataset(self) -> Dataset:
        """The recordings."""


P = TypeVar("P", bound=ComputedPart)
S = TypeVar("S", bound=ComputedStudy)


class ComputedResult(Result, Generic[P, S]):
    """A result of a long computation, with its samples until it is saved or pickled."""

    def __init__(self, data: Mapping[str, Any], part: P, study: S | None, ended: str, name: str) -> None:
        super().__init__(data, name)
        self._part, self._study, self._ended = part, study, ended

    @property
    def part(self) -> P:
        """The JSON as typed data."""
        return self._part

    @property
    def recordings(self) -> tuple[Source, ...]:
        """The recordings of the result: ``path``, ``sha256``, ``samples``, ``duration`` (s) of each."""
        return self._part.recordings

    @property
    def complete(self) -> bool:
        """False where it was ended early, with the best result so far."""
        return self._part.complete

    @property
    def ended(self) -> str:
        """Why it was ended early; empty where it was not, or where the reason is unknown."""
        return self._ended

    @property
    def saved(self) -> SavedModel:
        """The (final) model, as the start of a fit or a reference."""
        return self.as_reference

    def patch(
        self,
        into: PathLike,
        out: PathLike,
        *,
        rig: PathLike | Model | RigFile | None = None,
        holdout: float = 0.3,
    ) -> Patch:
        """Write a repaired copy of the file that was fitted or diagnosed, like ``labhil patch``.

        MuJoCo, the FMU or Python runs the new file on the held-out data. Effects that the format cannot
        describe go into a Python file beside it.

        Args:
            into: The original MJCF, URDF, FMU or Python file (``bench.py:pendulum``).
            out: The new file; it must not exist.
            rig: The rig file, the simulator or the :func:`labhil.model` of the fit or diagnosis, where it had
                one.
            holdout: The share of the recordings that was held out.

        Returns:
            The changes (``changes``, ``diff``), the effects in the Python file (``left``, ``companion``), and
            the errors before and after; ``to_dict()`` is what ``--json`` writes.

        Raises:
            UsageError: The new file exists, the files do not belong together, a result that was loaded names
                a recording that is not there, or the repaired file's error is more than 1.05 times the
                model's. Nothing is written then.
        """
        require_analysis("a patch")
        from labhil.analysis.patching import patch

        with TemporaryDirectory() as folder:
            result = self.save(Path(folder) / "result.json")
            return patch(
                result,
                path_of(into, "into"),
                path_of(out, "out"),
                rig_file(rig),
                holdout=holdout,
                recordings=self._recordings_read(),
            )

    def _recordings_read(self) -> list[FileRecording]:
        """Return the recordings themselves; none where the result was loaded or pickled."""
        study = self._study
        return [] if study is None else [recording for recording, _, _ in study.dataset.recordings]

    @property
    def study(self) -> S:
        """The computation with its samples.

        Raises:
            UsageError: The result was loaded or pickled.
        """
        return self._require_study("study")

    def _require_study(self, action: str) -> S:
        if self._study is None:
            raise no_samples_error(action)
        return self._study


def _restore(kind: Any, data: Mapping[str, Any], name: str) -> Result:
    result: Result = kind(data, name=name)
    return result


def no_samples_error(action: str) -> UsageError:
    """Return the error of an action that needs samples, which a saved result does not have."""
    return UsageError(
        f"{action}: a result that was loaded or pickled holds no samples; `simulate(recording).plot()` draws "
        "its model beside a recording"
    )


def parameter_columns(parameters: Parameters) -> dict[str, list[Any]]:
    """Return parameters by columns, in the order of the report."""
    from labhil.report.parameter_columns import COLUMNS

    frames = [entry for column in COLUMNS for entry in column.frame]
    return {name: [value(row) for row in parameters] for name, value in frames}


def parameter_frame(parameters: Parameters) -> Any:
    """Return a pandas DataFrame with a row for each parameter."""
    return data_frame(parameter_columns(parameters), index=parameters.keys(), index_name="parameter")


def parameter_set(parameters: Parameters, covariance: Any, attributes: Mapping[str, Any]) -> Any:
    """Return an xarray Dataset over the parameters."""
    import numpy as np

    numbers = ("value", "std_error", "ci_low", "ci_high", "p_value")
    columns = parameter_columns(parameters)
    variables: dict[str, Any] = {
        name: (("parameter",), np.array(columns[name], dtype=np.float64), {}) for name in numbers
    }
    names = parameters.keys()
    coordinates: dict[str, Any] = {"parameter": names, "unit": ("parameter", columns["unit"])}
    if covariance is not None:
        variables["covariance"] = (("parameter", "parameter_"), covariance, {})
        coordinates["parameter_"] = names
    return data_set(variables, coordinates, attributes)

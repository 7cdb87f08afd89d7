"""What all results have in common: they print themselves, compare, are saved, and do not change."""

from __future__ import annotations

import copy
from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING, Any, Generic, Protocol, Self, TypeVar

from labhil.api.inputs import PathLike, path_of
from labhil.api.render import WIDTH, data_frame, data_set, html_of, text_of
from labhil.errors import ModelFileError, UsageError
from labhil.extras import require_analysis

if TYPE_CHECKING:
    from rich.console import Console, RenderableType

    from labhil.analysis.patch import Patch
    from labhil.analysis.saved_model import SavedModel
    from labhil.analysis.schema import Parameters, Source


class Result(ABC):
    """A result with its JSON. ``print`` shows the report of the command line, a notebook does in colours."""

    def __init__(self, data: Mapping[str, Any], name: str) -> None:
        self._data, self._name = data, name

    @abstractmethod
    def _renderables(self) -> Sequence[RenderableType]:
        """What is printed."""

    @property
    @abstractmethod
    def recordings(self) -> tuple[Source, ...]:
        """The recordings that it comes from: ``path``, ``sha256``, ``samples``, ``duration`` (s) of each."""

    def to_dict(self) -> dict[str, Any]:
        """The whole result as plain data, as it is saved."""
        return copy.deepcopy(dict(self._data))

    @property
    def as_reference(self) -> SavedModel:
        """Its data under its name, as what reads files of results takes them."""
        require_analysis("a model")
        from labhil.analysis.saved_model import SavedModel

        return SavedModel(self._name, self._data)

    @classmethod
    def load(cls, path: PathLike) -> Self:
        """Read a saved result of this kind; :func:`labhil.load` reads any.

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
        """Write the whole result as JSON, the same that ``--json`` writes; :func:`labhil.load` reads it.

        Args:
            path: The file; one that is there is replaced.

        Returns:
            The path.

        Raises:
            UsageError: It cannot be written there.
        """
        from labhil.analysis.results import write_json

        file = path_of(path, "path")
        if not file.parent.is_dir():
            raise UsageError(f"{file}: expected a folder {file.parent} to write into, found none")
        write_json(dict(self._data), file)
        return file

    def report(self, path: PathLike) -> Path:
        """Write one HTML page about it, complete in itself.

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
        """Write the page of :meth:`report`."""

    def text(self, width: int = WIDTH) -> str:
        """The report as text.

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
        """The first line of the report of a result that was ended early."""
        if self._data.get("complete", True):
            return []
        return ["ENDED EARLY: the best so far; more time may change it."]

    def __eq__(self, other: object) -> bool:
        return isinstance(other, type(self)) and self._data == other._data

    def __hash__(self) -> int:
        return hash((type(self).__name__, *(source.sha256 for source in self.recordings)))

    def __reduce__(self) -> tuple[Any, ...]:
        return _restored, (type(self), self._data, self._name)


class ComputedPart(Protocol):
    """What the JSON of a computed result says, with types."""

    @property
    def recordings(self) -> tuple[Source, ...]:
        """The recordings that it comes from."""

    @property
    def complete(self) -> bool:
        """False where it was ended early."""


P = TypeVar("P", bound=ComputedPart)
S = TypeVar("S")


class ComputedResult(Result, Generic[P, S]):
    """A result that long work has made, with that work's samples until it is saved or pickled."""

    def __init__(self, data: Mapping[str, Any], part: P, study: S | None, ended: str, name: str) -> None:
        super().__init__(data, name)
        self._part, self._study, self._ended = part, study, ended

    @property
    def part(self) -> P:
        """All that the JSON says, with types."""
        return self._part

    @property
    def recordings(self) -> tuple[Source, ...]:
        """The recordings that it comes from: ``path``, ``sha256``, ``samples``, ``duration`` (s) of each."""
        return self._part.recordings

    @property
    def complete(self) -> bool:
        """False where it was ended early, with the best so far."""
        return self._part.complete

    @property
    def ended(self) -> str:
        """Why it was ended early; empty where it was not, or where that is not known."""
        return self._ended

    @property
    def saved(self) -> SavedModel:
        """The (final) model, to start from or to compare with."""
        return self.as_reference

    def patch(
        self, into: PathLike, out: PathLike, *, rig: PathLike | None = None, holdout: float = 0.3
    ) -> Patch:
        """Write a repaired copy of the MuJoCo file that was fitted or diagnosed; as ``labhil patch``.

        The new file is loaded and run by MuJoCo on the held-out data. What the format cannot hold goes into a
        Python file beside it.

        Args:
            into: The MuJoCo file as it was.
            out: The new file; nothing may be there.
            rig: The rig file of the work, where it had one.
            holdout: The share of the recordings that was held out.

        Returns:
            What was changed (``changes``, ``diff``), what was left to the Python file (``left``,
            ``companion``), and the errors before and after; ``to_dict()`` is what ``--json`` writes.

        Raises:
            UsageError: Something is there already, the files do not belong together, or the repaired file's
                error is more than 1.05 times the model's. Nothing is written then.
        """
        require_analysis("a patch")
        from labhil.analysis.patching import patch

        with TemporaryDirectory() as folder:
            result = self.save(Path(folder) / "result.json")
            rig_file = None if rig is None else path_of(rig, "rig")
            return patch(result, path_of(into, "into"), path_of(out, "out"), rig_file, holdout=holdout)

    @property
    def study(self) -> S:
        """The computation behind it, with its samples; UsageError of a result that was loaded or pickled."""
        return self._require_study("study")

    def _require_study(self, what: str) -> S:
        if self._study is None:
            raise no_samples_error(what)
        return self._study


def _restored(kind: Any, data: Mapping[str, Any], name: str) -> Result:
    result: Result = kind(data, name=name)
    return result


def no_samples_error(what: str) -> UsageError:
    """The refusal of what a saved result cannot do, since it holds numbers and no samples."""
    return UsageError(
        f"{what}: a result that was loaded or pickled holds no samples; `simulate(recording).plot()` draws "
        "its model beside a recording"
    )


def parameter_columns(parameters: Parameters) -> dict[str, list[Any]]:
    """Parameters by columns, in the order of the report."""
    from labhil.report.parameter_columns import COLUMNS

    frames = [entry for column in COLUMNS for entry in column.frame]
    return {name: [value(row) for row in parameters] for name, value in frames}


def parameter_frame(parameters: Parameters) -> Any:
    """A pandas DataFrame with a row for each parameter."""
    return data_frame(parameter_columns(parameters), index=parameters.keys(), index_name="parameter")


def parameter_set(parameters: Parameters, covariance: Any, attributes: Mapping[str, Any]) -> Any:
    """An xarray Dataset over the parameters."""
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

"""The rig file (TOML): which kind of rig stands on the bench, what is known of it, how its data are read."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from importlib import import_module
from math import isfinite
from pathlib import Path
from typing import Any, NamedTuple

from pydantic import (
    BaseModel,
    Field,
    ValidationError,
    field_validator,
    model_validator,
)

from labhil.documents import DocumentError, parse_toml, read_document
from labhil.errors import MissingExtraError, RigFileError, UsageError, suggestion
from labhil.kinds import Known, RigKind, kind_named, kind_names
from labhil.python_file import object_of
from labhil.rig_sections import (
    Channel,
    Interlock,
    Limit,
    Metric,
    ModelSection,
    OwnModel,
    RigSection,
    Section,
    Table,
)
from labhil.toml_text import toml_value
from labhil.unreadable import RIG, reason_unreadable
from labhil.validation_errors import fields_at, format_validation_error

LARGEST_FILE = 32 << 20
"""Bytes of a file that a rig file names. It goes into every recording; half a million points fit into it."""


FILES = {".xml": "mujoco", ".mjcf": "mujoco", ".urdf": "mujoco", ".fmu": "fmu"}
"""Which key of ``[model]`` a simulator's file is given by, by the end of its name."""

READERS = {
    "mujoco": ("labhil.simulators.mjcf", "mujoco_simulator"),
    "fmu": ("labhil.simulators.fmu", "fmu_simulator"),
}
"""What reads such a file; imported where a rig file names one."""

COLUMNS = ("labhil.simulators.several_columns", "simulated_outputs")
"""What takes columns of simulated output for a rig."""


class KnownFile(NamedTuple):
    """A file that ``[known]`` names: where it stands, for messages, and its content."""

    source: str
    content: bytes

    def text(self) -> str:
        """The content as UTF-8; RigFileError when it is none."""
        try:
            return self.content.decode("utf-8-sig")
        except UnicodeDecodeError as error:
            raise RigFileError(f"{self.source}: expected text (UTF-8), found {error}") from error


class RigFile(BaseModel):
    """A whole rig file; ``path`` and ``text`` say where it came from (a file or an attachment).

    ``files`` holds the content of the files that ``[known]`` names, by the names in ``[known]``, so that a
    recording can carry them.
    """

    model_config = Section.model_config

    rig: RigSection
    model: ModelSection | None = None
    known: dict[str, float | list[float] | str] = {}
    nominal: dict[str, float] = {}
    limits: dict[str, Limit] = {}
    interlocks: dict[str, Interlock] = {}
    metric: Metric = Metric()
    table: Table = Table()
    channels: dict[str, Channel] = {}
    path: Path = Field(default=Path("rig.toml"), exclude=True)
    text: str = Field(default="", exclude=True)
    files: dict[str, bytes] = Field(default={}, exclude=True)

    @property
    def kind(self) -> RigKind:
        """The kind of rig that this file describes."""
        return kind_named(self.rig.kind)

    def known_number(self, name: str) -> float | None:
        """A scalar of ``[known]``, or None when it is to be estimated."""
        value = self.known.get(name)
        return float(value) if isinstance(value, (int, float)) else None

    def known_numbers(self, name: str) -> list[float] | None:
        """A list of ``[known]`` (one number a joint), or None when it is to be estimated."""
        value = self.known.get(name)
        return [float(item) for item in value] if isinstance(value, list) else None

    def known_path(self, name: str) -> Path | None:
        """A table of ``[known]``, relative to the rig file; None when there is none."""
        value = self.known.get(name)
        return self.path.parent / value if isinstance(value, str) else None

    def known_file(self, name: str) -> KnownFile | None:
        """A file of ``[known]``: the one that travels with this rig file, else the one beside it.

        None when the rig file names none. RigFileError when the file cannot be found or read.
        """
        path = self.known_path(name)
        if path is None:
            return None
        if name in self.files:
            return KnownFile(f"{self.path}: {self.known[name]}", self.files[name])
        return KnownFile(str(path), _content(path, f"{self.path}: known.{name}"))

    @field_validator("nominal", mode="before")
    @classmethod
    def _flatten_nominal(cls, value: object) -> object:
        return dict(_flatten(value)) if isinstance(value, Mapping) else value

    @field_validator("known", "nominal", mode="before")
    @classmethod
    def _refuse_bools(cls, value: object) -> object:
        for name, number in _flatten(value) if isinstance(value, Mapping) else ():
            if any(isinstance(x, bool) for x in (number if isinstance(number, list) else [number])):
                raise ValueError(f"{name}: expected a number, found {str(number).lower()}")
        return value

    @model_validator(mode="after")
    def _check_all_names(self) -> RigFile:
        signals = {signal.name for signal in self.kind.signals()}
        _check_names("known", self.known, set(self.kind.known))
        columns = {column for signal in self.kind.signals() for column in signal.columns()}
        _check_names("limits", self.limits, signals | columns)
        _check_names("interlocks", self.interlocks, signals)
        _check_names("channels", self.channels, signals | {"t"})
        _check_keys_of_channels(self)
        for name, value in self.known.items():
            _check_known(name, value, self.kind.known[name])
        _check_geometry(self)
        for name, value in self.nominal.items():
            if not isfinite(value):
                raise ValueError(f"nominal.{name} must be a finite number, found {value!r}")
            what = self.kind.known.get(name)
            if what is not None and what.width == 1 and not what.admits(value):
                raise ValueError(f"nominal.{name} must be {what.expected()}, found {value!r}")
        return self


def load_rig(path: Path) -> RigFile:
    """Read a rig file and the files that it names; RigFileError says where, and what was expected.

    A simulator's file (see :func:`simulator_rig`) stands for a rig file that names it.
    """
    if is_simulator(str(path)):
        return simulator_rig(str(path))
    try:
        text = read_document(path)
    except (OSError, DocumentError) as error:
        reason = reason_unreadable(path, error, RIG)
        raise RigFileError(f"{path}: cannot be read as a rig file (TOML): {reason}") from error
    rig = parse_rig(_with_kind(text, path), path).model_copy(update={"text": text})
    files = {name: rig.known_file(name) for name, what in rig.kind.known.items() if what.table}
    return rig.model_copy(update={"files": {name: file.content for name, file in files.items() if file}})


def parse_rig(text: str, path: Path, files: Mapping[str, bytes] | None = None) -> RigFile:
    """Read the text of a rig file.

    Args:
        text: What the file holds (TOML).
        path: Where it stands; serves messages and relative paths.
        files: The content of files that ``[known]`` names, where they come with the text.

    Raises:
        RigFileError: The file, the field, what was expected and what was found.
    """
    try:
        data = parse_toml(text)
    except DocumentError as error:
        raise RigFileError(f"{path}: not TOML: {error}") from error
    if "rig" not in data and _is_of_columns(data.get("model")):
        data = parse_toml(_with_kind(text, path))  # nothing is loaded for it, whoever wrote the file
    if "model" in data and "rig" not in data:
        raise OwnSimulatorError(
            f"{path}: describes a simulator by a file of its own, which is not loaded unless you name it "
            "yourself: give the rig file with --rig RIG.toml"
        )
    if "rig" not in data:
        near = suggestion("rig", data)
        raise RigFileError(
            f'{path}: the table [rig] with kind = "…" is missing{near}; kinds: {", ".join(kind_names())}'
        )
    _refuse_reserved(data, path)
    try:
        return RigFile.model_validate({**data, "path": path, "text": text, "files": dict(files or {})})
    except ValidationError as error:
        raise RigFileError(format_validation_error(error, path, RigFile)) from error


def _is_of_columns(section: object) -> bool:
    return isinstance(section, Mapping) and "simulated" in section


class OwnSimulatorError(RigFileError):
    """A rig file that came with a recording would run code of its author."""


def _with_kind(text: str, path: Path) -> str:
    """The text of a rig file that was named by its user, with the kind that its simulator is."""
    try:
        data = parse_toml(text)
    except DocumentError:
        return text  # reported where it is parsed
    if "model" not in data:
        return text
    try:
        section = OwnModel.model_validate({"model": data["model"]}).model
    except ValidationError as error:
        raise RigFileError(format_validation_error(error, path, OwnModel)) from error
    kind = _kind_of(section, path)
    return text if "rig" in data else f'{text}\n[rig]\nkind = "{kind.name}"\n'


def _kind_of(section: ModelSection, path: Path) -> RigKind:
    """Load the simulator of a rig file, which makes its kind known."""
    key, stated = section.stated
    try:
        if section.simulated is not None:
            module, name = COLUMNS
            made = getattr(import_module(module), name)(section.simulated, beside=section.beside)
        elif key in READERS:
            module, name = READERS[key]
            reader = getattr(import_module(module), name)
            made = reader(path.parent / stated, inputs=section.inputs, outputs=section.outputs)
        else:
            made = object_of(stated, path.parent)
    except MissingExtraError:
        raise
    except UsageError as error:
        raise RigFileError(f"{path}: model.{key}: {error}") from error
    kind = getattr(made, "kind", None)
    if not isinstance(kind, RigKind):
        raise RigFileError(
            f"{path}: model.python: expected what labhil.simulator gives, found something else in "
            f"{section.python}"
        )
    return kind


def simulator_rig(stated: str) -> RigFile:
    """A rig file that says nothing but which simulator it is.

    Args:
        stated: ``bench.py:pendulum``, or the path of an MJCF or URDF file or of an FMU.

    Raises:
        RigFileError: What is wrong with the simulator.
    """
    path = Path(stated)
    what = FILES.get(path.suffix.lower(), "python")
    text = f"[model]\n{what} = {toml_value(path.name)}\n"
    return parse_rig(_with_kind(text, path), path)


def is_simulator(stated: str) -> bool:
    """Whether a text names a simulator: a MuJoCo file, an FMU, or a Python file with a name in it."""
    file, colon, _ = stated.rpartition(":")
    return Path(stated).suffix.lower() in FILES or bool(colon and file.endswith(".py"))


def default_rig(kind: str) -> RigFile:
    """A rig file that says nothing but its kind."""
    return parse_rig(f'[rig]\nkind = "{kind_named(kind).name}"\n', Path(f"rig {kind}"))


def _check_names(section: str, given: Mapping[str, object], known: set[str]) -> None:
    for name in given:
        if name not in known:
            raise ValueError(
                f"{section}.{name}: unknown name{suggestion(name, known)}; known: {', '.join(sorted(known))}"
            )


def _check_keys_of_channels(rig: RigFile) -> None:
    """ValueError for a key of ``[channels]`` where it means nothing."""
    inputs = {signal.name for signal in (*rig.kind.inputs, *rig.kind.optional)}
    for name, channel in rig.channels.items():
        if channel.hold is not None and name not in inputs:
            raise ValueError(
                f"channels.{name}.hold: only an input runs on between samples; inputs: "
                f"{', '.join(sorted(inputs))}"
            )
        if name == "t" and (channel.unwrap is not None or channel.shift):
            raise ValueError("channels.t: `unwrap` and `shift` belong to the signals, not to the time")


def _check_known(name: str, value: object, what: Known) -> None:
    """ValueError unless ``[known]`` gives for a name what belongs there."""
    if what.table:
        if not isinstance(value, str) or not value:
            raise ValueError(f"known.{name} must be {what.expected()}, found {value!r}")
        return
    numbers = value if isinstance(value, list) else [value]
    fits = isinstance(value, list) == (what.width > 1) and len(numbers) == what.width
    if not fits or not all(isinstance(x, float) and what.admits(x) for x in numbers):
        raise ValueError(f"known.{name} must be {what.expected()}, found {value!r}")


def _check_geometry(rig: RigFile) -> None:
    """ValueError for lengths that make no rig."""
    for low, high in (("crank_radius", "beam_length"), ("stop_low", "stop_high")):
        a, b = rig.known_number(low), rig.known_number(high)
        if a is not None and b is not None and not a < b:
            raise ValueError(f"known.{low} ({a:g}) must be smaller than known.{high} ({b:g})")


def _refuse_reserved(data: Mapping[str, object], path: Path) -> None:
    for name in ("path", "text", "files"):
        if name in data:
            raise RigFileError(f"{path}: {name}: unknown key; known: {', '.join(fields_at(RigFile, ()))}")


def _content(path: Path, field: str) -> bytes:
    """The bytes of a file that a rig file names; RigFileError when it is not there, or no such file."""
    hint = "paths are relative to the rig file; a recording's own rig file is replaced by --rig RIG.toml"
    if not path.is_file():
        actual = "something else" if path.exists() else "none"
        raise RigFileError(f"{field}: expected the file {path}, found {actual} ({hint})")
    size = path.stat().st_size
    if size > LARGEST_FILE:
        raise RigFileError(f"{field}: expected at most {LARGEST_FILE} bytes, found {path} with {size}")
    try:
        return path.read_bytes()
    except OSError as error:
        raise RigFileError(f"{field}: {path}: cannot be read: {error.strerror}") from error


def _flatten(value: Mapping[str, Any], prefix: str = "") -> Iterator[tuple[str, Any]]:
    for key, inner in value.items():
        if isinstance(inner, Mapping):
            yield from _flatten(inner, f"{prefix}{key}.")
        else:
            yield f"{prefix}{key}", inner

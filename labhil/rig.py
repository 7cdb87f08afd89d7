"""The rig file (TOML): which kind of rig stands on the bench, what is known of it, how its data are read."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from importlib import import_module
from math import inf, isfinite
from pathlib import Path
from typing import Annotated, Any, Literal, NamedTuple

from pydantic import (
    BaseModel,
    ConfigDict,
    Field,
    ValidationError,
    field_validator,
    model_validator,
)
from pydantic_core import PydanticCustomError

from labhil.documents import DocumentError, parse_toml
from labhil.errors import MissingExtraError, RigFileError, UsageError, suggestion
from labhil.kinds import Known, RigKind, kind_named, kind_names
from labhil.python_file import object_of
from labhil.signals import Hold
from labhil.toml_text import toml_value

Threshold = Annotated[float, Field(allow_inf_nan=False)] | None


LARGEST_FILE = 32 << 20
"""Bytes of a file that a rig file names. It goes into every recording; half a million points fit into it."""


MUJOCO_FILES = (".xml", ".mjcf", ".urdf")
MUJOCO_READER = "labhil.simulators.mjcf"
"""What reads a MuJoCo file; imported where a rig file names one."""


class _Section(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True)


class RigSection(_Section):
    """``[rig]``: which kind of rig this is."""

    kind: str

    @field_validator("kind")
    @classmethod
    def _exists(cls, value: str) -> str:
        names = kind_names()
        if value not in names:
            raise ValueError(f"no such rig{suggestion(value, names)}; known: {', '.join(sorted(names))}")
        return value


class ModelSection(_Section):
    """``[model]``: the simulator of a user's own, in place of ``[rig]``.

    Either ``python``, a Python file and a name in it, or ``mujoco``, an MJCF or URDF file. Of that,
    ``inputs`` and ``outputs`` give actuators, joints and sensors by the names of the recorded signals.
    """

    python: str | None = None
    mujoco: str | None = None
    inputs: dict[str, str] | None = None
    outputs: dict[str, str] | None = None

    @model_validator(mode="after")
    def _one_of_them(self) -> ModelSection:
        if (self.python is None) == (self.mujoco is None):
            raise ValueError('give either python = "FILE.py:NAME" or mujoco = "FILE.xml"')
        if self.python is not None and (self.inputs or self.outputs):
            raise ValueError("inputs and outputs are for mujoco; a simulator in Python states its own")
        return self


class _OwnModel(_Section):
    """That section by itself."""

    model: ModelSection


class Limit(_Section):
    """What a signal may be: ``min`` and ``max`` in its unit, ``rate`` in its unit per second."""

    min: float = float("-inf")
    max: float = float("inf")
    rate: Annotated[float, Field(gt=0)] = float("inf")

    @model_validator(mode="after")
    def _ordered(self) -> Limit:
        if not self.min < self.max:
            raise ValueError(f"min ({self.min:g}) must be smaller than max ({self.max:g})")
        return self


class Interlock(_Section):
    """One of ``[interlocks]``: beyond a trip threshold the device goes to its safe state.

    It stays there until the signal is back inside the resume thresholds (by default those of the trip),
    and somebody takes the command anew: nothing moves again by itself. ``then`` says what a run does:
    ``abort`` ends it, ``pause`` lets it wait for somebody to resume it. Thresholds in the signal's unit.
    """

    trip_above: Threshold = None
    resume_below: Threshold = None
    trip_below: Threshold = None
    resume_above: Threshold = None
    then: Literal["abort", "pause"] = "abort"

    @model_validator(mode="after")
    def _sensible(self) -> Interlock:
        if self.trip_above is None and self.trip_below is None:
            raise ValueError("give trip_above, trip_below or both: nothing would trip")
        if self.resume_below is not None and (self.trip_above is None or self.resume_below > self.trip_above):
            raise ValueError("resume_below needs a trip_above that is not smaller")
        if self.resume_above is not None and (self.trip_below is None or self.resume_above < self.trip_below):
            raise ValueError("resume_above needs a trip_below that is not larger")
        if self.resume_low >= self.resume_high:
            raise ValueError(
                f"between {self.resume_low:g} and {self.resume_high:g} there is nothing to resume at"
            )
        return self

    @property
    def resume_high(self) -> float:
        """The upper end of where the interlock is lifted."""
        above = inf if self.trip_above is None else self.trip_above
        return above if self.resume_below is None else self.resume_below

    @property
    def resume_low(self) -> float:
        """The lower end of where the interlock is lifted."""
        below = -inf if self.trip_below is None else self.trip_below
        return below if self.resume_above is None else self.resume_above


class Metric(_Section):
    """``[metric]``: horizon of the windowed simulation, s; cut-off of inverse dynamics, Hz."""

    horizon: Annotated[float, Field(gt=0, allow_inf_nan=False)] | None = None
    cut_off: Annotated[float, Field(gt=0, allow_inf_nan=False)] | None = None


class Table(_Section):
    """``[table]``: how to read a file that is not already in our names and units.

    ``thousands`` is the mark that groups digits; ``part`` (from 1) the stretch to take of a table whose clock
    begins anew; ``blanks = "fill"`` also fills empty cells of a slower output; ``bad_rows`` drops or refuses
    what cannot be read: without it a few rows are dropped, and many refused.
    """

    header: bool | None = None
    delimiter: Literal["comma", "tab", "whitespace", "semicolon"] | None = None
    rate: Annotated[float, Field(gt=0)] | None = None
    decimal: Literal[".", ","] = "."
    thousands: Literal[".", ",", "'", " "] | None = None
    skip_rows: Annotated[int, Field(ge=0)] = 0
    comment: str | None = None
    sheet: str | None = None
    part: Annotated[int, Field(ge=1)] | None = None
    blanks: Literal["fill"] | None = None
    bad_rows: Literal["drop", "fail"] | None = None

    @model_validator(mode="after")
    def _marks_differ(self) -> Table:
        if self.thousands == self.decimal:
            raise ValueError(f"decimal and thousands are both {self.decimal!r}; they must differ")
        return self


Column = Annotated[int, Field(ge=0)] | str
Factor = float | list[float]


class Channel(_Section):
    """One entry of ``[channels]``: value = raw · ``scale`` + ``offset``; columns by name or number.

    ``hold`` says how an input runs between samples: "zero" keeps the earlier value, "linear" is straight.
    ``unwrap`` is the period (in the signal's unit) after which a position begins anew, to be undone.
    ``shift`` (s) is added to the channel's own stamps: −0.01 for stamps that are 10 ms late.
    """

    column: Column | None = None
    columns: list[Column] | None = None
    scale: Factor = 1.0
    offset: Factor = 0.0
    hold: Hold | None = None
    unwrap: Annotated[float, Field(gt=0, allow_inf_nan=False)] | None = None
    shift: Annotated[float, Field(allow_inf_nan=False)] = 0.0

    @model_validator(mode="after")
    def _one_way(self) -> Channel:
        if (self.column is None) == (self.columns is None):
            raise ValueError("give either `column` (one) or `columns` (a list)")
        for name, factor in (("scale", self.scale), ("offset", self.offset)):
            if isinstance(factor, list) and len(factor) != len(self.sources()):
                counts = f"{len(factor)} values for {len(self.sources())} columns"
                raise ValueError(f"`{name}` has {counts}; give one, or one each")
        return self

    def sources(self) -> tuple[Column, ...]:
        """The columns of the file that this channel is made of, in order."""
        if self.columns is not None:
            return tuple(self.columns)
        return () if self.column is None else (self.column,)


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


class RigFile(_Section):
    """A whole rig file; ``path`` and ``text`` say where it came from (a file or an attachment).

    ``files`` holds the content of the files that ``[known]`` names, by the names in ``[known]``, so that a
    recording can carry them.
    """

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
    def _flattened(cls, value: object) -> object:
        return dict(_flatten(value)) if isinstance(value, Mapping) else value

    @field_validator("known", "nominal", mode="before")
    @classmethod
    def _are_numbers(cls, value: object) -> object:
        for name, each in _flatten(value) if isinstance(value, Mapping) else ():
            if any(isinstance(x, bool) for x in (each if isinstance(each, list) else [each])):
                raise ValueError(f"{name}: expected a number, found {str(each).lower()}")
        return value

    @model_validator(mode="after")
    def _names_exist(self) -> RigFile:
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
        text = path.read_text(encoding="utf-8")
    except (OSError, UnicodeDecodeError) as error:
        raise RigFileError(f"{path}: cannot be read as a rig file (TOML): {error}") from error
    rig = parse_rig(_with_kind(text, path), path).model_copy(update={"text": text})
    found = {name: rig.known_file(name) for name, what in rig.kind.known.items() if what.table}
    return rig.model_copy(update={"files": {name: file.content for name, file in found.items() if file}})


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
        raise RigFileError(explain(error, path, RigFile)) from error


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
        section = _OwnModel.model_validate({"model": data["model"]}).model
    except ValidationError as error:
        raise RigFileError(explain(error, path, _OwnModel)) from error
    kind = _kind_of(section, path)
    return text if "rig" in data else f'{text}\n[rig]\nkind = "{kind.name}"\n'


def _kind_of(section: ModelSection, path: Path) -> RigKind:
    """Load the simulator of a rig file, which makes its kind known."""
    try:
        if section.mujoco is not None:
            reader = import_module(MUJOCO_READER).mujoco_simulator
            made = reader(path.parent / section.mujoco, inputs=section.inputs, outputs=section.outputs)
        else:
            made = object_of(section.python or "", path.parent)
    except MissingExtraError:
        raise
    except UsageError as error:
        name = "python" if section.mujoco is None else "mujoco"
        raise RigFileError(f"{path}: model.{name}: {error}") from error
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
        stated: ``bench.py:pendulum``, or the path of an MJCF or URDF file.

    Raises:
        RigFileError: What is wrong with the simulator.
    """
    path = Path(stated)
    what = "mujoco" if path.suffix.lower() in MUJOCO_FILES else "python"
    text = f"[model]\n{what} = {toml_value(path.name)}\n"
    return parse_rig(_with_kind(text, path), path)


def is_simulator(stated: str) -> bool:
    """Whether a text names a simulator: a MuJoCo file, or a Python file with a name in it."""
    file, colon, _ = stated.rpartition(":")
    return Path(stated).suffix.lower() in MUJOCO_FILES or bool(colon and file.endswith(".py"))


def default_rig(kind: str) -> RigFile:
    """A rig file that says nothing but its kind."""
    return parse_rig(f'[rig]\nkind = "{kind_named(kind).name}"\n', Path(f"{kind}.toml"))


def explain(error: ValidationError, path: Path, model: type[BaseModel]) -> str:
    """Put pydantic's complaints into one line each: file, field, what was expected, what was found."""
    return "\n".join(f"{path}: {_complaint(item, model)}" for item in error.errors(include_url=False))


# pydantic names the branch of a union that it tried; that is no place in a file
PYDANTIC_BRANCHES = {"str", "int", "float", "list[float]", "constrained-int"}


UNKNOWN_KEY = "unknown_key"


def unknown_key(key: str, message: str) -> PydanticCustomError:
    """The error for a validator that knows better than its model which keys belong here."""
    return PydanticCustomError(UNKNOWN_KEY, "{message}", {"key": key, "message": message})


def _complaint(item: Any, model: type[BaseModel]) -> str:
    places = [str(part) for part in item["loc"] if str(part) not in PYDANTIC_BRANCHES]
    field = ".".join(places) or "file"
    if item["type"] == "extra_forbidden":
        known = _fields_at(model, item["loc"][:-1])
        return f"{field}: unknown key{suggestion(str(item['loc'][-1]), known)}; known: {', '.join(known)}"
    if item["type"] == "missing":
        return f"{field}: this key is missing"
    message = str(item["msg"]).removeprefix("Value error, ")
    if item["type"] == UNKNOWN_KEY:
        return f"{'.'.join([*places, str(item['ctx']['key'])])}: {message}"
    if item["type"] == "value_error":
        return f"{field}: {message}" if places else message
    return f"{field}: {message}, found {item['input']!r:.200}"


def _fields_at(model: type[BaseModel], loc: tuple[int | str, ...]) -> list[str]:
    """Names of the keys that are allowed at a place in a file, as far as the models tell."""
    current: type[BaseModel] = model
    for part in loc:
        field = current.model_fields.get(str(part))
        found = _model_within(field.annotation) if field is not None else None
        if found is not None:
            current = found
    return [name for name, field in current.model_fields.items() if not field.exclude]


def _model_within(annotation: object) -> type[BaseModel] | None:
    if isinstance(annotation, type) and issubclass(annotation, BaseModel):
        return annotation
    for inner in getattr(annotation, "__args__", ()):
        found = _model_within(inner)
        if found is not None:
            return found
    return None


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
            raise RigFileError(f"{path}: {name}: unknown key; known: {', '.join(_fields_at(RigFile, ()))}")


def _content(path: Path, field: str) -> bytes:
    """The bytes of a file that a rig file names; RigFileError when it is not there, or no such file."""
    hint = "paths are relative to the rig file; a recording's own rig file is replaced by --rig RIG.toml"
    if not path.is_file():
        found = "something else" if path.exists() else "none"
        raise RigFileError(f"{field}: expected the file {path}, found {found} ({hint})")
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

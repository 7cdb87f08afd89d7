"""Registry of the models of all rig kinds, and the conversion of recordings to records of a rig."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from importlib import import_module
from importlib.metadata import entry_points

import numpy as np

from labhil.errors import RecordingError, UnknownNameError, UsageError
from labhil.kinds import RigKind, declare_kind, declared_kinds
from labhil.physics.facts import Fact
from labhil.physics.model import Metric, Model, index_of, start_values, starts_of
from labhil.physics.record import Begin, Record, Windows
from labhil.recording.recording import Recording
from labhil.rig import RigFile, default_rig
from labhil.signals import FloatArray, Stream
from labhil.terminal import printable_name

SPEED_TERMS = ("stribeck_friction", "quadratic_viscous_friction", "cubic_viscous_friction")


@dataclass(frozen=True, slots=True)
class RigModel:
    """The model of a rig kind.

    Attributes:
        model: Its class as "module:class", imported when needed, or a factory.
        baseline: Terms from which a diagnosis starts by default.
        general: Terms of a fit by default (the general models of the reference text).
        facts: The function of plausibility figures (``physics.facts``) as "module:function"; "" for none.
    """

    model: str | Callable[[RigFile, Record | None], Model]
    baseline: tuple[str, ...]
    general: tuple[str, ...]
    facts: str = ""

    def facts_of(self, record: Record, known: Mapping[str, float]) -> list[Fact]:
        """Plausibility figures of a record, given the numbers of [known]; nothing is compiled for them."""
        if not self.facts:
            return []
        module, _, name = self.facts.partition(":")
        figures: list[Fact] = getattr(import_module(module), name)(record, known)
        return figures

    def load(self) -> Callable[[RigFile, Record | None], Model]:
        """Import the factory, which maps a rig file and a record (None: typical sizes) to a model."""
        if not isinstance(self.model, str):
            return self.model
        module, _, name = self.model.partition(":")
        factory: Callable[[RigFile, Record | None], Model] = getattr(import_module(module), name)
        return factory


VISCOUS = ("viscous_friction",)
DRY = ("viscous_friction", "coulomb_friction")
MODELS: Mapping[str, RigModel] = {
    "ball_beam": RigModel(
        "labhil.physics.ball_beam:BallBeamModel",
        VISCOUS,
        (*DRY, *SPEED_TERMS, "dead_zone", "time_delay"),
        "labhil.physics.ball_beam_facts:facts",
    ),
    "dc_motor": RigModel(
        "labhil.physics.dc_motor:DcMotorModel",
        VISCOUS,
        (*DRY, *SPEED_TERMS),
        "labhil.physics.dc_motor_facts:facts",
    ),
    "solenoid": RigModel(
        "labhil.physics.solenoid:SolenoidModel",
        VISCOUS,
        (*DRY, "stribeck_friction"),
        "labhil.physics.solenoid_facts:facts",
    ),
    "axis": RigModel(
        "labhil.physics.axis:AxisModel",
        (*DRY, "constant_force"),
        (*DRY, "constant_force", *SPEED_TERMS),
        "labhil.physics.axis_facts:facts",
    ),
    "ur5": RigModel(
        "labhil.physics.arm:ArmModel",
        (*DRY, "sensor_offset"),
        (*DRY, "sensor_offset", *SPEED_TERMS),
        "labhil.physics.arm_facts:facts",
    ),
}


MODEL_ENTRY_POINTS = "labhil.models"
"""Entry point group in which packages register a ``RightHandSide`` by the name of its rig kind."""


_DECLARED: dict[str, RigModel] = {}


def declare_model(kind: str, model: RigModel) -> None:
    """Register the model of a user's simulator as rig kind ``kind`` in this process."""
    _DECLARED[kind] = model


@contextmanager
def keeping_declarations() -> Iterator[None]:
    """Declare the kinds and models of users' simulators again at the end, as they were at the beginning.

    For work that reads a changed copy of a simulator's file, which replaces the simulator of the same name.
    """
    kinds, models = declared_kinds(), dict(_DECLARED)
    try:
        yield
    finally:
        for kind in kinds:
            declare_kind(kind)
        _DECLARED.update(models)


def rig_model(kind: str) -> RigModel:
    """Look up the model of a rig kind.

    Raises:
        UnknownNameError: The rig kind has no model; the message lists those that have.
    """
    if kind in MODELS:
        return MODELS[kind]
    if kind in _DECLARED:
        return _DECLARED[kind]
    for point in entry_points(group=MODEL_ENTRY_POINTS):
        if point.name == kind:
            stated = point.load()
            return RigModel(point.value, tuple(stated.baseline), tuple(stated.general))
    raise UnknownNameError("model of a rig kind", kind, MODELS)


def model_for(rig: RigFile, record: Record | None = None, per_recording: Sequence[str] = ()) -> Model:
    """Make the model of a rig.

    Args:
        rig: The rig file.
        record: The record that starts and scales are taken from; None for typical sizes.
        per_recording: Terms or parameters with a value of their own in each of several recordings
            (``physics.several``); all others are shared.

    Returns:
        The model.
    """
    model = rig_model(rig.kind.name).load()(rig, record)
    count = 1 if record is None else len(record.begins)
    if count == 1:
        return model
    from labhil.physics.several import several

    return several(model, per_recording, count)


def by_inverse_dynamics(model: Model) -> Model:
    """Convert a model to one that is fitted by inverse dynamics.

    Raises:
        UsageError: The rig kind has no inverse dynamics.
    """
    from labhil.physics.axis import AxisModel
    from labhil.physics.axis_inverse import AxisInverse

    if model.metric is Metric.INVERSE_DYNAMICS:
        return model
    if isinstance(model, AxisModel):
        return AxisInverse(model)
    raise UsageError(f"inverse dynamics fits the rigs axis and ur5, found {model.kind}")


def compile_kernels(kinds: tuple[str, ...] = ("ball_beam",)) -> None:
    """Simulate one second of these rig kinds, so that their kernels are compiled and cached."""
    for kind in kinds:
        rig = default_rig(kind)
        t = np.linspace(0.0, 1.0, 30)
        record = Record(
            t,
            np.column_stack([np.sin(t) for _ in rig.kind.driven_by[0]]),
            np.column_stack([np.sin(t) for _ in rig.kind.outputs]),
            rig.kind.driven_by[0],
            tuple(signal.name for signal in rig.kind.outputs),
            tuple(signal.unit for signal in rig.kind.outputs),
        )
        model = model_for(rig, record)
        windows = Windows.of([(0, 30)])
        states = model.initial_states(record, windows)
        everything = start_values(model.parameters)
        for values in starts_of(model, tuple(model.terms.values()), record):
            for name, value in values.items():
                everything[index_of(model.parameters)[name]] = value
        model.simulate(everything, record, windows, states)


def record_of(recording: Recording, kind: RigKind) -> Record:
    """Extract the signals of a rig kind from a recording.

    Raises:
        RecordingError: Signals are missing, several devices match, or values are unusable.
    """
    devices = _devices_of(recording, kind)
    if len(devices) > 1:
        raise RecordingError(
            f"{recording.path}: expected one device of kind {kind.name}, found "
            f"{', '.join(map(printable_name, devices))}; choose one with --device"
        )
    for stream in recording.streams:
        record = record_of_samples(stream.stream, stream.t, stream.values, kind)
        if record is None:
            continue
        if not len(stream):
            raise RecordingError(
                f"{recording.path}: expected samples in {stream.device}/{stream.stream.name}, found 0"
            )
        unusable = unusable_values(record)
        if unusable:
            raise RecordingError(f"{recording.path}: {unusable}")
        return replace(record, begins=(Begin(clock_faults=stream.clock_faults),))
    raise RecordingError(f"{recording.path}: {_needed(kind)}; found {recording.describe_streams()}")


def record_of_samples(stream: Stream, t: FloatArray, values: FloatArray, kind: RigKind) -> Record | None:
    """Extract the signals of a rig kind from samples (n, columns) at times (n,), s; None if incomplete."""
    names = set(stream.names())
    driven_by = next((inputs for inputs in kind.driven_by if names >= set(inputs)), None)
    outputs = [signal for signal in kind.outputs if signal.name in names]
    if driven_by is None or not outputs or (len(outputs) < len(kind.outputs) and not kind.any_output):
        return None
    holds = {signal.name: signal.hold for signal in stream.signals}
    columns = {s.name: values[:, stream.columns_of(s.name)] for s in kind.signals() if s.name in names}
    inputs = [signal for signal in kind.inputs if signal.name in driven_by]
    inputs += [signal for signal in kind.optional if signal.name in names]
    auxiliary = {
        column: np.ascontiguousarray(x)
        for signal in kind.auxiliary
        if signal.name in names
        for column, x in zip(signal.columns(), columns[signal.name].T, strict=True)
    }
    return Record(
        t=np.ascontiguousarray(t),
        inputs=np.hstack([columns[signal.name] for signal in inputs]),
        outputs=np.hstack([columns[signal.name] for signal in outputs]),
        input_names=tuple(column for signal in inputs for column in signal.columns()),
        output_names=tuple(column for signal in outputs for column in signal.columns()),
        output_units=tuple(signal.unit for signal in outputs for _ in signal.columns()),
        output_joints=tuple(
            joint if signal.width > 1 else None for signal in outputs for joint in range(signal.width)
        ),
        input_holds=tuple(holds[signal.name] for signal in inputs for _ in signal.columns()),
        auxiliary=auxiliary,
    )


def _devices_of(recording: Recording, kind: RigKind) -> list[str]:
    """Names of the devices that have the signals of this rig kind."""
    matching = [
        data.device
        for data in recording.streams
        if any(set(data.stream.names()) >= set(inputs) for inputs in kind.driven_by)
        and any(signal.name in data.stream.names() for signal in kind.outputs)
    ]
    return sorted(set(matching))


def unusable_values(record: Record, *, largest: float = 1e50, smallest: float = 1e-50) -> str:
    """Check that a model can compute with the values of a record.

    Laws take third powers and residuals are squared: the sixth power of a larger value overflows in double
    precision, that of a signal that is smaller throughout is 0.

    Args:
        record: The record.
        largest: Largest absolute value, SI units.
        smallest: Least maximum of a signal that is not zero, SI units.

    Returns:
        The reason why it cannot; "" if it can.
    """
    names = (*record.input_names, *record.output_names, *record.auxiliary)
    columns = (*record.inputs.T, *record.outputs.T, *record.auxiliary.values())
    for name, values in zip(names, columns, strict=True):
        sizes = np.where(np.isfinite(values), np.abs(values), 0.0)
        huge = np.flatnonzero(sizes > largest)
        if len(huge):
            return (
                f"{name}: expected values within ±{largest:g}, found "
                f"{values[huge[0]]:g} at {record.t[huge[0]]:g} s, and {len(huge) - 1} more"
            )
        if 0.0 < sizes.max(initial=0.0) < smallest:
            return f"{name}: expected values beyond ±{smallest:g} or 0, found none beyond ±{sizes.max():g}"
    return ""


def _needed(kind: RigKind) -> str:
    """The signals that a rig kind needs, for a message."""
    inputs = " or ".join(" with ".join(names) for names in kind.driven_by)
    outputs = (" or " if kind.any_output else " and ").join(signal.name for signal in kind.outputs)
    return f"a {kind.name} needs {outputs} and {inputs} in one stream"

"""Which model belongs to which kind of rig, and how a recording becomes what it works on."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from importlib import import_module
from importlib.metadata import entry_points

import numpy as np

from labhil.errors import RecordingError, UnknownNameError, UsageError
from labhil.kinds import RigKind
from labhil.physics.facts import Fact
from labhil.physics.model import Begin, Metric, Model, Record, Windows, index_of, start_values, starts_of
from labhil.recording.recording import Recording
from labhil.rig import RigFile, default_rig
from labhil.signals import FloatArray, Stream
from labhil.terminal import printable_name

ALL_SPEEDS = ("stribeck_friction", "quadratic_viscous_friction", "cubic_viscous_friction")


@dataclass(frozen=True, slots=True)
class RigModel:
    """How a rig kind is modelled.

    ``model`` names its class as "module:class", imported when needed, or is what makes it. ``baseline`` are
    the terms that a diagnosis starts from by default, ``general`` those of a fit by default (the reference
    text's general models). ``facts`` names the function that states what physics knows of a recording of such
    a rig (see ``physics.facts``), "" for none.
    """

    model: str | Callable[[RigFile, Record | None], Model]
    baseline: tuple[str, ...]
    general: tuple[str, ...]
    facts: str = ""

    def facts_of(self, record: Record, known: Mapping[str, float]) -> list[Fact]:
        """What is known of a record, given the numbers of ``[known]``; nothing is compiled for it."""
        if not self.facts:
            return []
        module, _, name = self.facts.partition(":")
        figures: list[Fact] = getattr(import_module(module), name)(record, known)
        return figures

    def load(self) -> Callable[[RigFile, Record | None], Model]:
        """The class: rig file and the record that sizes are taken from (None: typical sizes) to a model."""
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
        (*DRY, *ALL_SPEEDS, "dead_zone", "time_delay"),
        "labhil.physics.ball_beam_facts:facts",
    ),
    "dc_motor": RigModel(
        "labhil.physics.dc_motor:DcMotorModel",
        VISCOUS,
        (*DRY, *ALL_SPEEDS),
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
        (*DRY, "constant_force", *ALL_SPEEDS),
        "labhil.physics.axis_facts:facts",
    ),
    "ur5": RigModel(
        "labhil.physics.arm:ArmModel",
        (*DRY, "sensor_offset"),
        (*DRY, "sensor_offset", *ALL_SPEEDS),
        "labhil.physics.arm_facts:facts",
    ),
}


PLUGGED = "labhil.models"
"""Entry points under which other packages register a ``RightHandSide`` by the name of its rig kind."""


_DECLARED: dict[str, RigModel] = {}


def declare_model(kind: str, model: RigModel) -> None:
    """Make known in this process how the rig kind of a user's own simulator is modelled."""
    _DECLARED[kind] = model


def rig_model(kind: str) -> RigModel:
    """How a rig kind is modelled; UnknownNameError lists those that are."""
    if kind in MODELS:
        return MODELS[kind]
    if kind in _DECLARED:
        return _DECLARED[kind]
    for point in entry_points(group=PLUGGED):
        if point.name == kind:
            stated = point.load()
            return RigModel(point.value, tuple(stated.baseline), tuple(stated.general))
    raise UnknownNameError("model of a rig kind", kind, MODELS)


def model_for(rig: RigFile, record: Record | None = None, per_recording: Sequence[str] = ()) -> Model:
    """The model of this rig, with sizes for starts and scales taken from ``record`` where there is one.

    That of several recordings has a value in each of what ``per_recording`` names, else the same values in
    all (see ``physics.several``).
    """
    model = rig_model(rig.kind.name).load()(rig, record)
    count = 1 if record is None else len(record.begins)
    if count == 1:
        return model
    from labhil.physics.several import several

    return several(model, per_recording, count)


def by_inverse_dynamics(model: Model) -> Model:
    """The same model as inverse dynamics fits it; UsageError for a rig whose drive it does not know."""
    from labhil.physics.axis import AxisModel
    from labhil.physics.axis_inverse import AxisInverse

    if model.metric is Metric.INVERSE_DYNAMICS:
        return model
    if isinstance(model, AxisModel):
        return AxisInverse(model)
    raise UsageError(f"inverse dynamics fits the rigs axis and ur5, found {model.kind}")


def compile_kernels(kinds: tuple[str, ...] = ("ball_beam",)) -> None:
    """Simulate a moment of these rigs, so that the compiled kernels stand in their cache."""
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


LARGEST_VALUE = 1e50
SMALLEST_VALUE = 1e-50
"""In SI units, far beyond anything on a bench. The laws take third powers and the residuals are squared:
the sixth power of larger values overflows in a double, that of a signal that is smaller throughout is 0."""


def record_of(recording: Recording, kind: RigKind) -> Record:
    """Take the signals of a rig out of a recording; RecordingError says which are missing."""
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
    raise RecordingError(f"{recording.path}: {_needed(kind)}; found {recording.described()}")


def record_of_samples(stream: Stream, t: FloatArray, values: FloatArray, kind: RigKind) -> Record | None:
    """Take the signals of a rig out of samples (n, columns) at times (n,) s; None where some are missing."""
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
    """Names of the devices that a model of this kind could be made of."""
    matching = [
        data.device
        for data in recording.streams
        if any(set(data.stream.names()) >= set(inputs) for inputs in kind.driven_by)
        and any(signal.name in data.stream.names() for signal in kind.outputs)
    ]
    return sorted(set(matching))


def unusable_values(record: Record) -> str:
    """Why no model can calculate with the values of a record; empty where one can."""
    names = (*record.input_names, *record.output_names, *record.auxiliary)
    columns = (*record.inputs.T, *record.outputs.T, *record.auxiliary.values())
    for name, values in zip(names, columns, strict=True):
        sizes = np.where(np.isfinite(values), np.abs(values), 0.0)
        huge = np.flatnonzero(sizes > LARGEST_VALUE)
        if len(huge):
            return (
                f"{name}: expected values within ±{LARGEST_VALUE:g}, found "
                f"{values[huge[0]]:g} at {record.t[huge[0]]:g} s, and {len(huge) - 1} more"
            )
        if 0.0 < sizes.max(initial=0.0) < SMALLEST_VALUE:
            return (
                f"{name}: expected values beyond ±{SMALLEST_VALUE:g} or 0, found none beyond ±{sizes.max():g}"
            )
    return ""


def _needed(kind: RigKind) -> str:
    inputs = " or ".join(" with ".join(names) for names in kind.driven_by)
    outputs = (" or " if kind.any_output else " and ").join(signal.name for signal in kind.outputs)
    return f"a {kind.name} needs {outputs} and {inputs} in one stream"

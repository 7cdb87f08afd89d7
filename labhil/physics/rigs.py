"""Which model belongs to which kind of rig, and how a recording becomes what it works on."""

from __future__ import annotations

from collections.abc import Callable, Mapping

import numpy as np

from labhil.errors import RecordingError
from labhil.physics.ball_beam import BallBeamModel
from labhil.physics.model import Model, Record, Windows, index_of, start_values, starts_of
from labhil.recording.reader import Recording
from labhil.rig import RigFile, RigKind, default_rig

MODELS: Mapping[str, Callable[[RigFile, str], Model]] = {"ball_beam": BallBeamModel}

BASELINE: Mapping[str, tuple[str, ...]] = {"ball_beam": ("viscous_friction",)}
"""What a model holds when nobody says otherwise and something is to be found missing."""

GENERAL: Mapping[str, tuple[str, ...]] = {
    "ball_beam": (
        "viscous_friction",
        "coulomb_friction",
        "stribeck_friction",
        "quadratic_viscous_friction",
        "cubic_viscous_friction",
        "dead_zone",
        "time_delay",
    )
}
"""What a model holds when it is to be fitted and nobody says otherwise (the reference text's)."""


def model_for(rig: RigFile, input_name: str) -> Model:
    """The model of this rig, driven by the signal ``input_name``."""
    return MODELS[rig.kind.name](rig, input_name)


def compile_kernels() -> None:
    """Simulate a moment of every rig, so that the compiled kernels stand in their cache."""
    for kind in MODELS:
        rig = default_rig(kind)
        model = model_for(rig, rig.kind.inputs[0].name)
        t = np.linspace(0.0, 1.0, 30)
        inputs, outputs = np.sin(t)[:, None], np.zeros((30, len(rig.kind.outputs)))
        names = tuple(signal.name for signal in rig.kind.outputs)
        record = Record(t, inputs, outputs, (rig.kind.inputs[0].name,), names, ("",) * len(names))
        windows = Windows.of([(0, 30)])
        states = model.initial_states(record, windows)
        everything = start_values(model.parameters)
        for values in starts_of(model, tuple(model.terms.values()), record):
            for name, value in values.items():
                everything[index_of(model.parameters)[name]] = value
        model.simulate(everything, record, windows, states)


def record_of(recording: Recording, kind: RigKind) -> Record:
    """Take the signals of a rig out of a recording; RecordingError says which are missing."""
    outputs = kind.outputs
    wanted = " or ".join(signal.name for signal in kind.inputs)
    for stream in recording.streams:
        names = stream.stream.names()
        inputs = [signal for signal in kind.inputs if signal.name in names]
        if not inputs or any(signal.name not in names for signal in outputs):
            continue
        chosen = inputs[0]
        if not len(stream):
            raise RecordingError(
                f"{recording.path}: expected samples in {stream.device}/{stream.stream.name}, found 0"
            )
        return Record(
            t=np.ascontiguousarray(stream.t),
            inputs=np.column_stack([stream[chosen.name]]),
            outputs=np.column_stack([stream[signal.name] for signal in outputs]),
            input_names=(chosen.name,),
            output_names=tuple(signal.name for signal in outputs),
            output_units=tuple(signal.unit for signal in outputs),
        )
    found = "; ".join(f"{s.device}/{s.stream.name}: {', '.join(s.stream.names())}" for s in recording.streams)
    needed = ", ".join(signal.name for signal in outputs)
    raise RecordingError(
        f"{recording.path}: a {kind.name} needs {needed} and {wanted} in one stream; "
        f"found {found or 'no stream'}"
    )

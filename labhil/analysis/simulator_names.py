"""Check of a recording's signals against a MuJoCo file, and a proposal for the rig file where they differ."""

from __future__ import annotations

from collections.abc import Sequence
from difflib import SequenceMatcher

from labhil.errors import RecordingError
from labhil.kinds import RigKind
from labhil.recording.recording import Recording
from labhil.rig import RigFile
from labhil.signals import Direction
from labhil.simulators.mjcf_file import Names, load_model, names_of
from labhil.terminal import printable_name
from labhil.toml_text import toml_value


def check_signal_names(recording: Recording, rig: RigFile) -> None:
    """Check that one stream of a recording has the signals of a rig's MuJoCo file.

    Raises:
        RecordingError: None has; the message proposes a rig file.
    """
    section = rig.model
    if section is None or section.mujoco is None:
        return
    kind = rig.kind
    needed = {*kind.driven_by[0], *(signal.name for signal in kind.outputs)}
    if any(needed <= set(data.stream.names()) for data in recording.streams):
        return
    available = names_of(load_model(rig.path.parent / section.mujoco))
    if kind.inputs[0].width > 1:
        raise RecordingError(_arm_message(recording, section.mujoco, available, kind))
    signals = [signal for data in recording.streams for signal in data.stream.signals if signal.width == 1]
    inputs = [signal.name for signal in signals if signal.direction is Direction.INPUT]
    outputs = [signal.name for signal in signals if signal.direction is Direction.OUTPUT]
    recorded = ", ".join(printable_name(signal.name) for signal in signals) or "none"
    raise RecordingError(
        f"{recording.path}: expected the signals {', '.join(sorted(needed))} of {section.mujoco}, found "
        f"{recorded}; the file has {available.listing()}."
        f"{propose_rig_file(section.mujoco, available, inputs, outputs)}"
    )


def _arm_message(recording: Recording, file: str, available: Names, kind: RigKind) -> str:
    """Message about a recording without the signals of an arm, with the lines of a rig file that map them."""
    names = [signal.name for data in recording.streams for signal in data.stream.signals]
    recorded = ", ".join(map(printable_name, names)) or "none"
    n = len(available.joints)
    needed = (*(signal.name for signal in kind.inputs), kind.outputs[0].name)
    lines = "\n".join(f"{name} = {{ columns = [{', '.join(['…'] * n)}] }}" for name in needed)
    return (
        f"{recording.path}: expected the signals {', '.join(needed)} with {n} columns each "
        f"({', '.join(available.joints)}) for {file}, found {recorded}. Import the table anew with a rig "
        f"file that says which columns these are:\n[model]\nmujoco = {toml_value(file)}\n[channels]\n{lines}"
    )


def propose_rig_file(file: str, available: Names, inputs: Sequence[str], outputs: Sequence[str]) -> str:
    """Return a rig file that maps the most similar names; empty where there are no names to map."""
    measured = [name for name in available.sensors if name] or list(available.joints)
    input_pairs = _match_names(inputs, available.actuators or available.joints)
    output_pairs = _match_names(outputs, measured)
    if not input_pairs or not output_pairs:
        return ""
    return (
        " Perhaps, in a rig file (check that each is what it says):\n"
        f"[model]\nmujoco = {toml_value(file)}\n"
        f"inputs = {_toml_table(input_pairs)}\noutputs = {_toml_table(output_pairs)}"
    )


def _match_names(signals: Sequence[str], names: Sequence[str]) -> dict[str, str]:
    """Pair signals with names, the most similar first, each once."""
    similarities = sorted(
        (
            (_similarity(signal, name), -i, -j)
            for i, signal in enumerate(signals)
            for j, name in enumerate(names)
        ),
        reverse=True,
    )
    pairs: dict[str, str] = {}
    for _, i, j in similarities:
        signal, name = signals[-i], names[-j]
        if signal not in pairs and name not in pairs.values():
            pairs[signal] = name
    return pairs


def _similarity(first: str, second: str) -> float:
    return SequenceMatcher(None, first.lower(), second.lower()).ratio()


def _toml_table(pairs: dict[str, str]) -> str:
    return "{ " + ", ".join(f"{signal} = {toml_value(name)}" for signal, name in pairs.items()) + " }"

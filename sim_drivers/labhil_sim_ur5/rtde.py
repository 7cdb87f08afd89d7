"""Port 30004: one client's conversation, its recipes and its data packages."""

from __future__ import annotations

import struct
from collections.abc import Callable, Mapping

from labhil_sim_ur5.codec import (
    Command,
    Framer,
    Recipe,
    Value,
    data_package,
    package,
    split_names,
    text_package,
    type_list,
)
from labhil_sim_ur5.publish import TOOL
from labhil_sim_ur5.variables import Version, input_types, output_types

PROTOCOL = b"\x00\x02"
MOST_RECIPES = 255


class Variables:
    """What there is to read and to set, and which client has taken which input."""

    def __init__(self, version: Version) -> None:
        self.version = version
        self.outputs = output_types(version)
        self.inputs = input_types(version)
        self.taken: dict[str, Conversation] = {}


class Conversation:
    """One client of port 30004: bytes in, answers and inputs out."""

    def __init__(self, variables: Variables) -> None:
        self._variables = variables
        self._framer = Framer()
        self._inputs: list[Recipe | None] = []
        self._output: Recipe | None = None
        self._every = 1
        self._requests: Mapping[int, Callable[[bytes], bytes]] = {
            Command.PROTOCOL_VERSION: self._protocol,
            Command.CONTROLLER_VERSION: self._version,
            Command.OUTPUTS: self._setup_outputs,
            Command.INPUTS: self._setup_inputs,
            Command.START: self._start,
            Command.PAUSE: self._pause,
        }
        self.started = False
        self.reads_tool = False
        self.ignored = 0
        """Data packages that did not fit their recipe."""
        self.received: list[Mapping[str, Value]] = []
        """What was set, in order; emptied by who takes it."""

    def receive(self, data: bytes) -> bytes:
        """Take bytes; return the answers. FramingError when they make no sense."""
        return b"".join(self._answer(command, payload) for command, payload in self._framer.packages(data))

    def due(self, tick: int) -> bool:
        """Tell whether this tick is one that the client wants to hear of."""
        return self.started and self._output is not None and tick % self._every == 0

    def sample(self, values: Mapping[str, Value]) -> bytes:
        """Return the data package for the values as they are."""
        assert self._output is not None
        return data_package(1, self._output.pack(values))

    def close(self) -> None:
        """Let go of all inputs."""
        taken = self._variables.taken
        for name in [name for name, by in taken.items() if by is self]:
            del taken[name]

    def _answer(self, command: int, payload: bytes) -> bytes:
        """Return the answer to one package; data and text have none."""
        if command == Command.DATA:
            self._take(payload)
            return b""
        if command == Command.TEXT:
            return b""
        handler = self._requests.get(command)
        if handler is None:
            return text_package(f"unknown command {command}")
        return package(command, handler(payload))

    def _protocol(self, payload: bytes) -> bytes:
        return bytes([payload == PROTOCOL])

    def _version(self, _payload: bytes) -> bytes:
        version = self._variables.version
        return struct.pack(">4I", version.major, version.minor, version.bugfix, version.build)

    def _start(self, _payload: bytes) -> bytes:
        self.started = self._output is not None or bool(self._inputs)
        return bytes([self.started])

    def _pause(self, _payload: bytes) -> bytes:
        self.started = False
        return b"\x01"

    def _setup_outputs(self, payload: bytes) -> bytes:
        if len(payload) < 8:
            return type_list(0, ())
        frequency = struct.unpack_from(">d", payload)[0]
        names = split_names(payload[8:])
        types = [self._variables.outputs.get(name, "NOT_FOUND") for name in names]
        if "NOT_FOUND" in types or not names:
            self._output = None
            return type_list(0, types)
        rate = self._variables.version.rate
        self._every = max(round(rate / min(max(frequency, 1.0), rate)), 1)
        self._output = Recipe(names, tuple(types))
        self.reads_tool = any(name.startswith(TOOL) for name in names)
        return type_list(1, types)

    def _setup_inputs(self, payload: bytes) -> bytes:
        names = split_names(payload)
        types = [self._input_type(name) for name in names]
        good = bool(names) and not {"NOT_FOUND", "IN_USE"} & set(types) and len(self._inputs) < MOST_RECIPES
        # the client counts its recipes itself: a bad one has a number too
        self._inputs.append(Recipe(names, tuple(types)) if good else None)
        if good:
            self._variables.taken.update(dict.fromkeys(names, self))
        return type_list(len(self._inputs) if good else 0, types)

    def _input_type(self, name: str) -> str:
        kind = self._variables.inputs.get(name, "NOT_FOUND")
        by = self._variables.taken.get(name)
        return "IN_USE" if kind != "NOT_FOUND" and by is not None and by is not self else kind

    def _take(self, payload: bytes) -> None:
        number = payload[0] if payload else 0
        recipe = self._inputs[number - 1] if 0 < number <= len(self._inputs) else None
        if recipe is None or len(payload) - 1 < recipe.size:
            self.ignored += 1
            return
        # the client sends more than the recipe holds in one of its calls: what is over is no field
        self.received.append(recipe.unpack(payload[1:]))

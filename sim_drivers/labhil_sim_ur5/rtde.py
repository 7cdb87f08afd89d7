"""RTDE port: the conversation with a client, its recipes and its data packages."""

from __future__ import annotations

import struct
from collections.abc import Callable, Mapping

from labhil_sim_ur5.codec import (
    Command,
    PackageParser,
    Recipe,
    Value,
    data_package,
    package,
    split_names,
    text_package,
    type_list,
)
from labhil_sim_ur5.publish import TOOL_PREFIXES
from labhil_sim_ur5.variables import Version, input_types, output_types

PROTOCOL = b"\x00\x02"
MAX_RECIPES = 255


class Variables:
    """Outputs and inputs of a controller with their types, and the owner of each input."""

    def __init__(self, version: Version) -> None:
        self.version = version
        self.outputs = output_types(version)
        self.inputs = input_types(version)
        self.owners: dict[str, Conversation] = {}


class Conversation:
    """The conversation with one client: bytes in, answers and inputs out."""

    def __init__(self, variables: Variables) -> None:
        self._variables = variables
        self._framer = PackageParser()
        self._inputs: list[Recipe | None] = []
        self._output: Recipe | None = None
        self._divider = 1
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
        """Inputs that the client has set, in order; the server empties it."""

    def receive(self, data: bytes) -> bytes:
        """Handle bytes, and return the answers.

        Raises:
            FramingError: The bytes are no packages.
        """
        return b"".join(self._answer(command, payload) for command, payload in self._framer.packages(data))

    def due(self, tick: int) -> bool:
        """Return whether this tick is sent to the client."""
        return self.started and self._output is not None and tick % self._divider == 0

    def sample(self, values: Mapping[str, Value]) -> bytes:
        """Return the data package of the values."""
        assert self._output is not None
        return data_package(1, self._output.pack(values))

    def close(self) -> None:
        """Release all inputs."""
        owners = self._variables.owners
        for name in [name for name, owner in owners.items() if owner is self]:
            del owners[name]

    def _answer(self, command: int, payload: bytes) -> bytes:
        """Return the answer to one package; data and text have none."""
        if command == Command.DATA:
            self._receive_inputs(payload)
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
        self._divider = max(round(rate / min(max(frequency, 1.0), rate)), 1)
        self._output = Recipe(names, tuple(types))
        self.reads_tool = any(name.startswith(TOOL_PREFIXES) for name in names)
        return type_list(1, types)

    def _setup_inputs(self, payload: bytes) -> bytes:
        names = split_names(payload)
        types = [self._input_type(name) for name in names]
        is_valid = (
            bool(names) and not {"NOT_FOUND", "IN_USE"} & set(types) and len(self._inputs) < MAX_RECIPES
        )
        # the client numbers its recipes itself, wrong ones included
        self._inputs.append(Recipe(names, tuple(types)) if is_valid else None)
        if is_valid:
            self._variables.owners.update(dict.fromkeys(names, self))
        return type_list(len(self._inputs) if is_valid else 0, types)

    def _input_type(self, name: str) -> str:
        kind = self._variables.inputs.get(name, "NOT_FOUND")
        owner = self._variables.owners.get(name)
        return "IN_USE" if kind != "NOT_FOUND" and owner is not None and owner is not self else kind

    def _receive_inputs(self, payload: bytes) -> None:
        number = payload[0] if payload else 0
        recipe = self._inputs[number - 1] if 0 < number <= len(self._inputs) else None
        if recipe is None or len(payload) - 1 < recipe.size:
            self.ignored += 1
            return
        # one of the client's calls sends more bytes than the recipe has; they are ignored
        self.received.append(recipe.unpack(payload[1:]))

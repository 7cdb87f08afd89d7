"""Everything that can go wrong, as one tree.

::

    LabhilError
    ├── UsageError                 exit 2: wrong use or bad input
    │   ├── OptionError            an option, or an argument in Python, with a value that it cannot have
    │   ├── UnknownNameError       a plugin, rig, term, signal or parameter that does not exist
    │   ├── MissingExtraError      an optional package is not installed
    │   ├── MissingBenchmarksError the project's benchmarks are not at hand
    │   ├── RigFileError           a rig file: missing key, misspelt key, wrong value
    │   ├── ExperimentFileError    an experiment file, likewise
    │   ├── TableError             a table to import: missing column, text, NaN, no rows
    │   ├── RecordingError         a recording: not MCAP, empty, cut, without the signals asked for
    │   ├── ModelFileError         a fit or diagnosis file that cannot stand for a model
    │   ├── CommandRefusedError    a command out of limits, not finite, stale or without the lease
    │   └── DeviceError            what a device, or the wire to it, did
    │       ├── ConnectError       the address does not exist or nobody answers there
    │       ├── ProtocolError      somebody answers, but does not speak our protocol
    │       ├── DeviceResetError   the device booted again in the middle of a run
    │       └── DeviceSilentError  the device stopped talking
    └── RunError                   exit 1: the run itself came to grief
        ├── LimitTrippedError      a sample left the limits of the rig file
        ├── InterlockError         a sample tripped an interlock of the rig file
        ├── WatchdogError          commands stopped in the middle of a step
        ├── ConditionError         a condition of the experiment file did not hold in time
        ├── HookError              a function that the experiment file names has failed
        ├── RunStoppedError        a person or a signal stopped the run
        ├── EmergencyStopError     the emergency stop was pressed
        ├── BusError               the bus or a process of ours failed
        ├── DiskFailedError        a result or a table could not be written: the disk is full or fails
        └── RecordingFailedError   the recording could not be written to its end

Every message says what was expected, what was found, and where. ``UsageError`` messages end up in
front of a person as they are, so they are whole sentences without a traceback.

Example:
    >>> import labhil as lh
    >>> try:
    ...     lh.read("nowhere.mcap")
    ... except lh.errors.RecordingError as error:
    ...     print(error)
    nowhere.mcap: cannot be read: there is no such file
"""

from __future__ import annotations

import difflib
from collections.abc import Iterable
from contextlib import suppress

DISTRIBUTIONS = ("labhil", "labhil-slim")
"""Names under which the same code is installed: with all that the demo needs, or with the core alone."""


def installed_as() -> str:
    """The distribution that this is a part of; "labhil" where it is none."""
    from importlib.metadata import PackageNotFoundError, distribution  # takes as long as all of this file

    for name in DISTRIBUTIONS:
        with suppress(PackageNotFoundError):
            return distribution(name).name
    return DISTRIBUTIONS[0]


class LabhilError(Exception):
    """The root of the tree; never raised itself."""

    exit_status = 1


class UsageError(LabhilError):
    """Wrong use or bad input."""

    exit_status = 2


class OptionError(UsageError):
    """A value that an option of a command, or an argument of a Python function of that name, cannot have.

    ``str`` names it as Python does, :attr:`on_command_line` as the command line does.
    """

    def __init__(self, option: str, message: str) -> None:
        super().__init__(f"{option.replace('-', '_')}{message}")
        self.on_command_line = f"--{option}{message}"


class UnknownNameError(UsageError):
    """A name that is not among the known ones."""

    def __init__(self, what: str, name: str, known: Iterable[str]) -> None:
        names = sorted(known)
        super().__init__(
            f"{what} {name!r} does not exist{suggestion(name, names)}; known: {', '.join(names) or 'none'}"
        )


class MissingExtraError(UsageError):
    """An optional package is not installed; raised by ``labhil.extras``."""

    def __init__(self, package: str, extra: str, purpose: str, note: str = "") -> None:
        command = f"pip install '{installed_as()}[{extra}]'"
        more = f" ({note})" if note else ""
        super().__init__(f"{purpose} needs the package {package!r}, which is not installed: {command}{more}")


class MissingBenchmarksError(UsageError):
    """The project's benchmarks, which are no part of the package, are not at hand."""

    def __init__(self, purpose: str) -> None:
        super().__init__(
            f"{purpose} is one of the project's benchmarks, which come with its source, not the package: "
            "expected labhil to be installed from a checkout that still exists; run `pip install .` in one"
        )


class RigFileError(UsageError):
    """A rig file that cannot be used."""


class ExperimentFileError(UsageError):
    """An experiment file that cannot be used."""


class TableError(UsageError):
    """A table that cannot be imported."""


class RecordingError(UsageError):
    """A recording that cannot be read, or does not hold what is asked of it."""


class ModelFileError(UsageError):
    """A fit or diagnosis file that cannot stand for a model."""


class CommandRefusedError(UsageError):
    """A command that a host refused; nothing was sent to the device."""


class DeviceError(UsageError):
    """What a device, or the wire to it, did."""


class ConnectError(DeviceError):
    """The address does not exist, or nobody answers there."""


class ProtocolError(DeviceError):
    """Somebody answers, but does not speak our protocol."""


class DeviceResetError(DeviceError):
    """The device booted again in the middle of a run."""


class DeviceSilentError(DeviceError):
    """The device stopped talking."""


class RunError(LabhilError):
    """The run itself came to grief."""


class LimitTrippedError(RunError):
    """A sample left the limits of the rig file."""


class InterlockError(RunError):
    """A sample tripped an interlock of the rig file."""


class WatchdogError(RunError):
    """Commands stopped in the middle of a step, as on a machine that is too busy to send them."""


class ConditionError(RunError):
    """A condition of the experiment file did not hold in time."""


class HookError(RunError):
    """A function of somebody's own that the experiment file names has failed."""


class RunStoppedError(RunError):
    """A person or a signal stopped the run."""


class EmergencyStopError(RunError):
    """The emergency stop was pressed."""


class BusError(RunError):
    """The bus or a process of ours failed."""


class DiskFailedError(RunError):
    """A file could not be written, because the disk is full or fails."""


class RecordingFailedError(RunError):
    """The recording could not be written to its end (disk full, disk too slow, device gone)."""


def suggestion(name: str, known: Iterable[str]) -> str:
    """Return ``" (did you mean 'x'?)"`` for the nearest known name, or an empty string."""
    near = difflib.get_close_matches(name, list(known), n=1)
    return f" (did you mean {near[0]!r}?)" if near else ""

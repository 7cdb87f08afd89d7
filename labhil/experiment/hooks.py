"""Hooks: functions of the user that a run calls before and after its steps."""

from __future__ import annotations

import importlib
import threading
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

from labhil.errors import ExperimentFileError, HookError, UsageError
from labhil.experiment.experiment import Experiment
from labhil.python_file import object_of

POLL_INTERVAL = 0.05
"""How often a run checks its devices while a hook runs, s."""
MAX_REASON_LENGTH = 500
"""Characters of an exception that the reason of a run repeats."""


@dataclass(frozen=True, slots=True)
class RunContext:
    """What a hook knows of its run.

    Args:
        moment: "before" the steps, with every device connected and in its safe state and every check done;
            or "after" them, however the run has ended, with every device in its safe state again.
        name: The name of the experiment.
        recording: Where the recording will be when the run is over; it is written until then.
        metadata: ``operator``, ``sample``, ``notes`` and ``tags`` of the experiment file.
        values: For each device the newest value of every column of its samples, SI units.
        error: Why the run failed; None before the steps, and where it has not failed.
        reason: Why the steps have ended, in words; empty before them.

    Example:
        A file ``lab.py`` beside the experiment file, which names it by ``hook = "lab.py:refuse_if_hot"``:

        >>> from pathlib import Path
        >>> import labhil as lh
        >>> def refuse_if_hot(run: lh.RunContext) -> None:
        ...     if run.moment == "before" and run.values["bench"]["winding_temperature"] > 60.0:
        ...         raise RuntimeError("the motor is too hot")
        >>> values = {"bench": {"winding_temperature": 71.0}}
        >>> refuse_if_hot(lh.RunContext("before", "two-sine", Path("two-sine.mcap"), {}, values))
        Traceback (most recent call last):
        RuntimeError: the motor is too hot
    """

    moment: Literal["before", "after"]
    name: str
    recording: Path
    metadata: Mapping[str, str | tuple[str, ...]]
    values: Mapping[str, Mapping[str, float]]
    error: Exception | None = None
    reason: str = ""


class Hook:
    """The function that ``hook`` of an experiment file names.

    Args:
        reference: ``"lab.py:tell"``, a file relative to that of the experiment, or ``"lab.hooks:tell"``, a
            module that Python can import.
        experiment: The experiment whose runs call it.
        timeout: How long the function may take, s.

    Raises:
        ExperimentFileError: There is no such function.
    """

    def __init__(self, reference: str, experiment: Experiment, timeout: float = 60.0) -> None:
        self._reference, self._timeout = reference, timeout
        try:
            function = _load_function(reference, experiment.path.parent)
        except UsageError as error:
            raise ExperimentFileError(f"{experiment.path}: experiment.hook: {error}") from error
        self._function: Callable[[RunContext], object] = function

    def call(self, context: RunContext, poll: Callable[[], None]) -> None:
        """Call the function in a thread of its own and wait for it.

        Args:
            context: What the function gets.
            poll: Is called repeatedly meanwhile; may raise the error that ends the run.

        Raises:
            HookError: The function has raised, or has not ended in time.
        """
        raised: list[BaseException] = []

        def work() -> None:
            try:
                self._function(context)
            except BaseException as error:  # noqa: BLE001 - a user's function may raise anything, also SystemExit
                raised.append(error)

        thread = threading.Thread(target=work, name="hook", daemon=True)
        thread.start()
        deadline = time.monotonic() + self._timeout
        while thread.is_alive():
            thread.join(POLL_INTERVAL)
            poll()
            if time.monotonic() > deadline:
                raise HookError(f"{self._description(context)} has not ended within {self._timeout:g} s")
        if raised:
            message = " ".join(f"{type(raised[0]).__name__}: {raised[0]}".split())[:MAX_REASON_LENGTH]
            raise HookError(f"{self._description(context)} failed: {message}") from raised[0]

    def _description(self, context: RunContext) -> str:
        return f"the hook {self._reference} {context.moment} the steps"


def load_hook(experiment: Experiment) -> Hook | None:
    """Return the hook of an experiment; None where it names none.

    Raises:
        ExperimentFileError: There is no such function.
    """
    reference = experiment.experiment.hook
    return None if reference is None else Hook(reference, experiment)


def _load_function(reference: str, folder: Path) -> Callable[[RunContext], object]:
    module_name, _, name = reference.rpartition(":")
    if module_name.endswith(".py"):
        function = object_of(reference, folder)
    else:
        try:
            module = importlib.import_module(module_name)
        except Exception as error:
            raise UsageError(
                f"expected a module that can be imported, or a file like lab.py:{name}, found "
                f"{module_name!r}: {type(error).__name__}: {error}"
            ) from error
        function = getattr(module, name, None)
    if not callable(function):
        raise UsageError(f"expected {reference!r} to be a function of one argument, found {function!r:.100}")
    return function

"""Functions of somebody's own that a run calls before its steps and after them."""

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

INTERVAL = 0.05
"""How often a run looks at its devices while a function is at work, s."""
LONGEST_REASON = 500
"""Characters of an exception that the reason of a run repeats."""


@dataclass(frozen=True, slots=True)
class RunContext:
    """What a hook is told of its run.

    Args:
        moment: "before" the steps, with every device connected and in its safe state and every check done;
            or "after" them, however the run has ended, with every device in its safe state again.
        name: The name of the experiment.
        recording: Where the recording will be when the run is over; it is written until then.
        metadata: ``operator``, ``sample``, ``notes`` and ``tags`` of the experiment file.
        values: For each device the newest value of every column of its samples, SI units.
        error: Why the run failed; None before the steps, and where it has not.
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
        stated: ``"lab.py:tell"``, a file relative to that of the experiment, or ``"lab.hooks:tell"``, a
            module that Python can import.
        experiment: Whose runs call it.
        limit: How long the function may take, s.

    Raises:
        ExperimentFileError: There is no such function.
    """

    def __init__(self, stated: str, experiment: Experiment, limit: float = 60.0) -> None:
        self._stated, self._limit = stated, limit
        try:
            function = _function_of(stated, experiment.path.parent)
        except UsageError as error:
            raise ExperimentFileError(f"{experiment.path}: experiment.hook: {error}") from error
        self._function: Callable[[RunContext], object] = function

    def call(self, context: RunContext, look: Callable[[], None]) -> None:
        """Call the function in a thread of its own and wait for it; ``look`` may raise what ends the run.

        Raises:
            HookError: The function has raised, or has not ended in time.
        """
        raised: list[BaseException] = []

        def work() -> None:
            try:
                self._function(context)
            except BaseException as error:  # noqa: BLE001 - somebody else's function: sys.exit() in it, too
                raised.append(error)

        thread = threading.Thread(target=work, name="hook", daemon=True)
        thread.start()
        deadline = time.monotonic() + self._limit
        while thread.is_alive():
            thread.join(INTERVAL)
            look()
            if time.monotonic() > deadline:
                raise HookError(f"{self._place(context)} has not ended within {self._limit:g} s")
        if raised:
            what = " ".join(f"{type(raised[0]).__name__}: {raised[0]}".split())[:LONGEST_REASON]
            raise HookError(f"{self._place(context)} failed: {what}") from raised[0]

    def _place(self, context: RunContext) -> str:
        return f"the hook {self._stated} {context.moment} the steps"


def _function_of(stated: str, folder: Path) -> Callable[[RunContext], object]:
    module_name, _, name = stated.rpartition(":")
    if module_name.endswith(".py"):
        function = object_of(stated, folder)
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
        raise UsageError(f"expected {stated!r} to be a function of one argument, found {function!r:.100}")
    return function

"""An unpacked FMU, and one interface to the calls of FMI 2 and FMI 3."""

from __future__ import annotations

import zipfile
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from ctypes import c_double
from pathlib import Path
from shutil import rmtree
from tempfile import mkdtemp
from typing import Any
from weakref import finalize

from labhil.bounds import refuse_claim
from labhil.errors import UsageError
from labhil.extras import load_optional

PURPOSE = "an FMU"
MODEL_EXCHANGE, CO_SIMULATION = "ModelExchange", "CoSimulation"
REAL_TYPES = ("Real", "Float64")
TOLERANCE = 1e-10
"""Relative tolerance of an FMU's own solver: accelerations are taken from short steps."""

MAX_EVENT_ITERATIONS = 100
"""Largest number of updates of discrete states at one instant."""


class FmuFile:
    """An unpacked FMU with its description.

    Args:
        path: The file.

    Raises:
        UsageError: The file is not as expected; the message states what was found.
    """

    def __init__(self, path: Path) -> None:
        fmpy = load_optional("fmpy", PURPOSE)
        self.path = path
        if not path.is_file():
            raise UsageError(f"expected the FMU {path}, found none")
        try:
            with zipfile.ZipFile(path) as packed:
                refuse_claim(
                    "the FMU", sum(part.file_size for part in packed.infolist()), path.stat().st_size
                )
            self.description: Any = fmpy.read_model_description(str(path))
            self._folder = mkdtemp(prefix="labhil-fmu-")
            finalize(self, rmtree, self._folder, ignore_errors=True)
            fmpy.extract(str(path), self._folder)
        except Exception as error:  # whatever a reader of ZIP and XML may say
            raise self.refusal("an FMU that fmpy reads", str(error)) from error
        version = str(self.description.fmiVersion)
        if version[:2] not in ("2.", "3."):
            raise self.refusal("FMI 2 or 3", f"FMI {version}")
        self.is_fmi3 = version.startswith("3.")
        kinds = {MODEL_EXCHANGE: self.description.modelExchange, CO_SIMULATION: self.description.coSimulation}
        offered = [kind for kind, stated in kinds.items() if stated is not None]
        if not offered:
            raise self.refusal("model exchange or co-simulation", "scheduled execution alone")
        self.kind = offered[0]

    def refusal(self, expected: str, found: str) -> UsageError:
        """Make the error with what was expected of this file and what was found."""
        return UsageError(f"{self.path}: expected {expected}, found {' '.join(found.split())[:300]}")

    def variables(self, causality: str) -> list[Any]:
        """Return the scalar real variables of a causality ("input".

        "output", "parameter"), in their order.
        """
        return [
            v
            for v in self.description.modelVariables
            if v.causality == causality and v.type in REAL_TYPES and not v.dimensions
        ]

    def instance(self) -> Any:
        """Make an instance; UsageError where the binary cannot run here."""
        simulation = load_optional("fmpy.simulation", PURPOSE)
        try:
            return simulation.instantiate_fmu(
                self._folder,
                self.description,
                fmi_type=self.kind,
                logger=_silent,
            )
        except Exception as error:  # fmpy raises Exception itself
            platform = load_optional("fmpy", PURPOSE).platform
            raise self.refusal(f"a binary that runs here ({platform})", str(error)) from error


@contextmanager
def convert_fmi_errors(file: FmuFile, what: str) -> Iterator[None]:
    """Turn an error of an FMU's call into UsageError; ``what`` is what was expected."""
    try:
        yield
    except Exception as error:
        if type(error).__name__ != "FMICallException":  # a class of fmpy, which need not be installed
            raise
        raise file.refusal(what, str(error)) from error


def _silent(*_: object) -> None:
    """Drop the log of an FMU: a failed call returns its status."""


class FmuInstance:
    """An instance of an FMU, FMI 2 or FMI 3."""

    def __init__(self, file: FmuFile) -> None:
        self._file, self._fmu, self._is_initialised = file, file.instance(), False

    def initialise(self, starts: Mapping[int, float]) -> None:
        """Reset and initialise the instance with these values, by value reference."""
        try:
            if self._is_initialised:
                self._fmu.reset()
            self._is_initialised = True
            self.write_values(list(starts), list(starts.values()))
            if self._file.is_fmi3:
                self._fmu.enterInitializationMode(tolerance=TOLERANCE, startTime=0.0)
            else:
                self._fmu.setupExperiment(tolerance=TOLERANCE, startTime=0.0)
                self._fmu.enterInitializationMode()
            self._fmu.exitInitializationMode()
        except Exception as error:  # FMICallException is an Exception of fmpy
            raise self._file.refusal(
                "an FMU that is reset and initialised anew with its parameters", str(error)
            ) from error

    def write_values(self, references: Sequence[int], values: Sequence[float]) -> None:
        """Set real variables."""
        if references:
            write_values = self._fmu.setFloat64 if self._file.is_fmi3 else self._fmu.setReal
            write_values(list(references), list(values))

    def read_values(self, references: Sequence[int]) -> list[float]:
        """Read real variables."""
        get = self._fmu.getFloat64 if self._file.is_fmi3 else self._fmu.getReal
        return [float(x) for x in get(list(references))]


class ModelExchangeFmu(FmuInstance):
    """An FMU for model exchange: its states are set, and its derivatives are read."""

    def __init__(self, file: FmuFile, drive: int, *, with_events: bool) -> None:
        super().__init__(file)
        self._drive, self._with_events = drive, with_events
        self._x = (c_double * 2)()

    def initialise(self, starts: Mapping[int, float]) -> None:
        """Initialise, iterate the events, and enter continuous time."""
        super().initialise(starts)
        self._iterate_events()
        self._fmu.enterContinuousTimeMode()

    def states(self) -> tuple[float, ...]:
        """Read the two continuous states."""
        self._fmu.getContinuousStates(self._x, 2)
        return tuple(self._x)

    def rates(self, t: float, states: Sequence[float], drive: float) -> tuple[float, float]:
        """Return the derivatives of both states, with updated discrete states."""
        self.set_state(t, states, drive)
        if self._file.is_fmi3:
            self._fmu.getContinuousStateDerivatives(self._x, 2)
        else:
            self._fmu.getDerivatives(self._x, 2)
        return self._x[0], self._x[1]

    def set_state(self, t: float, states: Sequence[float], drive: float) -> None:
        """Set time, states and input, and iterate the events where the FMU has any."""
        self._fmu.setTime(t)
        self._x[0], self._x[1] = states
        self._fmu.setContinuousStates(self._x, 2)
        if self._with_events:
            self._fmu.enterEventMode()
        self.write_values([self._drive], [drive])
        if self._with_events:
            self._iterate_events()
            self._fmu.enterContinuousTimeMode()

    def _iterate_events(self) -> None:
        update = self._fmu.updateDiscreteStates if self._file.is_fmi3 else self._fmu.newDiscreteStates
        for _ in range(MAX_EVENT_ITERATIONS):
            if not update()[0]:
                return
        raise self._file.refusal(
            f"discrete states that settle within {MAX_EVENT_ITERATIONS} updates", "some that go on changing"
        )


class CoSimulationFmu(FmuInstance):
    """An FMU for co-simulation: its state is set at initialisation, then it makes steps."""

    def __init__(self, file: FmuFile, drive: int, pair: Sequence[int]) -> None:
        super().__init__(file)
        self._drive, self._pair, self._now = drive, list(pair), 0.0

    def states(self) -> tuple[float, ...]:
        """Read the two variables of the pair."""
        return tuple(self.read_values(self._pair))

    def start(self, starts: Mapping[int, float], states: Sequence[float], drive: float) -> None:
        """Restart at time 0 in a state."""
        self.initialise({**starts, **dict(zip(self._pair, states, strict=True)), self._drive: drive})
        self._now = 0.0

    def step(self, drive: float, length: float) -> tuple[float, ...]:
        """Make a step (s) under a held input; return the state after it."""
        self.write_values([self._drive], [drive])
        self._fmu.doStep(self._now, length)
        self._now += length
        return self.states()

    def try_step(self, drive: float, length: float) -> tuple[float, ...] | None:
        """Make a step like :meth:`step`; None where the FMU refuses it."""
        try:
            return self.step(drive, length)
        except Exception as error:
            if type(error).__name__ != "FMICallException":  # a class of fmpy, which need not be installed
                raise
            return None

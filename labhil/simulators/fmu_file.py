"""An FMU as it was unpacked: what it has by name, and its calls in FMI 2 and FMI 3 under one roof."""

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
EXCHANGE, CO_SIMULATION = "ModelExchange", "CoSimulation"
REAL = ("Real", "Float64")
TOLERANCE = 1e-10
"""Asked of a solver that an FMU brings: accelerations are taken from short steps."""

MOST_ROUNDS = 100
"""Of updates of discrete states at one instant."""


class FmuFile:
    """An unpacked FMU: its description, and how an instance of it is made.

    Args:
        path: The file.

    Raises:
        UsageError: What was expected of the file, and what was found.
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
        self.is_third = version.startswith("3.")
        kinds = {EXCHANGE: self.description.modelExchange, CO_SIMULATION: self.description.coSimulation}
        offered = [kind for kind, stated in kinds.items() if stated is not None]
        if not offered:
            raise self.refusal("model exchange or co-simulation", "scheduled execution alone")
        self.kind = offered[0]

    def refusal(self, expected: str, found: str) -> UsageError:
        """The error with what was expected of this file and what was found."""
        return UsageError(f"{self.path}: expected {expected}, found {' '.join(found.split())[:300]}")

    def variables(self, causality: str) -> list[Any]:
        """The scalar real variables of a causality ("input", "output", "parameter"), in their order."""
        return [
            v
            for v in self.description.modelVariables
            if v.causality == causality and v.type in REAL and not v.dimensions
        ]

    def instance(self) -> Any:
        """An instance of its own; UsageError where the binary cannot be run here."""
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
def answers(file: FmuFile, what: str) -> Iterator[None]:
    """Raises UsageError with the call that an FMU could not answer."""
    try:
        yield
    except Exception as error:
        if type(error).__name__ != "FMICallException":  # a class of fmpy, which need not be installed
            raise
        raise file.refusal(what, str(error)) from error


def _silent(*_: object) -> None:
    """Drops the log of an FMU: a failed call reports its status."""


class Calls:
    """What FMI 2 and FMI 3 call differently, and what both kinds of FMU need."""

    def __init__(self, file: FmuFile) -> None:
        self._file, self._fmu, self._is_begun = file, file.instance(), False

    def begin(self, starts: Mapping[int, float]) -> None:
        """Initialise the instance anew with these values, by value reference."""
        try:
            if self._is_begun:
                self._fmu.reset()
            self._is_begun = True
            self.put(list(starts), list(starts.values()))
            if self._file.is_third:
                self._fmu.enterInitializationMode(tolerance=TOLERANCE, startTime=0.0)
            else:
                self._fmu.setupExperiment(tolerance=TOLERANCE, startTime=0.0)
                self._fmu.enterInitializationMode()
            self._fmu.exitInitializationMode()
        except Exception as error:  # FMICallException is an Exception of fmpy
            raise self._file.refusal(
                "an FMU that is reset and initialised anew with its parameters", str(error)
            ) from error

    def put(self, references: Sequence[int], values: Sequence[float]) -> None:
        """Set real variables."""
        if references:
            put = self._fmu.setFloat64 if self._file.is_third else self._fmu.setReal
            put(list(references), list(values))

    def get(self, references: Sequence[int]) -> list[float]:
        """Read real variables."""
        get = self._fmu.getFloat64 if self._file.is_third else self._fmu.getReal
        return [float(x) for x in get(list(references))]


class Exchanged(Calls):
    """An FMU for model exchange: its states are set, and its derivatives are read."""

    def __init__(self, file: FmuFile, drive: int, *, with_events: bool) -> None:
        super().__init__(file)
        self._drive, self._with_events = drive, with_events
        self._x = (c_double * 2)()

    def begin(self, starts: Mapping[int, float]) -> None:
        """Initialise it, settle its events, and go over to continuous time."""
        super().begin(starts)
        self._settle()
        self._fmu.enterContinuousTimeMode()

    def states(self) -> tuple[float, ...]:
        """The two continuous states."""
        self._fmu.getContinuousStates(self._x, 2)
        return tuple(self._x)

    def rates(self, t: float, states: Sequence[float], drive: float) -> tuple[float, float]:
        """Derivatives of both states; discrete states are updated for them."""
        self.go_to(t, states, drive)
        if self._file.is_third:
            self._fmu.getContinuousStateDerivatives(self._x, 2)
        else:
            self._fmu.getDerivatives(self._x, 2)
        return self._x[0], self._x[1]

    def go_to(self, t: float, states: Sequence[float], drive: float) -> None:
        """Set time, states and input, and let events happen where the FMU has any."""
        self._fmu.setTime(t)
        self._x[0], self._x[1] = states
        self._fmu.setContinuousStates(self._x, 2)
        if self._with_events:
            self._fmu.enterEventMode()
        self.put([self._drive], [drive])
        if self._with_events:
            self._settle()
            self._fmu.enterContinuousTimeMode()

    def _settle(self) -> None:
        update = self._fmu.updateDiscreteStates if self._file.is_third else self._fmu.newDiscreteStates
        for _ in range(MOST_ROUNDS):
            if not update()[0]:
                return
        raise self._file.refusal(
            f"discrete states that settle within {MOST_ROUNDS} updates", "some that go on changing"
        )


class Stepping(Calls):
    """An FMU for co-simulation: its first state is set as it is initialised, then it makes steps."""

    def __init__(self, file: FmuFile, drive: int, pair: Sequence[int]) -> None:
        super().__init__(file)
        self._drive, self._pair, self._now = drive, list(pair), 0.0

    def states(self) -> tuple[float, ...]:
        """Position and velocity, or whatever the two variables are."""
        return tuple(self.get(self._pair))

    def start(self, starts: Mapping[int, float], states: Sequence[float], drive: float) -> None:
        """Begin anew at time 0 in a state."""
        self.begin({**starts, **dict(zip(self._pair, states, strict=True)), self._drive: drive})
        self._now = 0.0

    def step(self, drive: float, length: float) -> tuple[float, ...]:
        """Make a step (s) under an input; gives the state after it."""
        self.put([self._drive], [drive])
        self._fmu.doStep(self._now, length)
        self._now += length
        return self.states()

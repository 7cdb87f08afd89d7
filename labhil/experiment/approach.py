"""Before a run's clock starts: what has to stand where the steps begin; and how often a path is sent."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from labhil.driver import DriverSpec
from labhil.errors import RunError
from labhil.signals import Stream

LONGEST = 60.0
"""How long the way there may take, s of the device's clock."""
STEADY = 0.1
"""How long it has to stand there, s of the device's clock."""


class Approach:
    """Whether what ``spec.approach`` names has been where the command wants it, and is ready, for a while."""

    def __init__(self, spec: DriverSpec, stream: Stream) -> None:
        columns = stream.columns()
        self._near = {
            column: (columns.index(column), spec.approach[signal.name])
            for signal in spec.commands
            if signal.name in spec.approach
            for column in signal.columns()
        }
        self._ready = [(name, columns.index(name), value) for name, value in spec.ready.items()]
        self._wanted = max(1, round(STEADY * stream.rate))
        self._longest = round(LONGEST * stream.rate)
        self._steady = self._waited = 0

    def begin(self) -> None:
        """Look anew."""
        self._steady = self._waited = 0

    def is_there(self, requested: Mapping[str, float], values: Sequence[float]) -> bool:
        """Take the sample ``values`` in, and tell whether the clock may start; RunError when it never may."""
        if not self._near:
            return True
        missing = self._missing(requested, values)
        self._steady = 0 if missing else self._steady + 1
        self._waited += 1
        if missing and self._waited > self._longest:
            raise RunError(
                f"the device did not come to where the steps begin within {LONGEST:g} s: {missing}"
            )
        return self._steady >= self._wanted

    def _missing(self, requested: Mapping[str, float], values: Sequence[float]) -> str:
        """What is not as it has to be, in words."""
        for name, place, value in self._ready:
            if values[place] != value:
                return f"{name} is {values[place]:g}, expected {value:g}"
        for column, (place, near) in self._near.items():
            away = abs(values[place] - requested[column]) if column in requested else 0.0
            if not away <= near:
                return f"{column} is {away:.3g} away"
        return ""


class Waypoints:
    """When the next setpoint is due: at ``rate`` Hz of the device's clock, or (0) with every batch."""

    def __init__(self, rate: float) -> None:
        self.rate = rate
        self._due_ns: int | None = None

    def begin(self) -> None:
        """The next one is due at once."""
        self._due_ns = None

    def is_due(self, t_ns: int) -> bool:
        """Whether one is due at ``t_ns`` of the device's clock; it is taken for sent then."""
        if self.rate == 0.0:
            return True
        if self._due_ns is not None and t_ns < self._due_ns:
            return False
        period = round(1e9 / self.rate)
        # from one to the next, but not in a burst after a hole
        late = self._due_ns is None or t_ns - self._due_ns > period
        self._due_ns = t_ns + period if late or self._due_ns is None else self._due_ns + period
        return True

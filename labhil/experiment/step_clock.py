"""The clock of a device's steps: it runs with the device's, waits for ``when`` and jumps at ``until``."""

from __future__ import annotations

from collections import deque
from collections.abc import Sequence

from labhil.errors import ConditionError
from labhil.experiment.condition import Condition, values_in_words
from labhil.experiment.experiment import TimedStep


class StepClock:
    """Turns the device's time into that of the steps, ``elapsed`` s since they began.

    Args:
        steps: The steps of the device.
        columns: Names of the values of a sample, in their order.
    """

    def __init__(self, steps: Sequence[TimedStep], columns: Sequence[str]) -> None:
        self._columns = columns
        self._whens = [
            (timed, timed.step.when, timed.step.when.over(columns))
            for timed in steps
            if timed.step.when is not None
        ]
        self._untils = [
            (timed, timed.step.until.over(columns)) for timed in steps if timed.step.until is not None
        ]
        self._began: set[int] = set()
        self._zero_ns: int | None = None
        self._waits_since_ns: int | None = None
        self.elapsed = 0.0
        self.notes: deque[str] = deque()
        """What a condition has brought about, until the run has published it."""

    @property
    def is_going(self) -> bool:
        """Whether it runs or waits; not before its first sample, nor in a pause."""
        return self._zero_ns is not None

    @property
    def is_waiting(self) -> bool:
        """Whether it stands still because of a ``when``."""
        return self._waits_since_ns is not None

    def halt(self) -> None:
        """Stand still, however long, until the next :meth:`start`."""
        self._zero_ns = self._waits_since_ns = None

    def start(self, t_ns: int) -> None:
        """Go on where it was, at ``t_ns`` of the device's clock."""
        self._zero_ns = t_ns - round(self.elapsed * 1e9)

    def advance(self, t_ns: int, values: Sequence[float]) -> bool:
        """Take in a sample, and return whether what came before it counts no more for a controller.

        Raises:
            ConditionError: The condition of a step did not hold within its ``wait``.
        """
        assert self._zero_ns is not None
        self.elapsed = (t_ns - self._zero_ns) * 1e-9
        jumped = self._end_early(t_ns, values)
        return self._wait(t_ns, values) or jumped

    def _end_early(self, t_ns: int, values: Sequence[float]) -> bool:
        """Go to the end of a step whose condition holds."""
        jumped = False
        for timed, holds in self._untils:
            waits = timed.step.when is not None and timed.index not in self._began
            if waits or not timed.start <= self.elapsed < timed.end or not holds(values):
                continue
            self.notes.append(
                f"steps.{timed.index} ended at {self.elapsed - timed.start:.3f} s: {timed.step.until}"
            )
            self._set(timed.end, t_ns)
            jumped = True
        return jumped

    def _wait(self, t_ns: int, values: Sequence[float]) -> bool:
        """Stand still at the begin of a step whose condition does not hold yet."""
        for timed, condition, holds in self._whens:
            if timed.index in self._began or self.elapsed < timed.start:
                continue
            first = self._waits_since_ns is None
            since_ns = t_ns if self._waits_since_ns is None else self._waits_since_ns
            self._set(timed.start, t_ns)
            waited = (t_ns - since_ns) * 1e-9
            if holds(values):
                self._began.add(timed.index)
                self._waits_since_ns = None
                self.notes.append(f"steps.{timed.index} began after {waited:.3f} s: {condition}")
                return not first
            self._waits_since_ns = since_ns
            self._refuse_to_wait_longer(timed, condition, waited, values)
            if first:
                self.notes.append(f"steps.{timed.index} waits for {condition}, at most {timed.step.wait:g} s")
            return False
        return False

    def _refuse_to_wait_longer(
        self, timed: TimedStep, condition: Condition, waited: float, values: Sequence[float]
    ) -> None:
        if timed.step.wait is not None and waited >= timed.step.wait:
            readings = values_in_words(condition.names, self._columns, values)
            raise ConditionError(
                f"steps.{timed.index}.when: expected {condition} within {timed.step.wait:g} s, "
                f"found {readings}"
            )

    def _set(self, elapsed: float, t_ns: int) -> None:
        self._zero_ns = t_ns - round(elapsed * 1e9)
        self.elapsed = elapsed

"""The clock of a device's steps: it follows the device's clock, waits for ``when`` and jumps at ``until``."""

from __future__ import annotations

from collections import deque
from collections.abc import Sequence

from labhil.errors import ConditionError
from labhil.experiment.condition import Condition, format_values
from labhil.experiment.experiment import TimedStep


class StepClock:
    """Converts the device's time to that of the steps, ``elapsed`` s since they began.

    Args:
        steps: The steps of the device.
        columns: Names of the values of a sample, in their order.
    """

    def __init__(self, steps: Sequence[TimedStep], columns: Sequence[str]) -> None:
        self._columns = columns
        self._whens = [
            (timed, timed.step.when, timed.step.when.bind(columns))
            for timed in steps
            if timed.step.when is not None
        ]
        self._untils = [
            (timed, timed.step.until.bind(columns)) for timed in steps if timed.step.until is not None
        ]
        self._began: set[int] = set()
        self._zero_ns: int | None = None
        self._waits_since_ns: int | None = None
        self.elapsed = 0.0
        self.notes: deque[str] = deque()
        """Messages about steps that waited, began or ended early, until the run has published them."""

    @property
    def is_started(self) -> bool:
        """Whether it runs or waits; false before its first sample and in a pause."""
        return self._zero_ns is not None

    @property
    def is_waiting(self) -> bool:
        """Whether it stands still because of a ``when``."""
        return self._waits_since_ns is not None

    def halt(self) -> None:
        """Stand still until the next :meth:`start`."""
        self._zero_ns = self._waits_since_ns = None

    def start(self, t_ns: int) -> None:
        """Continue from ``elapsed`` at ``t_ns`` of the device's clock."""
        self._zero_ns = t_ns - round(self.elapsed * 1e9)

    def advance(self, t_ns: int, values: Sequence[float]) -> bool:
        """Advance to a sample.

        Args:
            t_ns: Time of the sample, ns of the device's clock.
            values: The sample, in the order of the columns.

        Returns:
            Whether the clock jumped, so that earlier samples make no derivative with this one.

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
            is_waiting = timed.step.when is not None and timed.index not in self._began
            if is_waiting or not timed.start <= self.elapsed < timed.end or not holds(values):
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
            is_first = self._waits_since_ns is None
            since_ns = t_ns if self._waits_since_ns is None else self._waits_since_ns
            self._set(timed.start, t_ns)
            waited = (t_ns - since_ns) * 1e-9
            if holds(values):
                self._began.add(timed.index)
                self._waits_since_ns = None
                self.notes.append(f"steps.{timed.index} began after {waited:.3f} s: {condition}")
                return not is_first
            self._waits_since_ns = since_ns
            self._check_wait(timed, condition, waited, values)
            if is_first:
                self.notes.append(f"steps.{timed.index} waits for {condition}, at most {timed.step.wait:g} s")
            return False
        return False

    def _check_wait(
        self, timed: TimedStep, condition: Condition, waited: float, values: Sequence[float]
    ) -> None:
        """Raise ConditionError where a step has waited ``wait`` s."""
        if timed.step.wait is not None and waited >= timed.step.wait:
            readings = format_values(condition.names, self._columns, values)
            raise ConditionError(
                f"steps.{timed.index}.when: expected {condition} within {timed.step.wait:g} s, "
                f"found {readings}"
            )

    def _set(self, elapsed: float, t_ns: int) -> None:
        self._zero_ns = t_ns - round(elapsed * 1e9)
        self.elapsed = elapsed

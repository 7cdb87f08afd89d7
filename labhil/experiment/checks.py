"""``[[checks]]``: conditions that have to hold before the steps begin or after they have ended."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from typing import Annotated, Literal

from pydantic import Field

from labhil.errors import ConditionError, suggestion
from labhil.experiment.condition import StatedCondition, format_values
from labhil.experiment.device_sections import Section

Seconds = Annotated[float, Field(gt=0, le=3600, allow_inf_nan=False)]


class CheckSection(Section):
    """``[[checks]]``: a condition that has to hold ``at`` "before" or "after" the steps.

    The device is in its safe state meanwhile. The condition has to hold for one sample within ``within`` s
    of the device's clock; otherwise the run ends as failed, and one whose check before the steps fails
    moves nothing. ``message`` says what to do then. ``device`` may be left out where there is only one.
    """

    at: Literal["before", "after"]
    condition: StatedCondition
    device: str | None = None
    within: Seconds = 5.0
    message: Annotated[str, Field(max_length=500)] = ""

    def refuse_unknown_device(self, place: str, devices: Collection[str]) -> None:
        """Raise ValueError unless ``device`` names one of ``devices``, or there is only one.

        Args:
            place: Where the check is in the file, for the message.
            devices: Names of the devices of the file.
        """
        if self.device is None and len(devices) > 1:
            raise ValueError(f"{place}.device: expected one of {', '.join(devices)}, found none")
        if self.device is not None and self.device not in devices:
            raise ValueError(f"{place}.device: {no_such_device(self.device, devices)}")


def no_such_device(name: str, devices: Collection[str]) -> str:
    """Return the message about a device that the file does not describe."""
    return f"no device {name!r}{suggestion(name, devices)}; known: {', '.join(devices)}"


class CheckWatch:
    """Watches the samples of one device until the condition of a check has held, or its time is over.

    Args:
        check: What has to hold.
        columns: Names of the values of a sample, in their order.
    """

    def __init__(self, check: CheckSection, columns: Sequence[str]) -> None:
        self._check, self._columns = check, columns
        self._holds = check.condition.bind(columns)
        self._until_ns: int | None = None
        self.has_held = False
        self.error: ConditionError | None = None

    def take(self, t_ns: int, values: Sequence[float]) -> None:
        """Take a sample, at ``t_ns`` of the device's clock."""
        if self.has_held or self.error is not None:
            return
        if self._until_ns is None:
            self._until_ns = t_ns + round(self._check.within * 1e9)
        self.has_held = self._holds(values)
        if not self.has_held and t_ns >= self._until_ns:
            self.error = ConditionError(self._failure_message(values))

    def _failure_message(self, values: Sequence[float]) -> str:
        check = self._check
        readings = format_values(check.condition.names, self._columns, values)
        advice = f": {check.message}" if check.message else ""
        return (
            f"the check {check.at} the steps failed{advice} (expected {check.condition} within "
            f"{check.within:g} s, found {readings})"
        )

"""Digital and analog outputs, and the speed slider: inputs of the protocol that take effect by a mask."""

from __future__ import annotations

from collections.abc import Mapping

from labhil_sim_ur5.codec import Value

_PLACES = {"standard_digital_output": 0, "configurable_digital_output": 8, "tool_digital_output": 16}
"""Where eight digital outputs stand in ``actual_digital_output_bits``."""
_SPANS = ((0.004, 0.016), (0.0, 10.0))
"""What 0 and 1 mean for an analog output of current (A) and of voltage (V): low and span."""


class Terminals:
    """What the controller puts out at its terminals."""

    def __init__(self, values: dict[str, Value]) -> None:
        self._values = values

    def receive(self, inputs: Mapping[str, Value]) -> float | None:
        """Take what a client has set; return the speed slider's new fraction when it was among it."""
        for name, place in _PLACES.items():
            mask = inputs.get(f"{name}_mask")
            if mask:
                self.set_bits(_whole(mask) << place, _whole(inputs.get(name, 0)) << place)
        mask = _whole(inputs.get("standard_analog_output_mask", 0))
        for number in (0, 1):
            if mask >> number & 1:
                voltage = _whole(inputs.get("standard_analog_output_type", 0)) >> number & 1
                self._set_analog(number, voltage, inputs.get(f"standard_analog_output_{number}", 0.0))
        slider = inputs.get("speed_slider_fraction", 1.0)
        if _whole(inputs.get("speed_slider_mask", 0)) & 1 and isinstance(slider, int | float):
            return float(slider)
        return None

    def set_bits(self, mask: int, bits: int) -> None:
        """Set the digital outputs in ``mask`` (bits 0–7 standard, 8–15 configurable, 16–17 tool)."""
        before = _whole(self._values["actual_digital_output_bits"])
        self._values["actual_digital_output_bits"] = before & ~mask | bits & mask

    def _set_analog(self, number: int, voltage: int, ratio: Value) -> None:
        low, span = _SPANS[voltage]
        share = min(max(float(ratio), 0.0), 1.0) if isinstance(ratio, int | float) else 0.0
        self._values[f"standard_analog_output{number}"] = low + span * share
        types = _whole(self._values["analog_io_types"])
        bit = 1 << (2 + number)
        self._values["analog_io_types"] = types & ~bit | (bit if voltage else 0)


def _whole(value: Value) -> int:
    return int(value) if isinstance(value, int | float) else 0

"""Digital and analog outputs, and the speed slider: inputs of the protocol with a mask."""

from __future__ import annotations

from collections.abc import Mapping

from labhil_sim_ur5.codec import Value

_OUTPUT_OFFSETS = {"standard_digital_output": 0, "configurable_digital_output": 8, "tool_digital_output": 16}
"""First bit of each group of digital outputs in ``actual_digital_output_bits``."""
_ANALOG_RANGES = ((0.004, 0.016), (0.0, 10.0))
"""Low end and span of an analog output of current (A) and of voltage (V)."""


class Terminals:
    """The outputs at the controller's terminals."""

    def __init__(self, values: dict[str, Value]) -> None:
        self._values = values

    def receive(self, inputs: Mapping[str, Value]) -> float | None:
        """Set outputs from a client; return the fraction of the speed slider, or None."""
        for name, offset in _OUTPUT_OFFSETS.items():
            mask = inputs.get(f"{name}_mask")
            if mask:
                self.set_bits(_as_int(mask) << offset, _as_int(inputs.get(name, 0)) << offset)
        mask = _as_int(inputs.get("standard_analog_output_mask", 0))
        for number in (0, 1):
            if mask >> number & 1:
                voltage = _as_int(inputs.get("standard_analog_output_type", 0)) >> number & 1
                self._set_analog(number, voltage, inputs.get(f"standard_analog_output_{number}", 0.0))
        slider = inputs.get("speed_slider_fraction", 1.0)
        if _as_int(inputs.get("speed_slider_mask", 0)) & 1 and isinstance(slider, int | float):
            return float(slider)
        return None

    def set_bits(self, mask: int, bits: int) -> None:
        """Set the digital outputs in ``mask`` (bits 0–7 standard, 8–15 configurable, 16–17 tool)."""
        previous = _as_int(self._values["actual_digital_output_bits"])
        self._values["actual_digital_output_bits"] = previous & ~mask | bits & mask

    def _set_analog(self, number: int, voltage: int, ratio: Value) -> None:
        low, span = _ANALOG_RANGES[voltage]
        fraction = min(max(float(ratio), 0.0), 1.0) if isinstance(ratio, int | float) else 0.0
        self._values[f"standard_analog_output{number}"] = low + span * fraction
        types = _as_int(self._values["analog_io_types"])
        bit = 1 << (2 + number)
        self._values["analog_io_types"] = types & ~bit | (bit if voltage else 0)


def _as_int(value: Value) -> int:
    return int(value) if isinstance(value, int | float) else 0

"""What the process of a shadow says, fixed: so that its screens can be compared."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

import numpy as np
from still import NOW_NS

BAND = 3.8


class StillHelper:
    """A process that has said all of it at once: a model that is right, then one output that it leaves."""

    def __init__(
        self, _name: str, module: str, told: Mapping[str, Any], on_line: Callable[[dict[str, Any]], object]
    ) -> None:
        self.running = True
        self.told = dict(told)
        assert module == "labhil.tui.shadow_process"
        on_line({"validated": "ball_beam_test.mcap"})
        for stretch in range(10):
            on_line(stretch_line(stretch, left=stretch >= 7))

    def send(self, _line: Mapping[str, Any]) -> None:
        """Take no notice."""

    def close(self, _patience: float = 0.0) -> None:
        """End."""
        self.running = False


def stretch_line(stretch: int, *, left: bool, dropped: float = 0.0) -> dict[str, Any]:
    """A line about one second; where the model has left it, its residual grows."""
    t = np.linspace(0.0, 0.99, 100)
    residual = 1.6 * np.sin(37.0 * t + stretch) * np.sin(91.0 * t)
    if left:
        residual += 9.0 * np.maximum(t - 0.4, 0.0) * (stretch - 6)
    output = {
        "name": "ball_position", "unit": "m", "noise": 0.00044, "band": BAND,
        "left_at": 9.7 if left else None, "left_ns": NOW_NS - 3_000_000_000 if left else None,
        "beyond": max(0.0, float(np.abs(residual).max()) - BAND) if left else 0.0,
        "t": np.round(t, 4).tolist(), "residual": np.round(residual, 2).tolist(),
    }  # fmt: skip
    begin = NOW_NS - 10_300_000_000 + stretch * 1_000_000_000
    return {
        "base_ns": begin, "ahead_ns": 0, "until": 3.0 + stretch, "outputs": [output], "dropped": dropped,
        "gaps": 0,
    }  # fmt: skip

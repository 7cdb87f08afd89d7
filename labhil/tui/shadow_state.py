"""The state of a live shadow, and its text on the screen."""

from __future__ import annotations

from collections import deque
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from rich.text import Text

from labhil.signals import FloatArray
from labhil.tui.formatting import format_duration

MOST_STRETCHES = 400
"""Stored stretches of each output: some minutes, more than any chart shows."""

SILENT_STRETCHES = 3.0
"""Time without a stretch after which the samples have stopped, in lengths of a stretch."""

SHORTEST_SILENCE = 2.0
"""Shortest such time, s."""


@dataclass(slots=True)
class ShadowedOutput:
    """Hold one output: its residual, and whether the model agrees.

    Attributes:
        name: Name of the output.
        unit: SI unit.
        noise: Standard deviation of its noise, in ``unit``.
        band: Bound of the residual, in noise levels.
        left_at: Time at which the residual left its band, s; None while the model agrees.
        left_ns: The same as Unix time, ns.
        beyond: Distance of the residual from its band, in noise levels.
        stretches: Unix time, times (n,) and residuals (n,) of each simulated stretch.
    """

    name: str
    unit: str
    noise: float
    band: float
    left_at: float | None
    left_ns: int | None
    beyond: float
    stretches: deque[tuple[int, FloatArray, FloatArray]] = field(
        default_factory=lambda: deque(maxlen=MOST_STRETCHES)
    )

    def residual(self, now_ns: int) -> tuple[FloatArray, FloatArray]:
        """Return the residual for a plot.

        Args:
            now_ns: Unix time, ns.

        Returns:
            Times (n,), s before now and negative, and residuals (n,); NaN between two stretches.
        """
        if not self.stretches:
            return np.empty(0), np.empty(0)
        t, y = [], []
        for base_ns, times, values in self.stretches:
            shift = (base_ns - now_ns) * 1e-9
            t += [times + shift, times[-1:] + shift]
            y += [values, np.array([np.nan])]
        return np.concatenate(t), np.concatenate(y)


@dataclass(slots=True)
class ShadowState:
    """Hold what the process of a shadow reports of ``device`` and of the file of its ``model``."""

    device: str
    model: str
    validated: str | None = None
    failed: str = ""
    unjudged: str = ""
    until: float = 0.0
    dropped: float = 0.0
    gaps: int = 0
    ahead_ns: int = 0
    outputs: dict[str, ShadowedOutput] = field(default_factory=dict)

    def handle_line(self, line: Mapping[str, Any]) -> None:
        """Update the state by a line of the process."""
        if "failed" in line:
            self.failed = str(line["failed"])
        elif "ended" in line:
            self.failed = self.failed or str(line["complaint"] or "the process that simulates has ended")
        elif "validated" in line:
            self.validated = str(line["validated"])
        elif "unjudged" in line:
            self.unjudged = str(line["unjudged"])
        elif "outputs" in line:
            self.unjudged = ""
            self.until, self.dropped = float(line["until"]), float(line["dropped"])
            self.gaps, self.ahead_ns = int(line["gaps"]), int(line["ahead_ns"])
            for output in line["outputs"]:
                self._update_output(output, int(line["base_ns"]))

    def _update_output(self, fields: Mapping[str, Any], base_ns: int) -> None:
        keys = ("name", "unit", "noise", "band", "left_at", "left_ns", "beyond")
        output = ShadowedOutput(**{key: fields[key] for key in keys})
        before = self.outputs.get(output.name)
        if before is not None:
            output.stretches = before.stretches
        if fields["t"]:
            output.stretches.append((base_ns, np.array(fields["t"]), np.array(fields["residual"])))
        self.outputs[output.name] = output

    @property
    def agrees(self) -> bool:
        """Whether the model explains all outputs."""
        return all(output.left_at is None for output in self.outputs.values())

    def silence(self, now_ns: int) -> float | None:
        """Return the time since the last stretch, s, where that is too long; else None."""
        newest = [output.stretches[-1] for output in self.outputs.values() if output.stretches]
        if not newest:
            return None
        base_ns, t, _ = newest[0]
        age = (now_ns - base_ns) * 1e-9 - float(t[-1])
        return age if age > max(SHORTEST_SILENCE, SILENT_STRETCHES * float(t[-1] - t[0])) else None

    def title(self, colours: Mapping[str, str], now_ns: int) -> Text:
        """Return the line with the name of the model and its agreement."""
        line = Text(no_wrap=True, overflow="ellipsis")
        if self.failed:
            line.append(f"✕ {self.failed}", style=f"bold {colours['error']}")
            return line
        line.append(f"Shadow of {self.device}", style="bold")
        line.append(f", {self.model}: ", style=colours["muted"])
        if not self.outputs:
            line.append("reads the model …" if self.validated is None else "waits for samples …")
        elif self.agrees:
            line.append("✓ agrees", style=f"bold {colours['success']}")
            line.append(f" ({self.until:.1f} s)", style=colours["muted"])
        else:
            line.append("✕ left its band", style=f"bold {colours['error']}")
            line.append(f" ({self.until:.1f} s)", style=colours["muted"])
        silence = self.silence(now_ns)
        if self.unjudged:
            line.append(f"  – not judged: {self.unjudged}", style=colours["warning"])
        elif silence is not None:
            line.append(f"  ◌ no samples for {format_duration(silence)}", style=f"bold {colours['warning']}")
        if self.dropped >= 0.1:
            line.append(f"  ! {self.dropped:.1f} s not simulated", style=f"bold {colours['warning']}")
        return line

    def rows(self, colours: Mapping[str, str], now_ns: int, *, wide: bool = True) -> list[Text]:
        """Return a line for each output: whether it agrees, or since when and by how much it does not."""
        return [_row(output, colours, now_ns, wide=wide) for output in self.outputs.values()]

    def about(self) -> str:
        """Return the origin of the band."""
        if self.validated is None:
            return ""
        return f"99.9 % of its errors on {self.validated}" if self.validated else "99.9 % of noise"


def _row(output: ShadowedOutput, colours: Mapping[str, str], now_ns: int, *, wide: bool) -> Text:
    """The line of one output; its band is left out where there is no room for it."""
    line = Text(no_wrap=True, overflow="ellipsis")
    line.append(f"  {output.name} ", style="bold")
    if output.left_at is None:
        line.append("agrees", style=colours["success"])
    else:
        line.append(f"left at {output.left_at:.1f} s", style=f"bold {colours['error']}")
        if output.left_ns is not None:
            line.append(f", {format_duration(max(0.0, (now_ns - output.left_ns) * 1e-9))} ago")
        line.append(f": × {output.beyond:.1f} noise levels beyond" if output.beyond else ": back within")
    if wide or output.left_at is None:
        line.append(f"  ± {output.band:.1f} × {output.noise:.2g} {output.unit}", style=colours["muted"])
    return line

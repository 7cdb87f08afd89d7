"""The shadow of a device in a process of its own: a model along what the device sends, while it sends it.

``python -m labhil.tui.shadowing`` reads ``{"endpoint", "device", "stream", "model"}`` first. It takes the
samples from the bus itself, so that the screen has nothing to do with them. It writes the origin of the band,
then a line for each simulated stretch, and the reason where it cannot go on.
"""

from __future__ import annotations

import os
import sys
import time
from collections.abc import Sequence
from contextlib import AbstractContextManager, suppress
from pathlib import Path

import numpy as np

from labhil.analysis.shadow import Shadow, Stretch, validated_bands
from labhil.api.diagnosis import Diagnosis
from labhil.api.fit import Fit
from labhil.api.saved import load
from labhil.bus.session import Bus, open_bus
from labhil.campaign.studies.process import read_further_lines, read_request, write_line
from labhil.errors import BusError, LabhilError, ModelFileError
from labhil.recording.reader import read_recording
from labhil.recording.recording import StreamData
from labhil.rig import RigFile, default_rig
from labhil.signals import FloatArray, IntArray, Stream
from labhil.tui.ring import envelope
from labhil.tui.stream_watch import KEPT, StreamWatch
from labhil.tui.watch import Watch

MODULE = "labhil.tui.shadowing"
LOOK = 0.1
"""How often the newest samples are taken, s."""

KNOCKS = 5
"""Attempts to open the bus."""

OVERLAP = 0.5
"""Extra time read before the new samples, since their stamps are not quite even, s."""

MOST_POINTS = 100
"""Pairs of smallest and largest residuals sent for a stretch: no screen has more columns for it."""


def validation_recording(model: Path, result: Fit | Diagnosis) -> tuple[RigFile, StreamData | None, str]:
    """The rig file of a result's recordings, the samples that it was judged on, and the name of their file.

    Without its recordings there is nothing but the rig kind.
    """
    sources = sorted(result.recordings, key=lambda source: source.role != "test")
    for source in sources:
        for path in (Path(source.path), model.parent / Path(source.path).name):
            if not path.is_file():
                continue
            recording = read_recording(path)
            if recording.rig is None:
                continue
            signals = {signal.name for signal in recording.rig.kind.outputs}
            data = next(
                (stream for stream in recording.streams if signals & set(stream.stream.names())), None
            )
            if data is not None:
                return recording.rig, data, path.name
    return default_rig(sources[0].rig), None, ""


class Follower:
    """Simulates the model along the new samples of a stream, and reports the residuals."""

    def __init__(self, model: Path, result: Fit | Diagnosis) -> None:
        self._saved = result.saved
        self._rig, self._validation, self.validated = validation_recording(model, result)
        self._bands: Sequence[float] | None = None
        if self._validation is not None:
            data = self._validation
            self._bands = validated_bands(self._saved, self._rig, data.stream, data.t, data.values)
        if self._bands is None:
            self.validated = ""
        self._shadow: Shadow | None = None
        self._stream: Stream | None = None
        self._begin = self._last = self._seen = 0
        self._left: dict[int, int] = {}

    def follow(self, watched: StreamWatch) -> None:
        """Simulate as much as there is; write a line for each stretch."""
        newest, _, _ = watched.ring.newest(0.0)
        if not len(newest):
            return
        seen_ns = int(newest[-1]) if self._shadow is None else self._seen
        self._seen = int(newest[-1])
        _, t_hw, values = watched.ring.newest(min(KEPT, (self._seen - seen_ns) * 1e-9 + OVERLAP))
        if self._shadow is None or watched.stream != self._stream or t_hw[-1] < self._last:
            self._stream = watched.stream
            self._shadow = Shadow(self._saved, self._rig, watched.stream, self._bands)
            self._begin, self._left = int(t_hw[0]), {}
            self._last = self._begin - 1
        new = t_hw > self._last
        if not new.any():
            return
        self._last = int(t_hw[-1])
        self._shadow.take(np.asarray((t_hw[new] - self._begin) * 1e-9, dtype=np.float64), values[new])
        while (stretch := self._shadow.step()) is not None:
            if not len(stretch.t):
                write_line({"unjudged": self._shadow.unjudged})
                continue
            t_acq, t_hw, _ = watched.ring.newest(KEPT)
            self._report(stretch, t_hw, t_acq, watched)

    def _report(self, stretch: Stretch, t_hw: IntArray, t_acq: IntArray, watched: StreamWatch) -> None:
        shadow = self._shadow
        assert shadow is not None
        t_device = (t_hw - self._begin) * 1e-9
        base_ns = int(t_acq[0])

        def wall_time(t: FloatArray) -> FloatArray:
            return np.asarray(np.interp(t, t_device, (t_acq - base_ns) * 1e-9))

        outputs = []
        for j, (name, unit, state) in enumerate(
            zip(stretch.names, stretch.units, shadow.agreements, strict=True)
        ):
            if state.left_at is None:
                self._left.pop(j, None)
            elif j not in self._left:
                self._left[j] = base_ns + round(float(wall_time(np.array([state.left_at]))[0]) * 1e9)
            x, y = envelope(wall_time(stretch.t), np.clip(stretch.residuals[:, j], -1e6, 1e6), MOST_POINTS)
            outputs.append(
                {
                    "name": name,
                    "unit": unit,
                    "noise": float(stretch.noise[j]),
                    "band": state.band,
                    "left_at": state.left_at,
                    "left_ns": self._left.get(j),
                    "beyond": min(state.beyond, 1e6),
                    "t": np.round(x, 4).tolist(),
                    "residual": np.round(np.nan_to_num(y, nan=1e6), 3).tolist(),
                }
            )
        write_line(
            {
                "base_ns": base_ns,
                "ahead_ns": watched.ahead_ns,
                "until": float(stretch.t[-1]),
                "outputs": outputs,
                "dropped": shadow.dropped,
                "gaps": shadow.gaps,
            }
        )


def _bus_at(endpoint: str) -> AbstractContextManager[Bus]:
    """Open the bus there; on a busy machine that may take several attempts. BusError where none answers."""
    for _ in range(KNOCKS - 1):
        with suppress(BusError):
            return open_bus(endpoint)
    return open_bus(endpoint)


def main() -> int:
    """Run the process; returns its exit status."""
    request = read_request()
    read_further_lines(lambda _line: None, lambda: os._exit(0))
    try:
        model = Path(str(request["model"]))
        result = load(model)
        if not isinstance(result, (Fit, Diagnosis)):
            raise ModelFileError(f"{model}: expected a fit or a diagnosis")
        follower = Follower(model, result)
        write_line({"validated": follower.validated})
        with _bus_at(str(request["endpoint"])) as bus, Watch(bus) as watch:
            while not (failure := watch.failure()):
                watched = watch.stream(str(request["device"]), str(request["stream"]))
                if watched is not None:
                    follower.follow(watched)
                time.sleep(LOOK)
            raise BusError(failure)
    except LabhilError as error:
        write_line({"failed": str(error)})
        return error.exit_status


if __name__ == "__main__":
    sys.exit(main())

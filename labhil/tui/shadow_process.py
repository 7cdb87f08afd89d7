"""The process of a live shadow: it simulates a model along the samples of a device while they come in.

``python -m labhil.tui.shadow_process`` reads ``{"endpoint", "device", "stream", "model"}`` first. It takes
the samples from the bus itself, so that the screen has nothing to do with them. It writes the origin of the
band, then a line for each simulated stretch, and the reason where it cannot go on.
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
from labhil.tui.bus_watch import BusWatch
from labhil.tui.ring_buffer import envelope
from labhil.tui.stream_watch import HISTORY, StreamWatch

MODULE = "labhil.tui.shadow_process"
SAMPLE_INTERVAL = 0.1
"""Time between two reads of the newest samples, s."""

CONNECTION_ATTEMPTS = 5
"""Attempts to open the bus."""

OVERLAP = 0.5
"""Extra time read before the new samples, s, since their stamps are uneven."""

MOST_POINTS = 100
"""Pairs of smallest and largest residuals that are sent for a stretch: no screen has more columns for it."""


def find_validation_recording(model: Path, result: Fit | Diagnosis) -> tuple[RigFile, StreamData | None, str]:
    """Find the data that a result was tested on, for the band of its residuals.

    Args:
        model: File of the result; recordings are also looked for beside it.
        result: The result.

    Returns:
        Rig file, samples, and name of the recording; the default rig, None and "" where none is found.
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


class StreamSimulator:
    """Simulate a model along the new samples of a stream, and write the residuals.

    Args:
        model: File of the result.
        result: The result.
    """

    def __init__(self, model: Path, result: Fit | Diagnosis) -> None:
        self._saved = result.saved
        self._rig, self._validation, self.validated = find_validation_recording(model, result)
        self._bands: Sequence[float] | None = None
        if self._validation is not None:
            data = self._validation
            self._bands = validated_bands(self._saved, self._rig, data.stream, data.t, data.values)
        if self._bands is None:
            self.validated = ""
        self._shadow: Shadow | None = None
        self._stream: Stream | None = None
        self._begin_hw_ns = self._last_hw_ns = self._last_acq_ns = 0
        self._left_ns: dict[int, int] = {}

    def follow(self, stream_watch: StreamWatch) -> None:
        """Simulate along the samples that have come in; write a line for each stretch."""
        latest, _, _ = stream_watch.ring.newest(0.0)
        if not len(latest):
            return
        seen_ns = int(latest[-1]) if self._shadow is None else self._last_acq_ns
        self._last_acq_ns = int(latest[-1])
        _, t_hw, values = stream_watch.ring.newest(
            min(HISTORY, (self._last_acq_ns - seen_ns) * 1e-9 + OVERLAP)
        )
        if self._shadow is None or stream_watch.stream != self._stream or t_hw[-1] < self._last_hw_ns:
            self._stream = stream_watch.stream
            self._shadow = Shadow(self._saved, self._rig, stream_watch.stream, self._bands)
            self._begin_hw_ns, self._left_ns = int(t_hw[0]), {}
            self._last_hw_ns = self._begin_hw_ns - 1
        new = t_hw > self._last_hw_ns
        if not new.any():
            return
        self._last_hw_ns = int(t_hw[-1])
        self._shadow.take(np.asarray((t_hw[new] - self._begin_hw_ns) * 1e-9, dtype=np.float64), values[new])
        while (stretch := self._shadow.step()) is not None:
            if not len(stretch.t):
                write_line({"unjudged": self._shadow.unjudged})
                continue
            t_acq, t_hw, _ = stream_watch.ring.newest(HISTORY)
            self._report(stretch, t_hw, t_acq, stream_watch)

    def _report(self, stretch: Stretch, t_hw: IntArray, t_acq: IntArray, stream_watch: StreamWatch) -> None:
        shadow = self._shadow
        assert shadow is not None
        t_device = (t_hw - self._begin_hw_ns) * 1e-9
        base_ns = int(t_acq[0])

        def wall_time(t: FloatArray) -> FloatArray:
            return np.asarray(np.interp(t, t_device, (t_acq - base_ns) * 1e-9))

        outputs = []
        for j, (name, unit, state) in enumerate(
            zip(stretch.names, stretch.units, shadow.agreements, strict=True)
        ):
            if state.left_at is None:
                self._left_ns.pop(j, None)
            elif j not in self._left_ns:
                self._left_ns[j] = base_ns + round(float(wall_time(np.array([state.left_at]))[0]) * 1e9)
            x, y = envelope(wall_time(stretch.t), np.clip(stretch.residuals[:, j], -1e6, 1e6), MOST_POINTS)
            outputs.append(
                {
                    "name": name,
                    "unit": unit,
                    "noise": float(stretch.noise[j]),
                    "band": state.band,
                    "left_at": state.left_at,
                    "left_ns": self._left_ns.get(j),
                    "beyond": min(state.beyond, 1e6),
                    "t": np.round(x, 4).tolist(),
                    "residual": np.round(np.nan_to_num(y, nan=1e6), 3).tolist(),
                }
            )
        write_line(
            {
                "base_ns": base_ns,
                "ahead_ns": stream_watch.ahead_ns,
                "until": float(stretch.t[-1]),
                "outputs": outputs,
                "dropped": shadow.dropped,
                "gaps": shadow.gaps,
            }
        )


def _open_bus(endpoint: str) -> AbstractContextManager[Bus]:
    """Open a bus; a busy machine may need several attempts. BusError where none answers."""
    for _ in range(CONNECTION_ATTEMPTS - 1):
        with suppress(BusError):
            return open_bus(endpoint)
    return open_bus(endpoint)


def main() -> int:
    """Run the process; return its exit status."""
    request = read_request()
    read_further_lines(lambda _line: None, lambda: os._exit(0))
    try:
        model = Path(str(request["model"]))
        result = load(model)
        if not isinstance(result, (Fit, Diagnosis)):
            raise ModelFileError(f"{model}: expected a fit or a diagnosis")
        follower = StreamSimulator(model, result)
        write_line({"validated": follower.validated})
        with _open_bus(str(request["endpoint"])) as bus, BusWatch(bus) as watch:
            while not (failure := watch.failure()):
                stream_watch = watch.stream(str(request["device"]), str(request["stream"]))
                if stream_watch is not None:
                    follower.follow(stream_watch)
                time.sleep(SAMPLE_INTERVAL)
            raise BusError(failure)
    except LabhilError as error:
        write_line({"failed": str(error)})
        return error.exit_status


if __name__ == "__main__":
    sys.exit(main())

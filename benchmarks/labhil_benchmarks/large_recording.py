"""A recording as large as one likes: a DC motor that was simulated, and what else a rig may measure of it."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from labhil.recording.writer import RecordingWriter
from labhil.signals import Batch, Direction, FloatArray, Signal, Stream

RATE = 1000.0
OTHERS = 19
"""Further channels, so that a sample takes some 200 bytes in the file."""

TONES = (0.11, 0.23, 0.57, 1.3)
BEGAN_NS = 1_760_000_000_000_000_000
BLOCK = 10_000
RIG = b"""
[rig]
kind = "dc_motor"
[known]
inertia = 0.1
"""
STREAM = Stream(
    "state",
    (
        Signal("voltage", "V", Direction.INPUT),
        Signal("speed", "rad/s", Direction.OUTPUT),
        Signal("current", "A", Direction.OUTPUT),
        Signal("strain", "1", Direction.OUTPUT, OTHERS),
    ),
    RATE,
)


def write_large(path: Path, samples: int, seed: int = 1) -> Path:
    """Write a recording of so many samples."""
    chance = np.random.default_rng(seed)
    writer = RecordingWriter(path, flush_interval=float("inf"))
    writer.attach("rig.toml", "application/toml", RIG)
    channel = writer.add_stream("bench", STREAM)
    speed = current = 0.0
    for first in range(0, samples, BLOCK):
        batch, speed, current = _block(first, min(BLOCK, samples - first), speed, current, chance)
        writer.write(channel, batch)
        writer.event("bench", BEGAN_NS + round(first * 1e9 / RATE), {"kind": "mark", "message": f"{first}"})
    return writer.finish("0", "all steps are done")


def _block(
    first: int, count: int, speed: float, current: float, chance: np.random.Generator
) -> tuple[Batch, float, float]:
    """Samples of the motor from where it stood; its next speed and current."""
    seq = np.arange(first, first + count, dtype=np.int64)
    t = seq / RATE
    voltage: FloatArray = 2.0 * np.sin(2.0 * np.pi * np.outer(t, TONES)).sum(axis=1)
    states: FloatArray = np.empty((count, 2))
    for row, volts in enumerate(voltage.tolist()):
        states[row] = speed, current
        pull = 0.5 * current - 0.05 * speed - 0.1 * (speed > 0) + 0.1 * (speed < 0)
        current += (volts - 1.0 * current - 0.5 * speed) / 0.01 / RATE
        speed += pull / 0.1 / RATE
    noisy = states + chance.normal(scale=(0.02, 0.01), size=(count, 2))
    values = np.column_stack([voltage, noisy, chance.normal(size=(count, OTHERS))])
    t_hw = np.round(t * 1e9).astype(np.int64)
    late = np.abs(chance.normal(scale=2e5, size=count)).astype(np.int64)
    return Batch(seq, BEGAN_NS + t_hw + late, t_hw, values), speed, current

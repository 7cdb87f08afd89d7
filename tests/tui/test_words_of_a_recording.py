"""Operator, sample, notes and tags of a recording are on the screen, as they were written."""

from __future__ import annotations

import asyncio
import json
import sys
from pathlib import Path

import numpy as np
import pytest

from labhil.recording.writer import RecordingWriter
from labhil.signals import Batch
from labhil.tui.app import LabApp

sys.path.insert(0, str(Path(__file__).parent))

from still import STATE, StillLab

SETTLED = 0.15
START_NS = 1_780_000_000_000_000_000
WORDS = {
    "name": "levels",
    "operator": "Ada",
    "sample": "steel ball 3",
    "notes": "after \x1b[31mlunch,\nthe [red]lamp[/] was on",
    "tags": json.dumps(["cold", "new belt"]),
}


def write(path: Path) -> None:
    kept = np.arange(50)
    t_ns = START_NS + kept * 10_000_000
    with RecordingWriter(path) as writer:
        channel = writer.add_stream("bench", STATE)
        writer.write(channel, Batch(kept, t_ns, t_ns, np.zeros((50, 2))))
        writer.metadata("experiment", WORDS)
        writer.finish("0", "all steps are done")


def shown(folder: Path, *keys: str) -> str:
    async def go() -> str:
        app = LabApp(folder, StillLab(), tab="recordings")  # type: ignore[arg-type]
        async with app.run_test(size=(80, 30)) as pilot:
            for key in ("home", *keys):
                await pilot.pause(SETTLED)
                await app.workers.wait_for_complete()
                await pilot.press(key)
            await pilot.pause(SETTLED)
            await app.workers.wait_for_complete()
            await pilot.pause(SETTLED)
            strips = app.screen._compositor.render_strips()
            return "\n".join("".join(segment.text for segment in strip) for strip in strips)

    return asyncio.run(go())


@pytest.mark.parametrize("keys", [(), ("enter",)])
def test_the_words_are_shown(keys: tuple[str, ...], tmp_path: Path) -> None:
    write(tmp_path / "levels.mcap")
    text = shown(tmp_path, *keys)
    assert "\x1b" not in text
    lines = [line.strip() for line in text.splitlines()]
    assert "operator: Ada" in lines
    assert "sample: steel ball 3" in lines
    assert "tags: cold, new belt" in lines
    notes = " ".join(line for line in lines if "lunch" in line or "lamp" in line)
    assert "the [red]lamp[/] was on" in notes


def test_a_recording_without_words_has_no_empty_lines(folder: Path) -> None:
    assert "operator" not in shown(folder)

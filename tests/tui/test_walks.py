"""Keys in no order at all: whatever is pressed, the screen stands, and the emergency stop works.

``pytest -m by_hand tests/tui/test_walks.py`` makes all walks, which takes half an hour; ``LABHIL_WALKS=1234``
begins with that seed.
"""

from __future__ import annotations

import asyncio
import os
import random
import sys
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import pytest

from labhil.bus.incoming import ReplayMessage
from labhil.campaign.studies import jobs
from labhil.tui import analysis, clock, overlay, runner, shadow
from labhil.tui.app import LabApp

sys.path.insert(0, str(Path(__file__).parent))

from still import NOW_NS, StillLab

FIRST = int(os.environ.get("LABHIL_WALKS", "0"))
STEPS = 25
SIZES = ((80, 24), (160, 50), (60, 15), (24, 6))
KEYS = (
    *"12345123451234512345",  # the tabs, often: other keys are for what they show
    *"abcdefghijklmnopqrstuvwxyz",
    *("up", "down", "left", "right", "pageup", "pagedown", "home", "end", "shift+left", "shift+right"),
    *("enter", "enter", "space", "space", "tab", "tab", "shift+tab", "escape", "escape", "escape"),
    *("plus", "minus", "comma", "full_stop", "delete", "backspace", "question_mark"),
    *("f9", "f12", "ctrl+e", "ctrl+p", "ctrl+t"),
)


class QuietHelper:
    """A process that has been asked for work and says nothing; what real ones say is tested elsewhere."""

    def __init__(
        self, _name: str, _module: str, _told: Mapping[str, Any], _on_line: Callable[[dict[str, Any]], object]
    ) -> None:
        self.running = True

    def send(self, _line: Mapping[str, Any]) -> None:
        """Take no notice."""

    def close(self, _patience: float = 0.0) -> None:
        """End."""
        self.running = False


@pytest.fixture(autouse=True)
def nothing_heavy(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(clock, "clock_ns", lambda: NOW_NS)
    for module in (jobs, analysis, overlay, runner, shadow):
        monkeypatch.setattr(module, "Helper", QuietHelper)


async def walk(folder: Path, seed: int) -> None:
    """Press keys that the seed draws; then the emergency stop, which has to reach the lab."""
    drawn = random.Random(seed)
    lab = StillLab(empty=drawn.random() < 0.2)
    if drawn.random() < 0.2:
        lab.replay = ReplayMessage(
            path="run.mcap", position=1.0, duration=60.0, speed=1.0, paused=False, ended=False
        )
    app = LabApp(folder, lab)  # type: ignore[arg-type]
    async with app.run_test(size=drawn.choice(SIZES)) as pilot:
        for _ in range(STEPS):
            await pilot.press(drawn.choice(KEYS))
            if drawn.random() < 0.1:
                await pilot.resize_terminal(*drawn.choice(SIZES))
            if not app.is_running or app._exit:
                return
        lab.latch = None
        await pilot.press("f12")
        await app.workers.wait_for_complete()
        assert lab.latch is not None, "the emergency stop has not reached the lab"


def make_walks(folder: Path, seeds: range) -> None:
    for seed in seeds:
        try:
            asyncio.run(walk(folder, seed))
        except BaseException as error:
            error.add_note(f"walk {seed}: LABHIL_WALKS={seed} pytest tests/tui/test_walks.py")
            raise


@pytest.mark.extended
def test_a_few_walks_do_no_harm(folder: Path) -> None:
    make_walks(folder, range(FIRST, FIRST + 3))


@pytest.mark.by_hand
@pytest.mark.timeout(1800)
@pytest.mark.parametrize("part", range(20))
def test_five_hundred_walks_do_no_harm(folder: Path, part: int) -> None:
    make_walks(folder, range(FIRST + 25 * part, FIRST + 25 * part + 25))

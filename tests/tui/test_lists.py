"""Lists: what they say is not said by colour alone."""

from __future__ import annotations

import asyncio
import sys
from pathlib import Path

from labhil.tui.app import LabApp
from labhil.tui.lists import LabSelection

sys.path.insert(0, str(Path(__file__).parent))

from still import StillLab

SETTLED = 0.15


def test_signals_that_are_on_and_off_have_different_signs(folder: Path) -> None:
    async def go() -> list[str]:
        app = LabApp(folder, StillLab(), tab="live")  # type: ignore[arg-type]
        async with app.run_test(size=(120, 40)) as pilot:
            for key in ("down", "space"):
                await pilot.pause(SETTLED)
                await pilot.press(key)
            await pilot.pause(SETTLED)
            selection = app.query_one("#live-signals", LabSelection)
            return [selection.render_line(row).text.strip() for row in range(3)]

    first, second, below = asyncio.run(go())
    assert first.startswith("▐○▌ ball_position")
    assert second.startswith("▐✓▌ servo_angle")
    assert below == ""

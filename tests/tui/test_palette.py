"""The command palette of the terminal UI."""

from __future__ import annotations

import asyncio

from textual.app import App
from textual.command import CommandList

from labhil.tui.palette import Palette


class WithPalette(App[None]):
    """A program that has nothing but the palette."""

    def action_command_palette(self) -> None:
        self.push_screen(Palette())


def test_a_search_that_begins_as_the_palette_is_left_ends_nothing() -> None:
    async def leave_while_it_searches() -> bool:
        app = WithPalette()
        async with app.run_test() as pilot:
            await pilot.press("ctrl+p")
            await pilot.pause()
            palette = app.screen
            assert isinstance(palette, Palette)
            palette._gather_commands("x")  # begins with the next turn of the loop, when the list is gone
            await palette.query(CommandList).remove()
            await pilot.pause(0.2)
            return app.is_running

    assert asyncio.run(leave_while_it_searches())

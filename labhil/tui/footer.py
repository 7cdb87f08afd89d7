"""The keys of what is in front, in the last row."""

from __future__ import annotations

from textual.screen import Screen
from textual.widgets import Footer


class KeyFooter(Footer):
    """A footer that is built anew only where other keys are to be shown, and once for many changes.

    A change of the pane announces its keys half a dozen times, each with all widgets of the footer.
    """

    def __init__(self) -> None:
        super().__init__(show_command_palette=False)
        self._shown: tuple[tuple[str, str, str, bool], ...] = ()
        self._waits = False

    def bindings_changed(self, screen: Screen[object]) -> None:
        """Look at the keys once what is under way has been drawn."""
        self._bindings_ready = True
        if screen.app.app_focus and self.is_attached and screen is self.screen and not self._waits:
            self._waits = True
            self.call_after_refresh(self._show_keys)

    async def _show_keys(self) -> None:
        self._waits = False
        shown = tuple(
            (binding.key, binding.description, binding.action, enabled)
            for _, binding, enabled, _ in self.screen.active_bindings.values()
            if binding.show
        )
        if shown != self._shown:
            self._shown = shown
            await self.recompose()

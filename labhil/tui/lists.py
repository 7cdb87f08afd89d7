"""Lists and tables of the terminal UI: Textual's, at less cost where a tab is changed."""

from __future__ import annotations

from typing import Any

from textual.geometry import Region
from textual.scroll_view import ScrollView
from textual.strip import Strip
from textual.widgets import DataTable, OptionList, SelectionList


class _Rows(ScrollView):
    """Rows at the top, and nothing below them; its style follows the focus only where that is seen."""

    _styled_with_focus: bool | None = None

    def render_lines(self, crop: Region) -> list[Strip]:
        """The lines; those below the last row are drawn once."""
        used = max(1, self.virtual_size.height - round(self.scroll_y) + 1 - crop.y)
        if used >= crop.height:
            return super().render_lines(crop)
        lines = super().render_lines(Region(crop.x, crop.y, crop.width, used))
        return lines + lines[-1:] * (crop.height - used)

    def notify_style_update(self) -> None:
        """Remember for which focus the styles are."""
        super().notify_style_update()
        self._styled_with_focus = self.has_focus

    def watch_has_focus(self, has_focus: bool) -> None:
        """Take the styles of the focus, or not: what goes with its tab has the focus when it is back."""
        is_hidden = not all(node.display for node in self.ancestors_with_self)
        if has_focus != self._styled_with_focus and not (is_hidden and not has_focus):
            super().watch_has_focus(has_focus)


class LabTable(DataTable[Any], _Rows):
    """A table."""


class LabOptions(OptionList, _Rows):
    """A list to choose one of."""


class LabSelection(SelectionList[str], _Rows):
    """A list to choose several of."""

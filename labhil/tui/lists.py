"""Lists and tables of Textual, with less work when a tab is changed."""

from __future__ import annotations

from typing import Any

from rich.segment import Segment
from textual.geometry import Region
from textual.scroll_view import ScrollView
from textual.strip import Strip
from textual.widgets import DataTable, OptionList, SelectionList


class _Rows(ScrollView):
    """Draw the empty area below the rows once, and follow the focus only where it is visible."""

    _styled_with_focus: bool | None = None

    def render_lines(self, crop: Region) -> list[Strip]:
        """Return the lines; those below the last row are drawn once."""
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
        """Restyle for the focus, unless the tab is hidden: it has the focus again when it returns."""
        is_hidden = not all(node.display for node in self.ancestors_with_self)
        if has_focus != self._styled_with_focus and not (is_hidden and not has_focus):
            super().watch_has_focus(has_focus)


class LabTable(DataTable[Any], _Rows):
    """Show a table."""


class LabOptions(OptionList, _Rows):
    """Show a list to choose one of."""


class LabSelection(SelectionList[str], _Rows):
    """Show a list to choose several of; what is on and what is off have different signs."""

    ON, OFF = "✓", "○"

    def render_line(self, y: int) -> Strip:
        """Return a line; Textual has one sign for both, in two colours."""
        strip = super().render_line(y)
        row = self.scroll_offset.y + y
        if row >= self.option_count:
            return strip
        left, sign, *rest = strip
        text = self.ON if self.get_option_at_index(row).value in self.selected else self.OFF
        return Strip([left, Segment(text, sign.style), *rest])

"""The tabs and their panes, with cheap backgrounds."""

from __future__ import annotations

from collections.abc import Mapping
from typing import ClassVar

from textual.app import ComposeResult
from textual.containers import Vertical
from textual.events import Resize
from textual.geometry import Region
from textual.reactive import Reactive, reactive
from textual.strip import Strip
from textual.widget import Widget
from textual.widgets import Tab, Tabs

from labhil.tui.top_bar import WithBar

AROUND_TITLE = 4
"""Blanks around the title of a tab."""


class Backdrop(Widget):
    """Draw a background without border and content as copies of one line.

    Textual also draws what other widgets cover, line by line.
    """

    def render_lines(self, crop: Region) -> list[Strip]:
        """Return the background, with the terminal's filters applied."""
        line = Strip.blank(crop.width, self.visual_style.rich_style)
        background = self.background_colors[1]
        for line_filter in self.get_line_filters():
            line = line.apply_filter(line_filter, background)
        return [line] * crop.height


class LabScreen(WithBar, Backdrop):
    """Hold the tabs; it looks the same wherever the focus is."""

    focused: Reactive[Widget | None] = Reactive(None, repaint=False)


class Pane(Backdrop):
    """Fill a tab; the app refreshes the pane in front."""

    MAIN_WIDGET: ClassVar[str]
    """Selector of the widget that has the focus when the tab is opened."""

    def refresh_view(self) -> None:
        """Show the present state; called several times a second."""

    def refresh_list(self) -> None:
        """List the files of the folder again; called every few seconds."""


class TabbedPanes(Vertical, Backdrop):
    """Display one of several panes, with their tabs above.

    All are mounted; a hidden one takes no part in layouts.

    Args:
        panes: Title and pane, by the name of the tab.
        first: Name of the first tab in front.
    """

    active: reactive[str] = reactive("", init=False, repaint=False)
    """The name of the tab in front."""

    def __init__(self, panes: Mapping[str, tuple[str, Pane]], first: str) -> None:
        super().__init__(id="tabs")
        self._titles = {name: title for name, (title, _) in panes.items()}
        self.panes = {name: pane for name, (_, pane) in panes.items()}
        self.set_reactive(TabbedPanes.active, first)

    def compose(self) -> ComposeResult:
        """Lay out the row of tabs and the panes."""
        yield Tabs(*[Tab(title, id=name) for name, title in self._titles.items()], active=self.active)
        for name, pane in self.panes.items():
            pane.display = name == self.active
            yield pane

    def on_resize(self, _event: Resize) -> None:
        """Show the titles of the tabs in the new width."""
        self._fit_titles()

    def _fit_titles(self) -> None:
        """Show the titles in full, or beside the one in front only numbers where they have no room."""
        has_room = sum(len(title) + AROUND_TITLE for title in self._titles.values()) <= self.size.width
        for tab in self.query(Tab):
            title = self._titles[tab.id or self.active]
            shown = title if has_room or tab.id == self.active else title.partition(" ")[0]
            if tab.label_text != shown:
                tab.label = shown

    @property
    def front(self) -> Pane:
        """The pane in front."""
        return self.panes[self.active]

    def watch_active(self, before: str, active: str) -> None:
        """Bring a pane to the front, with one layout for both changes."""
        with self.app.batch_update(), self.prevent(Tabs.TabActivated):
            self.panes[before].display = False
            self.panes[active].display = True
            self.query_one(Tabs).active = active
            self._fit_titles()

    def on_tabs_tab_activated(self, event: Tabs.TabActivated) -> None:
        """Follow a tab that was clicked, or reached with the arrows."""
        event.stop()
        if event.tab.id is not None:
            self.active = event.tab.id

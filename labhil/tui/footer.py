"""The row of keys at the bottom of the screen."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import ClassVar

from rich.text import Text
from textual.app import RenderResult
from textual.events import Leave, MouseDown, MouseMove, MouseScrollDown, MouseScrollUp
from textual.screen import Screen
from textual.widget import Widget


@dataclass(frozen=True, slots=True)
class _ShownKey:
    """Hold a key of the row: label, description and binding."""

    key: str
    label: str
    description: str
    tooltip: str
    is_enabled: bool
    is_kept: bool
    """Whether it is shown however little room there is."""

    @property
    def width(self) -> int:
        """Columns, with the blanks around the label and after the description."""
        return len(self.label) + len(self.description) + 3


MORE = _ShownKey("", "…", "", "More keys: ? lists them, the wheel brings them here", True, True)
"""Stands for keys that have no room."""


class KeyFooter(Widget):
    """Show the bound keys in one line, which can be clicked.

    No key is cut. Where there is no room for all, those of the whole application and the way back stay, and
    the wheel brings the others.

    It is one widget. Textual's own footer has a widget for each key, which costs more than all else when
    the pane changes.
    """

    COMPONENT_CLASSES: ClassVar[set[str]] = {
        "key-footer--key",
        "key-footer--description",
        "key-footer--hover",
        "key-footer--disabled",
    }
    ALLOW_SELECT = False

    def __init__(self) -> None:
        super().__init__()
        self._keys: tuple[_ShownKey, ...] = ()
        self._hovered: _ShownKey | None = None
        self._first = 0
        self._update_is_pending = False

    def on_mount(self) -> None:
        """Follow changes of the keys."""
        self.screen.bindings_updated_signal.subscribe(self, self._schedule_update)

    def _schedule_update(self, screen: Screen[object]) -> None:
        """Update the keys after the next refresh: they change several times in a row."""
        if (
            screen.app.app_focus
            and self.is_attached
            and screen is self.screen
            and not self._update_is_pending
        ):
            self._update_is_pending = True
            self.call_after_refresh(self._update_keys)

    def _update_keys(self) -> None:
        self._update_is_pending = False
        keys = tuple(self._bound_keys())
        if keys != self._keys:
            self._keys, self._hovered, self._first = keys, None, 0
            self.tooltip = None
            self.refresh()

    def _bound_keys(self) -> Iterator[_ShownKey]:
        """The keys to show, one for each action."""
        actions = set()
        for node, binding, enabled, tooltip in self.screen.active_bindings.values():
            if binding.show and binding.action not in actions:
                actions.add(binding.action)
                label = self.app.get_key_display(binding)
                is_kept = node is self.app or binding.key == "escape"
                yield _ShownKey(binding.key, label, binding.description, tooltip, enabled, is_kept)

    def _visible_keys(self) -> Sequence[_ShownKey]:
        """The keys that have room, with a sign in the place of others."""
        room = self.size.width
        if sum(key.width for key in self._keys) <= room:
            return self._keys
        kept = [key for key in self._keys if key.is_kept]
        others = [key for key in self._keys if not key.is_kept]
        room -= sum(key.width for key in kept)
        visible = [MORE] if self._first else []
        for index, key in enumerate(others[self._first :], start=self._first + 1):
            reserve = MORE.width if index < len(others) else 0
            if sum(shown.width for shown in visible) + key.width + reserve > room:
                visible.append(MORE)
                break
            visible.append(key)
        return [*visible, *kept]

    def render(self) -> RenderResult:
        """Return the row of the visible keys."""
        line = Text(no_wrap=True, end="")
        key_style = self.get_component_rich_style("key-footer--key")
        text_style = self.get_component_rich_style("key-footer--description")
        for key in self._visible_keys():
            part = Text.assemble((f" {key.label} ", key_style), (f"{key.description} ", text_style))
            if key is self._hovered:
                part.stylize(self.get_component_rich_style("key-footer--hover"))
            if not key.is_enabled:
                part.stylize(self.get_component_rich_style("key-footer--disabled", partial=True))
            line.append_text(part)
        return line

    def _key_at(self, column: int) -> _ShownKey | None:
        right_edge = 0
        for key in self._visible_keys():
            right_edge += key.width
            if column < right_edge:
                return key
        return None

    def on_mouse_down(self, event: MouseDown) -> None:
        """Press the key under the pointer."""
        key = self._key_at(event.x)
        if key is None:
            return
        if key is MORE:
            self._scroll(-1 if event.x < MORE.width and self._first else 1)
        elif key.is_enabled:
            self.app.simulate_key(key.key)
        else:
            self.app.bell()

    def on_mouse_move(self, event: MouseMove) -> None:
        """Highlight the key under the pointer, and show its tooltip."""
        self._hover(self._key_at(event.x))

    def on_leave(self, _event: Leave) -> None:
        """Remove the highlight."""
        self._hover(None)

    def _hover(self, key: _ShownKey | None) -> None:
        if key is not self._hovered:
            self._hovered = key
            self.tooltip = None if key is None else key.tooltip or None
            self.refresh()

    def on_mouse_scroll_down(self, event: MouseScrollDown) -> None:
        """Show keys further right, where they have no room."""
        event.stop()
        self._scroll(1)

    def on_mouse_scroll_up(self, event: MouseScrollUp) -> None:
        """Show keys further left."""
        event.stop()
        self._scroll(-1)

    def _scroll(self, keys: int) -> None:
        is_at_end = MORE not in self._visible_keys()[1:]
        first = self._first if keys > 0 and is_at_end else max(self._first + keys, 0)
        if first != self._first:
            self._first = first
            self.refresh()

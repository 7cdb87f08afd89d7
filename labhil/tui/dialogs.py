"""Dialogs in the middle of the screen: a question, a choice, a line of text, a notice."""

from __future__ import annotations

from collections.abc import Sequence
from typing import ClassVar

from textual.app import ComposeResult
from textual.binding import Binding, BindingType
from textual.containers import Horizontal, Vertical
from textual.screen import ModalScreen
from textual.widgets import Button, Input, OptionList, Static
from textual.widgets.option_list import Option

from labhil.tui.top_bar import WithBar


class Confirm(ModalScreen[bool], WithBar):
    """Ask a question with two answers; the negative one has the focus, and Escape gives it."""

    BINDINGS: ClassVar[list[BindingType]] = [
        Binding("y", "answer(True)", "Yes", id="confirm.yes"),
        Binding("n,escape", "answer(False)", "No", id="confirm.no"),
    ]

    def __init__(self, question: str, yes: str, no: str, *, danger: bool = False) -> None:
        super().__init__()
        self._question, self._yes, self._no, self._danger = question, yes, no, danger

    def compose(self) -> ComposeResult:
        """Lay out the question and its answers."""
        with Vertical(classes="dialog"):
            yield Static(self._question, markup=False)
            with Horizontal(classes="dialog-buttons"):
                yield Button(f"{self._yes}  y", id="yes", variant="error" if self._danger else "primary")
                yield Button(f"{self._no}  n", id="no")

    def on_mount(self) -> None:
        """Focus the negative answer."""
        self.query_one("#no", Button).focus()

    def on_button_pressed(self, event: Button.Pressed) -> None:
        """Answer by a button."""
        self.dismiss(event.button.id == "yes")

    def action_answer(self, answer: bool) -> None:
        """Answer by a key."""
        self.dismiss(answer)


class Choose(ModalScreen[str | None], WithBar):
    """Choose one of several entries, or none.

    Args:
        title: Title of the dialog.
        choices: Keys and texts of the entries.
    """

    BINDINGS: ClassVar[list[BindingType]] = [Binding("escape", "leave", "Cancel", id="choose.cancel")]

    def __init__(self, title: str, choices: Sequence[tuple[str, str]]) -> None:
        super().__init__()
        self._title, self._choices = title, choices

    def compose(self) -> ComposeResult:
        """Lay out the list."""
        with Vertical(classes="dialog"):
            yield Static(self._title, markup=False)
            yield OptionList(*[Option(shown, id=key) for key, shown in self._choices], markup=False)
            yield Static("Enter chooses, Escape leaves", classes="dialog-note")

    def on_option_list_option_selected(self, event: OptionList.OptionSelected) -> None:
        """Return the chosen key."""
        self.dismiss(event.option.id)

    def action_leave(self) -> None:
        """Choose none."""
        self.dismiss(None)


class TextPrompt(ModalScreen[str | None], WithBar):
    """Ask for a line of text.

    Args:
        title: Title of the dialog.
        most: Largest number of characters.
    """

    BINDINGS: ClassVar[list[BindingType]] = [Binding("escape", "leave", "Cancel", id="write.cancel")]

    def __init__(self, title: str, most: int) -> None:
        super().__init__()
        self._title, self._most = title, most

    def compose(self) -> ComposeResult:
        """Lay out the line."""
        with Vertical(classes="dialog"):
            yield Static(self._title, markup=False)
            yield Input(max_length=self._most)
            yield Static("Enter records it, Escape leaves", classes="dialog-note")

    def on_input_submitted(self, event: Input.Submitted) -> None:
        """Return the text; None for an empty one."""
        event.stop()
        self.dismiss(event.value.strip() or None)

    def action_leave(self) -> None:
        """Return no text."""
        self.dismiss(None)


class Notice(ModalScreen[None], WithBar):
    """Show a text."""

    BINDINGS: ClassVar[list[BindingType]] = [Binding("escape,enter,q", "dismiss", "Close", id="tell.close")]

    def __init__(self, title: str, text: str) -> None:
        super().__init__()
        self._title, self._text = title, text

    def compose(self) -> ComposeResult:
        """Lay out title and text."""
        with Vertical(classes="dialog dialog-wide"):
            yield Static(self._title, classes="dialog-title", markup=False)
            yield Static(self._text, markup=False)
            yield Static("Escape closes", classes="dialog-note")

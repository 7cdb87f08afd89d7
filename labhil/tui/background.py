"""Work in a thread, so that the screen stays responsive."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from textual.app import App
from textual.dom import DOMNode
from textual.worker import Worker

OUT_OF_DATE = "The view of the devices is out of date; restart the terminal UI"


def work_in_background(
    node: App[Any] | DOMNode, work: Callable[[], object], what: str, group: str
) -> Worker[None]:
    """Do work in a thread, and show what it raises as an error.

    Args:
        node: The app or a widget; the work is cancelled with it.
        work: The work.
        what: Name of the work in an error message.
        group: Group of workers, as Textual understands it.
    """
    app = node if isinstance(node, App) else node.app

    def run() -> None:
        try:
            work()
        except BaseException as error:  # noqa: BLE001 - nobody waits for this thread: it would end in silence
            app.call_later(app.notify, f"{what} failed: {error!r}", severity="error", timeout=30.0)

    return node.run_worker(run, thread=True, group=group, exit_on_error=False)

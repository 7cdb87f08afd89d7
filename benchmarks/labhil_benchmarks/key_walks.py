"""Random walks over the keys of the terminal UI: nothing that a person presses may end it by accident."""

from __future__ import annotations

import random
import shutil
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from textual.pilot import Pilot

from labhil.tui.app import LabApp
from labhil.tui.session import Session

ALWAYS = (
    "up",
    "down",
    "left",
    "right",
    "tab",
    "shift+tab",
    "enter",
    "escape",
    "space",
    "1",
    "2",
    "3",
    "4",
    "5",
)
TYPED = ("a", "m", "x", "[", "]", "/", "\\", "backspace", "home", "end", "pageup", "pagedown", "ctrl+p", "?")
LEAVES = ("q", "ctrl+q", "ctrl+c")
"""Keys that leave the screen: pressed last, or not at all."""
SIZES = ((80, 24), (100, 30), (160, 50), (40, 10))
SHARE_OF_BINDINGS = 0.6
"""How often the next key is one that is bound where the walk is."""
SHARE_OF_SIZES = 0.03
WORKS = ("f", "d", "x", "v", "k")
"""Keys that may start a study, a process of its own each: pressed with the share below of their chances."""
SHARE_OF_WORK = 0.02


@dataclass(frozen=True, slots=True)
class Walk:
    """The keys of one walk, and how it crashed; empty where it did not."""

    seed: int
    keys: tuple[str, ...]
    crash: str = ""


async def walk(folder: Path, lab: Session, seed: int, length: int) -> Walk:
    """Press ``length`` random keys in a screen over ``folder``; ``enter`` starts no experiment.

    Args:
        folder: With recordings, results and experiments.
        lab: What the screen sees of devices.
        seed: Of the walk.
        length: Number of keys.
    """
    draw = random.Random(seed)
    pressed: list[str] = []
    app = LabApp(folder, lab)
    try:
        async with app.run_test(size=draw.choice(SIZES)) as pilot:
            await pilot.pause()
            for _ in range(length):
                if not app.is_running:
                    break
                await _step(pilot, draw, pressed)
    except Exception as error:  # noqa: BLE001 - whatever it is, it is what is looked for
        return Walk(seed, tuple(pressed), f"{type(error).__name__}: {error}")
    finally:
        app.close_everything()
    return Walk(seed, tuple(pressed))


async def _step(pilot: Pilot[None], draw: random.Random, pressed: list[str]) -> None:
    if draw.random() < SHARE_OF_SIZES:
        size = draw.choice(SIZES)
        pressed.append(f"<{size[0]}x{size[1]}>")
        await pilot.resize_terminal(*size)
        return
    avoid = set(LEAVES)
    if draw.random() > SHARE_OF_WORK:
        avoid.update(WORKS)
    app = pilot.app
    if isinstance(app, LabApp) and app.tab == "experiment":
        avoid.add("enter")
    bound = sorted(set(app.screen.active_bindings) - avoid)
    others = [key for key in (*ALWAYS, *TYPED) if key not in avoid]
    key = draw.choice(bound if bound and draw.random() < SHARE_OF_BINDINGS else others)
    pressed.append(key)
    await pilot.press(key)


def fill(folder: Path, recordings: Sequence[Path], results: Sequence[Path]) -> Path:
    """Make a folder as people have them: whole files, a broken one, one cut short, and names with markup."""
    folder.mkdir(parents=True, exist_ok=True)
    for file in (*recordings, *results):
        shutil.copy(file, folder / file.name)
    first = recordings[0].read_bytes()
    (folder / "cut[red].mcap").write_bytes(first[: len(first) // 2])
    (folder / "empty.mcap").write_bytes(b"")
    (folder / "broken.json").write_text('{"schema": "labhil.fit/1", "parameters": 3}', encoding="utf-8")
    (folder / "[bold]broken.toml").write_text('[experiment]\nname = "[/]"\n', encoding="utf-8")
    return folder

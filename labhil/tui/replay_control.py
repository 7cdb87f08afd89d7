"""The state line of a replay on the live page, and the keys that control it."""

from __future__ import annotations

from rich.text import Text

from labhil.bus.incoming import ReplayMessage
from labhil.errors import LabhilError
from labhil.service.replay import MAX_SPEED, MIN_SPEED
from labhil.tui.session import Session

SPEEDS = (0.1, 0.2, 0.5, 1.0, 2.0, 5.0, 10.0, 20.0, 50.0, 100.0)
JUMP_BACK = 10.0
"""Distance of a jump back, s of the recording."""


def replay_line(replay: ReplayMessage, colours: dict[str, str]) -> Text:
    """Return the recording that is played, its position, and the keys that work now."""
    sign, word = ("■", "ENDED") if replay.ended else ("‖", "PAUSED") if replay.paused else ("↻", "REPLAY")
    text = Text(no_wrap=True, overflow="ellipsis")
    text.append(f"{sign} {word} ", style=f"bold {colours['accent']}")
    text.append(f"{replay.position:.1f} of {replay.duration:.1f} s", style="bold")
    text.append(f" × {replay.speed:g}  ")
    key_hint = "p plays it again" if replay.ended else "p goes on" if replay.paused else "p pauses"
    text.append(f"{key_hint}, < > speed, j back  ", style=colours["muted"])
    return text.append(replay.path.removesuffix(".mcap"), style=colours["muted"])


def next_speed(speed: float, way: int) -> float:
    """Return the next round speed above (``way`` > 0) or below."""
    speeds = [s for s in SPEEDS if (s > speed * 1.001 if way > 0 else s < speed * 0.999)]
    chosen = speed if not speeds else speeds[0] if way > 0 else speeds[-1]
    return min(max(chosen, MIN_SPEED), MAX_SPEED)


def control_replays(session: Session, action: str, way: int = 0) -> str:
    """Apply a key to every replay in reach, and wait for the answers.

    Args:
        session: Reaches the replays.
        action: "toggle", "speed" or "back".
        way: Faster (1) or slower (−1).

    Returns:
        The error; empty where there was none.
    """
    for endpoint, replay in session.replays():
        try:
            if action == "toggle":
                is_held = replay.paused or replay.ended
                session.control_replay(endpoint, "play" if is_held else "pause")
            elif action == "speed":
                session.control_replay(endpoint, "speed", next_speed(replay.speed, way))
            else:
                session.control_replay(endpoint, "seek", max(replay.position - JUMP_BACK, 0.0))
        except LabhilError as error:
            return str(error)
    return ""

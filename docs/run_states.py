"""Draws the states of a run and their changes as an SVG, from the table that the run itself obeys."""

from __future__ import annotations

from html import escape

from labhil.experiment.control import TRANSITIONS, RunState

WIDTH, HEIGHT = 118, 40
PLACES = {
    RunState.IDLE: (80, 60),
    RunState.STARTING: (330, 60),
    RunState.RUNNING: (640, 60),
    RunState.PAUSED: (930, 60),
    RunState.STOPPING: (560, 260),
    RunState.ABORTING: (230, 260),
    RunState.FINISHED: (760, 430),
    RunState.FAILED: (395, 430),
}
"""Centres of the boxes, in pixels."""
ENDS = (RunState.STOPPING, RunState.ABORTING)
STYLE = (
    "text{font:14px sans-serif;fill:#222;text-anchor:middle;dominant-baseline:middle}"
    ".why{font-size:12px;paint-order:stroke;stroke:#fff;stroke-width:4px}"
    ".box{fill:#eef3fa;stroke:#35618e;stroke-width:1.5}.end{fill:#e9e9e9;stroke:#555}"
    ".way{fill:none;stroke:#666;stroke-width:1.3;marker-end:url(#tip)}"
)


def draw_run_states() -> str:
    """The SVG: a box for each state, an arrow with its cause for each change."""
    parts = [
        '<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 1020 480" role="img">',
        "<title>The states of a run, and what leads from one to another</title>",
        f"<style>{STYLE}</style>",
        '<defs><marker id="tip" viewBox="0 0 8 8" refX="8" refY="4" markerWidth="8" markerHeight="8" '
        'orient="auto"><path d="M0 0L8 4L0 8z" fill="#666"/></marker></defs>',
        '<rect width="1020" height="480" fill="#fff"/>',
    ]
    changes = [(a, b, why) for a, following in TRANSITIONS.items() for b, why in following.items()]
    parts += [_arrow(before, after, (after, before) in _pairs()) for before, after, _ in changes]
    parts += [_box(state) for state in RunState]
    parts += [_cause(before, after, why) for before, after, why in changes if after not in ENDS]
    for end in ENDS:
        causes = dict.fromkeys(word for _, after, why in changes if after is end for word in why.split(", "))
        x, y = PLACES[end]
        parts.append(_text(x, y - 70, ", ".join(causes)))
    return "\n".join([*parts, "</svg>"]) + "\n"


def _pairs() -> set[tuple[RunState, RunState]]:
    return {(before, after) for before, following in TRANSITIONS.items() for after in following}


def _box(state: RunState) -> str:
    x, y = PLACES[state]
    kind = "box" if TRANSITIONS[state] else "box end"
    return (
        f'<rect class="{kind}" x="{x - WIDTH // 2}" y="{y - HEIGHT // 2}" width="{WIDTH}" height="{HEIGHT}" '
        f'rx="6"/><text x="{x}" y="{y}">{escape(state.value)}</text>'
    )


def _line(before: RunState, after: RunState) -> tuple[float, float, float, float]:
    """From the edge of one box to the edge of the other, px."""
    (x0, y0), (x1, y1) = PLACES[before], PLACES[after]
    if y0 == y1:
        side = WIDTH / 2 if x1 > x0 else -WIDTH / 2
        return x0 + side, y0, x1 - side, y1
    aside = max(-0.4 * WIDTH, min(0.12 * (x0 - x1), 0.4 * WIDTH))
    return x0, y0 + HEIGHT / 2, x1 + aside, y1 - HEIGHT / 2


def _arrow(before: RunState, after: RunState, both_ways: bool) -> str:
    x0, y0, x1, y1 = _line(before, after)
    shift = (9 if x1 > x0 else -9) if both_ways else 0
    return f'<path class="way" d="M{x0:.0f} {y0 - shift:.0f}L{x1:.0f} {y1 - shift:.0f}"/>'


def _cause(before: RunState, after: RunState, why: str) -> str:
    x0, y0, x1, y1 = _line(before, after)
    x, y = 0.5 * (x0 + x1), 0.5 * (y0 + y1)
    if y0 == y1:
        return _text(x, y + (-22 if x1 > x0 else 22), why)
    lines = why.replace(", ", ",\n").split("\n")
    return "".join(_text(x, y + 16 * (row - 0.5 * (len(lines) - 1)), line) for row, line in enumerate(lines))


def _text(x: float, y: float, words: str) -> str:
    return f'<text class="why" x="{x:.0f}" y="{y:.0f}">{escape(words)}</text>'

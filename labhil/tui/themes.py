"""Two themes, for dark and for bright rooms, and the colours of curves in both."""

from __future__ import annotations

from textual.theme import Theme

DARK = Theme(
    name="lab-dark",
    primary="#62b6d6",
    secondary="#7d8fa3",
    accent="#e5b567",
    foreground="#dde4ec",
    background="#0f1318",
    surface="#151b22",
    panel="#1d252e",
    success="#84cc8f",
    warning="#e5b567",
    error="#f2777a",
    dark=True,
    variables={
        "muted": "#8a9aac",
        "frame": "#42505f",
        "curve-0": "#62b6d6",
        "curve-1": "#e5b567",
        "curve-2": "#84cc8f",
        "curve-3": "#d68fd6",
        "curve-4": "#f29b77",
        "curve-5": "#a9b1ff",
        "curve-measured": "#b8c3cf",
        "block-cursor-background": "#2d4a5a",
        "block-cursor-foreground": "#ffffff",
        "block-cursor-text-style": "none",
        "block-cursor-blurred-background": "#222d37",
        "footer-key-foreground": "#e5b567",
        "stop-background": "#9b1c24",
        "stop-foreground": "#ffffff",
    },
)

LIGHT = Theme(
    name="lab-light",
    primary="#00628f",
    secondary="#5a6b7c",
    accent="#8a5300",
    foreground="#18222d",
    background="#f4f6f8",
    surface="#ffffff",
    panel="#e4eaf0",
    success="#176b30",
    warning="#8a5300",
    error="#b3261e",
    dark=False,
    variables={
        "muted": "#566575",
        "frame": "#9aa8b6",
        "curve-0": "#00628f",
        "curve-1": "#b05f00",
        "curve-2": "#176b30",
        "curve-3": "#8a2f8a",
        "curve-4": "#b3261e",
        "curve-5": "#3f45b5",
        "curve-measured": "#445362",
        "block-cursor-background": "#cfe3ee",
        "block-cursor-foreground": "#0c141c",
        "block-cursor-text-style": "none",
        "block-cursor-blurred-background": "#dfe7ee",
        "footer-key-foreground": "#8a5300",
        "stop-background": "#b3261e",
        "stop-foreground": "#ffffff",
    },
)

CURVES = 6

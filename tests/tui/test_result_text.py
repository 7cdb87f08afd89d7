"""Results as text on the screen: nothing is cut, however narrow the pane."""

from __future__ import annotations

from collections import defaultdict
from pathlib import Path

import pytest
from rich.console import Console

from labhil.analysis.schema import FitPart
from labhil.tui.result_text import ParameterTableView

FIT = Path(__file__).parents[2] / "examples" / "fit.json"
REMARKS = ("not identifiable", "at its bound", "may be zero")


def drawn(width: int) -> str:
    part = FitPart.model_validate_json(FIT.read_text(encoding="utf-8"))
    changes = ({"identifiable": False}, {"at_bound": True}, {"significant": False}, {})
    rows = [
        row.model_copy(update={"ci99": (-1.2345e-3, 1.23456e-2), **changes[i % 4]})
        for i, row in enumerate(part.parameters)
    ]
    console = Console(width=width, no_color=True, force_terminal=False)
    with console.capture() as said:
        console.print(ParameterTableView(rows, defaultdict(lambda: "#ffffff")))
    return said.get()


@pytest.mark.parametrize("width", range(58, 161, 6))
def test_no_word_of_a_parameter_is_cut(width: int) -> None:
    text = drawn(width)
    part = FitPart.model_validate_json(FIT.read_text(encoding="utf-8"))
    assert "…" not in text
    assert all(remark in text for remark in REMARKS)
    for row in part.parameters:
        assert all(piece in text for piece in row.key.split("."))


def test_a_row_takes_one_line_where_there_is_room() -> None:
    rows = len(FitPart.model_validate_json(FIT.read_text(encoding="utf-8")).parameters)
    assert len(drawn(160).splitlines()) == rows + 1
    assert len(drawn(58).splitlines()) > rows + 1

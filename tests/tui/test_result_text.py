"""Results as text on the screen: nothing is cut, however narrow the pane."""

from __future__ import annotations

from collections import defaultdict
from pathlib import Path

import pytest
from rich.console import Console, RenderableType

from labhil.analysis.schema import ComparisonPart, FitPart
from labhil.report.comparison import format_estimate
from labhil.report.formatting import format_interval, format_percent, format_quantity
from labhil.tui.comparison_text import comparison_renderable
from labhil.tui.result_text import ParameterTableView, fit_text

FIT = Path(__file__).parents[2] / "examples" / "fit.json"
COMPARISON = Path(__file__).parent / "compared" / "ball_beam_identify.comparison.json"
REMARKS = ("not identifiable", "at its bound", "may be zero")


def drawn(width: int) -> str:
    part = FitPart.model_validate_json(FIT.read_text(encoding="utf-8"))
    changes = ({"identifiable": False}, {"at_bound": True}, {"significant": False}, {})
    rows = [
        row.model_copy(update={"ci99": (-1.2345e-3, 1.23456e-2), **changes[i % 4]})
        for i, row in enumerate(part.parameters)
    ]
    return capture(ParameterTableView(rows, defaultdict(lambda: "#ffffff")), width)


def capture(shown: RenderableType, width: int) -> str:
    console = Console(width=width, no_color=True, force_terminal=False)
    with console.capture() as said:
        console.print(shown)
    return said.get()


def spaced(text: str) -> str:
    """A text in one line; what keeps a number and its unit together counts as a blank."""
    return " ".join(text.split())


@pytest.mark.parametrize("width", range(28, 161, 6))
def test_no_word_of_a_parameter_is_cut(width: int) -> None:
    text = drawn(width)
    part = FitPart.model_validate_json(FIT.read_text(encoding="utf-8"))
    assert "…" not in text
    assert all(remark in spaced(text) for remark in REMARKS)
    for row in part.parameters:
        assert all(piece in text for piece in row.key.split("."))


@pytest.mark.parametrize("width", [30, 40, 56, 75, 120])
def test_no_figure_of_a_fit_is_cut(width: int) -> None:
    part = FitPart.model_validate_json(FIT.read_text(encoding="utf-8"))
    said = capture(fit_text(part, defaultdict(lambda: "#ffffff")), width)
    assert "…" not in said
    words = spaced(said)
    for row in part.parameters:
        assert spaced(format_quantity(row.value, row.unit)) in words
        assert spaced(format_interval(row.ci99)) in words
    for score in (part.test or part.train).per_channel:
        assert spaced(format_quantity(score.rmse, score.unit)) in words
        assert spaced(format_percent(score.r2)) in words


@pytest.mark.parametrize("width", [26, 56, 75, 120])
def test_no_figure_of_a_comparison_is_cut(width: int) -> None:
    part = ComparisonPart.model_validate_json(COMPARISON.read_text(encoding="utf-8"))
    said = capture(comparison_renderable(part, defaultdict(lambda: "#ffffff")), width)
    words = spaced(said)
    assert "…" not in words.replace("compare … --recording", "")
    for row in part.parameters:
        for model in part.models:
            assert spaced(format_estimate(row, model.name)) in words


@pytest.mark.parametrize("width", [40, 75, 120])
@pytest.mark.parametrize("verdict", [None, "explained", "unexplained"])
def test_a_fit_says_what_to_do_next_as_its_report_does(verdict: str | None, width: int) -> None:
    part = FitPart.model_validate_json(FIT.read_text(encoding="utf-8"))
    part = part.model_copy(update={"verdict": verdict})
    said = capture(fit_text(part, defaultdict(lambda: "#ffffff")), width).partition("What to do next")[2]
    assert part.next_steps
    assert "".join(said.split()) == "".join("".join(f"·{step}" for step in part.next_steps).split())


def test_a_row_takes_one_line_where_there_is_room() -> None:
    rows = len(FitPart.model_validate_json(FIT.read_text(encoding="utf-8")).parameters)
    assert len(drawn(160).splitlines()) == rows + 1
    assert len(drawn(58).splitlines()) > rows + 1


@pytest.mark.parametrize(("p", "said"), [(0.4, "residuals white with"), (1e-9, "residuals not white with")])
def test_residuals_are_not_called_white_where_that_is_refuted(p: float, said: str) -> None:
    part = FitPart.model_validate_json(FIT.read_text(encoding="utf-8"))
    part = part.model_copy(update={"residuals": part.residuals.model_copy(update={"ljung_box_p": p})})
    assert said in spaced(capture(fit_text(part, defaultdict(lambda: "#ffffff")), 120))

from __future__ import annotations

from pathlib import Path

from labhil.experiment.reference import page

PAGE = Path(__file__).parents[2] / "docs" / "reference" / "experiment-file.md"


def test_the_page_of_the_experiment_file_is_current() -> None:
    made_by = "python -m labhil.experiment.reference > docs/reference/experiment-file.md"
    assert PAGE.read_text(encoding="utf-8") == page(), made_by

"""The page of a diagnosis has a switch for each found term, as that of a comparison has for each model."""

from __future__ import annotations

import re

import numpy as np
import pytest

from labhil.analysis.dataset import load_dataset
from labhil.analysis.study import fit_study
from labhil.diagnose.locate import HeldOut, without_sizes
from labhil.identify.score import score
from labhil.identify.windows import noise_of
from labhil.report.html.picture import Album
from labhil.report.html.term_switches import term_switches


@pytest.mark.extended
def test_every_found_term_has_a_switch_and_a_line_that_differs(shipped):
    dataset = load_dataset(shipped / "ball_beam_identify.mcap", test_path=shipped / "ball_beam_test.mcap")
    terms = ["viscous_friction", "coulomb_friction", "stribeck_friction", "dead_zone"]
    final, record = fit_study(dataset, terms=terms).fit.fitted, dataset.test
    model = final.problem.model
    after = score(model, final.theta, record, noise_of(record))
    bare = without_sizes(model, without_sizes(model, final.theta, "dead_zone"), "coulomb_friction")
    before = score(model, bare, record, noise_of(record), windows=after.windows)
    found = term_switches(final, ["dead_zone", "coulomb_friction"], HeldOut(record, before, after), Album())
    assert found is not None
    page = found.text
    names = (
        "with all that was found",
        "baseline",
        "without dead_zone",
        "without coulomb_friction",
    )
    for number, name in enumerate(("measured", *names)):
        assert f'id="show-{number}"' in page
        assert f"</span>{name}</label>" in page
        assert len(re.findall(rf'id="f1-model-{number}-', page)) == (2 if number else 1)
    line = 'id="f1-model-{}-simulated.*? d="([^"]*)"'
    paths = [re.search(line.format(number), page, re.DOTALL) for number in (1, 3, 4)]
    lines = [path[1] for path in paths if path is not None]
    assert len(set(lines)) == 3
    assert not np.array_equal(before.errors, after.errors)
    assert term_switches(final, [], HeldOut(record, before, after), Album()) is None

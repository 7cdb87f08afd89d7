"""The search with the sizes of the user's model held: only where it can win, and no longer than it can."""

from __future__ import annotations

import sys
from dataclasses import replace
from pathlib import Path

import pytest

from labhil.diagnose.begin import fit_baseline, prepare_data
from labhil.diagnose.judge import Data
from labhil.diagnose.search_with_sizes import search_with_sizes
from labhil.diagnose.structures.stages import search_structures
from labhil.identify.fitted import Fitted
from labhil.physics.model import index_of

sys.path.insert(0, str(Path(__file__).parent))
from one_input_rigs import replay, staircase

pytestmark = pytest.mark.extended

BASELINE = ["viscous_friction"]
MASS, STATED = 95.0, 30.0
SAME = "the same with the sizes of the given model held"


@pytest.fixture(scope="module")
def data() -> Data:
    """A mass of 95 kg on dry friction; the user's model has 30 kg and no dry friction."""
    plants = [
        replay(
            "axis", staircase(10.0, 0.01, 0.25, 100.0, seed), [*BASELINE, "coulomb_friction"],
            {"moving_mass": MASS, "coulomb_friction.level": 15.0},
            noise={"position_noise": 1e-4}, seed=seed,
        )
        for seed in (1, 2)
    ]  # fmt: skip
    return prepare_data(plants[0].model, plants[0].record, plants[1].record, {"moving_mass": STATED})


@pytest.fixture(scope="module")
def free(data: Data) -> Fitted:
    """The fit with all sizes free, and the dry friction."""
    return search_structures(data, fit_baseline(data, BASELINE), lambda text: None).final


def searched(data: Data, reference: dict[str, float]) -> tuple[dict[str, float], set[str], list[str]]:
    """Estimates, named terms and lines of progress."""
    lines: list[str] = []
    found = search_with_sizes(
        data, fit_baseline(data, BASELINE), terms=BASELINE, reference=reference, accepted=None,
        progress=lines.append,
    )  # fmt: skip
    return dict(found.final.estimates), {step.terms[0] for step in found.missing}, lines


def test_a_wrong_mass_is_not_held_against_the_data(data: Data) -> None:
    estimates, named, lines = searched(data, {"moving_mass": STATED})
    assert named == {"coulomb_friction"}
    assert estimates["moving_mass"] == pytest.approx(MASS, rel=0.01)
    # one size saves no parameter beside the term that would replace it
    assert SAME not in lines


def test_a_search_ends_with_the_windows_that_speak_for_its_rival(data: Data, free: Fitted) -> None:
    # with the mass alone held, a gain of the sensor would stand for it
    drag = index_of(data.model.parameters)["viscous_friction.coefficient"]
    begin = data.begin.copy()
    begin[drag] = free.theta[drag]
    held = replace(data, begin=begin, held=frozenset({"moving_mass", "viscous_friction.coefficient"}))
    baseline, lines = fit_baseline(held, BASELINE), list[str]()
    lost = search_structures(held, baseline, lines.append, rival=free)
    assert lost.complete and lost.curve is None
    assert not any(line.startswith("a force over each coordinate") for line in lines)
    assert lost.final.window == pytest.approx(0.375 * data.model.horizon)
    assert lost.final.estimates.keys().isdisjoint(held.held)


def test_a_search_that_begins_with_a_fit_has_it(data: Data, free: Fitted) -> None:
    """The fit is refitted on the windows of the first stage, and nothing less likely is found."""
    found = search_structures(data, fit_baseline(data, BASELINE), lambda text: None, others=[free])
    assert {step.terms[0] for step in found.missing} == {"coulomb_friction"}
    assert found.final.estimates["moving_mass"] == pytest.approx(MASS, rel=0.01)

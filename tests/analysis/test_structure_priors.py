"""Priors of many structures at once, against those of each alone."""

from __future__ import annotations

import sys
from pathlib import Path

from hypothesis import given, settings
from hypothesis import strategies as st

from labhil.diagnose.structures.prior import TermTable, candidates, closure, log_prior
from labhil.physics.rigs import model_for

sys.path.insert(0, str(Path(__file__).parent))
from one_input_rigs import rig_of

MODEL = model_for(rig_of("axis"))
BASELINE = frozenset({"viscous_friction"})
CANDIDATES = candidates(MODEL, sorted(BASELINE))
STRUCTURES = st.frozensets(st.sampled_from([c[-1] for c in CANDIDATES]), max_size=6).map(
    lambda terms: closure(MODEL, terms, BASELINE)
)


@settings(deadline=None)
@given(structures=st.lists(STRUCTURES, min_size=1, max_size=4))
def test_a_table_of_priors_has_what_each_structure_has(structures: list[frozenset[str]]) -> None:
    table, count = TermTable(MODEL, BASELINE), len(CANDIDATES)
    new = [c[-1] for c in CANDIDATES]
    for structure in structures:
        additions = [(closure(MODEL, [term], BASELINE) - structure) | {term} for term in new]
        allowed = table.may_be_added([structure], new, additions)[0]
        priors = table.log_priors([structure], additions, count)[0]
        for term, added, may, prior in zip(new, additions, allowed, priors, strict=True):
            assert may == (term not in structure)
            if may:
                assert abs(prior - log_prior(MODEL, structure | added, count)) < 1e-9


def test_a_term_without_what_it_builds_on_is_no_addition() -> None:
    table = TermTable(MODEL, BASELINE)
    builds = next(name for name, term in MODEL.terms.items() if set(term.with_terms) - BASELINE)
    carried = frozenset(MODEL.terms[builds].with_terms) - BASELINE
    alone, whole = frozenset({builds}), carried | {builds}
    assert table.may_be_added([frozenset(), carried], [builds, builds], [alone, whole]).tolist() == [
        [False, True],
        [True, False],
    ]

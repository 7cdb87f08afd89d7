"""`labhil diagnose --method`: which way an answer is searched."""

from __future__ import annotations

from pathlib import Path

import pytest

RECORDINGS = Path(__file__).parents[2] / "recordings"
SEARCHED = (RECORDINGS / "ball_beam_identify.mcap", "--test", RECORDINGS / "ball_beam_test.mcap")


def test_a_method_that_is_none_is_refused_with_those_that_are(labhil):
    done = labhil("diagnose", *SEARCHED, "--method", "evidnece")
    assert done.status == 2
    assert "evidnece" in done.err
    assert "evidence" in done.err


@pytest.mark.extended
def test_by_evidence_the_three_effects_of_the_shipped_recording_are_named(labhil, tmp_path):
    done = labhil("diagnose", *SEARCHED, "--method", "evidence", "--json", "said.json")
    assert done.status == 0, done.err
    assert "what remains is noise" in " ".join(done.out.split())
    said = (tmp_path / "said.json").read_text(encoding="utf-8")
    for term in ("coulomb_friction", "stribeck_friction", "dead_zone"):
        assert f'"term": "{term}"' in said

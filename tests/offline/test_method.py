"""`labhil diagnose --method`: which way an answer is searched."""

from __future__ import annotations

import json
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
    said = json.loads((tmp_path / "said.json").read_text(encoding="utf-8"))
    assert {item["term"] for item in said["missing"]} == {
        "coulomb_friction",
        "stribeck_friction",
        "dead_zone",
    }
    for item in said["missing"]:
        evidence = item["evidence"]
        # held-out figures are of held-out data, and no other way to write the searched data's odds
        assert evidence["heldout_loglik_gain"] > 0.0
        assert evidence["heldout_loglik_gain"] != pytest.approx(-0.5 * evidence["delta_bic"], rel=0.01)
        assert evidence["p_value"] < 0.1

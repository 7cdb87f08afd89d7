"""What `labhil diagnose` says of the recordings that come with the project."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

RECORDINGS = Path(__file__).parents[2] / "recordings"
SEARCHED = (RECORDINGS / "ball_beam_identify.mcap", "--test", RECORDINGS / "ball_beam_test.mcap")


@pytest.mark.extended
def test_the_three_effects_of_the_shipped_recording_are_named(labhil, tmp_path):
    done = labhil("diagnose", *SEARCHED, "--json", "said.json")
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

"""``--json`` of commands that print their result as JSON: alone, with ``-``, or with a path."""

from __future__ import annotations

import json

import pytest


@pytest.mark.parametrize("asked", [["--json"], ["--json", "-"], ["--json=-"]])
@pytest.mark.parametrize("place", ["before", "after"])
def test_json_goes_to_stdout(labhil, asked, place):
    arguments = [*asked, "axis"] if place == "before" else ["axis", *asked]
    if place == "before" and asked == ["--json"]:
        arguments = ["--json", "axis"]
    done = labhil("terms", *arguments)
    assert done.status == 0, done.err
    assert list(json.loads(done.out)["rigs"]) == ["axis"]


@pytest.mark.extended
def test_json_goes_to_a_file_and_the_result_is_shown_too(labhil, tmp_path):
    done = labhil("terms", "axis", "--json", "terms.json")
    assert json.loads((tmp_path / "terms.json").read_text())["schema"] == "labhil.terms/1"
    assert "viscous_friction" in done.out
    assert "expected a folder nowhere" in labhil("terms", "axis", "--json", "nowhere/it.json").refused()
    assert labhil("doctor", "--json", "found.json").out
    assert json.loads((tmp_path / "found.json").read_text())

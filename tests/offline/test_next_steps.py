"""What to do next: every verdict has an answer, and every command in one exists."""

from __future__ import annotations

import io
import re
from pathlib import Path
from typing import Any, get_args

import pytest
from rich.console import Console

import labhil as lh
from labhil.analysis.dataset import load_dataset
from labhil.analysis.next_steps import FORCE_CURVE
from labhil.analysis.schema import FitPart, Score, VerificationPart
from labhil.analysis.schema.diagnosis import DiagnosisPart, Remainder, Rival, UndecidedEffect, Verdict
from labhil.identify.extended import UNMODELLED_FORCE
from labhil.report.html.fit import fit_page
from labhil.report.html.picture import Album
from labhil.report.html.verification import verification_page
from labhil.report.text import fit_text
from labhil.report.verification import verification_text

EXAMPLE = Path(__file__).parents[2] / "examples" / "diagnosis.json"


@pytest.fixture(scope="module")
def example() -> DiagnosisPart:
    return DiagnosisPart.model_validate_json(EXAMPLE.read_text(encoding="utf-8"))


def commands(steps: tuple[str, ...]) -> list[str]:
    return re.findall(r"`(labhil [^`]+)`", " ".join(steps))


@pytest.mark.parametrize("verdict", get_args(Verdict))
def test_every_verdict_has_steps_whose_commands_exist(labhil, example, verdict):
    steps = example.model_copy(update={"verdict": verdict}).next_steps
    assert steps
    assert all(step.endswith((".", "?")) for step in steps)
    for line in commands(steps):
        _, command, *rest = line.split()
        known = labhil(command, "--help")
        assert known.status == 0, line
        assert all(option in known.out for option in rest if option.startswith("--")), line


def test_what_was_judged_on_a_test_recording_is_not_to_be_judged_again(example):
    assert example.improvement.data == "test"
    assert any("Hold the next recording" in step for step in example.next_steps)
    held_out = example.improvement.model_copy(update={"data": "heldout"})
    steps = example.model_copy(update={"improvement": held_out}).next_steps
    assert any("a recording of its own" in step for step in steps)


def test_rivals_come_first_and_a_curve_has_no_law(example):
    rival = Rival(
        term="backlash", instead_of="dead_zone", probability=0.3, delta_bic=1.0, distinguishable=False,
        experiment="excite with small reversals",
    )  # fmt: skip
    curve = example.missing[0].model_copy(update={"term": FORCE_CURVE})
    found = example.model_copy(update={"rivals": (rival,), "missing": (*example.missing, curve)})
    first, second, third, *_ = found.next_steps
    assert first.startswith("To tell backlash from dead_zone, excite with small reversals, record that")
    assert FORCE_CURVE not in second
    assert "add-a-law" in third
    assert FORCE_CURVE == UNMODELLED_FORCE


def test_a_search_that_was_ended_early_is_to_be_finished_first(example):
    found = example.model_copy(update={"complete": False})
    assert "ended early" in found.next_steps[0]


def test_they_are_printed_and_on_the_page(example, tmp_path):
    result = lh.load(EXAMPLE)
    assert result.next_steps == example.next_steps
    assert "What to do next" in str(result)
    page = result.report(tmp_path / "page.html").read_text(encoding="utf-8")
    assert "What to do next" in page
    assert "<code>labhil verify NEW.mcap --model DIAGNOSIS.json</code>" in page


def test_a_file_is_to_be_patched_only_where_a_file_was_diagnosed(example):
    assert not any("labhil patch" in step for step in example.next_steps)
    of_a_file = [item.model_copy(update={"rig": "crane"}) for item in example.recordings]
    steps = example.model_copy(update={"recordings": tuple(of_a_file)}).next_steps
    sentence = "`labhil patch` writes them into a MuJoCo, URDF or Python file, or beside an FMU."
    assert any(sentence in step for step in steps)


def test_a_curve_beside_laws_that_lacked_a_channel_asks_for_that_channel_first(example):
    curve = example.missing[0].model_copy(update={"term": FORCE_CURVE})
    wanting = UndecidedEffect(term="spring_force", needs=("angle",), reason="")
    found = example.model_copy(update={"missing": (curve,), "undecided": (wanting,)})
    first, second, *_ = found.next_steps
    assert first == "Record angle, too: spring_force could not be tried without."
    assert "No law that could be tried" in second


def test_what_has_no_size_is_not_put_into_a_simulation(example):
    first, *rest = example.missing
    unknown = [row.model_copy(update={"identifiable": False}) for row in first.parameters]
    found = example.model_copy(
        update={"missing": (first.model_copy(update={"parameters": tuple(unknown)}), *rest)}
    )
    put, known, *_ = found.next_steps
    assert first.term not in put
    assert known.startswith(f"Of {first.term} these data know the kind")


@pytest.mark.parametrize("is_noise", [True, False])
def test_more_than_noise_is_said_to_remain_where_more_remains(example, is_noise):
    rest = Remainder(
        explained=0.99,
        noise_floors=0.99 if is_noise else 3.0,
        is_noise=is_noise,
        channel="ball_position",
        statement="as said",
    )
    steps = example.model_copy(update={"remainder": rest}).next_steps
    assert any("More than noise remains" in step for step in steps) is not is_noise


@pytest.mark.parametrize(
    ("given", "option"),
    [
        ("bench.toml", "--rig bench.toml"),
        ("my rig.toml", "--rig 'my rig.toml'"),
        ("bench.py:pendulum", "--simulator bench.py:pendulum"),
    ],
)
@pytest.mark.parametrize("verdict", get_args(Verdict))
def test_what_was_given_for_a_recording_without_a_rig_file_is_advised_again(example, verdict, given, option):
    rest = Remainder(explained=0.9, noise_floors=3.0, channel="ball_position", statement="as said")
    of_a_file = tuple(item.model_copy(update={"rig_file": given}) for item in example.recordings)
    found = example.model_copy(update={"verdict": verdict, "recordings": of_a_file, "remainder": rest})
    advised = [line for line in commands(found.next_steps) if ".mcap" in line]
    assert advised or verdict == "not_decidable"
    assert all(line.endswith(f" {option}") for line in advised)


def test_a_result_holds_the_rig_file_that_was_given(shipped, tmp_path):
    rig = tmp_path / "bench.toml"
    recording = shipped / "ball_beam_identify.mcap"
    rig.write_text(lh.read(recording).file.rig.text, encoding="utf-8")
    given = load_dataset(recording, rig, span=(0.0, 10.0))
    assert [source.rig_file for source in given.sources("train")] == [str(rig)]
    own = load_dataset(recording, span=(0.0, 10.0))
    assert [source.rig_file for source in own.sources("train")] == [None]


def test_a_recording_of_arrays_is_named_by_a_placeholder_in_commands(example):
    unsaved = example.recordings[0].model_copy(update={"path": "arrays"})
    found = example.model_copy(update={"recordings": (unsaved,), "verdict": "unexplained_mismatch"})
    assert any(line.startswith("labhil linear REC.mcap") for line in commands(found.next_steps))


def check_commands(labhil: Any, steps: tuple[str, ...]) -> None:
    for line in commands(steps):
        _, command, *rest = line.split()
        known = labhil(command, "--help")
        assert known.status == 0, line
        assert all(option in known.out for option in rest if option.startswith("--")), line


@pytest.mark.parametrize(
    ("change", "step"),
    [
        ({"verdict": "unexplained"}, "looks for what is missing"),
        ({"verdict": "explained"}, "Judge it on a recording of its own"),
        ({"converged": False}, "give it more time"),
    ],
)
def test_a_fit_says_what_to_do_next_on_page_and_screen(labhil, change, step):
    text = (Path(__file__).parents[2] / "examples" / "fit.json").read_text(encoding="utf-8")
    fit = FitPart.model_validate_json(text)
    search = tuple(source for source in fit.recordings if source.role != "test")
    fit = fit.model_copy(update={"recordings": search, **change})
    assert any(step in each for each in fit.next_steps)
    check_commands(labhil, fit.next_steps)
    page = fit_page(fit, "", Album()).html()
    console = Console(width=1000, file=io.StringIO())
    console.print(fit_text(fit))
    for said in (page, console.file.getvalue()):
        assert said.count("What to do next") >= 1
        assert step in said


@pytest.mark.parametrize(
    ("change", "step"),
    [
        ({}, "Hold the next recording against it"),
        ({"adequacy": "unexplained"}, "more than noise remains"),
        ({"verdict": "contradicted"}, "names what the model lacks"),
    ],
)
def test_a_verification_says_what_to_do_next_on_page_and_screen(labhil, change, step):
    result = VerificationPart(
        recordings=(), model="fit.json", rig="axis", terms=("viscous_friction",), verdict="consistent",
        alpha=0.01, p_value=0.4, score=Score.model_construct(horizon=None, per_channel=()), channels=(),
        values_p=0.3,
    ).model_copy(update=change)  # fmt: skip
    assert any(step in each for each in result.next_steps)
    check_commands(labhil, result.next_steps)
    assert step in verification_page(result, "").html()
    console = Console(width=1000, file=io.StringIO())
    console.print(verification_text(result))
    assert step in console.file.getvalue()

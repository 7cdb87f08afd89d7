"""Pages of results and recordings: whole, escaped, and with everything in them that the result says."""

from __future__ import annotations

import base64
import hashlib
import html
import io
import json
import re
from collections import defaultdict
from dataclasses import asdict
from html.parser import HTMLParser
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from rich.console import Console, RenderableType

import labhil
from labhil.analysis.results import _rows, finite
from labhil.analysis.schema import DiagnosisPart, FitPart, validate
from labhil.analysis.verdicts import VERDICTS
from labhil.diagnose.collapsed import Collapsed
from labhil.identify.statistics import estimates_from_errors
from labhil.physics.terms import Parameter
from labhil.recording.writer import RecordingWriter
from labhil.report.formatting import (
    format_interval,
    format_percent,
    format_powers,
    format_probability,
    format_quantity,
)
from labhil.report.html.diagnosis import diagnosis_page
from labhil.report.html.element import tag
from labhil.report.html.fit import fit_page
from labhil.report.html.picture import Album
from labhil.report.html.signals import INTERVALS, envelope
from labhil.report.text import diagnosis_text
from labhil.signals import Batch, Direction, Signal, Stream
from labhil.tui.result_text import result_renderable

SCRIPT = Path(labhil.__file__).parent / "report" / "html" / "zoom.js"
EVIL = '<script>alert("x")</script>&$a_b'
VOID = {"meta", "br", "hr", "img", "col", "wbr"}


class Outline(HTMLParser):
    """What a page consists of; its elements must close in order, and no identifier may come twice."""

    def __init__(self, text: str) -> None:
        super().__init__()
        self.open: list[str] = []
        self.tags: list[tuple[str, dict[str, str | None]]] = []
        self.said: list[str] = []
        self.feed(text)
        self.close()
        assert self.open == []
        ids = [attributes["id"] for _, attributes in self.tags if "id" in attributes]
        assert len(ids) == len(set(ids))

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.tags.append((tag, dict(attrs)))
        if tag not in VOID:
            self.open.append(tag)

    def handle_startendtag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.tags.append((tag, dict(attrs)))

    def handle_endtag(self, tag: str) -> None:
        assert self.open.pop() == tag

    def handle_data(self, data: str) -> None:
        self.said.append(data)

    @property
    def text(self) -> str:
        return "".join(self.said)


def outlined(text: str) -> Outline:
    """Return a page's outline; it must be one that needs nothing from elsewhere and runs our script only."""
    page = Outline(text)
    assert text.startswith("<!DOCTYPE html>")
    assert [name for name, _ in page.tags].count("h1") == 1
    assert not {"link", "iframe", "object"} & {name for name, _ in page.tags}
    (script,) = re.findall(r"<script.*?</script>", text, re.DOTALL)
    ours = SCRIPT.read_text(encoding="utf-8")
    assert script == f"<script>{ours}</script>"
    (policy,) = [a["content"] for n, a in page.tags if a.get("http-equiv") == "Content-Security-Policy"]
    digest = base64.b64encode(hashlib.sha256(ours.encode()).digest()).decode()
    assert html.unescape(policy or "").endswith(f"; script-src 'sha256-{digest}'")
    for name, attributes in page.tags:
        assert not any(key.startswith("on") for key in attributes), name
        for key in ("src", "href", "xlink:href"):
            assert (attributes.get(key) or "#").startswith(("#", "data:")), name
        assert name != "th" or attributes.get("scope") in {"col", "row"}
    return page


def parameter(name: str, **more: Any) -> dict[str, Any]:
    row = {
        "name": name, "term": name.partition(".")[0], "joint": None, "value": 0.0903, "unit": "N",
        "std_error": 0.001, "std_error_reference": 1e-5, "ci99": [0.0877, 0.0929], "z": 90.0,
        "p_value": 0.0, "significant": True, "identifiable": True, "at_bound": False,
    }  # fmt: skip
    return row | more


def source(path: str = "run.mcap", role: str = "search") -> dict[str, Any]:
    return {
        "path": path, "sha256": "ab" * 32, "rig": "ball_beam", "samples": 2803, "duration": 28.0, "role": role
    }  # fmt: skip


@pytest.fixture
def diagnosis() -> dict[str, Any]:
    """Return a diagnosis with something in every part."""
    parameters = [parameter("viscous_friction.coefficient"), parameter("stribeck_friction.level")]
    channel = {
        "channel": "ball_position", "joint": None, "unit": "m", "rmse_before": 0.058, "rmse_after": 0.00042,
        "noise_floor": 0.00043, "r2_before": -0.13, "r2_after": 0.99994,
    }  # fmt: skip
    return {
        "schema": "labhil.diagnosis/1",
        "recordings": [source(), source("test.mcap", "test")],
        "verdict": "missing_physics",
        "p_value": 1e-120, "p_value_method": "tail_extrapolated", "p_value_floor": 0.0,
        "baseline": {"terms": ["viscous_friction"], "parameters": parameters[:1]},
        "changed": [{"name": "ball_mass", "joint": None, "before": 0.26, "after": 0.27, "unit": "kg",
                     "ci99": [0.265, 0.275], "p_value": 0.0003}],
        "location": {"channel": "ball_position", "joint": None, "enters": "force", "times": [[2.0, 6.0]],
                     "regimes": [{"coordinate": "ball_velocity", "low": -0.02, "high": 0.02,
                                  "share_of_excess": 0.81}], "statement": "It is off near rest."},
        "missing": [{"term": "stribeck_friction", "joint": 3, "statement": "Friction falls.",
                     "equation": "F = F_st·exp(−|v|/v_s)·sgn v", "probability": 0.87,
                     "parameters": parameters[1:],
                     "evidence": {"delta_bic": -812.0, "p_value": 0.002, "heldout_loglik_gain": 31.0}}],
        "rivals": [{"term": "dead_zone", "instead_of": "stribeck_friction", "joint": 3, "probability": 0.13,
                    "delta_bic": 3.1, "distinguishable": False, "experiment": "a slow ramp"}],
        "undecided": [{"term": "motional_emf", "joint": None, "needs": ["coil_voltage"], "reason": "none"}],
        "excluded": [{"term": "backlash", "joint": None, "largest_hidden": 3e-4, "unit": "rad",
                      "confidence": 0.99}],
        "improvement": {"data": "test", "metric": "windowed_simulation", "horizon": 4.0,
                        "rmse_before": 0.058, "rmse_after": 0.00042, "noise_floor": 0.00043,
                        "mse_before": 0.0034, "mse_after": 1.8e-7, "r2_before": -0.13, "r2_after": 0.99994,
                        "per_channel": [channel]},
        "final": {"terms": ["viscous_friction", "stribeck_friction"], "parameters": parameters},
        "curve": {"depends_on": ["ball_velocity"], "x": [[0.0, 0.1, 0.2]], "value": [0.0, 1.0, 1.5],
                  "ci99": [[-0.1, 0.9, 1.4], [0.1, 1.1, 1.6]], "unit": "N"},
        "seconds": 4.2,
    }  # fmt: skip


@pytest.fixture
def fit() -> dict[str, Any]:
    """Return a fit with something in every part."""
    parameters = [
        parameter("viscous_friction.coefficient"),
        parameter("dead_zone.left", value=0.06, ci99=[0.0, 0.9], significant=False, at_bound=True),
        parameter("inertia", identifiable=False, ci99=[None, None]),
    ]
    names = [row["name"] for row in parameters]
    channel = {
        "channel": "ball_position", "joint": None, "unit": "m", "mse": 1.8e-7, "rmse": 0.00042,
        "max_abs_error": 0.0016, "r2": 0.99995321, "noise_floor": 0.00044,
    }  # fmt: skip
    score = {
        "metric": "windowed_simulation", "horizon": 4.0, "mse": 1.8e-7, "rmse": 0.00042,
        "max_abs_error": 0.0016, "r2": 0.99995321, "noise_floor": 0.00044, "per_channel": [channel],
    }  # fmt: skip
    return {
        "schema": "labhil.fit/1", "recordings": [source(role="train")], "rig": "ball_beam",
        "estimator": "hybrid", "seed": 0, "terms": ["viscous_friction", "dead_zone"],
        "parameters": parameters, "covariance": [[1.0, 0.5, 0.0], [0.5, 1.0, 0.0], [0.0, 0.0, 0.0]],
        "identifiability": {"rank": 2, "of": 3, "combinations": ["inertia·resistance"],
                            "would_help": ["current"]},
        "train": score, "test": score,
        "residuals": {"ljung_box_p": 0.28, "input_crosscorrelation_p": 0.001},
        "intervals": {"method": "auto", "simultaneous": False}, "window": 6.0,
        "by_window": [{"window": w, "residual": 0.98, "values": dict.fromkeys(names, 0.1),
                       "std_errors": dict.fromkeys(names, 0.01)} for w in (1.5, 3.0, 6.0)],
        "converged": False, "evaluations": 5886, "seconds": 12.0,
    }  # fmt: skip


@pytest.fixture
def page(labhil, tmp_path):
    """Make the page of a result by the command; return its outline."""

    def make(data: Any) -> Outline:
        path = tmp_path / "result.json"
        path.write_text(json.dumps(data), encoding="utf-8")
        done = labhil("report", path, "-o", "page.html")
        assert (done.status, done.out) == (0, "page.html\n"), done.err
        return outlined((tmp_path / "page.html").read_text(encoding="utf-8"))

    return make


def test_the_page_of_a_diagnosis_says_what_the_diagnosis_says(page, diagnosis):
    text = page(diagnosis).text
    for said in (
        VERDICTS["missing_physics"], "It is off near rest.", "stribeck_friction[3]", "Friction falls.",
        "F = F_st·exp(−|v|/v_s)·sgn v", "87\N{NO-BREAK SPACE}%", "a slow ramp", "ball_mass", "motional_emf",
        "coil_voltage", "backlash", "0.0003\N{NO-BREAK SPACE}rad", "0.058\N{NO-BREAK SPACE}m",
        "135\N{NO-BREAK SPACE}×", "0.0877 to 0.0929", "ab" * 32, "extrapolated from the tail", "99 % band",
        "< 10⁻⁹⁹".replace(" ", "\N{NO-BREAK SPACE}"),
    ):  # fmt: skip
        assert said in text, said


def on_screen(result: dict[str, Any]) -> str:
    """What the terminal UI writes of a diagnosis."""
    return printed(result_renderable(validate(DiagnosisPart, result, "the diagnosis"), defaultdict(str)))


def in_the_report(result: dict[str, Any]) -> str:
    """What the commands print of a diagnosis."""
    return printed(diagnosis_text(validate(DiagnosisPart, result, "the diagnosis")))


def printed(what: RenderableType) -> str:
    console = Console(width=120, record=True, file=io.StringIO())
    console.print(what)
    return console.export_text()


def test_what_is_not_there_of_an_arm_stands_by_joint(page, diagnosis):
    limits = [("torque_ripple", 0, 0.035), ("torque_ripple", 2, 0.0058), ("torque_constant", 2, 0.0025)]
    units = {"torque_ripple": "N·m", "torque_constant": "1"}
    diagnosis["excluded"] += [
        {"term": t, "joint": j, "largest_hidden": size, "unit": units[t], "confidence": 0.99}
        for t, j, size in limits
    ]
    diagnosis["undecided"] = [
        {"term": "temperature_dependent_friction", "joint": j, "needs": [], "reason": "none"} for j in (0, 1)
    ]
    diagnosis["baseline"]["terms"] = ["coulomb_friction[0]", "viscous_friction[0]", "coulomb_friction[1]"]
    screen = on_screen(diagnosis)
    assert "baseline coulomb_friction[0, 1], viscous_friction[0];" in screen
    assert "temperature_dependent_friction[0, 1]" in screen
    assert re.search(r"torque_ripple +0\.035 +0\.0058 +N·m", screen)
    assert re.search(r"torque_constant +– +0\.0025", screen)
    text = page(diagnosis).text
    assert "temperature_dependent_friction[0, 1]" in text
    assert "coulomb_friction[0, 1]" in text
    table = text[text.index("The same by joint") :]
    told = ("Joint 0", "Joint 2", "torque_ripple", "0.035", "0.0058", "N·m", "torque_constant", "–", "0.0025")
    places = [table.index(said) for said in told]
    assert places == sorted(places)


def test_page_screen_and_report_say_which_sizes_gave_way_and_which_were_held(page, diagnosis):
    size = Collapsed("acceleration_per_radian", 0.019, 7.007, "m/s²")
    diagnosis["collapsed"] = [{**asdict(size), "statement": size.statement}]
    held = estimates_from_errors([Parameter("inertia", "kg·m²", 1.0)], np.array([0.02]), np.array([0.0]))
    diagnosis["final"]["parameters"] += finite(_rows(held))
    written = [" ".join(write(diagnosis).split()) for write in (on_screen, in_the_report)]
    for text in (*written, page(diagnosis).text):
        assert (
            "takes acceleration_per_radian to 0.019 m/s², far from its nominal or typical 7.007 m/s²" in text
        )
        assert re.search(r"inertia.{0,80}held", text, re.DOTALL)


def test_the_page_of_a_fit_says_what_the_fit_says(page, fit):
    text = page(fit).text
    for said in (
        "viscous_friction.coefficient", "2 of 3", "inertia·resistance", "current", "not identifiable",
        "at its bound, not significant", "99.9953", "stopped before it had settled", "1·10⁻⁵", "seed 0",
        "nothing speaks against it", "length of the fitted windows",
    ):  # fmt: skip
        assert said in text, said


@pytest.mark.parametrize("verdict", VERDICTS)
def test_every_verdict_has_its_page(diagnosis, verdict):
    bare = {"changed": [], "location": None, "missing": [], "rivals": [], "undecided": [], "excluded": []}
    result = DiagnosisPart.model_validate(diagnosis | bare | {"verdict": verdict, "curve": None})
    page = outlined(diagnosis_page(result, "", Album()).html())
    assert VERDICTS[verdict] in page.text


def evil(value: Any) -> Any:
    """Return the same result with malice in every text that is not a key of the format."""
    kept = {"schema", "verdict", "p_value_method", "data", "metric"}
    if isinstance(value, dict):
        return {key: inner if key in kept else evil(inner) for key, inner in value.items()}
    if isinstance(value, list):
        return [evil(inner) for inner in value]
    return EVIL + value if isinstance(value, str) else value


def test_every_value_is_escaped(diagnosis, fit):
    result = DiagnosisPart.model_validate(evil(diagnosis))
    page = outlined(diagnosis_page(result, EVIL, Album()).html())
    assert page.text.count(EVIL) > 30
    named = {EVIL + key: value for key, value in fit["by_window"][0]["values"].items()}
    rungs = [rung | {"values": named, "std_errors": named} for rung in fit["by_window"]]
    page = outlined(fit_page(FitPart.model_validate(evil(fit) | {"by_window": rungs}), EVIL, Album()).html())
    assert page.text.count(EVIL) > 15


def test_what_no_page_can_hold_is_replaced():
    assert tag("p", "a\x00\ud800b", title='"').text == '<p title="&quot;">a��b</p>'


def test_the_page_of_a_shipped_recording(labhil, shipped, tmp_path):
    done = labhil("report", shipped / "ball_beam_identify.mcap", "-o", "r.html")
    assert done.status == 0, done.err
    text = (tmp_path / "r.html").read_text(encoding="utf-8")
    page = outlined(text)
    for said in (
        "ball_position",
        "servo_angle_requested",
        "100.0",
        "two_sine",
        "ball_radius",
        "all steps are",
        "The recording is complete, and its run ended in order; no sample was lost.",
        "What to do next",
    ):
        assert said in page.text, said
    assert len([1 for tag, _ in page.tags if tag == "svg"]) == 6
    assert len(text) < 400_000


def test_gaps_names_and_files_of_a_recording_are_shown_and_escaped(labhil, tmp_path):
    signal = Signal("angle", EVIL, Direction.OUTPUT, description=EVIL)
    path = tmp_path / "odd.mcap"
    seq = np.array([0, 1, 2, 6, 7, 8])
    write_recording(path, Stream("state", (signal,), 100.0), seq)
    assert labhil("report", path, "-o", "r.html").status == 0
    page = outlined((tmp_path / "r.html").read_text(encoding="utf-8"))
    assert "Gaps of /bench/state" in page.text
    assert "made from imported data; 3 samples were lost in 1 gap." in page.text
    assert page.text.count(EVIL) >= 8


def write_recording(path: Path, stream: Stream, seq: Any) -> None:
    writer = RecordingWriter(path)
    channel = writer.add_stream("bench", stream, {EVIL: EVIL})
    t_ns = 10**18 + seq * 10**7
    writer.write(channel, Batch(seq, t_ns, t_ns, np.zeros((len(seq), 1))))
    writer.attach(EVIL, "text/plain", EVIL.encode())
    writer.event("bench", int(t_ns[0]), {"kind": EVIL, "message": EVIL})
    writer.finish()


def test_a_recording_without_an_end_says_so_and_how_to_save_it(labhil, tmp_path):
    signal = Signal("angle", "rad", Direction.OUTPUT)
    path = tmp_path / "whole.mcap"
    write_recording(path, Stream("state", (signal,), 100.0), np.arange(500))
    cut = tmp_path / "cut.mcap"
    cut.write_bytes(path.read_bytes()[:-300])
    assert labhil("report", cut, "-o", "r.html").status == 0
    page = outlined((tmp_path / "r.html").read_text(encoding="utf-8"))
    assert "The recording has no end" in page.text or "The recording is damaged" in page.text
    assert "labhil recover" in page.text


def test_an_envelope_keeps_every_extreme_and_breaks_at_gaps():
    n = 300_001
    t, values = np.arange(n) * 1e-3, np.zeros(n)
    values[[12_345, 299_999]] = 1.0, -2.0
    seq = np.arange(n) + (np.arange(n) > 150_000)
    drawn_t, drawn = envelope(t, values, seq)
    assert len(drawn) < 2 * INTERVALS + 5
    assert (np.nanmax(drawn), np.nanmin(drawn), np.isnan(drawn).sum()) == (1.0, -2.0, 1)
    assert np.all(np.diff(drawn_t) >= 0)
    assert drawn_t[np.nanargmax(drawn)] == pytest.approx(12.345)


@pytest.mark.parametrize(
    ("content", "expected"),
    [
        (b"", "JSON of `labhil fit` or `labhil diagnose`"),
        (b"\xff\xfe", "JSON of `labhil fit`"),
        (b"[" * 100_000, "JSON of `labhil fit`"),
        (b"[1]", "found no schema"),
        (b'{"schema": "labhil.linear/1"}', "labhil.linear/1"),
        (b'{"schema": "labhil.fit/1"}', "recordings: Field required"),
        (b'{"schema": ["labhil.fit/1"]}', "expected a result of schema"),
    ],
)
def test_a_file_that_is_no_result_is_refused(labhil, tmp_path, content, expected):
    (tmp_path / "odd.json").write_bytes(content)
    said = labhil("report", "odd.json", "-o", "page.html").refused()
    assert "odd.json: " in said
    assert expected in said
    assert not (tmp_path / "page.html").exists()


@pytest.mark.parametrize(
    ("change", "expected"),
    [
        ({"verdict": "maybe"}, "verdict: "),
        ({"missing": [{"term": 3, "statement": ""}]}, "missing.0.term: "),
        ({"final": None}, "final: "),
        ({"seconds": "soon"}, "seconds: "),
    ],
)
def test_a_result_with_a_wrong_field_is_refused_by_its_name(labhil, tmp_path, diagnosis, change, expected):
    (tmp_path / "d.json").write_text(json.dumps(diagnosis | change), encoding="utf-8")
    assert f"d.json: {expected}" in labhil("report", "d.json", "-o", "page.html").refused()


def test_paths_that_cannot_be_are_told(labhil, shipped, tmp_path):
    assert "absent.json" in labhil("report", "absent.json", "-o", "page.html").refused()
    assert "absent.mcap" in labhil("report", "absent.mcap", "-o", "page.html").refused()
    (tmp_path / "cut.mcap").write_bytes(b"no recording")
    assert "cut.mcap: expected an MCAP" in labhil("report", "cut.mcap", "-o", "page.html").refused()
    recording = shipped / "ball_beam_test.mcap"
    assert "nowhere" in labhil("report", recording, "-o", "nowhere/page.html").refused()
    assert "found a folder" in labhil("report", recording, "-o", tmp_path).refused()


def test_powers_of_ten_in_a_sentence_look_like_those_in_a_table():
    assert format_powers("more than noise (p = 1.8e-05).") == "more than noise (p = 1.8·10⁻⁵)."
    assert format_powers("(p < 1e-99), 3 times, stage-2") == "(p <\N{NO-BREAK SPACE}10⁻⁹⁹), 3 times, stage-2"


def test_numbers_are_written_as_people_write_them():
    space = "\N{NO-BREAK SPACE}"
    assert format_quantity(-0.0123456, "N") == f"−0.01235{space}N"
    assert format_quantity(1.8745e-7, "m²") == f"1.875·10⁻⁷{space}m²" or "1.874" in format_quantity(1.8745e-7)
    assert format_quantity(-17321.4) == "−17\N{NARROW NO-BREAK SPACE}320"
    assert format_quantity(2.0, "1") == "2"
    assert (format_quantity(None, "N"), format_quantity(float("nan"))) == ("–", "–")
    assert format_interval((None, 2.0), "N") == f"– to 2{space}N"
    assert (format_percent(0.99995321), format_percent(1.0)) == (f"99.9953{space}%", f"100.00{space}%")
    assert (format_probability(1.0), format_probability(0.5)) == (f">{space}99{space}%", f"50{space}%")


def test_verify_writes_its_page(labhil: Any, shipped: Path, tmp_path: Path) -> None:
    fit = shipped.parent / "examples" / "fit.json"
    done = labhil("verify", shipped / "ball_beam_test.mcap", "--model", fit, "--html", "v.html")
    assert done.status == 0, done.err
    assert "<html" in (tmp_path / "v.html").read_text(encoding="utf-8")

"""Whatever stands in a file or comes over a wire: it is taken, or refused by an error of ours."""

from __future__ import annotations

import math
import os
import random
import tomllib
from pathlib import Path

from hypothesis import given, settings
from hypothesis import strategies as st

from labhil.errors import ExperimentFileError, ProtocolError, RigFileError
from labhil.experiment.experiment import Experiment, parse_experiment
from labhil.kinds import KINDS
from labhil.link import Config, Hello, SetCommand, State
from labhil.rig import RigFile, parse_rig
from labhil.toml_text import to_toml

EXAMPLES = int(os.environ.get("LABHIL_EXAMPLES", "10"))
"""Of each property; set LABHIL_EXAMPLES for more."""

RIG = Path("rig.toml")
EXPERIMENT = Path("experiment.toml")
ROOT = Path(__file__).parents[2]

NUMBERS = st.one_of(
    st.integers(-(10**20), 10**20),
    st.floats(),
    st.sampled_from([0, 1, -1, 0.0, 1e308, 1e-320, math.nan, math.inf]),
)
SCALARS = st.one_of(NUMBERS, st.booleans(), st.text(max_size=6))
WORDS = """
rig kind known nominal limits metric table channels column columns scale offset min max rate header
delimiter decimal skip_rows comment sheet bad_rows horizon t path text links force_map experiment
name seed devices bench plugin address twin speed terms set wire steps device signal excitation
amplitude frequencies duration at stabilise on kp kd setpoint filter record level dwell low high
count stages sweep harmonics phases sine cosine
""".split()  # noqa: SIM905 - a list would take a page
KEYS = st.one_of(
    st.sampled_from(WORDS),
    st.sampled_from([name for kind in KINDS.values() for name in kind.known]),
    st.sampled_from([signal.name for kind in KINDS.values() for signal in kind.signals()]),
    st.text(max_size=5),
)
FLAT = st.one_of(SCALARS, st.lists(SCALARS, max_size=3))
VALUES = st.one_of(
    FLAT,
    st.dictionaries(KEYS, st.one_of(FLAT, st.dictionaries(KEYS, FLAT, max_size=2)), max_size=3),
)


@settings(max_examples=EXAMPLES, deadline=None)
@given(text=st.text(max_size=60))
def test_any_text_is_a_rig_file_or_refused(text: str) -> None:
    for content in (text, f'[rig]\nkind = "ball_beam"\n{text}'):
        try:
            assert isinstance(parse_rig(content, RIG), RigFile)
        except RigFileError as error:
            assert str(error).startswith("rig.toml: ")


@settings(max_examples=EXAMPLES, deadline=None)
@given(kind=st.sampled_from(sorted(KINDS)), tables=st.dictionaries(KEYS, VALUES, max_size=5))
def test_any_tables_are_a_rig_file_or_refused(kind: str, tables: dict[str, object]) -> None:
    text = to_toml({"rig": {"kind": kind}, **tables})
    try:
        rig = parse_rig(text, RIG)
    except RigFileError as error:
        assert "rig.toml" in str(error)
        return
    for name in rig.kind.known:
        number = rig.known_number(name)
        assert number is None or math.isfinite(number)


def mutated(text: str, draw: random.Random) -> str:
    """The text of a good file with some keys, values or lines changed."""
    lines = text.splitlines()
    for _ in range(draw.randint(1, 3)):
        place = draw.randrange(len(lines))
        match draw.randrange(5):
            case 0:
                del lines[place]
            case 1:
                lines.insert(place, draw.choice(lines))
            case 2:
                lines[place] = lines[place].replace(
                    draw.choice('=[]"{}0123456789. '), draw.choice('=[]"{}-e09.'), 1
                )
            case 3:
                head, equals, _ = lines[place].partition("=")
                lines[place] = (
                    f"{head}{equals} {draw.choice(['nan', 'inf', '-1', '[]', '{}', 'true', '1e400', '0'])}"
                )
            case _:
                lines[place] = lines[place][: draw.randrange(len(lines[place]) + 1)]
        lines = lines or [""]
    return "\n".join(lines)


@settings(max_examples=EXAMPLES, deadline=None)
@given(seed=st.integers(0, 2**32), which=st.sampled_from(["ball_beam_identify", "ball_beam_test"]))
def test_a_changed_experiment_file_is_one_or_refused(seed: int, which: str) -> None:
    text = (ROOT / "recordings" / f"{which}.toml").read_text(encoding="utf-8")
    try:
        found = parse_experiment(mutated(text, random.Random(seed)), EXPERIMENT)
    except ExperimentFileError as error:
        assert "experiment.toml" in str(error)
        return
    assert isinstance(found, Experiment)
    assert found.duration > 0
    tomllib.loads(found.public_text())


@settings(max_examples=EXAMPLES, deadline=None)
@given(tables=st.dictionaries(KEYS, VALUES, max_size=5), step=st.dictionaries(KEYS, VALUES, max_size=6))
def test_any_tables_are_an_experiment_or_refused(tables: dict[str, object], step: dict[str, object]) -> None:
    good = {"experiment": {"name": "a"}, "devices": {"bench": {"plugin": "ball_beam", "address": "twin"}}}
    asked = {"device": "bench", "signal": "servo_angle", "excitation": "hold", "level": 0.1, "duration": 1.0}
    text = to_toml({**good, **tables, "steps": [{**asked, **step}]})
    for content in (text, text.replace('"hold"', '"two_sine"').replace("level", "amplitude")):
        try:
            assert isinstance(parse_experiment(content, EXPERIMENT), Experiment)
        except ExperimentFileError as error:
            assert "experiment.toml" in str(error)


@settings(max_examples=EXAMPLES, deadline=None)
@given(text=st.text(max_size=60))
def test_any_text_is_an_experiment_or_refused(text: str) -> None:
    try:
        parse_experiment(text, EXPERIMENT)
    except ExperimentFileError as error:
        assert str(error).startswith("experiment.toml: ")


PAYLOADS = {"HELLO": Hello, "STATE": State, "SET": SetCommand, "CONFIG": Config}


@settings(max_examples=EXAMPLES, deadline=None)
@given(payload=st.binary(max_size=80), name=st.sampled_from(sorted(PAYLOADS)))
def test_any_payload_is_a_message_or_refused(payload: bytes, name: str) -> None:
    """Streams of frames with noise in and between them are in ``tests/wire/test_link.py``."""
    try:
        message = PAYLOADS[name].unpack(payload)
    except ProtocolError as error:
        assert f"payload of {name}" in str(error)
        return
    if name != "HELLO":
        assert message.pack() == payload


@settings(max_examples=EXAMPLES, deadline=None)
@given(count=st.integers(0, 4), body=st.binary(min_size=90, max_size=90))
def test_any_numbers_in_a_hello_are_taken(count: int, body: bytes) -> None:
    empty = Hello(0, (1, 0, 0), "x", "y", 1, 2, 100.0, 1.0, ()).pack()
    size = len(empty)
    payload = body[: size - 1] + bytes([count]) + body[size : size + 8 * count]
    assert len(Hello.unpack(payload).channels) == count

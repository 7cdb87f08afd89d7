"""The recordings that come with the project are what their README says."""

import hashlib
import json
import tomllib
from pathlib import Path

import numpy as np
import pytest
from google.protobuf import descriptor_pb2, descriptor_pool, message_factory
from mcap.reader import make_reader

from labhil.recording import read_recording
from labhil.rig import load_rig

FOLDER = Path(__file__).parents[2] / "recordings"
NAMES = ("ball_beam_identify", "ball_beam_test")


@pytest.fixture(params=NAMES)
def path(request):
    return FOLDER / f"{request.param}.mcap"


def test_it_is_read_whole(path):
    recording = read_recording(path)
    state = recording.stream_with("ball_position", "servo_angle")
    assert recording.complete
    assert (len(state) >= 2800, state.lost, state.speed) == (True, 0, 1.0)
    assert np.isfinite(state.values).all()
    assert np.diff(state.t) == pytest.approx(0.01, abs=1e-5)
    assert recording.rig.known == load_rig(FOLDER / "ball_beam.toml").known
    assert recording.stream_with("servo_angle_requested", "servo_angle_applied").lost == 0


def test_others_read_the_same_numbers(path):
    state = read_recording(path).stream_with("ball_position")
    with path.open("rb") as file:
        found = list(make_reader(file, validate_crcs=True).iter_messages(topics=["/bench/state"]))
    schema = found[0][0]
    pool = descriptor_pool.DescriptorPool()
    for described in descriptor_pb2.FileDescriptorSet.FromString(schema.data).file:
        pool.Add(described)
    sample_class = message_factory.GetMessageClass(pool.FindMessageTypeByName(schema.name))
    samples = [sample_class.FromString(message.data) for _, _, message in found]
    assert [sample.ball_position for sample in samples] == state["ball_position"].tolist()
    assert [sample.servo_angle for sample in samples] == state["servo_angle"].tolist()


def test_the_answer_stands_beside_it_and_not_in_it(path):
    answer = json.loads(path.with_suffix(".twin.json").read_text())
    asked = tomllib.loads(path.with_suffix(".toml").read_text())["devices"]["bench"]["twin"]
    assert answer["seed"] == asked["seed"]
    assert answer["terms"] == asked["terms"]
    for term, values in asked["set"].items():
        for name, value in values.items():
            assert answer["parameters"][f"{term}.{name}"] == value
    recording = read_recording(path)
    told = json.dumps([dict(recording.metadata), [dict(s.metadata) for s in recording.streams]], default=dict)
    told += "".join(data.decode() for data in recording.attachments.values())
    assert [term for term in answer["terms"] if term in told] == []


def test_its_readme_names_it_by_its_hash(path):
    written = hashlib.sha256(path.read_bytes()).hexdigest()
    assert f"{written}  {path.name}" in (FOLDER / "README.md").read_text()
    assert path.stat().st_size < 400_000

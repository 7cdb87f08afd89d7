"""Of a long recording a stretch is used: the one in which its inputs change most."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

import labhil as lh
from labhil.analysis.dataset import load_dataset
from labhil.analysis.stretch import liveliest_stretch
from labhil.errors import UsageError
from labhil.physics.record import Record

RECORDING = Path(__file__).parents[2] / "recordings" / "ball_beam_identify.mcap"
TERMS = ["viscous_friction", "coulomb_friction"]


def record_moved_from(begin: int, end: int, count: int = 5000, joint: int | None = None) -> Record:
    """A record whose input changes from row ``begin`` to ``end``, and once more, far away."""
    moved = np.zeros(count)
    moved[begin:end] = np.sin(np.arange(end - begin) / 7.0)
    moved[count - 2] = 0.5
    outputs = np.arange(float(count))[:, None]
    names = ("u",), ("y",), ("m",)
    return Record(np.arange(count) * 0.01, moved[:, None], outputs, *names, output_joints=(joint,))


@pytest.mark.parametrize("begin", [0, 1200, 3900])
def test_the_stretch_is_where_inputs_change_most(begin: int) -> None:
    record = record_moved_from(begin, begin + 1000)
    stretch = liveliest_stretch(record, 1000)
    assert len(stretch) == 1000
    first = int(stretch.outputs[0, 0])
    assert abs(first - begin) <= 5
    np.testing.assert_array_equal(stretch.inputs, record.inputs[first : first + 1000])
    assert stretch.begins[0].left_out == 4000
    assert not np.shares_memory(stretch.outputs, record.outputs)


def test_inputs_that_are_not_read_or_never_change_decide_nothing() -> None:
    record = record_moved_from(2000, 3000)
    record.inputs[100:150] = np.nan
    assert abs(int(liveliest_stretch(record, 1000).outputs[0, 0]) - 2000) <= 50
    record.inputs[:] = 1.0
    assert len(liveliest_stretch(record, 1000)) == 1000


@pytest.mark.parametrize(("joint", "most"), [(0, 100), (None, 5000), (None, None)])
def test_arms_and_short_recordings_are_used_as_they_are(joint: int | None, most: int | None) -> None:
    record = record_moved_from(0, 10, joint=joint)
    assert liveliest_stretch(record, most) is record


def test_a_fit_says_which_part_it_used() -> None:
    fit = lh.fit(RECORDING, terms=TERMS, estimator="nlse", max_samples=1500)
    (source,) = fit.recordings
    assert source.samples == 1500
    (note,) = [note for note in fit.notes if "samples are used" in note]
    whole = len(lh.read(RECORDING))
    assert f"1500 of {whole} samples are used, from {source.start:.6g} to" in note
    assert "max-samples" in note
    again = lh.fit(
        RECORDING, terms=TERMS, estimator="nlse", span=(source.start, source.start + source.duration + 1e-9)
    )
    assert again.parameters["viscous_friction.coefficient"].value == pytest.approx(
        fit.parameters["viscous_friction.coefficient"].value, rel=1e-3
    )
    assert not [note for note in again.notes if "samples are used" in note]
    verification = lh.verify(RECORDING, fit, max_samples=1000)
    assert verification.recordings[0].samples == 1000
    assert "1000 of" in verification.notes[0]
    later = lh.verify(RECORDING, fit, span=(10.0, 25.0)).recordings[0]
    assert later.start == pytest.approx(10.0, abs=0.05)
    assert later.duration == pytest.approx(15.0, abs=0.1)


def test_the_stretch_lies_within_a_span_that_was_chosen() -> None:
    dataset = load_dataset(RECORDING, span=(8.0, 27.0), max_samples=1500)
    assert len(dataset.measured) == 1500
    assert 8.0 <= dataset.measured.t[0] < dataset.measured.t[-1] <= 27.0
    assert "1500 of" in " ".join(dataset.notes())


def test_samples_of_test_recordings_are_limited_too() -> None:
    test = RECORDING.with_name("ball_beam_test.mcap")
    dataset = load_dataset(RECORDING, test_path=test, max_samples=800)
    assert (len(dataset.measured), len(dataset.test)) == (800, 800)
    assert sum("800 of" in note for note in dataset.notes()) == 2


@pytest.mark.parametrize("most", [39, 0, -5, 1.5, "many"])
def test_numbers_of_samples_that_fit_nothing_are_refused(most: object) -> None:
    with pytest.raises(UsageError, match="max_samples: expected"):
        lh.fit(RECORDING, terms=TERMS, max_samples=most)  # type: ignore[arg-type]


def test_the_command_line_takes_it(labhil, tmp_path: Path) -> None:
    done = labhil(
        "fit", RECORDING, "--terms", "viscous_friction", "--estimator", "nlse", "--max-samples", "900"
    )
    assert done.status == 0, done.err
    assert "900 of" in " ".join(done.out.split())
    assert "--max-samples: expected at least 40" in labhil("fit", RECORDING, "--max-samples", "3").refused()

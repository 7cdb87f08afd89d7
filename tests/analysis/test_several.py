"""Several recordings at once: nothing crosses a border, what is shared is known better, the rest apart."""

from __future__ import annotations

import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st

from labhil.diagnose.diagnosis import diagnose
from labhil.diagnose.intake import FaultKind, assess_usability, detect_faults
from labhil.errors import RecordingError, UnknownNameError, UsageError
from labhil.identify import statistics
from labhil.identify.fitted import fit_terms, start_theta
from labhil.identify.intervals import bootstrap_intervals
from labhil.identify.score import score
from labhil.identify.windows import (
    fit_windows,
    noise_of,
    scored_windows,
    split,
    whole_recordings,
    with_noise_scales,
)
from labhil.physics.extra_force import AcceptsExtraForce, CurveArgument, ExtraForce
from labhil.physics.joining import join_records
from labhil.physics.model import index_of, start_values
from labhil.physics.record import Record, Windows
from labhil.physics.rigs import model_for
from labhil.physics.several import for_every_recording, several
from labhil.rig import parse_rig
from labhil_benchmarks.statistics import arm
from labhil_benchmarks.statistics.cases import driven, levels

TERMS = ("viscous_friction", "coulomb_friction", "constant_force")
OWN = ("moving_mass", "constant_force")
NOISE = 2e-5
"""Of a position, m."""


def rig_of(kind: str, known: str = ""):
    return parse_rig(f'[rig]\nkind = "{kind}"\n[known]\n{known}', Path(f"{kind}.toml"))


def blank(n: int, period: float = 0.01, begin: float = 0.0) -> Record:
    return Record(begin + period * np.arange(n), np.zeros((n, 1)), np.zeros((n, 1)), ("u",), ("y",), ("m",))


def axis(seed: int, values=None, terms=TERMS, n: int = 900) -> Record:
    """An axis under force levels, with white noise of one size whatever the motion is."""
    random = np.random.default_rng(seed)
    silent = driven("axis", levels(n, 60, 80.0, random), 0.005, values or {}, terms, 300.0, False, random,
                    (("position", "m"),))[0]  # fmt: skip
    return replace(silent, outputs=silent.outputs + NOISE * random.standard_normal((n, 1)))


def motor(seed: int, n: int = 400, terms=("viscous_friction", "coulomb_friction")) -> Record:
    random = np.random.default_rng(seed)
    channels = (("speed", "rad/s"), ("current", "A"))
    return driven("dc_motor", levels(n, 50, 5.0, random), 0.01, {}, terms, 28.0, False, random, channels)[0]


# Records


def test_recordings_come_out_of_a_record_as_they_went_in():
    given = [blank(30, 0.01, 5.0), blank(40, 0.02, -1.0), blank(25, 0.01)]
    record = join_records(given)
    assert np.all(np.diff(record.t) > 0.0)
    assert record.spans == [(0, 30), (30, 70), (70, 95)]
    for number, (each, back) in enumerate(zip(given, record.recordings(), strict=True), 1):
        assert back.t == pytest.approx(each.t, abs=1e-12)
        assert [begin.number for begin in back.begins] == [number]
    assert record.own_time(70) == (3, pytest.approx(0.0, abs=1e-12))
    assert record.duration == pytest.approx(sum(each.duration for each in given))
    assert record.longest == pytest.approx(39 * 0.02)
    part = record.part(20, 80)
    assert part.spans == [(0, 10), (10, 50), (50, 60)]
    assert [begin.number for begin in part.begins] == [1, 2, 3]
    assert part.own_time(10) == (2, pytest.approx(-1.0))
    assert join_records(given[:1]) is given[0]


@pytest.mark.parametrize(
    ("other", "told"),
    [
        (replace(blank(30), input_names=("v",)), "expected the inputs u as in recording 1, found v"),
        (replace(blank(30), output_names=("z",)), "outputs"),
        (replace(blank(30), auxiliary={"temperature": np.zeros(30)}), "other channels none"),
        (blank(0), "recording 2: expected samples, found 0"),
    ],
)
def test_recordings_of_other_channels_are_refused(other, told):
    with pytest.raises(RecordingError, match=told):
        join_records([blank(30), other])


LENGTHS = st.lists(st.integers(60, 400), min_size=1, max_size=4)
PERIODS = st.lists(st.sampled_from([0.005, 0.01]), min_size=4)


@settings(deadline=None, max_examples=60)
@given(lengths=LENGTHS, window=st.floats(0.05, 6.0), periods=PERIODS)
def test_no_window_reaches_from_one_recording_into_the_next(lengths, window, periods):
    given = [blank(n, period, 3.0) for n, period in zip(lengths, periods, strict=False)]
    # a number of windows half way between two may be rounded to either
    assume(all(abs((each.duration / window) % 1.0 - 0.5) > 1e-6 for each in given))
    record = join_records(given)
    cut = fit_windows(record, window)
    assert np.array_equal(cut.rows, np.arange(len(record)))
    alone = np.concatenate([each.last - each.first for each in (fit_windows(each, window) for each in given)])
    # a border that falls upon a sample may be rounded to either side of it
    assert len(alone) == len(cut)
    assert np.abs(cut.last - cut.first - alone).max() <= 2
    horizon = min(window, 0.3 * min(each.duration for each in given))
    scored = scored_windows(record, horizon)
    for windows in (cut, scored.lead, scored.whole, whole_recordings(record).whole):
        assert crossing(record, windows) == 0
    assert np.array_equal(whole_recordings(record).whole.rows, np.arange(len(record)))


def crossing(record: Record, windows: Windows) -> int:
    """How many windows see more than one recording."""
    begins = [first for first, _ in record.spans]
    first, last = (np.searchsorted(begins, rows, side="right") for rows in (windows.first, windows.last - 1))
    return int(np.sum(first != last))


def test_the_last_share_of_every_recording_is_held_out():
    record = join_records([blank(200), blank(100)])
    learn, held_out = split(record, 0.3, 0.1)
    assert [part.duration for part in held_out.recordings()] == pytest.approx([0.6, 0.3], abs=0.02)
    assert [part.duration for part in learn.recordings()] == pytest.approx([1.29, 0.59], abs=0.02)
    assert [part.t[0] for part in held_out.recordings()] == pytest.approx([1.4, 0.7], abs=0.02)


def test_noise_is_that_within_recordings():
    random = np.random.default_rng(1)
    parts = [replace(blank(9), outputs=level + 1e-3 * random.standard_normal((9, 1))) for level in range(100)]
    assert noise_of(join_records(parts))[0] == pytest.approx(1e-3, rel=0.2)


def test_neighbours_are_of_the_same_recording():
    random = np.random.default_rng(2)
    scores, begins = random.standard_normal((300, 2)), (0, 100, 220)
    parts = [scores[:100], scores[100:220], scores[220:]]
    for lag in (0, 1, 7):
        alone = sum(part[lag:].T @ part[: len(part) - lag] for part in parts)
        assert statistics.lagged_product(scores, lag, begins) == pytest.approx(alone)
    # one recording after another that go on alike: a border would be seen as a jump
    walk = np.concatenate(
        [level + 0.1 * random.standard_normal(50) for level in 100.0 * random.standard_normal(9)]
    )
    begins = tuple(range(0, 450, 50))
    alone = [
        statistics.whiteness(walk[run] - walk[run].mean()) for run in statistics.recording_slices(begins, 450)
    ]
    together = statistics.smallest_p_value(
        lambda r, rows: statistics.whiteness(r - r.mean()), walk[:, None], begins
    )
    assert together == pytest.approx(min(1.0, 9 * min(alone)))


def test_blocks_of_a_bootstrap_stay_within_a_recording():
    """Two recordings of opposite errors: a block across the border would be a mean of both."""
    jacobian = np.ones((200, 1))
    residuals = np.repeat([1.0, -1.0], 100)
    low, high = bootstrap_intervals(jacobian, residuals, np.zeros(1), 199, 2.576, begins=(0, 100))[0]
    assert low == pytest.approx(-high, rel=0.2)


def test_faults_are_looked_for_in_each_recording_by_itself():
    good = axis(1)
    stuck = good.outputs.copy()
    stuck[300:420] = stuck[300]
    record = join_records([good, replace(good, outputs=good.outputs + 5.0), replace(good, outputs=stuck)])
    found = detect_faults(record)
    assert {(fault.kind, fault.recording) for fault in found} == {(FaultKind.STUCK, 3)}
    assert found[0].statement.startswith("Recording 3: ")
    assert found[0].times[0][0] == pytest.approx(good.t[300], abs=0.02)
    left = assess_usability(record, found)
    assert not left.is_usable
    assert left.sound[:1800].all() and not left.sound[2100 + 10 : 2220 - 10].any()


# Models


@pytest.fixture(scope="module")
def three() -> list[Record]:
    worlds = [(95.0, -3.2), (120.0, 4.0), (70.0, 0.5)]
    return [axis(k, {"moving_mass": m, "constant_force.force": f}) for k, (m, f) in enumerate(worlds, 1)]


def test_every_recording_is_simulated_by_its_own_model():
    records = [motor(1), motor(2)]
    record = join_records(records)
    rig = rig_of("dc_motor")
    model = model_for(rig, record, ("constant_force", "dead_zone.left"))
    keys = {p.key for p in model.parameters}
    assert {"constant_force.force@1", "dead_zone.left@2", "dead_zone.right", "inertia"} <= keys
    assert [p.key for p in model.terms["dead_zone"].parameters] == [
        "dead_zone.left@1", "dead_zone.left@2", "dead_zone.right"
    ]  # fmt: skip
    theta, at = start_values(model.parameters), index_of(model.parameters)
    for key, value in {
        "constant_force.force@1": 0.02, "constant_force.force@2": -0.05, "dead_zone.left@1": 0.1,
        "dead_zone.left@2": 0.3, "dead_zone.right": 0.2, "time_delay.delay": 0.013,
        "coulomb_friction.level": 0.02, "backlash.gap": 0.2,
    }.items():  # fmt: skip
        theta[at[key]] = value
    windows = fit_windows(record, 1.1)
    some = Windows.of([(int(windows.first[w]), int(windows.last[w])) for w in (1, 4, 5)])
    for chosen in (windows, some):
        states = model.initial_states(record, chosen)
        along = model.coordinates(theta, record, chosen, states)
        outputs = model.simulate(theta, record, chosen, states)
        generalised_force, driven_by = (
            model.generalised_force(theta, along),
            model.drive_coordinates(theta, record, chosen, along),
        )
        done = 0
        for number, (each, (first, last)) in enumerate(
            zip(record.recordings(), record.spans, strict=True), 1
        ):
            mine = (chosen.first >= first) & (chosen.first < last)
            alone = Windows.of(
                [(a - first, b - first) for a, b in zip(chosen.first[mine], chosen.last[mine], strict=True)]
            )
            rows = slice(done, done + len(alone.rows))
            done += len(alone.rows)
            own, inner = model.of_recording(theta, number), model.inner
            assert states[mine] == pytest.approx(inner.initial_states(each, alone), rel=1e-9)
            assert outputs[rows] == pytest.approx(inner.simulate(own, each, alone, states[mine]), rel=1e-9)
            here = inner.coordinates(own, each, alone, states[mine])
            for name, values in here.items():
                assert along[name][rows] == pytest.approx(values, rel=1e-9, abs=1e-12), name
            assert generalised_force[rows] == pytest.approx(
                inner.generalised_force(own, here), rel=1e-9, abs=1e-12
            )
            for name, values in inner.drive_coordinates(own, each, alone, here).items():
                assert driven_by[name][rows] == pytest.approx(values, rel=1e-9, abs=1e-12)


@pytest.mark.extended
def test_a_further_force_acts_in_the_recording_it_is_given_for():
    record = join_records([axis(1), axis(2)])
    model = model_for(rig_of("axis"), record)
    assert isinstance(model, AcceptsExtraForce)
    theta, windows = start_theta(model), fit_windows(record, 1.0)
    states = model.initial_states(record, windows)
    course = np.where(np.arange(len(record)) < 900, 0.0, 5.0)
    pushed = model.with_force(ExtraForce(CurveArgument.TIME, np.array([0.0, 1.0]), np.zeros(2), 1.0, course))
    moved = np.abs(
        pushed.simulate(theta, record, windows, states) - model.simulate(theta, record, windows, states)
    )
    assert not moved[:900].any()
    assert moved[900:].max() > 1e-4


@pytest.mark.extended
def test_one_recording_is_what_it_was():
    record = axis(3)
    rig = rig_of("axis")
    plain = model_for(rig, join_records([record]))
    wrapped = several(plain, (), 1)
    sigma = noise_of(record)
    one, other = (fit_terms(model, record, TERMS, 1.0, sigma, iterations=10) for model in (plain, wrapped))
    assert type(plain).__name__ == "AxisModel"
    assert np.array_equal(one.theta, other.theta)
    assert all(np.array_equal(a, b) for a, b in zip(one.covariances, other.covariances, strict=True))
    assert np.array_equal(
        score(plain, one.theta, record, sigma).errors, score(wrapped, one.theta, record, sigma).errors
    )


@pytest.mark.extended
def test_the_joint_fit_is_the_weighted_mean_of_single_ones(three):
    """Values that are shared are known as well as from all data, those that are not as from their own."""
    rig, shared = rig_of("axis"), ["viscous_friction.coefficient", "coulomb_friction.level"]
    record = join_records(three)
    model = model_for(rig, record, OWN)
    found = fit_terms(model, record, TERMS, 1.0, np.array([NOISE]))
    keys = [model.parameters[i].key for i in found.problem.free]
    values = dict(zip(keys, found.theta[found.problem.free], strict=True))
    _, classical, _ = found.covariances
    errors = dict(zip(keys, np.sqrt(np.diag(classical)), strict=True))
    truth = {"moving_mass@1": 95.0, "moving_mass@2": 120.0, "moving_mass@3": 70.0,
             "constant_force.force@1": -3.2, "constant_force.force@2": 4.0, "constant_force.force@3": 0.5,
             "viscous_friction.coefficient": 204.0, "coulomb_friction.level": 20.4}  # fmt: skip
    assert values.keys() == truth.keys()
    for key, value in truth.items():
        assert abs(values[key] - value) < 5.0 * errors[key], key
    weights, sums, alone = np.zeros((2, 2)), np.zeros(2), []
    for each in three:
        single = fit_terms(model_for(rig, each), each, TERMS, 1.0, np.array([NOISE]))
        own = [single.problem.model.parameters[i].key for i in single.problem.free]
        places = [own.index(key) for key in shared]
        _, covariance, _ = single.covariances
        weight = np.linalg.inv(covariance[np.ix_(places, places)])
        weights += weight
        sums += weight @ single.theta[single.problem.free][places]
        alone.append(np.sqrt(np.diag(covariance))[places])
    combined = np.linalg.solve(weights, sums)
    together = np.array([errors[key] for key in shared])
    assert together == pytest.approx(np.sqrt(np.diag(np.linalg.inv(weights))), rel=0.1)
    for key, value, error in zip(shared, combined, together, strict=True):
        assert abs(values[key] - value) < 0.3 * error, key
    assert np.all(together < 1.3 / np.sqrt(3.0) * np.sqrt(np.mean(np.square(alone), axis=0)))


@pytest.mark.extended
def test_scores_are_told_of_each_recording(three):
    record = join_records([three[0], replace(three[1], outputs=three[1].outputs + 7.0)])
    model = model_for(rig_of("axis"), record, OWN)
    found = fit_terms(model, record, TERMS, 1.0, np.array([NOISE]))
    marks = score(model, found.theta, record, np.array([NOISE]), 1.0)
    assert [each.recording for each in marks.recordings] == [1, 2]
    counts = [np.sum((marks.rows >= first) & (marks.rows < last)) for first, last in record.spans]
    pooled = sum(n * each.mse for n, each in zip(counts, marks.recordings, strict=True)) / sum(counts)
    assert marks.mse == pytest.approx(pooled)
    # where a recording is says nothing of how well it is simulated
    spread = sum(n * each.mse / (1.0 - each.r2) for n, each in zip(counts, marks.recordings, strict=True))
    assert 1.0 - marks.r2 == pytest.approx(sum(counts) * marks.mse / spread)


PAYLOADS = (1.0, 2.5)
LENGTHS_ONLY = "".join(
    f"[[joint]]\nd = {d}\na = {a}\nalpha = {alpha}\n"
    for d, a, alpha in (
        (0.089, 0.0, 1.5708),
        (0.0, -0.425, 0.0),
        (0.0, -0.392, 0.0),
        (0.109, 0.0, 1.5708),
        (0.095, 0.0, -1.5708),
        (0.082, 0.0, 0.0),
    )
)


@pytest.fixture(scope="module")
def lifted() -> Record:
    """An arm with one payload, then with another."""
    random = np.random.default_rng(5)
    records = []
    for seed, mass in enumerate(PAYLOADS, 1):
        values = {**arm.SILENT, "payload.mass": mass, "payload.centre_z": 0.06}
        seen = arm.follow((*arm.TERMS, "payload"), values, seed)
        records.append(replace(seen, outputs=seen.outputs + arm.noise(len(seen), False, random)))
    return join_records(records)


def values_of(model, record: Record) -> dict[str, float]:
    ready = model.prepare(record)
    found = fit_terms(model, ready, (*arm.TERMS, "payload"), ready.longest, noise_of(ready))
    return dict(zip([p.key for p in model.parameters], found.theta, strict=True))


@pytest.mark.parametrize("name", ["payload", "payload.mass"])
def test_two_payloads_on_one_arm(lifted, name):
    model = model_for(parse_rig(arm.RIG, Path("ur5.toml")), lifted, (name,))
    ready = model.prepare(lifted)
    assert len(ready.begins) == 2
    assert ready.recordings()[1].motion is not None
    values = values_of(model, lifted)
    for number, mass in enumerate(PAYLOADS, 1):
        assert values[f"payload.mass@{number}"] == pytest.approx(mass, abs=0.02)
    centre = "payload.centre_z@2" if name == "payload" else "payload.centre_z"
    assert values[centre] == pytest.approx(0.06, abs=0.003)
    shared = "coulomb_friction.level[2]"
    assert values[shared] == pytest.approx(arm.TRUTH[shared], rel=0.05)


@pytest.mark.extended
def test_of_an_arm_of_unknown_inertia_all_recordings_tell(lifted, tmp_path):
    """Its own mass may pass for a payload; how much more it carries the second time is known."""
    (tmp_path / "links.toml").write_text(LENGTHS_ONLY)
    rig = parse_rig(f'{arm.RIG}links = "links.toml"\n', tmp_path / "ur5.toml")
    both, one = model_for(rig, lifted, ("payload",)), model_for(rig, lifted.recordings()[0])
    assert len(both.inner.first.grouped.kept) >= len(one.first.grouped.kept)
    values = values_of(both, lifted)
    assert values["payload.mass@2"] - values["payload.mass@1"] == pytest.approx(1.5, abs=0.05)


@pytest.mark.parametrize(
    ("names", "known", "error", "told"),
    [
        (("movin_mass",), "", UnknownNameError, "did you mean 'moving_mass'"),
        (("moving_mass",), "moving_mass = 95.0\n", UsageError, r"the rig file's \[known\] gives it"),
        (("temperature_dependent_friction",), "", UsageError, "cannot show it: needs temperature"),
    ],
)
def test_what_cannot_be_of_one_recording_is_refused(names, known, error, told):
    with pytest.raises(error, match=told):
        model_for(rig_of("axis", known), join_records([axis(1, n=100), axis(2, n=100)]), names)


def test_a_recording_that_a_model_was_not_made_for_is_refused():
    two, three = (join_records([axis(seed, n=100) for seed in range(count)]) for count in (2, 3))
    for names, simulated in (((), True), (("moving_mass",), False)):
        model = model_for(rig_of("axis"), two, names)
        windows = fit_windows(three, 1.0)
        states = model.initial_states(three, windows)
        if simulated:
            assert len(model.simulate(start_theta(model), three, windows, states)) == 300
        else:
            with pytest.raises(RecordingError, match="recording 3: expected one of 2"):
                model.simulate(start_theta(model), three, windows, states)


def test_a_value_that_is_said_of_no_recording_is_said_of_all():
    model = model_for(rig_of("axis"), join_records([axis(1, n=100), axis(2, n=100)]), ("moving_mass",))
    values = {"moving_mass": 90.0, "moving_mass@2": 80.0, "coulomb_friction.level": 20.0}
    assert for_every_recording(model, values) == {
        "moving_mass@1": 90.0, "moving_mass@2": 80.0, "coulomb_friction.level": 20.0
    }  # fmt: skip


# Diagnoses

BASELINE = ("viscous_friction", "coulomb_friction")
SPRING = "spring_force"


def sprung(seed: int, stiffness: float, n: int = 400) -> Record:
    """An axis with a spring, or none, behind a sensor of 0.4 mm."""
    random = np.random.default_rng(seed)
    terms = (*BASELINE, SPRING) if stiffness else BASELINE
    inputs, channels = levels(n, 30, 80.0, random), (("position", "m"),)
    values = {f"{SPRING}.stiffness": stiffness} if stiffness else {}
    clean, _ = driven("axis", inputs, 0.01, values, terms, 300.0, False, random, channels)
    return replace(clean, outputs=clean.outputs + 4e-4 * random.standard_normal((n, 1)))


def diagnosed(searched: list[Record], tested: list[Record], names=()):
    search, test = join_records(searched), join_records(tested)
    model = model_for(rig_of("axis", "moving_mass = 95.0\n"), search, names)
    return diagnose(model, search, test, heldout_is_test=True, baseline=BASELINE, measured=search)


@pytest.mark.extended
def test_what_acts_in_one_recording_only_is_found_there():
    searched, tested = ([sprung(seed, 0.0), sprung(seed + 1, 60.0)] for seed in (1, 3))
    found = diagnosed(searched, tested, (SPRING,))
    assert [item.term for item in found.missing] == [SPRING]
    here, there = found.missing[0].parameters
    assert (here.recording, here.significant) == (1, False)
    assert (there.recording, there.significant) == (2, True)
    assert there.value == pytest.approx(60.0, abs=3.0)
    assert set(found.location.recordings) == {2}
    assert all(0.0 <= begin < end < 4.0 for begin, end in found.location.times)
    assert [each.recording for each in found.after.recordings] == [1, 2]
    assert re.search("stiffness@1 = .*, stiffness@2 = ", found.missing[0].statement)
    assert "in recording 2" in found.location.statement


@pytest.mark.extended
def test_what_each_recording_alone_shows_too_weakly_is_found_in_both():
    """Friction that is the same in both leaves less for a spring to be taken for."""
    searched, tested = [sprung(271, 4.0), sprung(272, 4.0)], [sprung(273, 4.0), sprung(274, 4.0)]
    alone = [diagnosed([one], [other]) for one, other in zip(searched, tested, strict=True)]
    # that there is more than noise may show, but not what
    assert [found.verdict for found in alone] == ["unexplained_mismatch", "no_mismatch"]
    assert not any(found.missing for found in alone)
    both = diagnosed(searched, tested)
    assert [item.term for item in both.missing] == [SPRING]
    assert both.missing[0].parameters[0].value == pytest.approx(4.0, abs=2.0)
    assert both.missing[0].parameters[0].recording is None


def test_a_loud_recording_says_less_than_a_quiet_one():
    """Each is weighted by its own noise: with a bad recording beside it a good one is worth no less."""
    good, bad = axis(1), axis(2)
    random = np.random.default_rng(3)
    bad = replace(bad, outputs=bad.outputs + 100.0 * NOISE * random.standard_normal(bad.outputs.shape))
    errors = []
    for records in ([good], [good, bad]):
        model = model_for(rig_of("axis"), join_records(records))
        record = with_noise_scales(model, join_records(records))
        found = fit_terms(model, record, TERMS, 1.0, noise_of(record))
        _, classical, _ = found.covariances
        errors.append(np.sqrt(np.diag(classical)))
    assert np.all(errors[1] < 1.1 * errors[0])
    marks = score(model, found.theta, record, noise_of(record), 1.0)
    floors = [own.noise_floor for own in marks.recordings]
    assert floors[1] == pytest.approx(100.0 * floors[0], rel=0.3)
    assert marks.noise_floor == pytest.approx(np.sqrt(np.mean(np.square(floors))), rel=0.05)

from __future__ import annotations

import re
import tomllib
from importlib.resources import files
from pathlib import Path

import pytest

from labhil.errors import ExperimentFileError, RigFileError
from labhil.experiment.controller import Controller
from labhil.experiment.excitation import sample
from labhil.experiment.experiment import Step, TimedStep, load_experiment, parse_experiment
from labhil.experiment.plan import make_plan
from labhil.signals import Direction, Signal, Stream
from labhil.toml_text import to_toml

TEXT = """
[experiment]
name = "two-sine"
seed = 1
[devices.bench]
plugin = "ball_beam"
address = "twin"
twin = { speed = 5.0, seed = 3, terms = ["viscous_friction"], set = { viscous_friction.coefficient = 0.3 } }
[[steps]]
device = "bench"
signal = "servo_angle"
excitation = "multisine"
frequencies = [0.23, 0.31]
amplitude = 0.6
stabilise = { on = "ball_position", kp = 7.0, kd = 3.0 }
duration = 60.0
[record]
path = "{name}-{start}.mcap"
"""
PATH = Path("bench/experiment.toml")


def test_the_contracts_example_is_read() -> None:
    experiment = parse_experiment(TEXT, PATH)
    twin = experiment.devices["bench"].twin
    assert (twin.speed, twin.seed, twin.terms) == (5.0, 3, ("viscous_friction",))
    assert twin.set == {"viscous_friction.coefficient": 0.3}
    step = experiment.steps[0]
    assert step.stabilise is not None
    assert (step.stabilise.kp, step.stabilise.setpoint, step.stabilise.filter) == (7.0, 0.0, 0.03)
    assert experiment.duration == 60.0


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ('name = "two-sine"', "", "experiment.name: this key is missing"),
        (
            "frequencies =",
            "frequencys =",
            r"steps.0.frequencys: unknown key \(did you mean 'frequencies'\?\)",
        ),
        (
            '"multisine"',
            '"multisin"',
            r"steps.0: excitation 'multisin' does not exist \(did you mean 'multisine'",
        ),
        ("amplitude = 0.6", "", "steps.0: excitation 'multisine' needs the key `amplitude`"),
        ("amplitude = 0.6", 'amplitude = "big"', "steps.0.amplitude: .*found 'big'"),
        ("amplitude = 0.6", "amplitude = nan", "steps.0.amplitude: .*found nan"),
        ("duration = 60.0", "duration = -1.0", "steps.0.duration: .*greater than 0, found -1.0"),
        ('device = "bench"', 'device = "bensh"', r"steps.0.device: no device 'bensh' \(did you mean 'bench'"),
        ("kp = 7.0", "k_p = 7.0", "steps.0.stabilise.k_p: unknown key .*known: on, kp, kd, setpoint, filter"),
        ("speed = 5.0", "speed = 0.0", "devices.bench.twin.speed"),
        ("{start}", "{begin}", "record.path: only {name} and {start}"),
        ("-{start}.mcap", "", "record.path: a recording's name ends in .mcap"),
        ("[devices.bench]", "[devices.run]", "devices: device name 'run'"),
        ("[experiment]", "[experiment", "not TOML"),
    ],
)
def test_a_wrong_file_says_where_and_what(old: str, new: str, message: str) -> None:
    with pytest.raises(ExperimentFileError, match=f"(?m)^{PATH}: {message}"):
        parse_experiment(TEXT.replace(old, new), PATH)


def test_an_experiment_without_steps_is_none() -> None:
    with pytest.raises(ExperimentFileError, match="steps: there are none"):
        parse_experiment("steps = []\n" + TEXT[: TEXT.index("[[steps]]")], PATH)


def test_a_file_that_is_not_there_is_named(tmp_path: Path) -> None:
    with pytest.raises(ExperimentFileError, match=r"nothing\.toml: cannot be read as an experiment file"):
        load_experiment(tmp_path / "nothing.toml")


STEP = """
[[steps]]
device = "bench"
signal = "servo_angle"
excitation = "hold"
level = 0.0
duration = 2.0
"""


def test_steps_follow_one_another_unless_they_say_when() -> None:
    text = TEXT + STEP + STEP + "at = 70.0\n" + STEP
    starts = [timed.start for timed in parse_experiment(text, PATH).schedule()]
    assert starts == [0.0, 60.0, 70.0, 72.0]


def test_two_steps_cannot_drive_one_signal_at_once() -> None:
    with pytest.raises(ExperimentFileError, match=r"steps\.1: bench\.servo_angle is driven by steps\.0"):
        parse_experiment(TEXT + STEP + "at = 10.0\n", PATH)


def test_the_public_copy_says_nothing_of_a_twin() -> None:
    text = "# the answer: coulomb\n" + TEXT
    public = parse_experiment(text, PATH).public_text()
    for secret in ("twin =", "viscous", "coulomb", "speed", "seed = 3"):
        assert secret not in public
    again = parse_experiment(public, PATH)
    assert again.steps == parse_experiment(TEXT, PATH).steps


def test_toml_is_written_so_that_it_reads_the_same() -> None:
    data = {
        "text": 'quote " backslash \\ newline \n ü',
        "flag": True,
        "numbers": [1, 2.5, 1e-7],
        "table": {"odd key": 1, "inner": {"x": -3.0}},
        "rows": [{"a": 1, "b": {"c": [1.0]}}, {"a": 2}],
    }
    assert tomllib.loads(to_toml(data)) == data


def plan_of(tmp_path: Path, text: str = TEXT, limits: str = "") -> str:
    (tmp_path / "rig.toml").write_text(f'[rig]\nkind = "ball_beam"\n{limits}')
    with_rig = text.replace('address = "twin"', 'address = "twin"\nrig = "rig.toml"')
    return make_plan(parse_experiment(with_rig, tmp_path / "experiment.toml")).describe()


def test_a_plan_says_what_would_happen(tmp_path: Path) -> None:
    told = plan_of(tmp_path, limits="[limits]\nservo_angle = { min = -1.2, max = 1.2, rate = 12.0 }\n")
    assert "60 s" in told
    assert "limit servo_angle: -1.2 to 1.2, 12 per second" in told
    assert "crest factor" in told
    assert "no limits" in plan_of(tmp_path)


def test_an_excitation_beyond_its_limits_is_refused(tmp_path: Path) -> None:
    with pytest.raises(
        ExperimentFileError, match=r"steps\.0: the excitation of servo_angle reaches from -1\.\d+ to"
    ):
        plan_of(tmp_path, limits="[limits]\nservo_angle = { min = -1.0, max = 1.0 }\n")


def test_an_excitation_beyond_what_the_device_takes_is_refused_without_limits_too(tmp_path: Path) -> None:
    with pytest.raises(ExperimentFileError, match=r"steps\.0: .*; ball_beam takes -1\.571 to 1\.571 rad"):
        plan_of(tmp_path, TEXT.replace("amplitude = 0.6", "amplitude = 1.6"))


def test_an_excitation_that_is_too_fast_is_told(tmp_path: Path) -> None:
    told = plan_of(tmp_path, limits="[limits]\nservo_angle = { rate = 0.5 }\n")
    assert "slowed to its limit of 0.5 rad/s" in told


@pytest.mark.parametrize(("dwell", "told"), [(100.0, False), (70.0, True)])
def test_an_output_that_the_device_will_end_is_told(tmp_path: Path, dwell: float, told: bool) -> None:
    levels = "[1.0, 0.0]" if dwell == 100.0 else "[1.0, 0.5, 0.0]"
    step = f'signal = "coil_current_command"\nexcitation = "steps"\nlevels = {levels}\ndwell = {dwell}\n'
    text = f"""
[experiment]
name = "long"
[devices.coil]
plugin = "solenoid"
address = "twin"
[[steps]]
device = "coil"
{step}duration = 300.0
"""
    said = make_plan(parse_experiment(text, tmp_path / "e.toml")).describe()
    assert ("ends an output after 120 s" in said) is told


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        (
            'plugin = "ball_beam"',
            'plugin = "ball_bean"',
            r"devices\.bench: driver plugin 'ball_bean' .*'ball_beam'",
        ),
        ('"servo_angle"', '"servo"', r"steps\.0\.signal: command 'servo' does not exist"),
        ('on = "ball_position"', 'on = "ball"', r"steps\.0\.stabilise\.on: signal 'ball' does not exist"),
        ('["viscous_friction"]', '["viscous"]', r"devices\.bench: twin\.terms: 'viscous' does not exist"),
        ("viscous_friction.coefficient", "viscous", r"devices\.bench: twin\.set: 'viscous' does not exist"),
    ],
)
def test_names_that_do_not_exist_are_told_before_anything_starts(
    tmp_path: Path, old: str, new: str, message: str
) -> None:
    with pytest.raises(ExperimentFileError, match=message):
        plan_of(tmp_path, TEXT.replace(old, new))


def test_a_rig_file_that_is_wrong_is_told_with_its_own_name(tmp_path: Path) -> None:
    with pytest.raises(RigFileError, match=r"rig\.toml: limits\.servo_angel: unknown name \(did you mean"):
        plan_of(tmp_path, limits="[limits]\nservo_angel = { min = -1.0 }\n")


@pytest.mark.parametrize("name", ["ball_beam_identify.toml", "ball_beam_test.toml"])
def test_the_examples_that_are_shipped_can_be_run(name: str) -> None:
    path = Path(str(files("labhil.experiment"))) / "examples" / name
    plan = make_plan(load_experiment(path))
    assert plan.duration == 60.0
    assert plan.warnings() == ()


PRMS = """
[[steps]]
device = "bench"
signal = "servo_angle"
excitation = "prms"
low = -0.5
high = 0.5
count = 9
dwell = 0.5
duration = 20.0
"""


def excitations(text: str) -> list[object]:
    return [timed.make() for timed in parse_experiment(text, PATH).schedule()]


def test_the_experiments_seed_begins_what_its_steps_draw() -> None:
    text = TEXT + PRMS + PRMS + PRMS + "seed = 5\n"
    first = excitations(text)
    assert excitations(text) == first
    assert len({repr(made) for made in first}) == 4
    other = excitations(text.replace("seed = 1\n", "seed = 2\n"))
    assert other[1:3] != first[1:3]
    assert other[3] == first[3]


def test_a_table_lies_beside_its_experiment(tmp_path: Path) -> None:
    table = STEP.replace('"hold"', '"file"').replace("level = 0.0", 'path = "u.csv"')
    (tmp_path / "u.csv").write_text("0,0\n1,0.4\n2,0\n")
    assert "0 to 0.4 rad" in plan_of(tmp_path, TEXT + table)
    with pytest.raises(ExperimentFileError, match=r"steps\.1: `path`: .*missing\.csv cannot be read"):
        plan_of(tmp_path, TEXT + table.replace("u.csv", "missing.csv"))


def test_a_plan_shows_the_spectrum(tmp_path: Path) -> None:
    told = plan_of(tmp_path, TEXT + PRMS)
    assert re.search(r"prms, -0.5 to 0.5 rad, .*crest factor 1\.\d\d, RMS 0\.3\d* rad", told)
    assert "90 % of its power in 0.233–0.317 Hz; −3 dB" in told
    assert " Hz |" in told
    assert "█" in told


def test_a_vector_needs_a_vector(tmp_path: Path) -> None:
    joints = """
[[steps]]
device = "bench"
signal = "servo_angle"
excitation = "fourier"
low = [-0.5, -0.5]
high = 0.5
speed = 1.0
acceleration = 5.0
base_frequency = 0.1
duration = 20.0
"""
    with pytest.raises(ExperimentFileError, match="servo_angle has 1 columns, but the excitation has 2"):
        plan_of(tmp_path, TEXT + joints)
    assert "fourier" in plan_of(tmp_path, TEXT + joints.replace("[-0.5, -0.5]", "-0.5"))


def test_a_vector_is_asked_for_column_by_column() -> None:
    joints = Step(
        device="arm",
        signal="target_q",
        excitation="fourier",
        low=(-0.5, -0.4),
        high=0.5,
        speed=1.0,
        acceleration=5.0,
        base_frequency=0.1,
        duration=20.0,
    )
    stream = Stream("state", (Signal("target_q", "rad", Direction.INPUT, width=2),), 125.0)
    asked = Controller([TimedStep(0, joints, 1.0)], stream, {}).setpoints(3.0, [0.0, 0.0])
    expected = sample(joints.make(), [2.0])[0]
    assert asked == {"target_q_0": expected[0], "target_q_1": expected[1]}

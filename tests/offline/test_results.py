"""Results as files: the fit's JSON by the contract, what may stand for a model, what a process loads."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest

TERMS = "viscous_friction,coulomb_friction"
NUMBER = (int, float)
NULLABLE = (int, float, type(None))
TOP = {
    "schema": str, "recordings": list, "rig": str, "estimator": str, "seed": int, "terms": list,
    "parameters": list, "covariance": list, "identifiability": dict, "train": dict, "test": dict,
    "residuals": dict, "evaluations": int, "seconds": NUMBER,
}  # fmt: skip
PARAMETER = {
    "name": str, "term": (str, type(None)), "joint": type(None), "value": NUMBER, "unit": str,
    "std_error": NULLABLE, "std_error_reference": NULLABLE, "ci99": list, "z": NULLABLE,
    "p_value": NULLABLE, "significant": bool, "identifiable": bool, "at_bound": bool,
}  # fmt: skip
SCORE = {"mse": NUMBER, "rmse": NUMBER, "max_abs_error": NUMBER, "r2": NULLABLE, "per_channel": list}
IDENTIFIABILITY = {"rank": int, "of": int, "combinations": list, "would_help": list}
RESIDUALS = {"ljung_box_p": NUMBER, "input_crosscorrelation_p": NUMBER}
RECORDING = {"path": str, "sha256": str, "rig": str, "samples": int, "duration": NUMBER, "role": str}

LOADED = (
    "import sys\n"
    "from labhil.cli import main\n"
    "sys.argv = ['labhil', *sys.argv[1:]]\n"
    "try:\n    main()\n"
    "finally:\n    print('loaded', *sorted(sys.modules))\n"
)
ACQUISITION = (
    "zenoh", "serial", "labhil_ball_beam", "labhil_sim_ball_beam", "labhil.bus", "labhil.service",
    "labhil.experiment", "labhil.plants", "labhil.link", "labhil.campaign",
)  # fmt: skip


@pytest.fixture
def fit(labhil, shipped, tmp_path):
    """Fit the shipped recording quickly; return the JSON of it and what was printed."""

    def run(*arguments: object) -> tuple[dict[str, Any], str]:
        done = labhil(
            *("fit", shipped / "ball_beam_identify.mcap", "--window", "1", "--json", "fit.json"), *arguments
        )
        assert done.status == 0, done.err
        return json.loads(
            (tmp_path / "fit.json").read_text(encoding="utf-8"), parse_constant=refuse
        ), done.out

    return run


def refuse(constant: str) -> None:
    raise AssertionError(f"{constant} in a JSON file")


def check(found: dict[str, Any], shape: dict[str, Any]) -> None:
    for key, kind in shape.items():
        assert key in found, f"{key} is missing among {list(found)}"
        assert isinstance(found[key], kind), f"{key}: {found[key]!r}"
        assert not (kind == NUMBER and isinstance(found[key], bool)), key


@pytest.mark.extended
def test_the_json_of_a_fit_is_the_contracts(fit, shipped):
    data, _ = fit("--terms", TERMS, "--test", shipped / "ball_beam_test.mcap")
    check(data, TOP)
    assert (data["schema"], data["rig"], data["estimator"]) == ("labhil.fit/1", "ball_beam", "hybrid")
    assert data["terms"] == TERMS.split(",")
    for row in data["parameters"]:
        check(row, PARAMETER)
        assert row["ci99"][0] <= row["value"] <= row["ci99"][1]
        assert 0.0 <= row["p_value"] <= 1.0
    covariance = np.array(data["covariance"])
    errors = [row["std_error"] for row in data["parameters"]]
    assert covariance.shape == (2, 2)
    assert np.allclose(np.sqrt(np.diag(covariance)), errors)
    assert np.allclose(covariance, covariance.T)
    check(data["identifiability"], IDENTIFIABILITY)
    check(data["residuals"], RESIDUALS)
    for part in ("train", "test"):
        check(data[part], SCORE)
        assert data[part]["rmse"] == pytest.approx(np.sqrt(data[part]["mse"]))
        assert data[part]["max_abs_error"] >= data[part]["rmse"]
        assert data[part]["r2"] <= 1.0
        for channel in data[part]["per_channel"]:
            check(channel, {"channel": str, "joint": type(None), "unit": str, "rmse": NUMBER})
    for source in data["recordings"]:
        check(source, RECORDING)
    assert [source["role"] for source in data["recordings"]] == ["train", "test"]


@pytest.mark.extended
def test_r2_is_one_less_the_share_of_squares_that_is_left(fit, shipped):
    from labhil.analysis.dataset import load_dataset
    from labhil.analysis.study import fit_study
    from labhil.identify.fit import Options

    dataset = load_dataset(shipped / "ball_beam_identify.mcap", test_path=shipped / "ball_beam_test.mcap")
    score = fit_study(dataset, terms=("viscous_friction",), options=Options(window=1.0)).fit.test
    measured = dataset.test.outputs[score.rows, 0]
    left = np.sum(score.errors[:, 0] ** 2) / np.sum((measured - measured.mean()) ** 2)
    assert score.r2 == pytest.approx(1.0 - left)
    assert score.mse == pytest.approx(np.mean(score.errors[:, 0] ** 2))
    assert score.max_abs_error == np.abs(score.errors).max()


@pytest.mark.extended
def test_a_fit_begins_at_the_model_that_it_is_given(fit, tmp_path):
    # the default looks for other valleys whatever it begins at
    first, _ = fit("--terms", TERMS, "--estimator", "nlse")
    (tmp_path / "fit.json").rename(tmp_path / "first.json")
    again, _ = fit("--model", "first.json", "--estimator", "nlse")
    for parameter in (far := json.loads((tmp_path / "first.json").read_text()))["parameters"]:
        parameter["value"] *= 5.0
    (tmp_path / "far.json").write_text(json.dumps(far))
    from_afar, _ = fit("--model", "far.json", "--estimator", "nlse")
    assert again["terms"] == TERMS.split(",")
    # were the given values not begun at, nothing would tell the two fits apart
    assert again["evaluations"] != from_afar["evaluations"]
    for before, after in zip(first["parameters"], again["parameters"], strict=True):
        assert after["name"] == before["name"]
        assert abs(after["value"] - before["value"]) < 0.5 * before["std_error"]


@pytest.mark.extended
def test_the_same_fit_twice_gives_the_same_numbers(fit):
    one, _ = fit("--terms", TERMS)
    two, _ = fit("--terms", TERMS)
    assert one["parameters"] == two["parameters"]
    assert one["covariance"] == two["covariance"]


@pytest.mark.extended
def test_the_table_shows_what_the_json_holds(fit):
    data, text = fit("--terms", TERMS)
    for row in data["parameters"]:
        (line,) = [line for line in text.splitlines() if line.startswith(row["name"])]
        assert f"{row['value']:.5g}" in line
        assert row["unit"] in line


def test_the_catalogue_is_json_that_names_every_default_term(labhil):
    done = labhil("terms", "ball_beam", "--json")
    data = json.loads(done.out, parse_constant=refuse)
    rig = data["rigs"]["ball_beam"]
    names = {term["term"] for term in rig["terms"]}
    assert rig["baseline"] == ["viscous_friction"]
    assert set(rig["general"]) <= names
    assert {"backlash", "saturation", "sensor_gain", "static_friction"} <= names
    for term in rig["terms"]:
        check(term, {"term": str, "enters": str, "equation": str, "source": str, "parameters": list})
        assert all(p["name"].startswith(term["term"] + ".") for p in term["parameters"])
    text = labhil("terms").out
    assert all(name in text for name in names)


@pytest.mark.parametrize("command", ["fit", "export", "import", "terms"])
@pytest.mark.extended
def test_offline_work_loads_no_bus_and_no_device(command: str, shipped: Path, tmp_path: Path) -> None:
    recording = str(shipped / "ball_beam_identify.mcap")
    (tmp_path / "rig.toml").write_text('[rig]\nkind = "ball_beam"\n')
    (tmp_path / "bench.csv").write_text("t,servo_angle,ball_position\n0,0,0\n0.01,0,0\n0.02,0,0\n")
    arguments = {
        "fit": ("fit", recording, "--terms", "viscous_friction", "--window", "1"),
        "export": ("export", recording, "-o", "run.csv"),
        "import": ("import", "bench.csv", "--rig", "rig.toml", "-o", "bench.mcap"),
        "terms": ("terms", "ball_beam"),
    }[command]
    done = subprocess.run(
        [sys.executable, "-P", "-c", LOADED, *arguments],
        cwd=tmp_path, capture_output=True, text=True, check=False,
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    loaded = set(done.stdout.splitlines()[-1].split()[1:])
    assert "labhil.recording" in loaded or command == "terms"
    assert loaded.isdisjoint(ACQUISITION)
    assert command in ("fit", "terms", "import") or loaded.isdisjoint({"numba", "matplotlib", "statsmodels"})

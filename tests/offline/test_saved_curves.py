"""A curve that a diagnosis found, back in a model: simulated, fitted beside, verified, refused."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from labhil.analysis.saved_curves import curves_json, with_saved_curves
from labhil.errors import ModelFileError
from labhil.identify.extended import Coordinate
from labhil.identify.fitted import start_theta
from labhil.identify.saved_curve import ModelUnderCurves, SavedCurve
from labhil.identify.windows import fit_windows
from labhil.physics.axis import AxisModel
from labhil.physics.extra_force import CurveArgument
from labhil.physics.record import Record
from labhil.physics.rigs import model_for
from labhil.plants.axis import AxisPlant
from labhil.rig import parse_rig
from labhil.signals import Hold

RIG = '[rig]\nkind = "axis"\n[known]\nmoving_mass = 95.0\n'


def bench(n: int = 1500) -> Record:
    t = 0.005 * np.arange(n)
    force = 60.0 * np.sin(2.0 * np.pi * 0.9 * t) + 40.0 * np.sin(2.0 * np.pi * 2.3 * t)
    plant = AxisPlant({"position_noise": 0.0}, ("viscous_friction",), 0, 0.005)
    x = plant.simulate(force).measured["position"]
    return Record(t, force[:, None], x[:, None], ("drive_force",), ("position",), ("m",), (Hold.ZERO,))


def kept(acts: CurveArgument, name: str, record: Record) -> SavedCurve:
    values = record.outputs[:, 0] if acts is CurveArgument.POSITION else record.inputs[:, 0]
    x = np.linspace(values.min(), values.max(), 101)
    value = 8.0 * np.sin(5.0 * x / np.ptp(x))
    return SavedCurve(
        Coordinate(name, "m", acts, AxisModel.moved[0]), x, value, value - 1.0, value + 1.0, "N"
    )


def of_rig(record: Record) -> ModelUnderCurves:
    model = model_for(parse_rig(RIG, Path("rig.toml")), record)
    return ModelUnderCurves(model, [kept(CurveArgument.POSITION, "position", record)])


@pytest.mark.extended
def test_force_over_an_input_is_that_input_with_the_force_added() -> None:
    record = bench()
    curve = kept(CurveArgument.TIME, "drive_force", record)
    model = model_for(parse_rig(RIG, Path("rig.toml")), record)
    windows = fit_windows(record, 2.0)
    states = model.initial_states(record, windows)
    pushed = Record(
        record.t, record.inputs + curve.at(record.inputs[:, 0])[:, None], record.outputs,
        record.input_names, record.output_names, record.output_units, record.input_holds,
    )  # fmt: skip
    theta = start_theta(model, {"viscous_friction.coefficient": 200.0})
    under = ModelUnderCurves(model, [curve]).simulate(theta, record, windows, states)
    assert np.ptp(under - model.simulate(theta, record, windows, states)) > 1e-3
    np.testing.assert_allclose(under, model.simulate(theta, pushed, windows, states), atol=1e-9)


@pytest.mark.extended
def test_curve_survives_its_file(tmp_path: Path) -> None:
    record = bench()
    under = of_rig(record)
    path = tmp_path / "d.json"
    path.write_text(json.dumps({"curve": curves_json(under)[0]}, default=lambda a: a.tolist()))
    read = with_saved_curves(under.inner, path)
    assert isinstance(read, ModelUnderCurves)
    windows = fit_windows(record, 2.0)
    states = under.initial_states(record, windows)
    theta = start_theta(under, {"viscous_friction.coefficient": 200.0})
    for model in (under, read):
        np.testing.assert_allclose(
            model.simulate(theta, record, windows, states), under.simulate(theta, record, windows, states)
        )


def test_file_without_a_curve_leaves_the_model_as_it_is(tmp_path: Path) -> None:
    model = of_rig(bench()).inner
    path = tmp_path / "f.json"
    path.write_text('{"schema": "labhil.fit/1", "curve": null}')
    assert with_saved_curves(model, path) is model
    assert with_saved_curves(model, None) is model


@pytest.mark.parametrize(
    ("field", "value", "expected"),
    [
        ("acts", "sideways", "position_against"),
        ("x", [[0.0, 1.0, 1.5]], "evenly spaced"),
        ("value", [1.0, None, 2.0], "x and value"),
        ("value", [1.0], "as many"),
        ("depends_on", ["ball_position"], "expected one of position"),
        ("depends_on", [], "depends_on"),
        ("joint", 2, "expected one of null"),
    ],
)
def test_bad_curve_is_named(field: str, value: object, expected: str, tmp_path: Path) -> None:
    good = {
        "depends_on": ["position"], "acts": "position", "x": [[0.0, 1.0, 2.0]], "value": [1.0, 2.0, 1.0],
        "ci99": [[0.0, 1.0, 0.0], [2.0, 3.0, 2.0]], "unit": "N",
    }  # fmt: skip
    path = tmp_path / "d.json"
    path.write_text(json.dumps({"curve": {**good, field: value}}))
    with pytest.raises(ModelFileError, match=expected) as refused:
        with_saved_curves(of_rig(bench()).inner, path)
    assert str(path) in str(refused.value)

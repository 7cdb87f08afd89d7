"""Viscous friction that falls with a recorded temperature, at the coordinate of a user's simulator."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

import labhil as lh
from labhil.physics.rigs import model_for, record_of
from labhil.physics.warming import WARMS
from labhil.python_file import module_of

MASS, DRAG, RATE = 2.0, 8.0, 0.03


def cart(t: float, x: Any, u: Any, p: Any) -> Any:
    return x.speed, u.force / p.mass


def damped(t: float, x: Any, u: Any, p: Any) -> Any:
    return x.speed, (u.force - p.drag * x.speed) / p.mass


def rig(f: Any = cart, **more: lh.Quantity) -> lh.Simulator:
    return lh.simulator(
        f,
        states={"place": "m", "speed": "m/s"},
        inputs={"force": "N"},
        parameters={"mass": lh.Quantity(1.0, "kg"), **more},
    )


def driven(
    seconds: float = 20.0, period: float = 0.01, parts: int = 20, noise: float = 1e-4
) -> dict[str, np.ndarray]:
    """A mass on grease that warms by 25 K, in steps of half a millisecond."""
    random = np.random.default_rng(4)
    t = period * np.arange(round(seconds / period))
    force = np.repeat(random.uniform(-10.0, 10.0, len(t) // 25), 25)
    temperature = 20.0 + 25.0 * (1.0 - np.exp(-t / 8.0))
    x = v = 0.0
    place = np.empty(len(t))
    for k, (u, warm) in enumerate(zip(force, temperature, strict=True)):
        place[k] = x
        # exact under a constant force and drag
        rate = DRAG * np.exp(-RATE * (warm - 20.0)) / MASS
        h = period / parts
        for _ in range(parts):
            last = u / (MASS * rate)
            gone = 1.0 - np.exp(-rate * h)
            x, v = x + last * h + (v - last) * gone / rate, v + (last - v) * gone
    place += noise * random.standard_normal(len(t))
    return {"t": t, "force": force, "place": place, "temperature": temperature}


def recorded(simulator: lh.Simulator, *, warm: bool = True) -> lh.Recording:
    made = driven()
    others = {"temperature": made["temperature"]} if warm else {}
    return lh.recording(
        made["t"], {"force": made["force"]}, {"place": made["place"]}, rig=simulator, others=others
    )


def test_a_fit_estimates_how_friction_falls() -> None:
    simulator = rig()
    fitted = lh.fit(
        recorded(simulator), simulator, terms=["viscous_friction", "temperature_dependent_friction"]
    )
    values = {row.key: row for row in fitted.parameters}
    for key, true in (
        ("mass", MASS),
        ("viscous_friction.coefficient", DRAG),
        ("temperature_dependent_friction.rate", RATE),
    ):
        low, high = values[key].ci99
        assert low < true < high and high - low < 0.1 * true, key


def undecided(simulator: lh.Simulator, *, warm: bool) -> str:
    """Why the effect cannot be estimated; "" where it can."""
    recording = recorded(simulator, warm=warm)
    model = model_for(simulator.rig_file, record_of(recording.file, simulator.kind))
    assert (WARMS in model.terms) != (WARMS in model.unobservable_terms)
    return model.unobservable_terms.get(WARMS, "")


@pytest.mark.extended
def test_it_needs_a_temperature_and_friction_that_is_not_the_simulators_own() -> None:
    assert undecided(rig(), warm=True) == ""
    assert undecided(rig(), warm=False) == "needs temperature"
    own = rig(damped, drag=lh.Quantity(5.0, "N·s/m"))
    assert "simulator's own" in undecided(own, warm=True)


PYTHON = """import labhil as lh

def cart(t, x, u, p):
    return x.speed, u.force / p.mass

bench = lh.simulator(
    cart,
    states={"place": "m", "speed": "m/s"},
    inputs={"force": "N"},
    parameters={"mass": lh.Quantity(1.0, "kg")},
)
"""
MJCF = """<mujoco model="bench">
  <option timestep="0.002" gravity="0 0 0"/>
  <worldbody>
    <body name="cart">
      <joint name="place" type="slide" axis="1 0 0"/>
      <geom name="box" type="box" size="0.1 0.1 0.1" mass="1"/>
    </body>
  </worldbody>
  <actuator><motor name="force" joint="place"/></actuator>
</mujoco>
"""


@pytest.mark.extended
@pytest.mark.parametrize(
    ("file", "text", "model"),
    [("bench.py", PYTHON, 'python = "bench.py:bench"'), ("bench.xml", MJCF, 'mujoco = "bench.xml"')],
)
def test_a_repaired_file_has_a_force_that_takes_the_temperature(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, file: str, text: str, model: str
) -> None:
    """Run with it on the held-out data, the file keeps the promise; the friction at 45 °C is what it was."""
    monkeypatch.chdir(tmp_path)
    Path(file).write_text(text, encoding="utf-8")
    Path("rig.toml").write_text(f"[model]\n{model}\n", encoding="utf-8")
    made = driven(noise=1e-3)  # MuJoCo's steps of 2 ms make errors of 1.1 mm, those of 1/16 of 0.07 mm
    given = {name: made[name] for name in ("force", "place", "temperature")}
    recording = lh.recording(
        made["t"], {"force": given["force"]}, {"place": given["place"]}, rig="rig.toml",
        others={"temperature": given["temperature"]},
    )  # fmt: skip
    recording.save("run.mcap")
    fitted = lh.fit("run.mcap", "rig.toml", terms=["viscous_friction", "temperature_dependent_friction"])
    into = f"{file}:bench" if file.endswith(".py") else file
    fixed = fitted.patch(into, f"fixed{Path(file).suffix}", rig="rig.toml")
    assert fixed.attempts[-1].ratio <= 1.05
    force = module_of(Path("fixed_effects.py")).force
    own = 0.0 if file.endswith(".py") else DRAG  # the damping of the joint
    for warm in (20.0, 45.0):
        expected = -DRAG * np.exp(-RATE * (warm - 20.0)) + own
        assert force(0.0, 1.0, temperature=warm) == pytest.approx(expected, abs=0.03)

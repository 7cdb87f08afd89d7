"""Viscous friction that falls with a recorded temperature, at the coordinate of a user's simulator."""

from __future__ import annotations

from typing import Any

import numpy as np

import labhil as lh
from labhil.physics.rigs import model_for, record_of
from labhil.physics.warming import WARMS

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


def driven(seconds: float = 20.0, period: float = 0.01, parts: int = 20) -> dict[str, np.ndarray]:
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
    place += 1e-4 * random.standard_normal(len(t))
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


def test_it_needs_a_temperature_and_friction_that_is_not_the_simulators_own() -> None:
    assert undecided(rig(), warm=True) == ""
    assert undecided(rig(), warm=False) == "needs temperature"
    own = rig(damped, drag=lh.Quantity(5.0, "N·s/m"))
    assert "simulator's own" in undecided(own, warm=True)

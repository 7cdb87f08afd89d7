"""Recordings of the plants that one input drives, and the model's numbers that say the same."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from labhil.identify.least_squares import least_squares
from labhil.identify.problem import Point, Problem
from labhil.physics.model import Model, index_of, start_values
from labhil.physics.record import Record, Windows
from labhil.physics.rigs import model_for
from labhil.plants.rigs import PLANT_DEFINITIONS, plant_of
from labhil.rig import RigFile, parse_rig
from labhil.signals import Hold

CHANNELS: dict[str, tuple[str, tuple[str, ...], tuple[str, ...], tuple[str, ...], Hold]] = {
    "dc_motor": (
        "voltage",
        ("speed", "current"),
        ("rad/s", "A"),
        ("angle", "winding_temperature"),
        Hold.ZERO,
    ),
    "axis": ("drive_force", ("position",), ("m",), ("temperature",), Hold.ZERO),
    "solenoid": ("coil_current", ("plunger_position",), ("m",), (), Hold.LINEAR),
}
"""Input, outputs with units, other channels, and what the input does between samples."""


@dataclass(frozen=True)
class Replay:
    """A plant's recording, its true states (n, states), and the model with the plant's own numbers."""

    record: Record
    states: np.ndarray
    model: Model
    theta: np.ndarray


def rig_of(kind: str, known: str = "") -> RigFile:
    """A rig file that knows what ``known`` (lines of TOML) says."""
    return parse_rig(f'[rig]\nkind = "{kind}"\n[known]\n{known}', Path("rig.toml"))


def replay(
    kind: str,
    u: np.ndarray,
    terms: Sequence[str] = (),
    parameters: Mapping[str, float] | None = None,
    *,
    own: Mapping[str, float] | None = None,
    known: str = "",
    noise: Mapping[str, float] | None = None,
    period: float = 0.01,
    seed: int = 0,
    outputs: Sequence[str] = (),
) -> Replay:
    """Let a plant follow ``u``; ``own`` are the model's values where it names them otherwise (SI)."""
    silent = {name: 0.0 for name in PLANT_DEFINITIONS[kind].bare if name.endswith("_noise")}
    plant = plant_of(kind, {**silent, **(parameters or {}), **(noise or {})}, terms, seed, period)
    made = plant.simulate(u)
    driven_by, names, units, others, hold = CHANNELS[kind]
    chosen = [name for name in names if not outputs or name in outputs]
    record = Record(
        made.t,
        made.input[:, None],
        np.column_stack([made.measured[name] for name in chosen]),
        (driven_by,),
        tuple(chosen),
        tuple(units[names.index(name)] for name in chosen),
        (hold,),
        {name: made.measured[name] for name in others},
    )
    model = model_for(rig_of(kind, known), record)
    theta, places = start_values(model.parameters), index_of(model.parameters)
    for name, value in {**plant.parameters, **(own or {})}.items():
        if name in places and (name.partition(".")[0] in terms or "." not in name):
            theta[places[name]] = value
    states = {"dc_motor": ("speed", "current"), "axis": ("position", "velocity")}.get(
        kind, ("plunger_position", "plunger_velocity")
    )
    return Replay(record, np.column_stack([made.truth[name] for name in states]), model, theta)


def disagreement(found: Replay, spans: Sequence[tuple[int, int]]) -> np.ndarray:
    """Largest error of the model over windows that begin in the plant's states, over the RMS (channels,)."""
    windows = Windows.of(list(spans))
    seen = found.record.outputs[windows.rows]
    said = found.model.simulate(found.theta, found.record, windows, found.states[windows.first])
    return np.abs(said - seen).max(axis=0) / np.sqrt(np.mean(seen**2, axis=0))


def staircase(seconds: float, period: float, hold: float, largest: float, seed: int = 0) -> np.ndarray:
    """Values drawn evenly from ± ``largest``, held for ``hold`` s each."""
    n, each = round(seconds / period), round(hold / period)
    levels = np.random.default_rng(seed).uniform(-largest, largest, n // each + 1)
    return np.repeat(levels, each)[:n]


def two_tones(seconds: float, period: float = 1e-3) -> np.ndarray:
    """A solenoid's current (A) that sweeps the plunger from stop to stop."""
    t = period * np.arange(round(seconds / period))
    return 1.35 + 0.9 * np.sin(2 * np.pi * t) + 0.45 * np.sin(8 * np.pi * t)


def without(found: Replay, terms: Sequence[str]) -> Replay:
    """The same with the model's ``terms`` neutral."""
    theta = found.theta.copy()
    for i, parameter in enumerate(found.model.parameters):
        if parameter.term in terms:
            theta[i] = parameter.neutral
    return replace(found, theta=theta)


def places_of(model: Model, terms: Sequence[str]) -> np.ndarray:
    """Places of the rig's own parameters and those of ``terms`` in the model's vector."""
    chosen = [i for i, p in enumerate(model.parameters) if p.term is None or p.term in terms]
    return np.array(chosen, dtype=np.int64)


def distance(found: Replay, terms: Sequence[str], sigma: Sequence[float], first: int) -> tuple[float, int]:
    """How far the least squares lie from the truth, and how many parameters have moved.

    The squared distance is in the metric of the Cramér-Rao bound under the noise ``sigma`` of each channel:
    χ² of as many degrees of freedom as there are parameters, if the model is the plant. Fitted is one window
    from sample ``first`` on, its initial state with it.
    """
    free = places_of(found.model, terms)
    windows = Windows.of([(first, len(found.record))])
    problem = Problem(found.model, found.record, windows, free, found.theta, np.array(sigma))
    truth = Point(found.theta[free] / problem.scale, found.states[windows.first].copy())
    solution = least_squares(problem, truth, iterations=40)
    slopes = problem.linearise(solution.point, solution.residuals, central=True)
    moved = problem.project(slopes, slopes.by_parameters) @ (solution.point.z - truth.z)
    return float(np.sum(moved**2)), len(free)

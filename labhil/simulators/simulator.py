"""Describe a simulator by a Python function: its states, inputs, parameters, and where forces act.

:mod:`labhil.simulators.probing` calls the function, :mod:`labhil.simulators.model` makes a model of it.
"""

from __future__ import annotations

from collections import namedtuple
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from math import isfinite
from pathlib import Path
from typing import TYPE_CHECKING, Any

from labhil.errors import UsageError, suggestion
from labhil.kinds import Known, RigKind, declare_kind
from labhil.physics.quantity import Quantity
from labhil.physics.rigs import RigModel, declare_model
from labhil.physics.warming import TEMPERATURE
from labhil.rig import RigFile, default_rig
from labhil.rig_sections import ModelSection
from labhil.signals import Direction, Hold, Signal
from labhil.simulators.pointwise import one_at_a_time
from labhil.simulators.probing import (
    EXACT,
    FROM_SOLVER,
    FROM_STEPS,
    is_damped,
    probe,
    probe_once,
    start_numbers,
)
from labhil.simulators.python_rollout import PythonRollout, RolloutFunction
from labhil.simulators.python_step import PythonStep, StepFunction, rates_of

if TYPE_CHECKING:
    from labhil.simulators.stepped import SteppedSimulator

RightHandSide = Callable[[float, Any, Any, Any], Sequence[float]]
"""``f(t, x, u, p)`` to the rates of the states; x, u and p have their values by name and by number."""

RATES, STEP, ROLLOUT = KINDS = ("rates", "step", "rollout")
"""What a function may return: rates of the states, the states after a step, or the states at given times."""

TOLERANCES = {RATES: EXACT, STEP: FROM_STEPS, ROLLOUT: FROM_SOLVER}

UNDAMPED = ("viscous_friction",)
"""Terms that a diagnosis of a simulator without damping starts with."""


@dataclass(frozen=True, slots=True)
class Coordinate:
    """A coordinate at which friction, springs and other generalised forces may act.

    Attributes:
        velocity: Name of the state that is the rate of the coordinate.
        like: Name of the input that a force acts like; or
        inertia: name of the parameter that a force is divided by, and
        force: the unit of the force then.

    Example:
        >>> from labhil import Coordinate
        >>> Coordinate("speed", inertia="inertia", force="N·m").velocity
        'speed'
    """

    velocity: str
    like: str = ""
    inertia: str = ""
    force: str = ""


@dataclass(frozen=True)
class Simulator:
    """A simulator as its user describes it; it can be given wherever a rig can.

    :func:`simulator` and the readers of files make it.

    Attributes:
        f: ``f(t, x, u, p)`` to the rates of the states.
        name: Name of the rig kind.
        states: Units of position and velocity by name.
        inputs: Unit of the input by name.
        outputs: Units of the measured states by name.
        parameters: Start, unit and bounds by name.
        position: Name of the position.
        coordinate: Where forces act.
        horizon: Length of the scored windows, s; None where a recording decides.
        stepped: The simulator that is called point by point; None where ``f`` is compiled.
        nominal: Values of the simulation as it is, by key, as in ``[nominal]`` of a rig file.
        notes: Parts of a file that are not part of the fitted model.
        section: The table ``[model]`` of a rig file that states the same file and names; None without a file.

    Example:
        >>> import labhil as lh
        >>> lag = lh.simulator(
        ...     lambda t, x, u, p: (x.speed, (u.force - p.drag * x.speed) / p.mass),
        ...     name="cart",
        ...     states={"place": "m", "speed": "m/s"},
        ...     inputs={"force": "N"},
        ...     parameters={"mass": lh.Quantity(1.0, "kg"), "drag": lh.Quantity(0.1, "N·s/m")},
        ... )
        >>> len(lh.model(lag).terms) >= 15
        True
    """

    f: RightHandSide
    name: str
    states: Mapping[str, str]
    inputs: Mapping[str, str]
    outputs: Mapping[str, str]
    parameters: Mapping[str, Quantity]
    position: str
    coordinate: Coordinate
    horizon: float | None
    stepped: SteppedSimulator | None = None
    nominal: Mapping[str, float] = field(default_factory=dict)
    notes: tuple[str, ...] = ()
    section: ModelSection | None = None

    @property
    def kind(self) -> RigKind:
        """The rig kind: signals, and the keys that ``[known]`` may have."""
        signals = {
            Direction.INPUT: [
                Signal(n, u, Direction.INPUT, hold=Hold.ZERO, description="of the simulator")
                for n, u in self.inputs.items()
            ],
            Direction.OUTPUT: [
                Signal(n, u, Direction.OUTPUT, description="of the simulator")
                for n, u in self.outputs.items()
            ],
        }
        known = {n: Known(q.unit, positive=q.bounds[0] > 0.0) for n, q in self.parameters.items()}
        return RigKind(
            self.name,
            tuple(signals[Direction.INPUT]),
            (tuple(self.inputs),),
            tuple(signals[Direction.OUTPUT]),
            known,
            auxiliary=self._auxiliary,
        )

    @property
    def _auxiliary(self) -> tuple[Signal, ...]:
        """Channels of which effects may depend."""
        if TEMPERATURE in {*self.states, *self.inputs, *self.parameters}:
            return ()
        return (Signal(TEMPERATURE, "°C", Direction.STATUS, description="of what rubs"),)

    @property
    def rig_file(self) -> RigFile:
        """A rig file with the kind, and the file that the simulator was read from."""
        return default_rig(self.name).model_copy(update={"model": self.section})

    @property
    def force_unit(self) -> str:
        """Unit of a force at the coordinate."""
        return self.coordinate.force or self.inputs.get(self.coordinate.like, "")

    @cached_property
    def records(self) -> tuple[Any, Any, Any]:
        """Classes of the arguments x, u and p of f: named tuples."""
        return (
            namedtuple("States", tuple(self.states)),
            namedtuple("Inputs", tuple(self.inputs)),
            namedtuple("Parameters", tuple(self.parameters) or ("none",)),
        )


def simulator(
    f: RightHandSide | StepFunction | RolloutFunction,
    *,
    states: Mapping[str, str],
    inputs: Mapping[str, str],
    parameters: Mapping[str, Quantity | float],
    outputs: Mapping[str, str] | Sequence[str] | None = None,
    coordinates: Mapping[str, Coordinate] | None = None,
    name: str = "",
    horizon: float | None = None,
    kind: str = RATES,
) -> Simulator:
    """Describe a simulator by its right-hand side, so that all effects of the catalogue can be fitted to it.

    The right-hand side is that of one coordinate: a position, its velocity and one input. It has to be
    smooth: the catalogue adds friction, dead zones and the like. numba compiles it. A function that makes a
    step, or simulates a whole input, may be any Python: its acceleration is tabulated. It may keep a state
    between calls (an engine that it sets, steps and reads): one thread at a time calls it.

    Args:
        f: ``f(t, x, u, p)`` to the rates of the states, in their order. ``x.angle``, ``u.torque`` and
            ``p.inertia`` are the values by name; an index gives them, too. With ``kind="step"``
            ``f(x, u, p, dt)`` to the states ``dt`` s later; with ``kind="rollout"`` ``f(p, t, u, x0)`` to the
            states (n, 2) at the times ``t`` (n,), from ``x0`` at the first, where ``u.torque`` (n,) is held
            from each time to the next.
        states: Units by name: the position, then its velocity.
        inputs: Unit by name.
        parameters: Value, unit and bounds by name. A fit starts at the values; a diagnosis states those
            that the recording contradicts.
        outputs: Which states are measured; the position when absent.
        coordinates: Where forces act, by the name of the position. Without it a force acts like the input.
        name: Name of the rig; that of ``f`` when absent.
        horizon: Length of the simulated windows by which it is scored, s; taken from the recording when
            absent.
        kind: ``"rates"`` where ``f`` gives the rates of the states, ``"step"`` where it makes a step,
            ``"rollout"`` where it simulates a whole input.

    Returns:
        The simulator, to be given as a rig to :func:`labhil.fit`, :func:`labhil.diagnose`,
        :func:`labhil.model` and :func:`labhil.recording`.

    Raises:
        UsageError: What was expected of ``f`` or of the names, and what was found.

    Example:
        >>> import labhil as lh, math
        >>> def pendulum(t, x, u, p):
        ...     return x.rate, (u.torque - p.gravity_torque * math.sin(x.angle)) / p.inertia
        >>> rig = lh.simulator(
        ...     pendulum,
        ...     states={"angle": "rad", "rate": "rad/s"},
        ...     inputs={"torque": "N·m"},
        ...     parameters={"inertia": lh.Quantity(0.02, "kg·m²"), "gravity_torque": lh.Quantity(0.5, "N·m")},
        ... )
        >>> rig.kind.name
        'pendulum'
    """
    name = name or getattr(f, "__name__", "")
    _check_names(name, states, inputs)
    position, velocity = states
    measured = _measured_units(name, outputs, states)
    quantities = {n: q if isinstance(q, Quantity) else Quantity(float(q)) for n, q in parameters.items()}
    _check_quantities(name, quantities, {*states, *inputs})
    coordinates = dict(coordinates or {position: Coordinate(velocity, like=next(iter(inputs)))})
    if list(coordinates) != [position] or coordinates[position].velocity != velocity:
        raise UsageError(
            f"simulator {name!r}: expected one coordinate, {position!r} with velocity {velocity!r}, found "
            f"{', '.join(f'{n!r} with {c.velocity!r}' for n, c in coordinates.items())}"
        )
    coordinate = coordinates[position]
    _check_coordinate(name, coordinate, inputs, quantities)
    if kind not in KINDS:
        raise UsageError(f"simulator {name!r}: kind: expected {' or '.join(KINDS)}, found {kind!r}")
    nominal = {n: q.start for n, q in quantities.items()}
    rig = Simulator(
        f,
        name,
        dict(states),
        dict(inputs),
        measured,
        quantities,
        position,
        coordinate,
        horizon,
        nominal=nominal,
    )
    if kind == STEP:
        step = one_at_a_time(f)
        rig = replace(rig, f=_rates_of_step(step), stepped=PythonStep(step, rig.records, coordinate.inertia))
    elif kind == ROLLOUT:
        rig = _with_rollout(rig, one_at_a_time(f))
    probe(rig, TOLERANCES[kind])
    declare(rig, () if is_damped(rig, TOLERANCES[kind]) else UNDAMPED)
    return rig


def _check_names(name: str, states: Mapping[str, str], inputs: Mapping[str, str]) -> None:
    if not name.isidentifier():
        raise UsageError(f"simulator: expected a name of letters, digits and _, found {name!r}")
    if len(states) != 2 or len(inputs) != 1:
        alone = next(iter(states), "speed")
        whole = f"states={{'position': …, {alone!r}: …}}, outputs=[{alone!r}]"
        raise UsageError(
            f"simulator {name!r}: expected 2 states (a position and its velocity) and 1 input, found "
            f"{len(states)} and {len(inputs)}; "
            + (f"where {alone} is a velocity, give {whole}; " if len(states) == 1 else "")
            + "for others register a RightHandSide, see docs/how-to/add-a-twin-and-a-rig.md"
        )


def _rates_of_step(step: StepFunction) -> RightHandSide:
    """Make the rates of a function that makes steps."""

    def rates(t: float, x: Any, u: Any, p: Any) -> Sequence[float]:
        return rates_of(step, x, u, p)

    return rates


def _with_rollout(rig: Simulator, f: Any) -> Simulator:
    """Make a simulator of a function that simulates a whole input, with the rates of short runs."""
    stepped = PythonRollout(f, rig.name, rig.records, rig.coordinate.inertia)

    def rates(t: float, x: Any, u: Any, p: Any) -> Sequence[float]:
        return stepped.rates(list(p), list(x), float(u[0]))

    with_rates = replace(rig, f=rates, stepped=stepped)
    probe_once(with_rates)
    stepped.choose_step(start_numbers(rig))
    return with_rates


def stated_section(
    key: str, file: Path, inputs: Mapping[str, str] | None, outputs: Mapping[str, str] | None
) -> ModelSection:
    """Make the table ``[model]`` that states a file, and the names in it by recorded signal.

    Args:
        key: ``"mujoco"`` or ``"fmu"``.
        file: The file.
        inputs: Names in the file by recorded input; None where the file's own are used.
        outputs: Names in the file by recorded output; None likewise.
    """
    names = {"inputs": inputs, "outputs": outputs}
    stated = {what: dict(pairs) for what, pairs in names.items() if pairs is not None}
    return ModelSection.model_validate({key: str(file), **stated})


def declare(rig: Simulator, baseline: tuple[str, ...]) -> None:
    """Declare the kind and the model of a simulator in this process.

    Args:
        rig: The simulator.
        baseline: Terms that a diagnosis starts with.
    """
    from labhil.simulators.model import SimulatorModel

    def model(rig_file: RigFile, record: Any = None) -> Any:
        return SimulatorModel(rig, rig_file, record)

    declare_kind(rig.kind)
    declare_model(rig.name, RigModel(model, baseline, tuple(dict.fromkeys((*baseline, "coulomb_friction")))))


def _measured_units(
    rig_name: str, outputs: Mapping[str, str] | Sequence[str] | None, states: Mapping[str, str]
) -> dict[str, str]:
    """Return the units of the measured states by name."""
    names = tuple(states)[:1] if outputs is None else tuple(outputs)
    for name in names:
        if name not in states:
            raise UsageError(
                f"simulator {rig_name!r}: outputs: expected names of states, found {name!r}"
                f"{suggestion(name, states)}; states: {', '.join(states)}"
            )
    if not names:
        raise UsageError(f"simulator {rig_name!r}: outputs: expected one at least, found none")
    return {n: states[n] for n in states if n in names}


def _check_quantities(rig_name: str, quantities: Mapping[str, Quantity], taken: set[str]) -> None:
    for name, quantity in quantities.items():
        low, high = quantity.bounds
        if name in taken:
            raise UsageError(f"simulator {rig_name!r}: {name!r} names a parameter and a signal; rename one")
        if not isfinite(quantity.start) or not low <= quantity.start <= high or not low < high:
            raise UsageError(
                f"simulator {rig_name!r}: {name}: expected a start from {low:g} to {high:g}, found "
                f"{quantity.start:g}"
            )


def _check_coordinate(
    rig_name: str, coordinate: Coordinate, inputs: Mapping[str, str], quantities: Mapping[str, Quantity]
) -> None:
    for what, name, known in (("like", coordinate.like, inputs), ("inertia", coordinate.inertia, quantities)):
        if name and name not in known:
            raise UsageError(
                f"simulator {rig_name!r}: coordinate {what}: unknown name {name!r}{suggestion(name, known)}; "
                f"known: {', '.join(known)}"
            )
    if coordinate.inertia and not quantities[coordinate.inertia].bounds[0] > 0.0:
        quantity = quantities[coordinate.inertia]
        raise UsageError(
            f"simulator {rig_name!r}: {coordinate.inertia}: expected an inertia above 0, as is its lower "
            f"bound; found a start of {quantity.start:g} and a lower bound of {quantity.bounds[0]:g}"
        )
    if bool(coordinate.like) == bool(coordinate.inertia):
        raise UsageError(
            f"simulator {rig_name!r}: coordinate: expected either `like` (an input that a force acts like) "
            "or `inertia` (a parameter that divides it)"
        )

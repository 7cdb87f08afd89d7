"""What a user says of a simulator: its right-hand side, its names, and where forces act."""

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
from labhil.rig import RigFile, parse_rig
from labhil.signals import Direction, Hold, Signal
from labhil.simulators.probing import (
    ROUNDED,
    SAME,
    SAME_OF_SOLVERS,
    SAME_OF_STEPS,
    SOLVED,
    is_damped,
    probe,
    probe_once,
)
from labhil.simulators.python_rollout import PythonRollout, RolloutFunction
from labhil.simulators.python_step import PythonStep, StepFunction, rates_of

if TYPE_CHECKING:
    from labhil.simulators.stepped import Stepped

RightHandSide = Callable[[float, Any, Any, Any], Sequence[float]]
"""``f(t, x, u, p)`` to the rates of the states; x, u and p have their values by name and by number."""

RATES, STEP, ROLLOUT = KINDS = ("rates", "step", "rollout")
"""What a function may give: the rates of the states, the states a step later, or at all of many times."""

UNDAMPED = ("viscous_friction",)
"""What a simulator without damping of its own begins with."""


@dataclass(frozen=True, slots=True)
class Coordinate:
    """A place where a generalised force may act: the port for friction, springs and other forces.

    ``velocity`` names the state that is the rate of the coordinate. A force acts like the input ``like``, or
    is divided by the parameter ``inertia`` and has the unit ``force``.

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
    """A simulator as its user describes it; made by :func:`simulator`. Wherever a rig may be named, it may.

    One that only answers when it is called, a step or a MuJoCo file, is ``stepped``; ``nominal`` are values
    of a file that stand for the user's simulation, as ``[nominal]`` of a rig file would. ``notes`` say what
    of a file is not part of what is fitted.

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
    stepped: Stepped | None = None
    nominal: Mapping[str, float] = field(default_factory=dict)
    notes: tuple[str, ...] = ()

    @property
    def kind(self) -> RigKind:
        """The rig kind that it is: its signals, and what ``[known]`` may say."""
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
        )

    @property
    def rig_file(self) -> RigFile:
        """A rig file that says nothing but that the rig is this simulator."""
        return parse_rig(f'[rig]\nkind = "{self.name}"\n', Path(f"{self.name}.toml"))

    @property
    def force_unit(self) -> str:
        """Unit of a force at the coordinate."""
        return self.coordinate.force or self.inputs.get(self.coordinate.like, "")

    @cached_property
    def records(self) -> tuple[Any, Any, Any]:
        """What f takes for x, u and p: tuples with names."""
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
    """Describe a simulator by its right-hand side; the whole catalogue of effects is then there for it.

    The right-hand side is that of one coordinate: a position, its velocity and one input. It has to be
    smooth: friction, stops of dead zones and the like are what the catalogue adds. numba compiles it. A
    function that makes a step, or simulates a whole input, may be any Python: its acceleration is tabulated.

    Args:
        f: ``f(t, x, u, p)`` to the rates of the states, in their order. ``x.angle``, ``u.torque`` and
            ``p.inertia`` are the values by name; by number they are there too. With ``kind="step"``
            ``f(x, u, p, dt)`` to the states ``dt`` s later; with ``kind="rollout"`` ``f(p, t, u, x0)`` to the
            states (n, 2) at the times ``t`` (n,), from ``x0`` at the first, where ``u.torque`` (n,) is held
            from each time to the next.
        states: Units by name: the position, then its velocity.
        inputs: Unit by name.
        parameters: Start, unit and bounds by name.
        outputs: Which states are measured; the position when absent.
        coordinates: Where forces act, by the name of the position. Without it a force acts like the input.
        name: What the rig is called; the name of ``f`` when absent.
        horizon: Length of the simulated windows by which it is scored, s; taken from the recording when
            absent.
        kind: ``"rates"`` where ``f`` gives the rates of the states, ``"step"`` where it makes a step,
            ``"rollout"`` where it simulates a whole input.

    Returns:
        The simulator: :func:`labhil.fit`, :func:`labhil.diagnose`, :func:`labhil.model` and
        :func:`labhil.recording` take it for a rig.

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
    title = name or getattr(f, "__name__", "")
    if not title.isidentifier():
        raise UsageError(f"simulator: expected a name of letters, digits and _, found {title!r}")
    if len(states) != 2 or len(inputs) != 1:
        raise UsageError(
            f"simulator {title!r}: expected 2 states (a position and its velocity) and 1 input, found "
            f"{len(states)} and {len(inputs)}; for others register a RightHandSide, see "
            "docs/how-to/add-a-twin-and-a-rig.md"
        )
    position, velocity = states
    measured = _measured_units(title, outputs, states)
    quantities = {n: q if isinstance(q, Quantity) else Quantity(float(q)) for n, q in parameters.items()}
    _check_quantities(title, quantities, {*states, *inputs})
    given = dict(coordinates or {position: Coordinate(velocity, like=next(iter(inputs)))})
    if list(given) != [position] or given[position].velocity != velocity:
        raise UsageError(
            f"simulator {title!r}: expected one coordinate, {position!r} with velocity {velocity!r}, found "
            f"{', '.join(f'{n!r} with {c.velocity!r}' for n, c in given.items())}"
        )
    _check_coordinate(title, given[position], inputs, quantities)
    if kind not in KINDS:
        raise UsageError(f"simulator {title!r}: kind: expected {' or '.join(KINDS)}, found {kind!r}")
    made = Simulator(
        f,
        title, dict(states), dict(inputs), measured, quantities, position, given[position], horizon,
    )  # fmt: skip
    if kind == STEP:
        made = replace(made, f=_rates_of_step(f), stepped=PythonStep(f, made.records))
    elif kind == ROLLOUT:
        made = _with_rollout(made, f)
    probe(made, {RATES: SAME, STEP: SAME_OF_STEPS, ROLLOUT: SAME_OF_SOLVERS}[kind])
    declare(made, () if is_damped(made, {RATES: 0.0, STEP: ROUNDED, ROLLOUT: SOLVED}[kind]) else UNDAMPED)
    return made


def _rates_of_step(step: StepFunction) -> RightHandSide:
    """The rates of a function that makes steps, as it is probed."""

    def rates(t: float, x: Any, u: Any, p: Any) -> Sequence[float]:
        return rates_of(step, x, u, p)

    return rates


def _with_rollout(made: Simulator, f: Any) -> Simulator:
    """The simulator with a function that simulates a whole input: its rates are those of short rollouts."""
    stepped = PythonRollout(f, made.name, made.records)

    def rates(t: float, x: Any, u: Any, p: Any) -> Sequence[float]:
        return stepped.rates(list(p), list(x), float(u[0]))

    with_rates = replace(made, f=rates, stepped=stepped)
    probe_once(with_rates)
    stepped.settle([quantity.start for quantity in made.parameters.values()] or [0.0])
    return with_rates


def declare(made: Simulator, baseline: tuple[str, ...]) -> None:
    """Make a simulator's kind and model known in this process, with the terms that it begins with."""
    from labhil.simulators.model import SimulatorModel

    def model(rig: RigFile, record: Any = None) -> Any:
        return SimulatorModel(made, rig, record)

    declare_kind(made.kind)
    declare_model(made.name, RigModel(model, baseline, tuple(dict.fromkeys((*baseline, "coulomb_friction")))))


def _measured_units(
    title: str, outputs: Mapping[str, str] | Sequence[str] | None, states: Mapping[str, str]
) -> dict[str, str]:
    """Units of what is measured, by name of the state."""
    names = tuple(states)[:1] if outputs is None else tuple(outputs)
    for name in names:
        if name not in states:
            raise UsageError(
                f"simulator {title!r}: outputs: expected names of states, found {name!r}"
                f"{suggestion(name, states)}; states: {', '.join(states)}"
            )
    if not names:
        raise UsageError(f"simulator {title!r}: outputs: expected one at least, found none")
    return {n: states[n] for n in states if n in names}


def _check_quantities(title: str, quantities: Mapping[str, Quantity], taken: set[str]) -> None:
    for name, quantity in quantities.items():
        low, high = quantity.bounds
        if name in taken:
            raise UsageError(f"simulator {title!r}: {name!r} names a parameter and a signal; rename one")
        if not isfinite(quantity.start) or not low <= quantity.start <= high or not low < high:
            raise UsageError(
                f"simulator {title!r}: {name}: expected a start from {low:g} to {high:g}, found "
                f"{quantity.start:g}"
            )


def _check_coordinate(
    title: str, coordinate: Coordinate, inputs: Mapping[str, str], quantities: Mapping[str, Quantity]
) -> None:
    for what, name, known in (("like", coordinate.like, inputs), ("inertia", coordinate.inertia, quantities)):
        if name and name not in known:
            raise UsageError(
                f"simulator {title!r}: coordinate {what}: unknown name {name!r}{suggestion(name, known)}; "
                f"known: {', '.join(known)}"
            )
    if coordinate.inertia and not quantities[coordinate.inertia].bounds[0] > 0.0:
        quantity = quantities[coordinate.inertia]
        raise UsageError(
            f"simulator {title!r}: {coordinate.inertia}: expected an inertia above 0, as is its lower "
            f"bound; found a start of {quantity.start:g} and a lower bound of {quantity.bounds[0]:g}"
        )
    if bool(coordinate.like) == bool(coordinate.inertia):
        raise UsageError(
            f"simulator {title!r}: coordinate: expected either `like` (an input that a force acts like) or "
            "`inertia` (a parameter that divides it)"
        )

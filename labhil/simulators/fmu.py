"""An FMU (FMI 2 or 3) with one coordinate as a simulator."""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any, NamedTuple

from labhil.errors import UsageError, suggestion
from labhil.physics.quantity import Quantity
from labhil.simulators.fmu_file import EXCHANGE, REAL, Exchanged, FmuFile, Stepping, answers
from labhil.simulators.fmu_mechanism import ExchangedMechanism, SteppingMechanism
from labhil.simulators.names import identifier
from labhil.simulators.probing import ROUNDED, SAME_OF_SOLVERS, SAME_OF_STEPS, SOLVED, is_damped, probe
from labhil.simulators.simulator import UNDAMPED, Coordinate, Simulator, declare

STEPS = (1e-3, 1e-2, 1e-4)
"""Lengths of a step (s) that an FMU for co-simulation is tried with, beside those that it states."""

PROBES = ((0.1, 0.3), (-0.2, 0.7))
"""States at which it is seen which of two is the rate of the other."""

DRIVE = 0.25
ALIKE = 0.05
"""Share of the velocity by which a short step may miss it."""

MOVED = 1.25
"""By what a parameter is multiplied to see what changes with it."""

_EXPONENT = re.compile(r"(?<=[^\W\d_])-?\d+|(?<=\))-?\d+")
_RAISED = str.maketrans("-0123456789", "⁻⁰¹²³⁴⁵⁶⁷⁸⁹")

Mechanism = ExchangedMechanism | SteppingMechanism


class Pair(NamedTuple):
    """The variables of an FMU that are its position and its velocity."""

    position: Any
    velocity: Any


class FmuAccess(NamedTuple):
    """The coordinate of an FMU, and how it is called.

    ``read`` gives the values of variables in a state (position, velocity), ``make`` its mechanism with the
    parameters of these value references.
    """

    pair: Pair
    read: Callable[[tuple[float, float], list[int]], list[float]]
    make: Callable[[list[int]], Mechanism]


def fmu_simulator(
    path: str | Path,
    *,
    inputs: Mapping[str, str] | None = None,
    outputs: Mapping[str, str] | None = None,
    name: str = "",
) -> Simulator:
    """Take an FMU for a simulator; the whole catalogue of effects is then there for it.

    The FMU (FMI 2 or 3) has one coordinate: two continuous states, of which one is the rate of the other, and
    one input. For model exchange its derivatives are asked for; for co-simulation it is started anew at many
    states and makes two short steps from each. Forces act like the input. Its parameters that are not 0 are
    estimated from where they start.

    Args:
        path: The file. Its binary is code of its author, and is run.
        inputs: Variable of the FMU by the name of the recorded signal; the only input by its own name when
            absent.
        outputs: Variable of the FMU by the name of the recorded signal; those of its outputs that are
            position or velocity when absent.
        name: What the rig is called; the FMU's model name when absent.

    Returns:
        The simulator: :func:`labhil.fit`, :func:`labhil.diagnose` and others take it for a rig.

    Raises:
        UsageError: What was expected of the FMU or of the names, and what it has.
        MissingExtraError: The package ``fmpy`` is not installed.

    Example:
        >>> import labhil as lh
        >>> try:
        ...     plant = lh.fmu_simulator("plant.fmu", inputs={"torque": "motor.tau"})
        ... except lh.errors.UsageError as error:
        ...     print(error)
        expected the FMU plant.fmu, found none
    """
    file = FmuFile(Path(path))
    signal, drive = _input(file, inputs)
    starts = {v: _start(v) for v in file.variables("parameter")}
    access = _access(file, drive, {v.valueReference: x for v, x in starts.items() if x is not None})
    position, velocity, measured = _outputs(file, access, outputs)
    used = _without_starts([v for v, x in starts.items() if x], starts, access.make)
    mechanism = access.make([v.valueReference for v in used])
    quantities = {identifier(v.name): _quantity(v, float(starts[v] or 0.0)) for v in used}

    def rates(t: float, x: Any, u: Any, p: Any) -> list[float]:
        return mechanism.rates(list(p)[: len(used)], t, list(x), float(u[0]))

    states = {position: _unit(access.pair.position), velocity: _unit(access.pair.velocity)}
    made = Simulator(
        rates,
        identifier(name or str(file.description.modelName)),
        states,
        {signal: _unit(drive)},
        {n: states[n] for n in states if n in measured},
        quantities,
        position,
        Coordinate(velocity, like=signal),
        None,
        mechanism,
        {n: quantity.start for n, quantity in quantities.items()},
    )
    exact = isinstance(mechanism, ExchangedMechanism)
    probe(made, SAME_OF_STEPS if exact else SAME_OF_SOLVERS)
    declare(made, () if is_damped(made, ROUNDED if exact else SOLVED) else UNDAMPED)
    return made


def _input(file: FmuFile, stated: Mapping[str, str] | None) -> tuple[str, Any]:
    """Name of the recorded input, and the variable."""
    variables = {v.name: v for v in file.variables("input")}
    which = 'say which: inputs = { force = "NAME" }; ' if variables else ""
    listed = f"inputs of the FMU: {', '.join(variables) or 'none'}"
    if stated is None:
        if len(variables) != 1:
            raise file.refusal("one real input", f"{len(variables)}; {which}{listed}")
        stated = {name: name for name in variables}
    if len(stated) != 1:
        raise file.refusal("one input", f"{', '.join(stated) or 'none'}; {listed}")
    ((signal, name),) = stated.items()
    if name not in variables:
        raise UsageError(
            f"{file.path}: inputs: {signal}: no input {name!r}{suggestion(name, variables)}; {listed}"
        )
    return identifier(signal), variables[name]


def _access(file: FmuFile, drive: Any, starts: Mapping[int, float]) -> FmuAccess:
    """Find which state is the position and which its velocity."""
    states = _state_variables(file)
    if len(states) != 2:
        raise file.refusal(
            "two continuous states, a position and its velocity",
            f"{len(states)}: {', '.join(v.name for v in states) or 'none'}; what else has a state (filters, "
            "motors) is left to the effects that are offered (`labhil terms`)",
        )
    with answers(file, f"an FMU whose states and input {drive.name} can be set"):
        return (_access_exchange if file.kind == EXCHANGE else _access_stepping)(file, drive, starts, states)


def _state_variables(file: FmuFile) -> list[Any]:
    """The states that an FMU declares; of one for co-simulation that declares none, what can be set."""
    derivatives = [unknown.variable for unknown in file.description.derivatives]
    declared = [v.derivative for v in derivatives if v is not None and v.derivative is not None]
    if declared or file.kind == EXCHANGE:
        return declared
    return [
        v
        for v in file.description.modelVariables
        if v.causality in ("output", "local")
        and v.type in REAL
        and v.initial == "exact"
        and v.variability in (None, "continuous")
        and v.start is not None
    ]


def _access_exchange(file: FmuFile, drive: Any, starts: Mapping[int, float], states: list[Any]) -> FmuAccess:
    events = int(file.description.numberOfEventIndicators or 0) > 0 or drive.variability == "discrete"
    fmu = Exchanged(file, drive.valueReference, with_events=events)
    fmu.begin(starts)
    rates = [fmu.rates(0.0, state, DRIVE) for state in PROBES]
    for turned in (False, True):
        place = int(turned)
        if all(r[place] == s[1 - place] for r, s in zip(rates, PROBES, strict=True)):
            turn = -1 if turned else 1

            def read(state: tuple[float, float], references: list[int], turn: int = turn) -> list[float]:
                fmu.go_to(0.0, state[::turn], DRIVE)
                return fmu.get(references)

            def make(used: list[int], turned: bool = turned) -> Mechanism:
                return ExchangedMechanism(fmu, file, used, turned=turned)

            return FmuAccess(Pair(*states[::turn]), read, make)
    raise _no_velocity(file, states)


def _access_stepping(file: FmuFile, drive: Any, starts: Mapping[int, float], states: list[Any]) -> FmuAccess:
    for v in states:
        if v.initial not in ("exact", None) or v.start is None:
            raise file.refusal(
                'a co-simulation whose position and velocity can be set as it starts (initial = "exact"), or '
                "model exchange",
                f"{v.name}, which cannot",
            )
    for pair in (Pair(*states), Pair(*states[::-1])):
        fmu = Stepping(file, drive.valueReference, [v.valueReference for v in pair])
        step = next((step for step in _steps(file) if _moves_by(fmu, starts, step)), None)
        if step is None:
            continue

        def read(state: tuple[float, float], references: list[int], fmu: Stepping = fmu) -> list[float]:
            fmu.start(starts, state, DRIVE)
            return fmu.get(references)

        def make(used: list[int], fmu: Stepping = fmu, step: float = step) -> Mechanism:
            return SteppingMechanism(fmu, file, used, step)

        return FmuAccess(pair, read, make)
    raise _no_velocity(file, states)


def _steps(file: FmuFile) -> list[float]:
    """Lengths to try, s: the FMU's own step first."""
    fixed = file.description.coSimulation.fixedInternalStepSize
    default = file.description.defaultExperiment
    usual = None if default is None else default.stepSize
    return [float(x) for x in (fixed, *STEPS, usual) if x]


def _moves_by(fmu: Stepping, starts: Mapping[int, float], step: float) -> bool:
    """Whether within a step the position moves by the velocity, from either state."""
    for position, velocity in PROBES:
        fmu.start(starts, (position, velocity), DRIVE)
        try:
            after = fmu.step(DRIVE, step)[0]
        except Exception as error:
            if type(error).__name__ != "FMICallException":
                raise
            return False  # it makes no such step
        mean = 0.5 * (velocity + fmu.states()[1])
        if abs(after - position - step * mean) > ALIKE * step * abs(velocity):
            return False
    return True


def _no_velocity(file: FmuFile, states: list[Any]) -> UsageError:
    return file.refusal(
        "that one of the two states is the rate of the other",
        f"{' and '.join(v.name for v in states)}, of which none is",
    )


def _outputs(
    file: FmuFile, access: FmuAccess, stated: Mapping[str, str] | None
) -> tuple[str, str, tuple[str, ...]]:
    """Names of position and velocity, and which of the two are measured."""
    pair, names = access.pair, _names(file, access)
    given = stated
    if given is None:
        given = {v.name: v.name for v in file.variables("output") if v.name in names}
        given = given or {pair.position.name: pair.position.name}
    signals: dict[int, str] = {}
    for signal, of in given.items():
        if of not in names:
            raise UsageError(
                f"{file.path}: outputs: {signal}: expected the position or the velocity, found "
                f"{of!r}{suggestion(of, names)}; these are {', '.join(names)}"
            )
        signals.setdefault(names[of], identifier(signal))
    if not signals:
        raise file.refusal("one output at least", f"none; position and velocity are {', '.join(names)}")
    position = signals.get(0, identifier(pair.position.name))
    velocity = signals.get(1, identifier(pair.velocity.name))
    return position, velocity, tuple(signals.values())


def _names(file: FmuFile, access: FmuAccess) -> dict[str, int]:
    """Names of all variables that are the position (0) or the velocity (1)."""
    candidates = [*access.pair, *file.variables("output")]
    with answers(file, "an FMU whose outputs can be read"):
        read = [access.read(state, [v.valueReference for v in candidates]) for state in PROBES]
    return {
        v.name: place
        for place in (0, 1)
        for k, v in enumerate(candidates)
        if all(values[k] == state[place] for values, state in zip(read, PROBES, strict=True))
    }


def _without_starts(
    used: list[Any], starts: Mapping[Any, float | None], make: Callable[[list[int]], Mechanism]
) -> list[Any]:
    """The parameters without those that only set the FMU's start: a window starts where it was recorded."""
    mechanism = make([v.valueReference for v in used])
    if not isinstance(mechanism, ExchangedMechanism):
        return used
    values = [float(starts[v] or 0.0) for v in used]
    begun, kept = mechanism.start_states(values), []
    for k, v in enumerate(used):
        moved = [x * (MOVED if k == i else 1.0) for i, x in enumerate(values)]
        same = all(
            mechanism.rates(values, 0.0, s, DRIVE) == mechanism.rates(moved, 0.0, s, DRIVE) for s in PROBES
        )
        if not (same and mechanism.start_states(moved) != begun):
            kept.append(v)
    return kept


def _start(variable: Any) -> float | None:
    return None if variable.start is None else float(variable.start)


def _quantity(variable: Any, start: float) -> Quantity:
    """A parameter with bounds of the FMU where it has narrower ones."""
    low, high = Quantity(start).bounds
    least = low if variable.min is None else max(low, float(variable.min))
    most = high if variable.max is None else min(high, float(variable.max))
    return Quantity(start, _unit(variable), min(least, start), max(most, start))


def _unit(variable: Any) -> str:
    """Unit of a variable, of its type where it has none of its own."""
    unit = variable.unit or getattr(variable.declaredType, "unit", None) or "1"
    return _EXPONENT.sub(lambda power: power[0].translate(_RAISED), str(unit).replace(".", "·"))

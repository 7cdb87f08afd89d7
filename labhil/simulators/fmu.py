"""Read an FMU (FMI 2 or 3) with one coordinate as a simulator.

The calls are in :mod:`labhil.simulators.fmu_file`, the acceleration in ``fmu_mechanism``.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any, NamedTuple

from labhil.errors import UsageError, suggestion
from labhil.physics.quantity import Quantity
from labhil.simulators.fmu_file import (
    MODEL_EXCHANGE,
    REAL_TYPES,
    CoSimulationFmu,
    FmuFile,
    ModelExchangeFmu,
    convert_fmi_errors,
)
from labhil.simulators.fmu_mechanism import CoSimulationMechanism, ModelExchangeMechanism
from labhil.simulators.fmu_solver import (
    PROBED_INPUT,
    PROBED_STATES,
    SolverStep,
    find_step,
    steps_that_fail,
    steps_to_try,
)
from labhil.simulators.names import identifier
from labhil.simulators.probing import FROM_SOLVER, FROM_STEPS, is_damped, probe
from labhil.simulators.simulator import (
    UNDAMPED,
    Coordinate,
    RightHandSide,
    Simulator,
    declare,
    stated_section,
)

_EXPONENT = re.compile(r"(?<=[^\W\d_])-?\d+|(?<=\))-?\d+")
_RAISED = str.maketrans("-0123456789", "⁻⁰¹²³⁴⁵⁶⁷⁸⁹")

Mechanism = ModelExchangeMechanism | CoSimulationMechanism


class Pair(NamedTuple):
    """The variables of an FMU that are its position and its velocity."""

    position: Any
    velocity: Any


class FmuAccess(NamedTuple):
    """The coordinate of an FMU, and how it is called.

    Attributes:
        pair: Position and velocity.
        read: State (position, velocity) and value references to the values of those variables.
        make: Value references of parameters to the mechanism.
        note: What a user should know of its solver; empty for nothing.
    """

    pair: Pair
    read: Callable[[tuple[float, float], list[int]], list[float]]
    make: Callable[[list[int]], Mechanism]
    note: str = ""


def fmu_simulator(
    path: str | Path,
    *,
    inputs: Mapping[str, str] | None = None,
    outputs: Mapping[str, str] | None = None,
    name: str = "",
) -> Simulator:
    """Read an FMU as a simulator, so that all effects of the catalogue can be fitted to it.

    The FMU (FMI 2 or 3) has one coordinate: two continuous states, of which one is the rate of the other, and
    one input. Of model exchange the derivatives are used; a co-simulation is restarted at many states and
    makes two short steps from each. Forces act like the input. Parameters that are not 0 are estimated from
    their starts.

    Args:
        path: The file. Its binary is run: it is code of the author of the file.
        inputs: Variable of the FMU by the name of the recorded signal; the only input by its own name when
            absent.
        outputs: Variable of the FMU by the name of the recorded signal; those of its outputs that are
            position or velocity when absent.
        name: Name of the rig; the FMU's model name when absent.

    Returns:
        The simulator, to be given as a rig to :func:`labhil.fit`, :func:`labhil.diagnose` and others.

    Raises:
        UsageError: The FMU or a name is not as expected; the message states what the FMU has.
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
    estimated = _without_starts([v for v, x in starts.items() if x], starts, access.make)
    mechanism = access.make([v.valueReference for v in estimated])
    quantities = {identifier(v.name): _quantity(v, float(starts[v] or 0.0)) for v in estimated}
    states = {position: _unit(access.pair.position), velocity: _unit(access.pair.velocity)}
    rig = Simulator(
        _rates_of(mechanism, len(estimated)),
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
        notes=(access.note,) if access.note else (),
        section=stated_section("fmu", file.path, inputs, outputs),
    )
    tolerances = FROM_STEPS if isinstance(mechanism, ModelExchangeMechanism) else FROM_SOLVER
    probe(rig, tolerances)
    declare(rig, () if is_damped(rig, tolerances) else UNDAMPED)
    return rig


def _rates_of(mechanism: Mechanism, count: int) -> RightHandSide:
    """Make the right-hand side of a mechanism with ``count`` parameters."""

    def rates(t: float, x: Any, u: Any, p: Any) -> list[float]:
        return mechanism.rates(list(p)[:count], t, list(x), float(u[0]))

    return rates


def _input(file: FmuFile, stated: Mapping[str, str] | None) -> tuple[str, Any]:
    """Return the name of the recorded input, and the variable."""
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
    """Determine which state is the position and which its velocity."""
    states = _state_variables(file)
    if len(states) != 2:
        raise file.refusal(
            "two continuous states, a position and its velocity",
            f"{len(states)}: {', '.join(v.name for v in states) or 'none'}; what else has a state (filters, "
            "motors) is left to the effects that are offered (`labhil terms`)",
        )
    with convert_fmi_errors(file, f"an FMU whose states and input {drive.name} can be set"):
        return (_access_exchange if file.kind == MODEL_EXCHANGE else _access_stepping)(
            file, drive, starts, states
        )


def _state_variables(file: FmuFile) -> list[Any]:
    """Return the declared states; for a co-simulation without any, the variables that can be set."""
    derivatives = [unknown.variable for unknown in file.description.derivatives]
    declared = [v.derivative for v in derivatives if v is not None and v.derivative is not None]
    if declared or file.kind == MODEL_EXCHANGE:
        return declared
    return [
        v
        for v in file.description.modelVariables
        if v.causality in ("output", "local")
        and v.type in REAL_TYPES
        and v.initial == "exact"
        and v.variability in (None, "continuous")
        and v.start is not None
    ]


def _access_exchange(file: FmuFile, drive: Any, starts: Mapping[int, float], states: list[Any]) -> FmuAccess:
    events = int(file.description.numberOfEventIndicators or 0) > 0 or drive.variability == "discrete"
    fmu = ModelExchangeFmu(file, drive.valueReference, with_events=events)
    fmu.initialise(starts)
    rates = [fmu.rates(0.0, state, PROBED_INPUT) for state in PROBED_STATES]
    for velocity_first in (False, True):
        index = int(velocity_first)
        if all(r[index] == s[1 - index] for r, s in zip(rates, PROBED_STATES, strict=True)):
            order = -1 if velocity_first else 1

            def read(state: tuple[float, float], references: list[int], order: int = order) -> list[float]:
                fmu.set_state(0.0, state[::order], PROBED_INPUT)
                return fmu.read_values(references)

            def make(used: list[int], velocity_first: bool = velocity_first) -> Mechanism:
                return ModelExchangeMechanism(fmu, file, used, velocity_first=velocity_first)

            return FmuAccess(Pair(*states[::order]), read, make)
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
        fmu = CoSimulationFmu(file, drive.valueReference, [v.valueReference for v in pair])
        step = find_step(fmu, file, starts)
        if step is None:
            continue

        def read(
            state: tuple[float, float], references: list[int], fmu: CoSimulationFmu = fmu
        ) -> list[float]:
            fmu.start(starts, state, PROBED_INPUT)
            return fmu.read_values(references)

        def make(used: list[int], fmu: CoSimulationFmu = fmu, step: SolverStep = step) -> Mechanism:
            return CoSimulationMechanism(fmu, file, used, step)

        return FmuAccess(pair, read, make, step.note(file))
    raise _no_step(file, states, steps_that_fail(fmu, file, starts))


def _no_velocity(file: FmuFile, states: list[Any]) -> UsageError:
    return file.refusal(
        "that one of the two states is the rate of the other",
        f"{' and '.join(v.name for v in states)}, of which none is",
    )


def _no_step(file: FmuFile, states: list[Any], refused: list[float]) -> UsageError:
    """Make the error of a co-simulation in whose steps no variable is the rate of the other."""
    tried = steps_to_try(file)
    if len(refused) == len(tried):
        return file.refusal(
            "a co-simulation that makes steps of one length out of "
            f"{', '.join(f'{length:g}' for length in tried)} s, or that states its own (stepSize of "
            "DefaultExperiment), or model exchange",
            "one that returns an error in each",
        )
    made = ", ".join(f"{length:g}" for length in tried if length not in refused)
    return file.refusal(
        "that one of the two states is the rate of the other",
        f"{' and '.join(v.name for v in states)}, of which none is in steps of {made} s; where its solver "
        "is too coarse to show it, export the FMU with shorter steps (stepSize of DefaultExperiment), or as "
        "model exchange",
    )


def _outputs(
    file: FmuFile, access: FmuAccess, stated: Mapping[str, str] | None
) -> tuple[str, str, tuple[str, ...]]:
    """Return the names of position and velocity, and which of the two are measured."""
    pair, names = access.pair, _names(file, access)
    if stated is None:
        stated = {v.name: v.name for v in file.variables("output") if v.name in names}
        stated = stated or {pair.position.name: pair.position.name}
    signals: dict[int, str] = {}
    for signal, variable in stated.items():
        if variable not in names:
            raise UsageError(
                f"{file.path}: outputs: {signal}: expected the position or the velocity, found "
                f"{variable!r}{suggestion(variable, names)}; these are {', '.join(names)}"
            )
        signals.setdefault(names[variable], identifier(signal))
    if not signals:
        raise file.refusal("one output at least", f"none; position and velocity are {', '.join(names)}")
    position = signals.get(0, identifier(pair.position.name))
    velocity = signals.get(1, identifier(pair.velocity.name))
    return position, velocity, tuple(signals.values())


def _names(file: FmuFile, access: FmuAccess) -> dict[str, int]:
    """Return the names of all variables that are the position (0) or the velocity (1)."""
    candidates = [*access.pair, *file.variables("output")]
    with convert_fmi_errors(file, "an FMU whose outputs can be read"):
        readings = [access.read(state, [v.valueReference for v in candidates]) for state in PROBED_STATES]
    return {
        v.name: index
        for index in (0, 1)
        for k, v in enumerate(candidates)
        if all(values[k] == state[index] for values, state in zip(readings, PROBED_STATES, strict=True))
    }


def _without_starts(
    parameters: list[Any],
    starts: Mapping[Any, float | None],
    make: Callable[[list[int]], Mechanism],
    *,
    factor: float = 1.25,
) -> list[Any]:
    """Drop the parameters that only set the first state: a window starts in the recorded one.

    Args:
        parameters: Variables that may be estimated.
        starts: Their start values.
        make: Value references to the mechanism.
        factor: Factor by which a parameter is multiplied to observe what changes with it.

    Returns:
        The other parameters.
    """
    mechanism = make([v.valueReference for v in parameters])
    if not isinstance(mechanism, ModelExchangeMechanism):
        return parameters
    values = [float(starts[v] or 0.0) for v in parameters]
    initial_states, remaining = mechanism.start_states(values), []
    for k, v in enumerate(parameters):
        moved = [x * (factor if k == i else 1.0) for i, x in enumerate(values)]
        has_same_rates = all(
            mechanism.rates(values, 0.0, s, PROBED_INPUT) == mechanism.rates(moved, 0.0, s, PROBED_INPUT)
            for s in PROBED_STATES
        )
        if not (has_same_rates and mechanism.start_states(moved) != initial_states):
            remaining.append(v)
    return remaining


def _start(variable: Any) -> float | None:
    return None if variable.start is None else float(variable.start)


def _quantity(variable: Any, start: float) -> Quantity:
    """Make a parameter, with the bounds of the FMU where they are narrower."""
    low, high = Quantity(start).bounds
    lower = low if variable.min is None else max(low, float(variable.min))
    upper = high if variable.max is None else min(high, float(variable.max))
    return Quantity(start, _unit(variable), min(lower, start), max(upper, start))


def _unit(variable: Any) -> str:
    """Return the unit of a variable, or that of its type, with raised exponents."""
    unit = variable.unit or getattr(variable.declaredType, "unit", None) or "1"
    return _EXPONENT.sub(lambda power: power[0].translate(_RAISED), str(unit).replace(".", "·"))

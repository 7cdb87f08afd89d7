"""Write effects for which a simulator's file has no attribute as a Python file.

The Python file accompanies the repaired one and does not import labhil: ``force`` is added at the joint in
each step, ``Command`` turns the recorded input into the acting one, ``Sensor`` the simulated output into the
measured one. For a simulator whose parameters are set by a program, ``PARAMETERS`` are their values.
"""

from __future__ import annotations

from collections.abc import Mapping
from string import Formatter
from textwrap import wrap
from typing import NamedTuple

from labhil.physics.friction_law import FrictionLaw, laws
from labhil.physics.warming import WARMS
from labhil.simulators.law_tables import INTERPOLATE, LawTable

WIDTH = 100


class Law(NamedTuple):
    """An effect: its equation in text, and lines of Python."""

    equation: str
    lines: tuple[str, ...]


BRISTLES = "presliding_friction"
FORCES: Mapping[str, Law] = {
    "constant_force": Law("F = F_0", ("F += {force}",)),
    "spring_force": Law("F = -k x", ("F -= {stiffness} * x",)),
    "spring_hardening": Law("F = -k3 x^3", ("F -= {coefficient} * x**3",)),
    "cogging_torque": Law(
        "F = -a sin(k x) - b cos(k x)",
        ("F -= {sine} * math.sin({order} * x) + {cosine} * math.cos({order} * x)",),
    ),
    "viscous_friction": Law("F = -c v", ("F -= {coefficient} * v",)),
    "quadratic_viscous_friction": Law("F = -c2 v |v|", ("F -= {coefficient} * v * abs(v)",)),
    "cubic_viscous_friction": Law("F = -c3 v^3", ("F -= {coefficient} * v**3",)),
    "friction_asymmetry": Law("F = -c_a |v|", ("F -= {coefficient} * abs(v)",)),
    "coulomb_friction": Law("F = -F_c sgn v", ("F -= {level} * side",)),
    BRISTLES: Law(
        "F = -F_c (b + T db/dt), db = (dx - b |dx|) / length; F_c is the dry friction of creeping motion",
        ("F -= {level} * (side + {time_constant} * (v - abs(v) * side) / {length})",),
    ),
    "static_friction": Law(
        "|F| <= F_c + F_st + F_hold at v = 0; the dry friction holds with all of it, and this gives F_hold "
        "back once it moves",
        ("F += {level} * (1.0 - math.exp(-abs(v) / (3.0 * AT_REST))) * moving",),
    ),
    "stribeck_friction": Law(
        "F = -F_st exp(-|v| / v_s) sgn v; the dry friction holds with F_c + F_st, and this gives back "
        "F_st (1 - exp(-|v| / v_s)) sgn v as it moves",
        ("F += {level} * (1.0 - math.exp(-abs(v) / {velocity})) * moving",),
    ),
    "position_dependent_friction": Law("F = -s x sgn v", ("F -= {slope} * x * side",)),
    WARMS: Law(
        "c(T) = c exp(-a (T - 20)), T in deg C; c itself is the viscous friction beside this",
        ("F -= {coefficient} * (math.exp(-{rate} * (temperature - 20.0)) - 1.0) * v",),
    ),
    "load_dependent_friction": Law("F = -mu |F_drive| sgn v", ("F -= {coefficient} * abs(drive) * side",)),
}
INPUTS: Mapping[str, Law] = {
    "backlash": Law(
        "play of full width gap: u_eff stays until the command has crossed it",
        ("u = self.play = min(max(self.play, u - 0.5 * {gap}), u + 0.5 * {gap})",),
    ),
    "dead_zone": Law(
        "u_eff = u - right above right, u + left below -left, else 0",
        ("u = max(u - {right}, 0.0) + min(u + {left}, 0.0)",),
    ),
    "saturation": Law(
        "u_eff = clip(u, +-1/s)", ("u = min(max(u, -1.0 / {inverse_limit}), 1.0 / {inverse_limit})",)
    ),
    "rate_limit": Law(
        "|du_eff/dt| <= 1/r",
        ("most = dt / {inverse_rate}", "u = self.last = min(max(u, self.last - most), self.last + most)"),
    ),
    "actuator_lag": Law(
        "T du_eff/dt + u_eff = u",
        ("self.lagged += (u - self.lagged) * (1.0 - math.exp(-dt / {time_constant}))", "u = self.lagged"),
    ),
    "time_delay": Law(
        "u_eff(t) = u(t - T_d)",
        ("self.past.append(u)", "u = self.past.popleft() if len(self.past) * dt > {delay} else self.past[0]"),
    ),
}
SENSORS: Mapping[str, Law] = {
    "sensor_nonlinearity": Law("y = x + c x^3", ("y = y + {cubic} * y**3",)),
    "sensor_gain": Law("y = (1 + g) x", ("y = (1.0 + {gain}) * y",)),
    "sensor_offset": Law("y = x + b", ("y = y + {offset}",)),
    "sensor_lag": Law(
        "T dy/dt + y = x",
        ("self.lagged += (y - self.lagged) * (1.0 - math.exp(-dt / {time_constant}))", "y = self.lagged"),
    ),
}


FIRM_FRICTION_NOTE = """
The file's dry friction has to hold firmly, which its format cannot say; when it is loaded,

    model.dof_solref[:] = 2.0 * model.opt.timestep, 1.0
    model.dof_solimp[:, :3] = 0.99, 0.999, 0.001
"""


class Usage(NamedTuple):
    """How a simulation calls a companion.

    Attributes:
        signal: Name of the recorded input.
        force: Line that adds ``force``; ``{drive}`` stands for its third argument, where it needs one.
        drive: What the third argument is.
        command: Line that calls a ``Command``.
        sensor: Line that calls a ``Sensor``.
        parameters: Line that sets ``PARAMETERS``.
        max_step: Longest step for which the functions hold, s; None where the file states its step.
    """

    signal: str
    force: str
    drive: str
    command: str
    sensor: str
    parameters: str = ""
    max_step: float | None = None

    @classmethod
    def in_mujoco(cls, signal: str) -> Usage:
        """Return the lines for MuJoCo's Python interface."""
        return cls(
            signal,
            "data.qfrc_applied[0] = effects.force(data.qpos[0], data.qvel[0]{drive})",
            "data.qfrc_actuator[0]",
            f"data.ctrl[...] = act({signal}, dt), with act = effects.Command()",
            "measured = read(data.qpos[0], dt), with read = effects.Sensor()",
        )

    @classmethod
    def of_step(cls, signal: str, force: str, max_step: float, parameters: str = "") -> Usage:
        """Return the lines for a simulation that is stepped by its user.

        Args:
            signal: Name of the recorded input.
            force: Line that adds ``force``.
            max_step: Longest step, s.
            parameters: Line that sets ``PARAMETERS``.
        """
        return cls(
            signal,
            force,
            signal,
            f"{signal} = act({signal}, dt), with act = effects.Command()",
            "measured = read(output, dt), with read = effects.Sensor()",
            parameters,
            max_step,
        )


class SortedEffects(NamedTuple):
    """Effects of a companion by the place where they act, each with its parameters.

    ``tables`` are friction laws of the user's own; ``unknown`` effects have no law.
    """

    forces: Mapping[str, Mapping[str, float]]
    tables: tuple[LawTable, ...]
    inputs: Mapping[str, Mapping[str, float]]
    sensors: Mapping[str, Mapping[str, float]]
    unknown: tuple[str, ...]

    @property
    def has_force(self) -> bool:
        """Whether anything acts as a force."""
        return bool(self.forces or self.tables)

    @property
    def needs_temperature(self) -> bool:
        """Whether the force depends on a temperature."""
        return WARMS in self.forces


def sort_effects(values: Mapping[str, float]) -> SortedEffects:
    """Sort values of effects by where they act, in the order of the signal path."""
    terms: dict[str, dict[str, float]] = {}
    for name, value in values.items():
        term, _, part = name.partition(".")
        terms.setdefault(term, {})[part] = value
    forces, inputs, sensors = (
        {t: terms[t] for t in known if t in terms} for known in (FORCES, INPUTS, SENSORS)
    )
    own: dict[str, FrictionLaw] = {law.name: law for law in laws() if law.name in terms}
    known = forces.keys() | inputs.keys() | sensors.keys() | own.keys()
    tables = tuple(LawTable.of(law, terms[name]) for name, law in own.items())
    return SortedEffects(forces, tables, inputs, sensors, tuple(sorted(terms.keys() - known)))


def companion_text(
    effects: SortedEffects,
    file: str,
    usage: Usage,
    at_rest: float,
    *,
    firm: bool = False,
    parameters: Mapping[str, float] | None = None,
) -> str:
    """Return the text of the Python file.

    Args:
        effects: The effects.
        file: Name of the repaired file.
        usage: How a simulation of the file calls the functions.
        at_rest: Velocity below which dry friction is viscous, SI.
        firm: Whether the user has to make the dry friction of the file firm after loading.
        parameters: Values that a program has to set.

    Returns:
        The text.
    """
    needs_drive = any("drive" in line for term in effects.forces for line in FORCES[term].lines)
    drive = f", {usage.drive}" if needs_drive else ""
    drive += ", temperature=temperature" if effects.needs_temperature else ""
    lines_of_use = [
        usage.command if effects.inputs else "",
        usage.force.format(drive=drive) if effects.has_force else "",
        usage.sensor if effects.sensors else "",
    ]
    blocks = [
        INTERPOLATE.splitlines() if effects.tables else [],
        _force_function(effects, at_rest) if effects.has_force else [],
        _stage_class("Command", f"The input {usage.signal} as it acts.", "u", effects.inputs, INPUTS)
        if effects.inputs
        else [],
        _stage_class("Sensor", "The output as it is measured.", "y", effects.sensors, SENSORS)
        if effects.sensors
        else [],
    ]
    lines = [
        f'"""What {file} cannot hold of the physics that was found; made by `labhil patch`. SI units.',
        *(["", "Before the simulation:", "", f"    {usage.parameters}"] if parameters else []),
        *(
            [
                "",
                f"In each step of the simulation{_at_most(usage.max_step)}, with this file as `effects`:",
                "",
            ]
            if any(lines_of_use)
            else []
        ),
        *(f"    {line}" for line in lines_of_use if line),
        *(FIRM_FRICTION_NOTE.splitlines() if firm else []),
        '"""',
        "",
        "import math",
        *(["from bisect import bisect"] if effects.tables else []),
        *(["from collections import deque"] if effects.inputs or effects.sensors else []),
    ]
    if parameters:
        lines += ["", "PARAMETERS = {", *(f'    "{k}": {v:.6g},' for k, v in parameters.items()), "}"]
    for block in blocks:
        lines += ["", "", *block] if block else []
    return "\n".join(lines) + "\n"


def _at_most(step: float | None) -> str:
    return "" if step is None else f", of {step:.3g} s at most"


def _force_function(effects: SortedEffects, at_rest: float) -> list[str]:
    lines = [
        *(line for table in effects.tables for line in table.text(WIDTH)),
        *(_bristles_class(effects.forces[BRISTLES]["length"]) if BRISTLES in effects.forces else []),
        f"AT_REST = {at_rest:.6g}  # velocity below which dry friction counts as holding",
        "",
        "",
        "def force(x, v, drive=0.0, temperature=20.0):"
        if effects.needs_temperature
        else "def force(x, v, drive=0.0):",
        '    """The force or torque at the joint beside the file\'s own; drive is that of the actuator."""',
        *_directions(effects),
    ]
    own = [f"    F -= interpolate(*{table.name}, abs(v)) * side" for table in effects.tables]
    return [*lines, *_law_lines(effects.forces, FORCES, "    "), *own, "    return F"]


def _directions(effects: SortedEffects) -> list[str]:
    """Lines that compute the direction of dry friction, at rest and in motion."""
    if BRISTLES in effects.forces:
        return ["    F, side = 0.0, BRISTLES.bend_at(x, v)", "    moving = side"]
    return ["    F, side, moving = 0.0, math.tanh(v / AT_REST), math.copysign(1.0, v)"]


def _bristles_class(length: float) -> list[str]:
    """Lines of the state that dry friction on bristles has."""
    return [
        "class Bristles:",
        '    """Bend of the bristles that carry the dry friction, -1 to 1; make a new one for each run."""',
        "",
        "    def __init__(self):",
        "        self.x, self.bend = None, 0.0",
        "",
        "    def bend_at(self, x, v):",
        '        """The bend at x; it changes with the way between calls and begins as in steady motion."""',
        "        if self.x is None:",
        "            self.x, self.bend = x, math.copysign(1.0, v) if v else 0.0",
        "        side = math.copysign(1.0, x - self.x)",
        f"        self.bend = side - (side - self.bend) * math.exp(-abs(x - self.x) / {length:.6g})",
        "        self.x = x",
        "        return self.bend",
        "",
        "",
        "BRISTLES = Bristles()",
    ]


def _stage_class(
    name: str, doc: str, variable: str, effects: Mapping[str, Mapping[str, float]], laws: Mapping[str, Law]
) -> list[str]:
    return [
        f"class {name}:",
        f'    """{doc}"""',
        "",
        f"    def __init__(self, {variable}=0.0):",
        f"        self.play = self.last = self.lagged = {variable}",
        "        self.past = deque()",
        "",
        f"    def __call__(self, {variable}, dt):",
        '        """The next value, dt s after the one before."""',
        *_law_lines(effects, laws, "        "),
        f"        return {variable}",
    ]


def _law_lines(effects: Mapping[str, Mapping[str, float]], laws: Mapping[str, Law], indent: str) -> list[str]:
    lines = []
    for term, numbers in effects.items():
        parts = {part: f"{value:.6g}" if value >= 0 else f"({value:.6g})" for part, value in numbers.items()}
        law = laws[term]
        names = [name for line in law.lines for name in _placeholders(line)]
        filled = {name: parts.get(name, "0.0") for name in names}
        lines += [f"{indent}# {text}" for text in wrap(f"{term}: {law.equation}", WIDTH)]
        lines += [indent + line.format(**filled) for line in law.lines]
    return lines


def _placeholders(line: str) -> list[str]:
    return [name for _, name, _, _ in Formatter().parse(line) if name]

"""Builds the pendulum of ``pendulum.c`` as an FMU, with the standard's headers that fmpy brings.

``python examples/fmu/pendulum_fmu.py FOLDER`` writes FOLDER/rod.fmu (FMI 3); it needs a C compiler.
"""

from __future__ import annotations

import shutil
import subprocess
import sys
import tempfile
import zipfile
from collections.abc import Sequence
from pathlib import Path

import fmpy
from fmpy.fmi2 import FMU2Model, FMU2Slave
from fmpy.fmi3 import FMU3Model, FMU3Slave

HEADERS = Path(fmpy.__file__).parent / "c-code"
SOURCE = Path(__file__).parent / "pendulum.c"

Variable = tuple[str, str, str, str, str, str]
# name, causality, variability, start, unit, more attributes, in the order of the value references
VARIABLES = (
    ("angle", "output", "continuous", "0", "rad", ""),
    ("rate", "local", "continuous", "0", "rad/s", ""),
    ("torque", "input", "continuous", "0", "N.m", ""),
    ("inertia", "parameter", "tunable", "0.02", "kg.m2", 'min="1e-4"'),
    ("gravity_torque", "parameter", "fixed", "0.5", "N.m", ""),
    ("drag", "parameter", "fixed", "0.01", "N.m.s/rad", ""),
    ("bearing_width", "parameter", "fixed", "0.3", "m", ""),
    ("angle_start", "parameter", "fixed", "0.1", "rad", ""),
)
CLOCK = '<Float64 name="time" valueReference="99" causality="independent" variability="continuous"/>'
DERIVATIVES = ("der(angle)", "der(rate)")


def built(
    folder: Path,
    *,
    version: int,
    kinds: str = "me cs",
    dry: bool = False,
    step: float = 0.0,
    heun: bool = False,
    variables: Sequence[Variable] = VARIABLES,
    **changes: str,
) -> Path:
    """An FMU in a folder; ``changes`` replace names of its description.

    ``step`` (s) is that of a co-simulation whose solver makes no other, and that states it, ``heun`` that
    it goes by Heun's method and not by Euler's. ``variables`` may have other names, units
    and starts than those of the pendulum, in the same order.
    """
    tree = folder / f"fmi{version}"
    platform = fmpy.platform if version == 2 else fmpy.platform_tuple
    binaries = tree / "binaries" / platform
    binaries.mkdir(parents=True, exist_ok=True)
    library = binaries / f"rod{fmpy.sharedLibraryExtension}"
    starts = ", ".join(start for _, _, _, start, *_ in variables)
    flags = [f"-DFMI={version}", f"-DSTARTS={starts}", *(["-DDRY"] if dry else [])]
    flags += [f"-DSTEP={step}"] * (step > 0.0) + ["-DHEUN"] * heun
    rest = tree / "rest.c"
    rest.write_text(_rest(version), encoding="utf-8")
    sources = [str(SOURCE), str(rest)]
    command = ["cc", "-O2", "-shared", "-fPIC", f"-I{HEADERS}", *flags, *sources, "-o", str(library), "-lm"]
    subprocess.run(command, check=True)
    text = (_second if version == 2 else _third)(kinds.split(), variables, events=int(dry))
    if step:
        text = _with_step(text, version, step)
    for old, new in changes.items():
        assert f'name="{old}"' in text
        text = text.replace(f'name="{old}"', f'name="{new}"')
    path = folder / "rod.fmu"
    with zipfile.ZipFile(path, "w") as packed:
        packed.writestr("modelDescription.xml", text)
        packed.write(library, f"binaries/{platform}/{library.name}")
    return path


def _with_step(text: str, version: int, step: float) -> str:
    """The description with the length of the solver's steps: FMI 2 has no other place than its experiment."""
    if version == 3:
        return text.replace("<CoSimulation ", f'<CoSimulation fixedInternalStepSize="{step}" ')
    return text.replace("<ModelVariables>", f'<DefaultExperiment stepSize="{step}"/><ModelVariables>')


def _rest(version: int) -> str:
    """The standard's other functions, all of which say that they failed; the pendulum's own go before."""
    kinds = {2: (FMU2Model, FMU2Slave), 3: (FMU3Model, FMU3Slave)}[version]
    names = {name for kind in kinds for name in dir(kind) if name.startswith(f"fmi{version}")}
    return "".join(f"__attribute__((weak)) int {name}(void) {{ return 3; }}\n" for name in sorted(names))


def _units(variables: Sequence[Variable]) -> str:
    names = dict.fromkeys(v[4] for v in variables)
    return "<UnitDefinitions>" + "".join(f'<Unit name="{name}"/>' for name in names) + "</UnitDefinitions>"


def _second(kinds: list[str], variables: Sequence[Variable], *, events: int) -> str:
    means = {"me": "ModelExchange", "cs": "CoSimulation"}
    described = "".join(
        f'<ScalarVariable name="{name}" valueReference="{k}" causality="{causality}" '
        f'variability="{variability}"{_initial(causality)}><Real start="{start}" unit="{unit}" {more}/>'
        "</ScalarVariable>"
        for k, (name, causality, variability, start, unit, more) in enumerate(variables)
    ) + "".join(
        f'<ScalarVariable name="{name}" valueReference="{len(variables) + k}" causality="local" '
        f'variability="continuous" initial="calculated"><Real derivative="{k + 1}"/></ScalarVariable>'
        for k, name in enumerate(DERIVATIVES)
    )
    first = len(variables) + 1
    indices = "".join(f'<Unknown index="{first + k}"/>' for k in range(2))
    return (
        '<?xml version="1.0" encoding="UTF-8"?><fmiModelDescription fmiVersion="2.0" modelName="rod" '
        f'guid="{{rod}}" numberOfEventIndicators="{events}">'
        + "".join(f'<{means[kind]} modelIdentifier="rod"/>' for kind in kinds)
        + f"{_units(variables)}<ModelVariables>{described}</ModelVariables><ModelStructure><Outputs>"
        f'<Unknown index="1"/></Outputs><Derivatives>{indices}</Derivatives><InitialUnknowns>{indices}'
        "</InitialUnknowns></ModelStructure></fmiModelDescription>"
    )


def _third(kinds: list[str], variables: Sequence[Variable], *, events: int) -> str:
    means = {"me": "ModelExchange", "cs": "CoSimulation"}
    described = "".join(
        f'<Float64 name="{name}" valueReference="{k}" causality="{causality}" '
        f'variability="{variability}"{_initial(causality)} start="{start}" unit="{unit}" {more}/>'
        for k, (name, causality, variability, start, unit, more) in enumerate(variables)
    ) + "".join(
        f'<Float64 name="{name}" valueReference="{len(variables) + k}" causality="local" '
        f'variability="continuous" initial="calculated" derivative="{k}"/>'
        for k, name in enumerate(DERIVATIVES)
    )
    first = len(variables)
    unknown = "".join(
        f'<{what} valueReference="{first + k}"/>'
        for what in ("ContinuousStateDerivative", "InitialUnknown")
        for k in range(2)
    )
    assert not events
    return (
        '<?xml version="1.0" encoding="UTF-8"?><fmiModelDescription fmiVersion="3.0" modelName="rod" '
        'instantiationToken="{rod}">'
        + "".join(f'<{means[kind]} modelIdentifier="rod"/>' for kind in kinds)
        + f"{_units(variables)}<ModelVariables>{described}{CLOCK}</ModelVariables><ModelStructure>"
        f'<Output valueReference="0"/>{unknown}</ModelStructure></fmiModelDescription>'
    )


def _initial(causality: str) -> str:
    return "" if causality == "input" else ' initial="exact"'


if __name__ == "__main__":
    with tempfile.TemporaryDirectory() as build:
        print(shutil.copy(built(Path(build), version=3), sys.argv[1] if len(sys.argv) > 1 else "."))

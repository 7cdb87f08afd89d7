"""Load a MuJoCo file in a process of its own, so that a file that crashes or never ends ends only that.

MuJoCo reads XML, meshes and pictures in C, and ``<replicate count="…">`` makes a million bodies of a line.
The process has limits on memory and time; it returns the model in MuJoCo's binary format.
"""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import tempfile
from pathlib import Path
from typing import Any

from labhil.errors import UsageError
from labhil.extras import load_optional
from labhil.terminal import show

MAX_CPU_SECONDS = 8
"""Processor time for a file, s; the meshes of a robot take one or two."""

MAX_WALL_SECONDS = 15.0

MAX_MEMORY = 700 << 20
"""Memory for a file in addition to that of MuJoCo itself, bytes."""

MAX_PARTS = 20_000
"""Largest number of bodies, and of shapes."""


def load_in_subprocess(file: Path, purpose: str) -> Any:
    """Load a file with MuJoCo in a process of its own.

    Args:
        file: An MJCF or URDF file.
        purpose: The feature that needs MuJoCo, for the message where that is not installed.

    Returns:
        A ``mujoco.MjModel``.

    Raises:
        UsageError: MuJoCo cannot load it (with its message), or it exceeds the limits of time or memory.
    """
    mujoco = load_optional("mujoco", purpose)
    with tempfile.TemporaryDirectory(prefix="labhil-mujoco-") as folder:
        binary = Path(folder) / "model.mjb"
        error = _load_error(file.resolve(), binary)
        if error:
            raise UsageError(f"{file}: expected a file that MuJoCo loads (MJCF, URDF), found: {error}")
        # without this MuJoCo writes warnings of a simulation to a file in the working directory
        mujoco.set_mju_user_warning(lambda _text: None)
        return mujoco.MjModel.from_binary_path(str(binary))


def _load_error(file: Path, binary: Path) -> str:
    """Return the error of loading a file; "" where its binary form was written."""
    command = [sys.executable, "-P", "-m", "labhil.simulators.trial_load", str(file), str(binary)]
    path = os.pathsep.join(entry for entry in sys.path if entry)
    try:
        process = subprocess.run(
            command,
            cwd=binary.parent,  # MuJoCo writes a log there
            env={**os.environ, "PYTHONPATH": path},
            stdin=subprocess.DEVNULL,
            stdout=subprocess.PIPE,
            stderr=subprocess.DEVNULL,
            timeout=MAX_WALL_SECONDS,
            check=False,
        )
    except subprocess.TimeoutExpired:
        return f"one that takes longer than {MAX_WALL_SECONDS:.0f} s"
    if process.returncode == -signal.SIGXCPU:
        return f"one that takes more than {MAX_CPU_SECONDS} s of processor time"
    if process.returncode or not binary.is_file():
        message = " ".join(process.stdout.decode("utf-8", "replace").split())
        return message or f"one that ends its reader ({process.returncode})"
    return ""


def main() -> None:
    """Load the file of the first argument and write it to that of the second, or print the error."""
    import mujoco

    _limit_resources()
    try:
        model = _load(mujoco, sys.argv[1])
    except (ValueError, MemoryError) as error:
        sys.exit(_fail(str(error) or f"one that needs more than {MAX_MEMORY >> 20} MB of memory"))
    if max(model.nbody, model.ngeom) > MAX_PARTS:
        size = f"{model.nbody} bodies with {model.ngeom} shapes"
        sys.exit(_fail(f"{size}; at most {MAX_PARTS} of either are taken"))
    mujoco.mj_saveModel(model, sys.argv[2], None)


def _load(mujoco: Any, path: str) -> Any:
    """Load a file; an arm whose meshes are not there (``package://…`` of a ROS package) without them.

    The inverse dynamics of an arm needs no shapes where each link has an inertia of its own.
    """
    try:
        return mujoco.MjModel.from_xml_path(path)
    except ValueError as error:
        if "opening file" not in str(error):
            raise
        without = _without_meshes(mujoco, path)
        if without is None or without.njnt < 2:
            raise
        return without


def _without_meshes(mujoco: Any, path: str) -> Any:
    """Load a file without its meshes; None where one of them gives a body its inertia."""
    spec = mujoco.MjSpec.from_file(path)
    for body in spec.bodies:
        shaped = [geom for geom in body.geoms if geom.type == mujoco.mjtGeom.mjGEOM_MESH]
        if shaped and not body.explicitinertial:
            return None
        for geom in shaped:
            spec.delete(geom)
    for mesh in list(spec.meshes):
        spec.delete(mesh)
    return spec.compile()


def _fail(text: str) -> int:
    show(text)
    return 1


def _limit_resources() -> None:
    """Limit processor time and memory of this process."""
    try:
        import resource
    except ImportError:  # not a POSIX system
        return
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
    pages = int(Path("/proc/self/statm").read_text(encoding="ascii").split()[0])
    for what, limit in (
        (resource.RLIMIT_CPU, MAX_CPU_SECONDS),
        (resource.RLIMIT_AS, pages * resource.getpagesize() + MAX_MEMORY),
    ):
        hard = resource.getrlimit(what)[1]
        resource.setrlimit(what, (limit if hard == resource.RLIM_INFINITY else min(limit, hard), hard))


if __name__ == "__main__":
    main()

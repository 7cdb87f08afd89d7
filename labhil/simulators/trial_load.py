"""A MuJoCo file, loaded in a process of its own: a file that crashes it, or never ends, harms only that.

MuJoCo reads XML, meshes and pictures in C, and ``<replicate count="…">`` makes a million bodies of a line.
The process has bounds on memory and time; what it loaded comes back as MuJoCo's own binary form.
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

CPU_SECONDS = 8
"""Processor time for a file; meshes of a robot take one or two seconds."""

WALL_SECONDS = 15.0

MEMORY = 700 << 20
"""Bytes of memory for a file, beyond those of MuJoCo itself."""

MOST_PARTS = 20_000
"""Bodies, or shapes, of a file with one joint."""


def load_apart(file: Path, purpose: str) -> Any:
    """Load a file with MuJoCo.

    Args:
        file: An MJCF or URDF file.
        purpose: What it is for, for the message where MuJoCo is not installed.

    Returns:
        A ``mujoco.MjModel``.

    Raises:
        UsageError: What MuJoCo says of it, or that it takes more time or memory than a file may.
    """
    mujoco = load_optional("mujoco", purpose)
    with tempfile.TemporaryDirectory(prefix="labhil-mujoco-") as folder:
        binary = Path(folder) / "model.mjb"
        complaint = _load_error(file.resolve(), binary)
        if complaint:
            raise UsageError(f"{file}: expected a file that MuJoCo loads (MJCF, URDF), found: {complaint}")
        # else MuJoCo writes warnings of a simulation to a file in the working directory
        mujoco.set_mju_user_warning(lambda _text: None)
        return mujoco.MjModel.from_binary_path(str(binary))


def _load_error(file: Path, binary: Path) -> str:
    """What is wrong with a file; nothing where its binary form was written."""
    command = [sys.executable, "-P", "-m", "labhil.simulators.trial_load", str(file), str(binary)]
    path = os.pathsep.join(entry for entry in sys.path if entry)
    try:
        done = subprocess.run(
            command,
            cwd=binary.parent,  # where MuJoCo writes a log of its own
            env={**os.environ, "PYTHONPATH": path},
            stdin=subprocess.DEVNULL,
            stdout=subprocess.PIPE,
            stderr=subprocess.DEVNULL,
            timeout=WALL_SECONDS,
            check=False,
        )
    except subprocess.TimeoutExpired:
        return f"one that takes longer than {WALL_SECONDS:.0f} s"
    if done.returncode == -signal.SIGXCPU:
        return f"one that takes more than {CPU_SECONDS} s of processor time"
    if done.returncode or not binary.is_file():
        message = " ".join(done.stdout.decode("utf-8", "replace").split())
        return message or f"one that ends its reader ({done.returncode})"
    return ""


def main() -> None:
    """Load the file that is named first, and write it to the one that is named second; else print why not."""
    import mujoco

    _bound()
    try:
        model = mujoco.MjModel.from_xml_path(sys.argv[1])
    except (ValueError, MemoryError) as error:
        sys.exit(_tell(str(error) or f"one that needs more than {MEMORY >> 20} MB of memory"))
    if max(model.nbody, model.ngeom) > MOST_PARTS:
        size = f"{model.nbody} bodies with {model.ngeom} shapes"
        sys.exit(_tell(f"{size}; at most {MOST_PARTS} of either are taken"))
    mujoco.mj_saveModel(model, sys.argv[2], None)


def _tell(text: str) -> int:
    show(text)
    return 1


def _bound() -> None:
    """Bound what the file may take, beyond what the process has taken already."""
    try:
        import resource
    except ImportError:  # not a POSIX system
        return
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
    pages = int(Path("/proc/self/statm").read_text(encoding="ascii").split()[0])
    for what, limit in (
        (resource.RLIMIT_CPU, CPU_SECONDS),
        (resource.RLIMIT_AS, pages * resource.getpagesize() + MEMORY),
    ):
        hard = resource.getrlimit(what)[1]
        resource.setrlimit(what, (limit if hard == resource.RLIM_INFINITY else min(limit, hard), hard))


if __name__ == "__main__":
    main()

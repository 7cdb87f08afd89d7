"""A program whose writes to one disk are slowed down by the kernel (cgroup v1, ``blkio``; root only):

    python benchmarks/measuring/on_slow_disk.py GROUP MOST PROGRAM ARGUMENTS…

The process enters the group, whose limits hold for its children, too. MOST is how many bytes a recorder lets
wait for the disk; 0 for what it usually does. PROGRAM is ``recorder_alone.py``, or ``labhil``, whose hosts
wait 5 s for commands instead of 0.22 s: what is measured is the disk, and not how busy the machine is.
"""

from __future__ import annotations

import os
import runpy
import sys
from functools import partial, partialmethod
from pathlib import Path

from labhil.service.recorder import Recorder


def main() -> None:
    group, most, program = sys.argv[1], int(sys.argv[2]), sys.argv[3]
    (Path(group) / "cgroup.procs").write_text(str(os.getpid()))
    if most:
        Recorder.__init__ = partialmethod(Recorder.__init__, max_backlog=most)  # type: ignore[method-assign,assignment]
    sys.argv = sys.argv[3:]
    if program == "labhil":
        from labhil.cli import main as labhil
        from labhil.experiment import devices

        devices.HostConfig = partial(devices.HostConfig, watchdog=5.0)  # type: ignore[misc,assignment]
        labhil()
    else:
        sys.path.insert(0, str(Path(program).parent))
        runpy.run_path(program, run_name="__main__")


if __name__ == "__main__":
    main()

"""A recorder in a process of its own, with a note of what it forced to the disk:

    python benchmarks/measuring/recorder_alone.py NOTES RECORDING.mcap

It writes where its bus is reached to ``endpoint.txt``, and records until its standard input ends.
"""

from __future__ import annotations

import sys
from pathlib import Path

from labhil.bus.session import open_bus
from labhil.host_clock import session_clock
from labhil.service.recorder import Recorder
from noted_syncs import note_syncs


def main() -> None:
    note_syncs(Path(sys.argv[1]))
    with session_clock(), open_bus() as bus, Recorder(bus, Path(sys.argv[2])):
        draft = Path("endpoint.draft")
        draft.write_text(bus.endpoint)
        draft.rename("endpoint.txt")
        sys.stdin.read()


if __name__ == "__main__":
    main()

"""Memory that is free goes back to the system: a service that lives for months does not keep it."""

from __future__ import annotations

import platform
import subprocess
import sys
import weakref
from pathlib import Path

import pytest

from labhil.bus.session import open_bus
from labhil.memory import give_back
from labhil.service.recorder import Recorder

CODE = """
import psutil
from labhil.memory import give_back, keep_few_arenas
keep_few_arenas()
me = psutil.Process()
blocks = [bytes(4000) for _ in range(20_000)]
kept = blocks[::50]  # one in each stretch of memory, so that none of them is free as a whole
full = me.memory_info().rss
del blocks
before = me.memory_info().rss
give_back()
print(full, before, me.memory_info().rss, len(kept))
"""


@pytest.mark.skipif(platform.libc_ver()[0] != "glibc", reason="another C library decides for itself")
def test_what_lies_free_between_what_is_used_is_given_back() -> None:
    done = subprocess.run([sys.executable, "-P", "-c", CODE], capture_output=True, text=True, check=True)
    full, before, after, kept = map(int, done.stdout.split())
    assert kept == 400
    assert before > full - 20e6, "nothing was left to give back: this test proves nothing"
    assert after < full - 50e6


def test_a_recorder_that_is_over_is_freed(tmp_path: Path) -> None:
    with open_bus() as bus:
        recorder = Recorder(bus, tmp_path / "a.mcap")
        recorder.finish()
        watched = weakref.ref(recorder)
        del recorder
        give_back()
        assert watched() is None

"""Threads of ``labhil serve`` that die: the service ends in order and says why."""

from __future__ import annotations

import sys
import time
from pathlib import Path

import pytest

from labhil.recording.reader import read_recording

sys.path.insert(0, str(Path(__file__).parent))
from test_serve import BENCH, PATIENCE, begin, wait_for

PATCH = """
import pathlib
import sys

if "serve" in sys.orig_argv:
    from {module} import {owner}

    before = {owner}.{method}

    def struck(self, *args):
        if pathlib.Path({strike!r}).exists():
            raise SystemExit("struck")
        return before(self, *args)

    {owner}.{method} = struck
"""


def struck_lab(folder: Path, monkeypatch: pytest.MonkeyPatch, module: str, owner: str, method: str) -> str:
    """Serve a lab, let a thread of it die, and return what was said; its recording has its end."""
    strike = folder / "strike"
    patch = PATCH.format(module=module, owner=owner, method=method, strike=str(strike))
    (folder / "sitecustomize.py").write_text(patch)
    monkeypatch.setenv("PYTHONPATH", str(folder))
    service = begin(folder, f"[lab]\n{BENCH}")
    said = folder / "said.txt"
    try:
        wait_for(lambda: "bench: ball_beam at" in said.read_text(), "the bench")
        time.sleep(1.0)
        strike.touch()
        assert service.wait(PATIENCE) == 1
    finally:
        service.kill()
        assert service.stdout is not None
        service.stdout.close()
    return said.read_text()


@pytest.mark.extended
def test_a_lab_ends_with_what_its_worker_raised(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    said = struck_lab(tmp_path, monkeypatch, "labhil.campaign.worker", "Worker", "poll")
    assert "'worker' has died: SystemExit('struck')" in said
    (path,) = tmp_path.glob("*.mcap")
    recording = read_recording(path)
    assert recording.metadata["end"]["exit_status"] == "1"
    assert "SystemExit('struck')" in recording.metadata["end"]["reason"]


@pytest.mark.extended
def test_a_lab_ends_with_what_its_recorder_raised(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    said = struck_lab(tmp_path, monkeypatch, "labhil.service.recorder", "Recorder", "_tick")
    assert "SystemExit('struck')" in said
    (part,) = tmp_path.glob("*.mcap*")
    assert len(read_recording(part).streams) > 0

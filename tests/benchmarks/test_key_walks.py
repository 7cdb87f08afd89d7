"""Random keys in the terminal UI, a few walks of them; ``measure_key_walks.py`` makes hundreds."""

from __future__ import annotations

import asyncio
from pathlib import Path

import pytest

from labhil.tui.session import Session
from labhil_benchmarks.key_walks import fill, walk

ROOT = Path(__file__).parents[2]


@pytest.mark.extended
@pytest.mark.timeout(180)
def test_no_random_walk_over_the_keys_ends_the_screen(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("XDG_RUNTIME_DIR", str(tmp_path))
    recordings = sorted((ROOT / "recordings").glob("*.mcap"))[:2]
    folder = fill(tmp_path / "bench", recordings, sorted((ROOT / "tests" / "tui" / "results").iterdir()))
    with Session() as lab:
        walks = [asyncio.run(walk(folder, lab, seed, 40)) for seed in range(4)]
    assert [one for one in walks if one.crash] == []
    assert all(len(one.keys) == 40 for one in walks), "a walk ended early without a crash"

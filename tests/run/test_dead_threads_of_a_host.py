"""Each thread of a real host made to raise, with its device and the bus: the host ends and says why."""

from __future__ import annotations

import time
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from typing import Any

import pytest

from labhil.errors import LabhilError

PATIENCE = 90.0
PATCH = """
import pathlib
import sys

if "labhil.service.host" in sys.orig_argv:
    from {module} import {owner}

    before = {owner}.{method}

    def struck(self, *args):
        if pathlib.Path({strike!r}).exists() and {key!r} in self._thread._thread.name:
            raise SystemExit("struck")
        return before(self, *args)

    {owner}.{method} = struck
"""


@pytest.mark.extended
@pytest.mark.parametrize(
    ("owner", "method", "module", "key"),
    [
        ("Responder", "_answer", "labhil.bus.ask", "cmd/status"),
        ("Subscription", "_deliver", "labhil.bus.subscribe", "setpoint"),
        ("StreamPublisher", "_publish", "labhil.bus.publish", "/state"),
        ("StreamPublisher", "_publish", "labhil.bus.publish", "/command"),
    ],
)
def test_a_host_ends_with_what_its_thread_raised(
    owner: str,
    method: str,
    module: str,
    key: str,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    start_bench: Callable[..., Any],
) -> None:
    strike = tmp_path / "strike"
    patch = PATCH.format(owner=owner, method=method, module=module, key=key, strike=str(strike))
    (tmp_path / "sitecustomize.py").write_text(patch)
    monkeypatch.setenv("PYTHONPATH", str(tmp_path))
    bench = start_bench()
    bench.take_lease()
    bench.set(0.1)
    strike.touch()
    deadline = time.monotonic() + PATIENCE
    while (failure := bench.host.failure()) is None:
        assert time.monotonic() < deadline, "the host goes on"
        with suppress(LabhilError):
            bench.put(0.1)
            if key == "cmd/status":
                bench.ask("status")
        time.sleep(0.02)
    assert "SystemExit('struck')" in str(failure) and key in str(failure)
    assert "struck" in bench.wait_for_event("failed")["message"]

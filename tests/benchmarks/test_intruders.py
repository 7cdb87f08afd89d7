"""What an intruder makes of what it hears; ``measure_intruders.py`` lets it loose on a run."""

from __future__ import annotations

import subprocess
import sys
import threading
import time
from pathlib import Path

import pytest

from labhil.bus.keys import event_key
from labhil.bus.publish import publish_event
from labhil.bus.session import open_bus
from labhil.bus.subscribe import subscribe

SCRIPT = Path(__file__).parents[2] / "benchmarks" / "measuring" / "intruder.py"


@pytest.mark.extended
@pytest.mark.parametrize("attack", ["malformed", "forged", "replayed", "flood"])
def test_an_intruder_sends_what_it_is_told_to(attack: str) -> None:
    key, heard = event_key("bench"), list[bytes]()
    with open_bus() as bus, subscribe(bus, key, lambda _key, payloads: heard.extend(payloads)):
        over = threading.Event()

        def publish() -> None:
            while not over.wait(0.02):
                publish_event(bus, "bench", "ours")

        thread = threading.Thread(target=publish)
        thread.start()
        command = [sys.executable, str(SCRIPT), bus.endpoint, key, "put", attack, "0.3", "200"]
        try:
            done = subprocess.run(command, capture_output=True, text=True, timeout=60, check=True)
        finally:
            over.set()
            thread.join()
        sent = int(done.stdout.split()[-1])
        time.sleep(0.3)
    assert sent > 20
    false = [payload for payload in heard if b'"ours"' not in payload]
    if attack == "replayed":
        assert false == [] and len(heard) > len(set(heard))
    else:
        assert len(false) > 20 and (b"forged" in b"".join(false)) == (attack != "malformed")

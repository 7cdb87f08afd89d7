"""What a client of a twin's port has sent goes with it."""

from __future__ import annotations

import os
import time

from labhil.serial_twin.wires import PseudoTerminal


def test_a_device_that_boots_reads_nothing_of_the_client_before() -> None:
    wire = PseudoTerminal()
    first = os.open(wire.address, os.O_RDWR | os.O_NOCTTY)
    assert wire.client() == 1
    os.write(first, b"a command")
    os.close(first)
    deadline = time.monotonic() + 5.0
    while wire.client() and time.monotonic() < deadline:
        time.sleep(0.001)
    second = os.open(wire.address, os.O_RDWR | os.O_NOCTTY)
    assert wire.client() == 2
    assert wire.read() == b""
    os.write(second, b"another")
    time.sleep(0.05)
    assert wire.read() == b"another"
    os.close(second)
    wire.close()

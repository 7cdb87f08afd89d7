"""A subscriber that only counts what it hears, to be frozen: ``slow_subscriber.py ENDPOINT``."""

from __future__ import annotations

import sys

from labhil.bus.keys import ALL_STREAMS
from labhil.bus.session import open_bus
from labhil.bus.subscribe import subscribe


def main() -> None:
    heard = 0

    def take(_key: str, payloads: list[bytes]) -> None:
        nonlocal heard
        heard += len(payloads)

    with open_bus(sys.argv[1]) as bus, subscribe(bus, ALL_STREAMS, take):
        sys.stdin.read()
    print(heard)


if __name__ == "__main__":
    main()

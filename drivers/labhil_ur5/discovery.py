"""Finds UR controllers on the network by their RTDE port.

Nothing is asked but the version of the protocol. Only hosts are tried that this machine exchanges packages
with anyway (its neighbours), and itself, unless a network is named.
"""

from __future__ import annotations

import ipaddress
from collections.abc import Iterable
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

from labhil.driver import FoundAddress
from labhil.errors import ConnectError, OptionError, ProtocolError
from labhil_ur5.rtde import PORT, Receiver

SIMULATOR = "127.0.0.1"
"""Where a simulated controller on this machine listens by default."""
NEIGHBOURS = Path("/proc/net/arp")
"""The neighbour table of Linux; another system has none there, and only the simulator is tried."""
COMPLETE = 0x2
"""Flag of a neighbour whose hardware address is known: one that has answered lately (``ATF_COM``)."""
PROBE_TIMEOUT = 0.3
"""Longest time to connect, and to answer, s; a controller of the same network answers within milliseconds."""
SMALLEST_PREFIX = 24
MAX_HOSTS = 254
"""Hosts that are tried: those of a network of 24 bits, the one of a lab."""
IN_PARALLEL = 64
"""Hosts that are tried at once: all take four rounds, 2.4 s where nobody answers."""


def find_controllers(search: str | None = None) -> tuple[FoundAddress, ...]:
    """Return the hosts that answer on the RTDE port.

    Args:
        search: An IPv4 network of 24 bits or more, such as "192.168.1.0/24"; None for this machine and its
            neighbours.

    Raises:
        OptionError: It is no such network.
    """
    hosts = [SIMULATOR, *neighbours()] if search is None else hosts_of(search)
    hosts = list(dict.fromkeys(hosts))[:MAX_HOSTS]
    with ThreadPoolExecutor(IN_PARALLEL) as pool:
        answers = list(pool.map(is_controller, hosts))
    return tuple(
        FoundAddress(host, f"a controller that speaks RTDE on port {PORT}")
        for host, answered in zip(hosts, answers, strict=True)
        if answered
    )


def is_controller(host: str) -> bool:
    """Return whether a host speaks RTDE; asks only for the version of the protocol."""
    try:
        receiver = Receiver(host, PROBE_TIMEOUT)
    except ConnectError:
        return False
    try:
        receiver.negotiate()
    except (ConnectError, ProtocolError):
        return False
    finally:
        receiver.close()
    return True


def neighbours(table: Path = NEIGHBOURS) -> tuple[str, ...]:
    """Return the IPv4 addresses of the neighbour table that have answered, in its order."""
    try:
        lines = table.read_text(encoding="ascii", errors="replace").splitlines()[1:]
    except OSError:
        return ()
    return tuple(_answering(line.split() for line in lines))


def _answering(rows: Iterable[list[str]]) -> Iterable[str]:
    """Yield the addresses of rows (address, hardware type, flags, …) whose flags say "complete"."""
    for address, _, flags, *_ in (row for row in rows if len(row) > 2):
        if int(flags, 16) & COMPLETE:
            yield address


def hosts_of(search: str) -> list[str]:
    """Return the addresses of a network's hosts.

    Raises:
        OptionError: It is no IPv4 network, or one of more than 254 hosts.
    """
    example = "an IPv4 network of 254 hosts at most, such as 192.168.1.0/24"
    try:
        network = ipaddress.IPv4Network(search, strict=False)
    except ValueError as error:
        raise OptionError("search", f": expected {example}, found {search!r} ({error})") from error
    if network.prefixlen < SMALLEST_PREFIX:
        raise OptionError(
            "search",
            f": expected {example}, found {search!r} with {network.num_addresses}; name a part of it",
        )
    return [str(host) for host in network.hosts()]

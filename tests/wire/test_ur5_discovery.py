"""Controllers are found by their RTDE port, and nothing else answers for one."""

from __future__ import annotations

import socket
import sys
import threading
from collections.abc import Iterator
from pathlib import Path

import pytest

from labhil.driver import AddressFinder
from labhil.errors import OptionError
from labhil.plugins import find_addresses, load_driver
from labhil_ur5 import discovery
from labhil_ur5.rtde import PORT, PROTOCOL_VERSION

sys.path.insert(0, str(Path(__file__).parent))
from ur5_process import address, running_twin

TABLE = """\
IP address       HW type     Flags       HW address            Mask     Device
{answers}        0x1         0x2         00:11:22:33:44:55     *        eth0
{silent}         0x1         0x0         00:00:00:00:00:00     *        eth0
"""


@pytest.fixture
def listener() -> Iterator[tuple[str, list[bytes]]]:
    """A server on the RTDE port that is no controller, and what it hears."""
    host, heard = address(93), list[bytes]()
    with socket.create_server((host, PORT)) as server:

        def serve() -> None:
            connection, _ = server.accept()
            with connection:
                heard.append(connection.recv(4096))
                connection.sendall(b"220 mail\r\n")
                heard.append(connection.recv(4096))

        thread = threading.Thread(target=serve)
        thread.start()
        yield host, heard
        thread.join(10.0)


def test_somebody_else_on_the_port_is_no_controller_and_is_asked_for_the_version_only(listener) -> None:
    host, heard = listener
    assert not discovery.is_controller(host)
    version_request = bytes([0, 5, ord("V"), 0, PROTOCOL_VERSION])
    assert heard[0] == version_request


def test_of_the_neighbours_those_count_that_have_answered(tmp_path: Path) -> None:
    table = tmp_path / "arp"
    table.write_text(TABLE.format(answers="192.168.1.7", silent="192.168.1.8"), encoding="ascii")
    assert discovery.neighbours(table) == ("192.168.1.7",)
    assert discovery.neighbours(tmp_path / "none") == ()


@pytest.mark.parametrize(
    ("search", "message"),
    [
        ("192.168.0.0/16", "with 65536; name a part of it"),
        ("lab", "found 'lab'"),
        ("fe80::/120", "found 'fe80::/120'"),
    ],
)
def test_a_large_network_and_what_is_none_are_refused(search: str, message: str) -> None:
    with pytest.raises(OptionError) as refused:
        find_addresses("ur5", search)
    assert message in refused.value.on_command_line


def test_a_network_of_24_bits_has_254_hosts() -> None:
    hosts = discovery.hosts_of("192.168.1.77/24")
    assert (len(hosts), hosts[0], hosts[-1]) == (254, "192.168.1.1", "192.168.1.254")
    assert discovery.hosts_of("192.168.1.9/32") == ["192.168.1.9"]


def test_every_driver_is_asked_in_the_same_way() -> None:
    for name in ("ball_beam", "dc_motor", "solenoid", "ur5", "ur5_cb3"):
        assert isinstance(load_driver(name), AddressFinder)
    for place in find_addresses("dc_motor"):
        assert place.what.startswith("serial port")
    with pytest.raises(OptionError, match="serial port"):
        find_addresses("dc_motor", "192.168.1.0/24")


def test_a_thread_that_dies_is_heard_of(monkeypatch: pytest.MonkeyPatch) -> None:
    def die(host: str) -> bool:
        raise RuntimeError(f"struck at {host}")

    monkeypatch.setattr(discovery, "is_controller", die)
    with pytest.raises(RuntimeError, match=r"struck at 192\.168\.1\.9"):
        find_addresses("ur5", "192.168.1.9/32")


@pytest.mark.extended
def test_a_controller_is_found_in_the_network_that_is_named() -> None:
    host = address(94)
    with running_twin(host):
        found = find_addresses("ur5", f"{host.rpartition('.')[0]}.92/30")
        assert [place.address for place in found] == [host]

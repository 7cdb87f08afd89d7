"""Who may command from another machine: guests over TLS with certificates, and a lab in other processes."""

from __future__ import annotations

import json
import os
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import psutil
import pytest
import zenoh

from labhil.bus import latch
from labhil.bus.ask import ask
from labhil.bus.keys import ALL_STREAMS, RUN, command_key, guest_key, setpoint_key, stream_key
from labhil.bus.live import live_devices
from labhil.bus.publish import publish_command
from labhil.bus.session import Bus, open_bus
from labhil.bus.subscribe import subscribe
from labhil.errors import BusError, CommandRefusedError, LabhilError
from labhil.host_clock import unix_ns
from labhil.service.emergency import press_everywhere, release_everywhere
from labhil.service.messages import Setpoint
from labhil.tui.bus_watch import BusWatch

sys.path.insert(0, str(Path(__file__).parents[2] / "benchmarks" / "measuring"))
from open_lab import PEOPLE, REVOKED, OpenLab, free_port, labhil, make_people, open_lab, wait_for

TLS = "transport/link/tls"
BENCH = "bench"
pytestmark = pytest.mark.extended


@pytest.fixture(scope="module")
def lab(tmp_path_factory: pytest.TempPathFactory) -> Iterator[OpenLab]:
    """Return a lab that is open to guests."""
    with open_lab(tmp_path_factory.mktemp("open")) as opened:
        yield opened


def enter(endpoint: str, mode: str = "client", **tls: str) -> zenoh.Session:
    """Join as somebody with a program of their own would, in any mode."""
    config = zenoh.Config()
    settings: dict[str, Any] = {
        "mode": mode,
        "scouting/multicast/enabled": False,
        "connect/endpoints": [endpoint],
        "connect/timeout_ms": 2000,
        "connect/exit_on_failure": True,
        "listen/endpoints": [] if mode == "client" else ["tcp/127.0.0.1:0"],
        f"{TLS}/enable_mtls": True,
        **{f"{TLS}/{name}": value for name, value in tls.items()},
    }
    for key, value in settings.items():
        config.insert_json5(key, json.dumps(value))
    return zenoh.open(config)


def certificate(folder: str) -> dict[str, str]:
    return {
        "root_ca_certificate": f"{folder}/ca.pem",
        "connect_certificate": f"{folder}/certificate.pem",
        "connect_private_key": f"{folder}/private.key",
    }


def status_of(bus: Bus) -> dict[str, Any]:
    return ask(bus, command_key(BENCH, "status"), {}, 5.0)


def take_lease(bus: Bus) -> str:
    return str(ask(bus, command_key(BENCH, "lease"), {"action": "take", "holder": "the king"}, 5.0)["token"])


def give_back(bus: Bus, token: str) -> None:
    ask(bus, command_key(BENCH, "lease"), {"action": "return", "token": token}, 5.0)


@contextmanager
def stopped_by(lab: OpenLab, person: str) -> Iterator[None]:
    """Let somebody press the emergency stop; whatever stands at the end is released by the admin."""
    outcome = press_everywhere("whoever", "a test", lab.folder(person))
    assert outcome.answered == {BENCH: "latched"}
    try:
        yield
    finally:
        release_everywhere(lab.folder("ada"))
        assert not lab.latch.exists()


def test_nobody_gets_a_link_without_a_certificate_of_this_lab(lab: OpenLab, tmp_path: Path) -> None:
    ours, endpoint = lab.folder("ada"), lab.authority.endpoint
    strangers = make_people(tmp_path / "strangers", free_port()).folder / "people" / "ada"
    with enter(endpoint, **certificate(ours)):
        pass  # the door is open: what follows is refused for what it is
    with pytest.raises(zenoh.ZError):
        enter(endpoint, root_ca_certificate=f"{ours}/ca.pem")
    with pytest.raises(zenoh.ZError):
        # signed by another authority, for a person of the same name
        enter(endpoint, **{**certificate(str(strangers)), "root_ca_certificate": f"{ours}/ca.pem"})
    with pytest.raises(zenoh.ZError):
        enter(endpoint.replace("tls/", "tcp/"))
    with pytest.raises(zenoh.ZError):
        enter(endpoint, **certificate(str(strangers)))  # a lab of another authority is no lab for its people


@pytest.mark.parametrize("mode", ["client", "peer", "router"])
def test_a_guest_in_any_mode_cannot_use_another_name_or_pretend_to_be_a_device(
    lab: OpenLab, mode: str
) -> None:
    forged: list[str] = []
    own, others = (guest_key(command_key(BENCH, "status"), name) for name in ("vera", "otto"))
    with (
        open_bus(lab.folder("ada")) as admin,
        subscribe(admin, stream_key("ghost", "state"), lambda key, _: forged.append(key)),
        enter(lab.authority.endpoint, mode, **certificate(lab.folder("vera"))) as guest,
    ):
        asked = guest_key(command_key(BENCH, "status"), "ada")
        # this session's own questions for everything come here, too
        guest.declare_queryable(
            "lab/*/by/ada/cmd/*",
            lambda query: forged.append("asked") if str(query.key_expr) == asked else None,
        )
        guest.liveliness().declare_token("lab/ghost/@live")
        if mode == "client":
            wait_for(lambda: any(reply.ok for reply in guest.get(own, timeout=2.0)), "an answer")
        else:  # a peer or a router has to learn who answers, and learns nothing
            time.sleep(1.0)
        for key in (others, guest_key(command_key(BENCH, "status"), "*"), "lab/**", "**"):
            own_places = (own, "@/")  # a session also answers of itself
            replies = [str(reply.ok.key_expr) for reply in guest.get(key, timeout=2.0) if reply.ok]
            assert not [place for place in replies if not place.startswith(own_places)], key
        guest.put(stream_key("ghost", "state"), b"x")
        guest.put("lab/ghost/event", b'{"text": "fire"}')
        guest.put(guest_key(setpoint_key(BENCH), "otto"), b"{}")
        status_of(admin)  # what was sent before has been dealt with
        time.sleep(0.5)
        assert [live_devices(admin) for _ in range(8)] == 8 * [(BENCH,)]
    assert not forged


def test_a_viewer_sees_everything_and_commands_nothing(lab: OpenLab) -> None:
    heard: list[str] = []
    with (
        open_bus(lab.folder("vera")) as bus,
        subscribe(bus, ALL_STREAMS, lambda key, _: heard.append(key)),
        BusWatch(bus) as watch,
    ):
        wait_for(lambda: stream_key(BENCH, "state") in heard, "samples")
        wait_for(lambda: any(view.state == "idle" and view.stream for view in watch.devices()), "the bench")
        assert ask(bus, command_key(RUN, "status"), {}, 5.0)["state"] == "serving"
        for device, command in (
            *((BENCH, name) for name in ("lease", "set", "safe", "shutdown", "release")),
            *((RUN, name) for name in ("pause", "resume", "stop", "abort", "mark")),
        ):
            with pytest.raises(CommandRefusedError, match=r"'vera' is viewer .* no right to that"):
                ask(bus, command_key(device, command), {}, 5.0)
        assert status_of(bus)["holder"] is None


def test_an_operator_commands_under_the_name_of_the_certificate(lab: OpenLab) -> None:
    with open_bus(lab.folder("otto")) as bus, open_bus(lab.folder("olga")) as other:
        token = take_lease(bus)
        assert status_of(other)["holder"] == "otto (certificate)"
        with pytest.raises(CommandRefusedError, match=r"held by 'otto \(certificate\)'"):
            take_lease(other)

        def commanded() -> bool:
            setpoint = Setpoint(token, unix_ns(), {"servo_angle": 0.05})
            publish_command(bus, setpoint_key(BENCH), setpoint.to_bytes())
            return bool(status_of(other)["applied"]["servo_angle"] == 0.05)

        wait_for(commanded, "a setpoint from afar to be applied")
        answer = ask(
            bus, command_key(BENCH, "set"), Setpoint(token, unix_ns(), {"servo_angle": 0.1}).to_json()
        )
        assert answer["applied"]["servo_angle"] == 0.1
        give_back(bus, token)
        with pytest.raises(CommandRefusedError, match=r"'otto' is operator .* no right to that"):
            ask(bus, command_key(BENCH, "shutdown"), {}, 5.0)


def test_a_setpoint_of_a_viewer_does_not_arrive(lab: OpenLab) -> None:
    with open_bus(lab.folder("otto")) as operator, open_bus(lab.folder("vera")) as viewer:
        token = take_lease(operator)
        for _ in range(10):
            # with the operator's own token: only the right is missing
            setpoint = Setpoint(token, unix_ns(), {"servo_angle": 0.07})
            publish_command(viewer, setpoint_key(BENCH), setpoint.to_bytes())
            time.sleep(0.02)
        assert status_of(operator)["applied"]["servo_angle"] == 0.0
        give_back(operator, token)


def test_a_viewer_stops_everything_and_only_an_admin_releases_that(lab: OpenLab) -> None:
    with stopped_by(lab, "vera"):
        standing = json.loads(lab.latch.read_text())
        assert standing["by"] == "vera (certificate)"
        assert latch.read_latch() is None  # this machine is not the lab's
        with (
            open_bus(lab.folder("otto")) as bus,
            pytest.raises(CommandRefusedError, match="emergency stop by vera"),
        ):
            take_lease(bus)
        with pytest.raises(CommandRefusedError, match=r"'vera' is viewer .* no right to that"):
            release_everywhere(lab.folder("vera"))
        with pytest.raises(CommandRefusedError, match="nobody but 'otto' has pressed"):
            release_everywhere(lab.folder("otto"))
        assert lab.latch.exists()
    with open_bus(lab.folder("otto")) as bus:
        give_back(bus, take_lease(bus))  # the admin has released it


def test_an_operator_releases_his_own_stop_but_not_anothers(lab: OpenLab) -> None:
    with stopped_by(lab, "otto"):
        with pytest.raises(CommandRefusedError, match=r"nobody but 'olga' has pressed.*by otto"):
            release_everywhere(lab.folder("olga"))
        assert release_everywhere(lab.folder("otto")).answered == {BENCH: "idle"}
        assert not lab.latch.exists()


def test_a_stop_that_another_presses_again_is_the_operators_own_no_more(lab: OpenLab) -> None:
    with stopped_by(lab, "otto"):
        press_everywhere("whoever", "a second time", lab.folder("olga"))
        for name in ("otto", "olga"):
            with pytest.raises(CommandRefusedError, match="pressed again by olga"):
                release_everywhere(lab.folder(name))
        assert lab.latch.exists()


def test_a_stop_pressed_at_the_lab_is_not_released_from_afar_but_by_an_admin(lab: OpenLab) -> None:
    there = {"XDG_RUNTIME_DIR": str(lab.runtime)}
    assert labhil("estop", "--reason", "smoke", environment=there).returncode == 0
    refused = labhil("estop", "--release", "--connect", lab.folder("otto"))
    assert refused.returncode == 2
    assert "smoke" in refused.stderr
    assert lab.latch.exists()
    released = labhil("estop", "--release", "--connect", lab.folder("ada"))
    assert (released.returncode, released.stdout) == (0, "bench: idle\n")
    assert not lab.latch.exists()


def test_who_was_revoked_sees_nothing_and_stops_nothing(lab: OpenLab) -> None:
    heard: list[str] = []
    with open_bus(lab.folder(REVOKED)) as bus, subscribe(bus, ALL_STREAMS, lambda key, _: heard.append(key)):
        with pytest.raises(BusError, match=f"'{REVOKED}' was revoked"):
            status_of(bus)
        with pytest.raises(BusError, match=f"'{REVOKED}' was revoked"):
            press_everywhere("whoever", "a test", lab.folder(REVOKED))
        assert live_devices(bus) == ()
    assert not heard
    assert not lab.latch.exists()


def test_a_door_that_is_open_takes_rights_away_at_once_and_guests_come_back(lab: OpenLab) -> None:
    lab.authority.add("greta", PEOPLE["otto"], 30)
    wait_for(lambda: "greta (operator)" in lab.said("door"), "the door to know her")
    with open_bus(lab.folder("greta")) as greta, open_bus(lab.folder("vera")) as vera:
        give_back(greta, take_lease(greta))
        status_of(vera)
        lab.authority.revoke("greta")

        def answered(bus: Bus) -> bool:
            try:
                return bool(status_of(bus))
            except LabhilError:
                return False

        wait_for(lambda: answered(vera), "the link to come back")
        wait_for(lambda: not answered(greta), "the rights to be gone")
        with pytest.raises(BusError):
            take_lease(greta)


def test_commands_take_the_folder_of_a_connection(lab: OpenLab) -> None:
    seen = labhil("control", "status", "--connect", lab.folder("vera"))
    assert json.loads(seen.stdout)["devices"] == [BENCH]
    refused = labhil("control", "pause", "--connect", lab.folder("vera"))
    assert (refused.returncode, "'vera' is viewer" in refused.stderr) == (2, True)
    no_run = labhil("mark", "oil added", "--connect", lab.folder("otto"))
    assert (no_run.returncode, "expected a run that is up" in no_run.stderr) == (2, True)


def test_only_the_door_listens_beyond_its_own_kind(lab: OpenLab) -> None:
    """Lab, host and twin listen on the loopback as ever; the door at the port that it was given."""
    listening = {}
    for process in psutil.process_iter():
        try:
            command = " ".join(process.cmdline())
            if str(lab.runtime) == process.environ().get("XDG_RUNTIME_DIR"):
                ports = [c.laddr for c in process.net_connections("tcp") if c.status == psutil.CONN_LISTEN]
                listening[command] = ports
        except psutil.Error:
            continue
    doors = [ports for command, ports in listening.items() if "security serve" in command]
    assert [address.port for address in doors[0] if address.port == lab.authority.port]
    assert {address.ip for ports in listening.values() for address in ports} == {"127.0.0.1"}
    assert os.environ["XDG_RUNTIME_DIR"] != str(lab.runtime)

"""Who may do what in a lab on another machine: every role tries every action. A command, no test:

    python benchmarks/measuring/measure_rights.py -o benchmarks/results/rights.json

A lab with a simulated bench, a run with another one, and the door to them are processes of their own; guests
come over TLS on 127.0.0.1 and share no directory with them. The result says of each attempt whether it was
carried out, what refused it otherwise, and lists what is not as ``ALLOWED`` says; exit status 1 where
anything is not.
"""

from __future__ import annotations

import argparse
import json
import platform
import sys
import tempfile
import time
from collections.abc import Callable, Mapping
from importlib.metadata import version
from pathlib import Path
from typing import Any

import zenoh

from labhil.bus.ask import ask
from labhil.bus.keys import ALL_STREAMS, RUN, command_key, guest_key, setpoint_key, stream_key
from labhil.bus.publish import publish_command
from labhil.bus.session import Bus, open_bus
from labhil.bus.subscribe import subscribe
from labhil.errors import BusError, CommandRefusedError, LabhilError
from labhil.host_clock import unix_ns
from labhil.service.emergency import press_everywhere, release_everywhere
from labhil.service.messages import Setpoint
from measured import tell
from open_lab import REVOKED, OpenLab, free_port, make_people, open_lab, wait_for

BENCH, ANOTHER, ADMIN = "bench", "olga", "ada"
EXPERIMENT = """
[experiment]
name = "guests"
[devices.second]
plugin = "ball_beam"
address = "twin"
rig = "rig.toml"
twin = { seed = 3 }
[[steps]]
device = "second"
signal = "servo_angle"
excitation = "hold"
level = 0.0
duration = 3000.0
"""
RIG = '[rig]\nkind = "ball_beam"\n'
LOOK = ("look", "status", "press the emergency stop")
COMMAND = (
    *("mark", "pause the run", "resume the run", "stop the run"),
    *("take the lease", "set", "stream setpoints", "make safe", "release an own stop"),
)
REST = ("release another's stop", "end a host")
NEVER = ("ask under another's name", "publish a sample as a device", "hear another's setpoints")
ACTIONS = (*LOOK, *COMMAND, *REST, *NEVER)
ALLOWED: Mapping[str, tuple[str, ...]] = {
    "no certificate": (),
    "another authority's certificate": (),
    "revoked": (),
    "viewer": LOOK,
    "operator": (*LOOK, *COMMAND),
    "admin": (*LOOK, *COMMAND, *REST),
}
PEOPLE = {"revoked": REVOKED, "viewer": "vera", "operator": "otto", "admin": ADMIN}


class Attempts:
    """What one person tries; an attempt raises LabhilError or AssertionError where it is not carried out."""

    def __init__(self, lab: OpenLab, person: str, bus: Bus, admin: Bus) -> None:
        self._lab, self._person, self._bus, self._admin = lab, person, bus, admin
        self._token = ""

    def by_name(self) -> dict[str, Callable[[], object]]:
        """In the order in which they are made: what ends a run or a host comes late."""
        return {
            "look": self._look,
            "status": lambda: self._ask(BENCH, "status"),
            "ask under another's name": self._borrow_name,
            "publish a sample as a device": self._pretend,
            "mark": lambda: self._ask(RUN, "mark", text="oil added"),
            "pause the run": lambda: self._ask(RUN, "pause"),
            "resume the run": lambda: self._ask(RUN, "resume"),
            "stop the run": lambda: self._ask(RUN, "stop"),
            "take the lease": self._take_lease,
            "set": lambda: self._ask(BENCH, "set", **self._setpoint(0.1)),
            "stream setpoints": self._stream,
            "hear another's setpoints": self._listen_in,
            "make safe": lambda: self._ask(BENCH, "safe"),
            "press the emergency stop": self._press,
            "release an own stop": self._release_own,
            "release another's stop": self._release_anothers,
            "end a host": lambda: self._ask(BENCH, "shutdown"),
        }

    def _ask(self, device: str, command: str, **request: Any) -> dict[str, Any]:
        return ask(self._bus, command_key(device, command), request, 6.0)

    def _look(self) -> None:
        heard: list[str] = []
        with subscribe(self._bus, ALL_STREAMS, lambda key, _: heard.append(key)):
            time.sleep(2.0)
        assert stream_key(BENCH, "state") in heard, "no sample in 2 s"

    def _borrow_name(self) -> None:
        key = guest_key(command_key(BENCH, "status"), ANOTHER)
        replies = list(self._bus.session.get(key, payload=b"{}", timeout=3.0))
        assert any(reply.ok for reply in replies), "no answer"

    def _pretend(self) -> None:
        heard: list[str] = []
        key = stream_key("ghost", "state")
        with subscribe(self._admin, key, lambda _, payloads: heard.extend(map(str, payloads))):
            for _ in range(10):
                self._bus.session.put(key, b"forged")
                time.sleep(0.1)
        assert heard, "nobody heard it"

    def _take_lease(self) -> None:
        self._token = str(self._ask(BENCH, "lease", action="take")["token"])

    def _setpoint(self, level: float) -> dict[str, Any]:
        return Setpoint(self._token, unix_ns(), {"servo_angle": level}).to_json()

    def _stream(self) -> None:
        """Without a right to the lease: with that of another, so that nothing but the right is missing."""
        answer = (
            None if self._token else ask(self._admin, command_key(BENCH, "lease"), {"action": "take"}, 6.0)
        )
        token = self._token if answer is None else str(answer["token"])
        applied = 0.0
        for _ in range(30):
            setpoint = Setpoint(token, unix_ns(), {"servo_angle": 0.07})
            publish_command(self._bus, setpoint_key(BENCH), setpoint.to_bytes())
            time.sleep(0.03)
        status = ask(self._admin, command_key(BENCH, "status"), {}, 6.0)
        applied = status["applied"]["servo_angle"]
        ask(self._admin, command_key(BENCH, "safe"), {}, 6.0)
        assert applied == 0.07, f"servo_angle is {applied}"

    def _listen_in(self) -> None:
        heard: list[str] = []
        own = guest_key(setpoint_key(BENCH), self._person)
        with subscribe(self._bus, "lab/*/by/**", lambda key, _: heard.append(key)):
            time.sleep(0.5)
            for _ in range(10):
                publish_command(self._admin, setpoint_key(BENCH), b"{}")
                time.sleep(0.05)
        # what the admin's own session sends is its own
        assert [key for key in heard if key != own], "nothing was heard"

    def _press(self) -> None:
        outcome = press_everywhere("whoever", "measured", self._lab.folder(self._person))
        # a run that has just been stopped may be ending: its device is gone then
        assert BENCH in outcome.answered, f"{outcome}"
        assert self._lab.latch.exists()

    def _release_own(self) -> None:
        self._release(self._person)

    def _release_anothers(self) -> None:
        self._release(ANOTHER)

    def _release(self, presser: str) -> None:
        release_everywhere(self._lab.folder(ADMIN))
        if presser != REVOKED:
            press_everywhere("whoever", "measured", self._lab.folder(presser))
        try:
            release_everywhere(self._lab.folder(self._person))
            assert not self._lab.latch.exists(), "it still stands"
        finally:
            release_everywhere(self._lab.folder(ADMIN))


def attempt(action: Callable[[], object]) -> str:
    """Make an attempt; "carried out", or what kept it from that."""
    try:
        action()
    except (CommandRefusedError, BusError, AssertionError) as error:
        return f"refused: {error}"
    return "carried out"


def enter_without(lab: OpenLab, tls: Mapping[str, str]) -> str:
    """Try to get a link; "carried out" where there is one."""
    config = zenoh.Config()
    place = "transport/link/tls"
    settings: dict[str, Any] = {
        "mode": "client",
        "scouting/multicast/enabled": False,
        "connect/endpoints": [lab.authority.endpoint],
        "connect/timeout_ms": 3000,
        "connect/exit_on_failure": True,
        f"{place}/root_ca_certificate": str(lab.authority.folder / "ca.pem"),
        f"{place}/enable_mtls": True,
        **{f"{place}/{name}": value for name, value in tls.items()},
    }
    for key, value in settings.items():
        config.insert_json5(key, json.dumps(value))
    try:
        with zenoh.open(config):
            return "carried out"
    except zenoh.ZError:
        return "refused: no link"


def ensure_run(lab: OpenLab, admin: Bus) -> None:
    """Begin a run where none is up, and wait until it runs."""

    def state() -> str:
        try:
            return str(ask(admin, command_key(RUN, "status"), {}, 6.0)["state"])
        except LabhilError:
            return ""

    if state() != "running":
        wait_for(lambda: state() == "serving", "the run before to be over")
        lab.begin("run", "run", "guests.toml")
    wait_for(lambda: state() == "running", "a run")


def measure(lab: OpenLab) -> dict[str, dict[str, str]]:
    """Let everybody try everything."""
    (lab.directory / "guests.toml").write_text(EXPERIMENT)
    (lab.directory / "rig.toml").write_text(RIG)
    strangers = make_people(lab.directory / "strangers", free_port()).folder / "people" / ADMIN
    foreign = {
        "connect_certificate": str(strangers / "certificate.pem"),
        "connect_private_key": str(strangers / "private.key"),
    }
    outcomes = {
        "no certificate": dict.fromkeys(ACTIONS, enter_without(lab, {})),
        "another authority's certificate": dict.fromkeys(ACTIONS, enter_without(lab, foreign)),
    }
    with open_bus(lab.folder(ADMIN)) as admin:
        for role, person in PEOPLE.items():
            ensure_run(lab, admin)
            with open_bus(lab.folder(person)) as bus:
                attempts = Attempts(lab, person, bus, admin).by_name()
                outcomes[role] = {name: attempt(attempts[name]) for name in attempts}
            done = [name for name, outcome in outcomes[role].items() if outcome == "carried out"]
            print(f"{role}: {', '.join(done) or 'nothing'}", file=sys.stderr)
    return outcomes


def main() -> int:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("-o", dest="out", type=Path, help="the result's file (default: standard output)")
    arguments = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder, open_lab(Path(folder)) as lab:
        outcomes = measure(lab)
    unexpected = [
        f"{role}: {action}: {outcome}"
        for role, actions in outcomes.items()
        for action, outcome in actions.items()
        if (outcome == "carried out") != (action in ALLOWED[role])
    ]
    result = {
        "schema": "labhil.benchmark.rights/1",
        "machine": platform.platform(),
        "zenoh": version("eclipse-zenoh"),
        "attempts": sum(len(actions) for actions in outcomes.values()),
        "unexpected": unexpected,
        "outcomes": outcomes,
    }
    tell(result, arguments.out)
    return 1 if unexpected else 0


if __name__ == "__main__":
    sys.exit(main())

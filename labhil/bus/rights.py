"""Who may say what on a bus that is open to other machines, as zenoh's access control has it.

Everything is forbidden that is not named here. A person is known by the common name of a certificate, and
asks and commands only under keys with that name in them (:func:`labhil.bus.keys.guest_key`): zenoh lets no
other certificate use them, so that whoever answers knows who asked.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from labhil.bus.keys import ALL_LIVE, ALL_SCHEMAS, ALL_STREAMS, RUN, command_key, guest_key, setpoint_key
from labhil.security.roles import RIGHTS, SETPOINT, Role


def asked_keys(person: str, commands: Sequence[str]) -> list[str]:
    """Return where a person asks for these commands, of devices and of a run."""
    # a run's chunk begins with @, which no wildcard matches
    return [guest_key(command_key(device, name), person) for name in commands for device in ("*", RUN)]


def setpoint_keys(person: str) -> list[str]:
    """Return where a person streams setpoints to."""
    return [guest_key(setpoint_key("*"), person)]


def access_control(people: Mapping[str, Role]) -> dict[str, Any]:
    """Return the section ``access_control`` of the bus that serves these people."""
    rules = [
        _rule("listen", "ingress", ["declare_subscriber"], [ALL_STREAMS, ALL_SCHEMAS]),
        _rule("look", "ingress", ["query"], [ALL_SCHEMAS]),
        _rule("presence", "ingress", ["liveliness_query", "declare_liveliness_subscriber"], [ALL_LIVE]),
        _rule("shown", "egress", ["put", "reply"], [ALL_STREAMS, ALL_SCHEMAS]),
        _rule("present", "egress", ["liveliness_token"], [ALL_LIVE]),
    ]
    common = [rule["id"] for rule in rules]
    subjects, policies = [], []
    for person, role in people.items():
        own = _own_rules(person, role)
        rules += own
        subjects.append({"id": person, "cert_common_names": [person]})
        policies.append({"rules": [*common, *(rule["id"] for rule in own)], "subjects": [person]})
    section = {"enabled": True, "default_permission": "deny"}
    return {**section, "rules": rules, "subjects": subjects, "policies": policies}


def _own_rules(person: str, role: Role) -> list[dict[str, Any]]:
    commands = [name for name in RIGHTS[role] if name != SETPOINT]
    asked = asked_keys(person, commands)
    rules = [
        _rule(f"{person} asks", "ingress", ["query"], asked),
        _rule(f"{person} is answered", "egress", ["reply"], asked_keys(person, ["*"])),
    ]
    if SETPOINT in RIGHTS[role]:
        rules.append(_rule(f"{person} commands", "ingress", ["put"], setpoint_keys(person)))
    return rules


def _rule(name: str, flow: str, messages: Sequence[str], keys: Sequence[str]) -> dict[str, Any]:
    return {
        "id": name,
        "permission": "allow",
        "flows": [flow],
        "messages": list(messages),
        "key_exprs": list(keys),
    }

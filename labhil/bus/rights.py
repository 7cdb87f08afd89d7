"""The rights of guests on a bus that is open to other machines, as rules of zenoh's access control.

Everything that is not listed here is denied. A person is identified by the common name of a certificate and
sends requests only under keys that contain that name (:func:`labhil.bus.keys.guest_key`). Zenoh permits them
to no other certificate, so that the receiver knows the sender.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from labhil.bus.keys import ALL_LIVE, ALL_SCHEMAS, ALL_STREAMS, RUN, command_key, guest_key, setpoint_key
from labhil.security.roles import RIGHTS, SETPOINT, Role


def request_keys(person: str, commands: Sequence[str]) -> list[str]:
    """Return the keys under which a person sends these commands to devices and to a run."""
    # a run's chunk begins with @, which no wildcard matches
    return [guest_key(command_key(device, name), person) for name in commands for device in ("*", RUN)]


def setpoint_keys(person: str) -> list[str]:
    """Return the keys under which a person streams setpoints."""
    return [guest_key(setpoint_key("*"), person)]


def access_control(people: Mapping[str, Role]) -> dict[str, Any]:
    """Return the section ``access_control`` of the configuration of the bus for these people."""
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
        personal = _personal_rules(person, role)
        rules += personal
        subjects.append({"id": person, "cert_common_names": [person]})
        policies.append({"rules": [*common, *(rule["id"] for rule in personal)], "subjects": [person]})
    section = {"enabled": True, "default_permission": "deny"}
    return {**section, "rules": rules, "subjects": subjects, "policies": policies}


def _personal_rules(person: str, role: Role) -> list[dict[str, Any]]:
    commands = [name for name in RIGHTS[role] if name != SETPOINT]
    rules = [
        _rule(f"{person} asks", "ingress", ["query"], request_keys(person, commands)),
        _rule(f"{person} is answered", "egress", ["reply"], request_keys(person, ["*"])),
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

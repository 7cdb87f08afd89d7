"""A process that joins a bus without its key and sends what it likes to one key:

    python benchmarks/measuring/intruder.py ENDPOINT KEY put|ask malformed|forged|replayed|flood SECONDS RATE

It listens first, for a third of a second: what is replayed or forged is made of what it heard. Prints how
many messages it sent. RATE is in messages a second, 0 for as many as it can.
"""

from __future__ import annotations

import json
import sys
import time
from collections.abc import Iterator
from itertools import cycle
from typing import Any

import zenoh

LISTENS = 0.35
DEEP = b'{"a":' * 5000 + b"1" + b"}" * 5000
MALFORMED = (
    b"", b"{}", b"[]", b"null", b"{", b"\x00", b"\xff\xfe", b"[" * 100_000, DEEP, b"x" * 1_000_000,
    b'{"token": "x", "t_ns": 1e999, "values": {}, "kind": "a"}', b'{"t_ns": 1, "kind": "\\ud800"}',
    b'{"action": "perhaps", "reason": 7}', b'{"stream": "{}", "metadata": {"speed": "nan"}}',
    bytes(range(256)),
)  # fmt: skip


class Intruder:
    """A session without a key, and what it has heard."""

    def __init__(self, endpoint: str) -> None:
        config = zenoh.Config()
        for name, value in (
            ("mode", "peer"),
            ("scouting/multicast/enabled", False),
            ("connect/endpoints", [endpoint]),
            ("listen/endpoints", ["tcp/127.0.0.1:0"]),
        ):
            config.insert_json5(name, json.dumps(value))
        self.heard: dict[str, tuple[bytes, bytes | None]] = {}
        self._session = zenoh.open(config)
        self._listening = self._session.declare_subscriber("lab/**", self._hear)
        time.sleep(LISTENS)

    def _hear(self, sample: zenoh.Sample) -> None:
        attached = None if sample.attachment is None else sample.attachment.to_bytes()
        self.heard[str(sample.key_expr)] = sample.payload.to_bytes(), attached

    def attack(self, key: str, how: str, attack: str, seconds: float, rate: float) -> int:
        """Send to a key for so long, at so many a second (0: at once); how many messages that were."""
        self._listening.undeclare()
        messages = cycle(list(self._messages(key, attack)))
        begun, sent = time.monotonic(), 0
        while (now := time.monotonic() - begun) < seconds:
            if rate and sent > rate * now:
                time.sleep(1e-3)
                continue
            payload, code = next(messages)
            self._send(key, how, payload, code, wait=attack != "flood")
            sent += 1
        return sent

    def _send(self, key: str, how: str, payload: bytes, code: bytes | None, *, wait: bool) -> None:
        if how == "put":
            control = zenoh.CongestionControl.BLOCK if wait else zenoh.CongestionControl.DROP
            self._session.put(key, payload, attachment=code, congestion_control=control)
        elif wait:
            list(self._session.get(key, payload=payload, attachment=code, timeout=3.0))
        else:
            self._session.get(key, lambda _reply: None, payload=payload, attachment=code, timeout=3.0)

    def _messages(self, key: str, attack: str) -> Iterator[tuple[bytes, bytes | None]]:
        if attack in ("malformed", "flood"):
            yield from (
                (payload, None) for payload in MALFORMED if attack == "malformed" or len(payload) < 1000
            )
        if attack in ("replayed", "flood"):
            yield from [self.heard[key]] if key in self.heard else list(self.heard.values())
        if attack in ("forged", "flood"):
            yield from ((payload, code) for payload in self._forged(key) for code in (None, bytes(41)))

    def _forged(self, key: str) -> Iterator[bytes]:
        """Messages that are right but for who sends them: what was heard, changed, and what moves or ends."""
        now = time.time_ns()
        token = self._token()
        if key in self.heard and not self.heard[key][0].startswith(b"{"):
            payload = self.heard[key][0]
            # stamps are fixed64 behind their tags: later ones, with the same values, and other values
            yield payload[:-8] + b"\x00\x00\x00\x00\x00\x00\xf0\x3f"
            yield b"".join(
                payload[k : k + 8] + b"\x7f" if payload[k : k + 1] in b"\x09\x11\x19" else payload[k : k + 9]
                for k in range(0, len(payload), 9)
            )
            return
        for message in (
            {"t_ns": now, "kind": "failed", "message": "forged", "state": "failed"},
            {"t_ns": now, "kind": "tripped", "message": "forged", "state": "tripped"},
            {"t_ns": now, "kind": "lost", "message": "forged"},
            {"token": token, "t_ns": now, "values": {"servo_angle": 0.9}},
            {"action": "take", "holder": "an intruder"},
            {"action": "return", "token": token},
            {"action": "release", "by": "an intruder"},
            {"reason": "an intruder"},
            {"text": "an intruder"},
        ):
            yield json.dumps(message).encode()

    def _token(self) -> str:
        for key, (payload, _) in self.heard.items():
            if key.endswith("/setpoint"):
                setpoint: Any = json.loads(payload)
                return str(setpoint["token"])
        return "none"


def main() -> None:
    endpoint, key, how, attack, seconds, rate = sys.argv[1:]
    intruder = Intruder(endpoint)
    print("listening is over", flush=True)
    print(intruder.attack(key, how, attack, float(seconds), float(rate)), flush=True)


if __name__ == "__main__":
    main()

"""Admission to the terminal UI in a browser: it moves devices, so only its user is admitted.

On the loopback that is the same user of this machine, by Linux's list of connections; everywhere else whoever
has the token, which a browser keeps in a cookie. A page of another site is refused in either case.
"""

from __future__ import annotations

import ipaddress
import os
import secrets
import socket
import struct
from dataclasses import dataclass
from pathlib import Path
from urllib.parse import urlsplit

from aiohttp import web

LOOPBACK_NAMES = ("localhost", "127.0.0.1", "::1")
CONNECTIONS = Path("/proc/net/tcp"), Path("/proc/net/tcp6")
"""Where Linux lists connections: local address, remote address, state, …, user."""
ESTABLISHED = "01"


def is_loopback(host: str) -> bool:
    """Return whether only this machine reaches an address.

    Example:
        >>> is_loopback("localhost"), is_loopback("127.0.0.1"), is_loopback("0.0.0.0")
        (True, True, False)
    """
    if host == "localhost":
        return True
    try:
        return ipaddress.ip_address(host).is_loopback
    except ValueError:
        return False


@dataclass(frozen=True, slots=True)
class Gate:
    """Admit whoever has the ``token``; with None, the same user of this machine."""

    token: str | None

    @classmethod
    def at(cls, host: str) -> Gate:
        """Make the gate that an address needs."""
        users_are_known = CONNECTIONS[0].exists()
        return cls(None if is_loopback(host) and users_are_known else secrets.token_urlsafe(32))

    @property
    def query(self) -> str:
        """End of the address that is handed out."""
        return "" if self.token is None else f"?token={self.token}"

    def refusal(self, request: web.Request) -> str:
        """Return why this request is refused; empty where it is not."""
        origin = request.headers.get("Origin")
        if origin is not None and urlsplit(origin).netloc != request.host:
            return f"a page of {origin[:200]} may not use this one"
        if self.token is None:
            return self._stranger_refusal(request)
        given = request.query.get("token") or request.cookies.get(_cookie(request), "")
        if not secrets.compare_digest(given.encode(), self.token.encode()):
            return "open the whole address that `labhil tui --web` printed, with its token"
        return ""

    def welcome(self, request: web.Request) -> web.Response | None:
        """Move a token from the address, which stays in the browser's history, into a cookie."""
        if self.token is None or "token" not in request.query or request.path != "/":
            return None
        answer = web.Response(status=303, headers={"Location": "/"})
        answer.set_cookie(_cookie(request), self.token, httponly=True, samesite="Strict")
        return answer

    def _stranger_refusal(self, request: web.Request) -> str:
        # a name of another site may lead here; its page would then count as one of this server
        name = urlsplit(f"//{request.host}").hostname
        if name not in LOOPBACK_NAMES:
            return f"expected the address http://127.0.0.1 or http://localhost, found {request.host[:200]}"
        if _user_behind(request) not in (os.getuid(), 0):
            return "this screen is that of another user of this machine"
        return ""


def _cookie(request: web.Request) -> str:
    """Name of the cookie; it holds the port, since ports share their host's cookies."""
    return f"labhil-{urlsplit(f'//{request.host}').port or 80}"


def _user_behind(request: web.Request) -> int | None:
    """The user at the other end of the connection of a request."""
    if request.transport is None:
        return None
    theirs, ours = (request.transport.get_extra_info(name) for name in ("peername", "sockname"))
    return user_of(theirs[:2], ours[:2]) if theirs and ours else None


def user_of(theirs: tuple[str, int], ours: tuple[str, int]) -> int | None:
    """Return the user whose process holds one end of a connection.

    Args:
        theirs: Address and port of that end.
        ours: Address and port of the other end.

    Returns:
        The user; None where the system does not list the connection.
    """
    for path in CONNECTIONS:
        if path.exists():
            user = user_in_listing(path.read_text(), theirs, ours)
            if user is not None:
                return user
    return None


def user_in_listing(listing: str, theirs: tuple[str, int], ours: tuple[str, int]) -> int | None:
    """Return the user of one established connection in a listing such as /proc/net/tcp.

    A port alone identifies no user: ports are reused as soon as the far end differs, and a closed connection
    stays in the list for a minute, under user 0.

    Args:
        listing: The listing.
        theirs: Address and port of one end.
        ours: Address and port of the other end.
    """
    wanted = {(_listing_address(*theirs), _listing_address(*ours))}
    if ":" not in theirs[0]:
        wanted.add(
            (
                _listing_address(f"::ffff:{theirs[0]}", theirs[1]),
                _listing_address(f"::ffff:{ours[0]}", ours[1]),
            )
        )
    for line in listing.splitlines()[1:]:
        _, local, remote, state, _, _, _, user, *_ = line.split()
        if (local, remote) in wanted and state == ESTABLISHED:
            return int(user)
    return None


def _listing_address(address: str, port: int) -> str:
    """Words of 4 bytes in the machine's order, as the kernel prints them."""
    packed = socket.inet_pton(socket.AF_INET6 if ":" in address else socket.AF_INET, address)
    words = struct.unpack(f"={len(packed) // 4}I", packed)
    return "".join(f"{word:08X}" for word in words) + f":{port:04X}"

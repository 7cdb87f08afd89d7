"""A serial port of any kind that pyserial knows: a device path, ``socket://``, ``rfc2217://``, …"""

from __future__ import annotations

import contextlib
import io
import os
import re
import select
import socket

import serial
from serial.tools import list_ports

from labhil.driver import FoundAddress
from labhil.errors import ConnectError

BAUD_RATE = 115200
"""Default baud rate of a rig."""
OWN_BAUD_RATE = re.compile(r"(/[^@]*|COM\d+)@(\d+)\Z")
WRITE_TIMEOUT = 1.0
CHUNK = 4096


class Port:
    """An open port for this process alone.

    Args:
        address: The port; it may end in a baud rate: ``/dev/ttyACM0@2000000``.
        baud_rate: Baud rate where the address has none.

    Raises:
        ConnectError: It cannot be opened.
    """

    def __init__(self, address: str, baud_rate: int = BAUD_RATE) -> None:
        self.address = address
        self._serial = _open(address, baud_rate)
        self._fd = _descriptor(self._serial)
        # pyserial closes a socket only while the other end is still there; see close()
        self._socket: socket.socket | None = getattr(self._serial, "_socket", None)
        if self._socket is not None:
            # a command must not wait for the acknowledgement of the one before
            self._socket.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)

    def receive(self, timeout: float) -> bytes:
        """Return received bytes, after waiting up to ``timeout`` s for the first; ConnectError on loss."""
        try:
            if self._fd is not None:
                ready, _, _ = select.select([self._fd], [], [], timeout)
                if ready and self._socket is not None:
                    return _read_socket(self._socket)
                return bytes(self._serial.read(CHUNK)) if ready else b""
            self._serial.timeout = timeout
            first = bytes(self._serial.read(1))
            self._serial.timeout = 0
            return first + bytes(self._serial.read(CHUNK)) if first else b""
        except (OSError, serial.SerialException) as error:
            raise ConnectError(f"{self.address}: the wire is gone: {error}") from error

    def send(self, data: bytes) -> None:
        """Send bytes, waiting at most ``WRITE_TIMEOUT`` s; ConnectError on loss."""
        try:
            self._serial.write(data)
        except (OSError, serial.SerialException) as error:
            raise ConnectError(f"{self.address}: nothing can be sent: {error}") from error

    def close(self) -> None:
        """Close the port in any state."""
        with contextlib.suppress(OSError, serial.SerialException):
            self._serial.close()
        if self._socket is not None:
            self._socket.close()


def _read_socket(connection: socket.socket) -> bytes:
    """Read once: pyserial reads on and discards the last bytes where the other end has closed."""
    data = connection.recv(CHUNK)
    if not data:
        raise ConnectionError("the other end has hung up")
    return data


def _open(address: str, baud_rate: int) -> serial.SerialBase:
    match = OWN_BAUD_RATE.match(address)
    try:
        port = serial.serial_for_url(
            match[1] if match else address,
            do_not_open=True,
            baudrate=int(match[2]) if match else baud_rate,
            timeout=0,
            write_timeout=WRITE_TIMEOUT,
            exclusive=True,
        )
        port.open()
    except (OSError, serial.SerialException, ValueError) as error:
        raise ConnectError(
            f"{address}: cannot be opened: {_reason(error, address)}; {_ports_here()}"
        ) from error
    return port


def _reason(error: Exception, address: str) -> str:
    """Return the reason of the operating system, without the text of pyserial around it."""
    number = getattr(error, "errno", None)
    if number is None and isinstance(error.__context__, OSError):
        number = error.__context__.errno
    if number is None:
        return str(error)
    if "lock" in str(error):
        return "another program has it open"
    return os.strerror(number).lower() + ("" if "://" in address else f" (error {number})")


def serial_ports() -> tuple[FoundAddress, ...]:
    """Return the serial ports of this machine, sorted by name; none is opened."""
    ports = sorted(list_ports.comports(), key=lambda port: port.device)
    return tuple(FoundAddress(port.device, f"serial port, {port.description}") for port in ports)


def _ports_here() -> str:
    names = [port.address for port in serial_ports()]
    return f"serial ports here: {', '.join(names)}" if names else "this machine has no serial port"


def _descriptor(port: serial.SerialBase) -> int | None:
    """Return the file descriptor to wait on; some ports of pyserial have none."""
    try:
        return int(port.fileno())
    except (AttributeError, io.UnsupportedOperation):
        return None

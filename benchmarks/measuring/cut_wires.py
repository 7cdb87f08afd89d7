"""Wires that can be cut, held up and disturbed, with a log of what the device sent: serial and a UR's."""

from __future__ import annotations

import contextlib
import errno
import os
import random
import select
import socket
import threading
import time
import tty
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from labhil.errors import LabhilError
from labhil.host_clock import unix_ns
from labhil.link import Decoder, Frame, Hello, MessageType, Samples, State, StateFlag, Unwrapper
from labhil.serial_rig.rig import Scaler, SerialRig
from labhil.signals import FloatArray, IntArray
from labhil_ur5.rtde import Receiver

TURN = 0.02
"""s; how often a wire looks for orders."""

NOTICED = 0.1
"""s; a twin takes a shorter absence for none."""

CLOSED = -1
"""The descriptor of a socket that is closed."""


@dataclass(frozen=True, slots=True)
class Sent:
    """What a device sent, a row a sample: Unix time (ns) when it came by, boot, number, clock, values."""

    t_ns: IntArray
    boot: IntArray
    number: IntArray
    t_hw_ns: IntArray
    safe: np.ndarray
    values: FloatArray


def joined(pieces: Sequence[Sent]) -> Sent:
    """Return pieces of a log as one."""
    columns = ("t_ns", "boot", "number", "t_hw_ns", "safe", "values")
    return Sent(*(np.concatenate([getattr(piece, name) for piece in pieces]) for name in columns))


class SerialWire:
    """A port of this machine with a cable to a twin; ``address`` is what a driver opens.

    The port is a pseudo terminal behind a link of the file system, as ``/dev/serial/by-id`` is. Bytes go
    through a thread of ours that knows what the twin sent, and drops, holds or disturbs them.
    """

    def __init__(self, twin: str, rig: SerialRig, place: Path, chance: random.Random) -> None:
        self.address = str(place)
        self.to_host = self.to_device = True
        self.hold = self.noise = False
        self.configured: list[int] = []
        """When a CONFIG reached the device, Unix ns."""
        self._twin_at, self._rig, self._place, self._chance = twin, rig, place, chance
        self._log: list[Sent] = []
        self._boots = 0
        self._held: list[tuple[bool, bytes]] = []
        self._lock = threading.RLock()
        self._port: int | None = None
        self._device: int | None = None
        self._over = threading.Event()
        self._thread = threading.Thread(target=self._run)
        self.power_up()
        self.plug_in()
        self._thread.start()

    def close(self) -> None:
        """End all."""
        self._over.set()
        self._thread.join()
        self.unplug()
        self.power_down()

    def sent(self) -> Sent:
        """What the device has sent so far."""
        with self._lock:
            return joined(self._log)

    # what may happen to it

    def plug_in(self) -> None:
        """Let the port be there."""
        ours, theirs = os.openpty()
        tty.setraw(theirs)
        os.set_blocking(ours, False)
        draft = self._place.with_name("draft")
        draft.symlink_to(os.ttyname(theirs))
        with self._lock:
            draft.replace(self._place)
            self._port = ours
        os.close(theirs)

    def unplug(self) -> None:
        """Take the port away, as an adapter that is pulled."""
        with self._lock:
            self._place.unlink(missing_ok=True)
            if self._port is not None:
                os.close(self._port)
            self._port = None
            self._held.clear()

    def power_up(self) -> None:
        """Let the device boot."""
        with self._lock:
            self._device = os.open(self._twin_at, os.O_RDWR | os.O_NOCTTY | os.O_NONBLOCK)
            tty.setraw(self._device)
            self._boots += 1
            self._to_device, self._from_device = Decoder(), Decoder()
            self._numbers = {MessageType.STATE: Unwrapper(16), MessageType.SAMPLES: Unwrapper(32)}
            self._clock = Unwrapper(32)
            self._hello: Hello | None = None

    def power_down(self) -> None:
        """Take the device's power; returns once it has noticed."""
        with self._lock:
            if self._device is not None:
                os.close(self._device)
            self._device = None
            self._held.clear()
        time.sleep(NOTICED)

    def release(self) -> None:
        """Deliver what was held."""
        with self._lock:
            self.hold = False
            held, self._held = self._held, []
            for to_host in (True, False):
                self._deliver(to_host, b"".join(data for side, data in held if side is to_host))

    # the thread

    def _run(self) -> None:
        while not self._over.is_set():
            with self._lock:
                ends = [end for end in (self._port, self._device) if end is not None]
            try:
                ready = select.select(ends, [], [], TURN)[0] if ends else []
            except (OSError, ValueError):
                continue
            if not ends:
                self._over.wait(TURN)
            with self._lock:
                for end in ready:
                    self._pass_on(end)
                if self.noise:
                    self._deliver(True, self._chance.randbytes(self._chance.randrange(1, 60)))
                    self._deliver(False, self._chance.randbytes(self._chance.randrange(1, 60)))

    def _pass_on(self, end: int) -> None:
        if end not in (self._port, self._device):
            return
        try:
            data = os.read(end, 4096)
        except OSError as error:
            if error.errno == errno.EIO:  # nobody has the port open
                self._over.wait(0.005)
            return
        from_device = end == self._device
        if from_device:
            self._note(self._from_device.feed(data))
        if not (self.to_host if from_device else self.to_device):
            return
        if self.hold:
            self._held.append((from_device, data))
        else:
            self._deliver(from_device, data)

    def _deliver(self, to_host: bool, data: bytes) -> None:
        end = self._port if to_host else self._device
        if not to_host and data:
            frames = self._to_device.feed(data)
            self.configured += [unix_ns() for frame in frames if frame.type == MessageType.CONFIG]
        if end is not None:
            with contextlib.suppress(OSError):
                os.write(end, data)

    def _note(self, frames: Sequence[Frame]) -> None:
        now = unix_ns()
        for frame in frames:
            if frame.type == MessageType.HELLO:
                self._hello = Hello.unpack(frame.payload)
                self._scaler = Scaler(self._rig, self._hello)
            elif self._hello is not None and frame.type == MessageType.STATE:
                state = State.unpack(frame.payload)
                self._add(frame, state.flags, frame.seq, np.array([state.raw], dtype=np.uint16), now)
            elif self._hello is not None and frame.type == MessageType.SAMPLES:
                some = Samples.unpack(frame.payload)
                self._add(frame, some.flags, some.first, some.raw, now)

    def _add(self, frame: Frame, flags: int, number: int, raw: np.ndarray, now: int) -> None:
        assert self._hello is not None
        count = np.arange(len(raw))
        period_ns = 1e9 / self._hello.sample_rate
        first = self._numbers[MessageType(frame.type)].unwrap(number)
        t_hw_ns = self._clock.unwrap(frame.t_us) * 1000 + np.rint(count * period_ns).astype(np.int64)
        same = np.ones(len(raw), dtype=np.int64)
        safe = np.full(len(raw), bool(flags & StateFlag.SAFE))
        values = self._scaler.values(raw)
        self._log.append(Sent(now * same, self._boots * same, first + count, t_hw_ns, safe, values))


class ArmWire:
    """The three ports of a UR controller at another address of this machine, with cables to a twin.

    What the controller sends is logged by a client of its own, straight from the twin.
    """

    PORTS = (30004, 30003, 29999)
    NAMES = ("timestamp", "actual_q", "target_qd")
    STILL = 1e-3

    def __init__(self, twin: str, address: str, rate: float) -> None:
        self.address, self.hold, self.noise = address, False, False
        self.configured: list[int] = []
        """When a client's list of variables reached the controller, Unix ns."""
        self._twin, self._rate = twin, rate
        self._pairs: list[tuple[socket.socket, socket.socket, int]] = []
        self._held: list[tuple[socket.socket, bytes]] = []
        self._doors: dict[int, socket.socket] = {}
        self._lock, self._over = threading.RLock(), threading.Event()
        self._log: list[Sent] = []
        self._boots = 0
        self._threads = [threading.Thread(target=self._run), threading.Thread(target=self._listen)]
        self.plug_in()
        for thread in self._threads:
            thread.start()

    def close(self) -> None:
        """End all."""
        self._over.set()
        for thread in self._threads:
            thread.join()
        self.unplug()

    def sent(self) -> Sent:
        """What the controller has sent so far; an arm is safe where it stands."""
        with self._lock:
            return joined(self._log)

    def plug_in(self) -> None:
        """Let the ports be there."""
        with self._lock:
            for port in self.PORTS:
                door = socket.create_server((self.address, port))
                door.setblocking(False)
                self._doors[port] = door

    def unplug(self) -> None:
        """Close all ports and connections."""
        with self._lock:
            for door in self._doors.values():
                door.close()
            self._doors.clear()
            self.hang_up(self.PORTS)

    def hang_up(self, ports: Sequence[int]) -> None:
        """Close the connections of these ports, which stay open for others."""
        with self._lock:
            for pair in self._pairs:
                if pair[2] in ports:
                    for end in pair[:2]:
                        end.close()
            self._pairs = [pair for pair in self._pairs if pair[2] not in ports]
            self._held.clear()

    def disturb(self, data: bytes) -> None:
        """Put bytes in between what clients of port 30004 receive."""
        with self._lock:
            for client, _twin, port in self._pairs:
                if port == self.PORTS[0]:
                    with contextlib.suppress(OSError):
                        client.sendall(data)

    def release(self) -> None:
        """Deliver what was held, as TCP does after a cable was out."""
        with self._lock:
            self.hold = False
            held, self._held = self._held, []
            for end, data in held:
                with contextlib.suppress(OSError):
                    end.sendall(data)

    def _run(self) -> None:
        while not self._over.is_set():
            with self._lock:
                # while it is held nobody gets in, either: the first packet is lost as all are
                doors = {} if self.hold else {door: port for port, door in self._doors.items()}
                ends = {end: pair for pair in self._pairs for end in pair[:2]}
            try:
                ready = select.select([*doors, *ends], [], [], TURN)[0]
            except (OSError, ValueError):
                continue
            with self._lock:
                for end in ready:
                    if end.fileno() == CLOSED:
                        continue
                    if end in doors:
                        self._let_in(end, doors[end])
                    elif ends[end] in self._pairs:
                        self._pass_on(end, ends[end])

    def _let_in(self, door: socket.socket, port: int) -> None:
        try:
            client = door.accept()[0]
        except OSError:
            return
        try:
            twin = socket.create_connection((self._twin, port), 1.0)
        except OSError:
            client.close()
            return
        for end in (client, twin):
            end.settimeout(1.0)
            end.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        self._pairs.append((client, twin, port))

    def _pass_on(self, end: socket.socket, pair: tuple[socket.socket, socket.socket, int]) -> None:
        client, twin, port = pair
        try:
            data = end.recv(1 << 16)
        except OSError:
            data = b""
        if not data:
            client.close()
            twin.close()
            self._pairs.remove(pair)
            return
        if end is client and port == self.PORTS[0] and len(data) > 2 and data[2] == ord("O"):
            self.configured.append(unix_ns())
        other = twin if end is client else client
        if self.hold:
            self._held.append((other, data))
            return
        with contextlib.suppress(OSError):
            other.sendall(data)

    def _listen(self) -> None:
        while not self._over.is_set():
            try:
                receiver = Receiver(self._twin, 1.0)
            except LabhilError:
                self._over.wait(0.1)
                continue
            with contextlib.suppress(LabhilError):
                self._boots += 1
                receiver.greet()
                recipe = receiver.start(self.NAMES, [], self._rate)
                while not self._over.is_set():
                    select.select([receiver], [], [], TURN)
                    packages = receiver.packages()
                    if packages:
                        self._note(np.array([recipe.unpack(package) for package in packages]))
            receiver.close()

    def _note(self, rows: FloatArray) -> None:
        same = np.ones(len(rows), dtype=np.int64)
        still = np.abs(rows[:, 7:]).max(axis=1) < self.STILL
        t_hw_ns = np.rint(rows[:, 0] * 1e9).astype(np.int64)
        number = np.rint(rows[:, 0] * self._rate).astype(np.int64)
        # waiting packages came when they were made, and not when this thread had time
        t_ns = unix_ns() * same - (t_hw_ns[-1] - t_hw_ns)
        with self._lock:
            self._log.append(Sent(t_ns, self._boots * same, number, t_hw_ns, still, rows[:, 1:7]))

"""The machine: cores, clock, timer, disk, serial ports, limits for real time."""

from __future__ import annotations

import os
import shutil
import statistics
import time
from collections.abc import Iterator
from pathlib import Path

from labhil.cores import cores
from labhil.doctor.finding import Finding, broken, fine, note

TIMER_RATE = 500.0
TIMER_SECONDS = 1.0
LATE = 1e-3
"""s; a tick that comes later than that is half a period late at 500 Hz."""

MANY_LATE = 0.01
SMALLEST_DISK = 16 * 1024**2
"""Bytes; with less the recorder ends a recording."""

LITTLE_DISK = 2 * 1024**3
CLOCKS = Path("/sys/devices/system/clocksource/clocksource0")
GOOD_CLOCKS = ("tsc", "arch_sys_counter", "kvm-clock", "hyperv_clocksource_tsc_page")
FEWEST_CORES = 2


def check_cores() -> Iterator[Finding]:
    """How many cores may be used, and how busy they are."""
    usable, load = cores(), os.getloadavg()[0]
    summary = f"{usable} for this process, load {load:.1f}"
    if usable < FEWEST_CORES:
        yield note("cores", summary, "record or fit, not both at once: one core has to do all of it")
    elif load > 2 * usable:
        yield note("cores", summary, "wait for other work to end before a run in real time")
    else:
        yield fine("cores", summary)


def check_clock() -> Iterator[Finding]:
    """What the kernel takes the time from, and how finely it counts."""
    tick = time.get_clock_info("monotonic").resolution
    name = _text(CLOCKS / "current_clocksource")
    summary = f"{name or 'unknown to this system'}, counts in {1e9 * tick:.0f} ns"
    if tick > 1e-5:
        yield broken(
            "clock", summary, "stamps need 10 µs or finer: choose another clock source in the kernel"
        )
    elif name and name not in GOOD_CLOCKS:
        available = _text(CLOCKS / "available_clocksource")
        yield note(
            "clock", summary, f"each stamp costs microseconds; tsc is cheaper (available: {available})"
        )
    else:
        yield fine("clock", summary)


def check_timer() -> Iterator[Finding]:
    """A loop of 500 Hz for a second: how late its ticks come."""
    period = 1.0 / TIMER_RATE
    late = []
    due = time.perf_counter() + period
    for _ in range(int(TIMER_SECONDS * TIMER_RATE)):
        time.sleep(max(0.0, due - time.perf_counter()))
        late.append(time.perf_counter() - due)
        due += period
    late.sort()
    share = sum(tick > LATE for tick in late) / len(late)
    median, high = 1e6 * statistics.median(late), 1e6 * late[int(0.99 * len(late))]
    worst = 1e6 * late[-1]
    summary = (
        f"{TIMER_RATE:g} Hz: late by {median:.0f} µs (median), {high:.0f} µs (99 %), {worst:.0f} µs at worst"
    )
    if share > MANY_LATE:
        yield note(
            "timer",
            f"{summary}; {100 * share:.1f} % of the ticks came more than 1 ms late",
            "end other work, or allow real-time priority (below); samples are stamped, so gaps are seen",
        )
    else:
        yield fine("timer", summary)


def check_disk(folder: Path) -> Iterator[Finding]:
    """Whether recordings can be written here, and for how long."""
    probe = folder / f".labhil-doctor-{os.getpid()}"
    try:
        probe.write_bytes(b"x")
        begun = time.perf_counter()
        with probe.open("ab") as file:
            os.fsync(file.fileno())
        took = time.perf_counter() - begun
        probe.unlink()
    except OSError as error:
        yield broken(
            "disk",
            f"{folder.resolve()}: {error.strerror}",
            "go to a folder that can be written, or use --out",
        )
        return
    free = shutil.disk_usage(folder).free
    summary = f"{free / 1e9:.1f} GB free in {folder.resolve()}, a forced write took {1e3 * took:.1f} ms"
    if free < SMALLEST_DISK:
        yield broken("disk", summary, "make room: the recorder ends a recording with less than 16 MB left")
    elif free < LITTLE_DISK:
        yield note("disk", summary, "make room before long recordings (500 Hz of an arm: about 1 GB an hour)")
    else:
        yield fine("disk", summary)


def check_serial() -> Iterator[Finding]:
    """Which serial ports are there, and whether this user may open them."""
    from serial.tools.list_ports import comports

    ports = sorted(comports())
    if not ports:
        yield note("serial ports", "none found", "plug the device in; without one there are the twins")
        return
    for port in ports:
        about = f"{port.device} ({port.description})"
        if os.access(port.device, os.R_OK | os.W_OK):
            yield fine("serial ports", about)
        else:
            yield broken("serial ports", f"{about}: no permission", _serial_advice(port.device))


def _serial_advice(device: str) -> str:
    import grp
    import stat

    try:
        status = Path(device).stat()
        group = grp.getgrgid(status.st_gid).gr_name
    except (OSError, KeyError):
        return "ask who administers this machine for access to it"
    if status.st_mode & stat.S_IWGRP and group != "root":
        return f"sudo usermod -aG {group} $USER, then log in again"
    return f"add a udev rule that gives {device} to the group dialout, then plug it in again"


def check_real_time() -> Iterator[Finding]:
    """Whether a control thread may ask for priority and keep its memory."""
    try:
        import resource

        priority = resource.getrlimit(resource.RLIMIT_RTPRIO)[0]
        locked = resource.getrlimit(resource.RLIMIT_MEMLOCK)[0]
    except (ImportError, AttributeError):
        yield note("real time", "this system does not say", "")
        return
    kernel = "a PREEMPT_RT kernel" if _text(Path("/sys/kernel/realtime")) == "1" else "an ordinary kernel"
    memory = "unlimited" if locked == resource.RLIM_INFINITY else f"{locked // 1024} kB"
    allowed = "any" if priority == resource.RLIM_INFINITY else str(priority)
    summary = f"{kernel}; priority {allowed}, locked memory {memory}"
    if priority == 0 and os.geteuid() != 0:
        advice = "not needed; for less jitter: '@labhil - rtprio 80' in /etc/security/limits.d/labhil.conf"
        yield note("real time", summary, advice)
    else:
        yield fine("real time", summary)


def _text(path: Path) -> str:
    try:
        return path.read_text(encoding="ascii").strip()
    except (OSError, UnicodeDecodeError):
        return ""

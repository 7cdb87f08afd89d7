"""Checks of the machine: cores, clock, timer, disk, serial ports, and limits for real time."""

from __future__ import annotations

import os
import shutil
import statistics
import time
from collections.abc import Iterator
from pathlib import Path

from labhil.cores import cores
from labhil.doctor.finding import Finding, broken, fine, note

CLOCKS = Path("/sys/devices/system/clocksource/clocksource0")
GOOD_CLOCKS = ("tsc", "arch_sys_counter", "kvm-clock", "hyperv_clocksource_tsc_page")
"""Clock sources of Linux that are read without a system call."""


def check_cores(*, min_cores: int = 2) -> Iterator[Finding]:
    """Check the number of cores (at least ``min_cores``) and their load."""
    usable, load = cores(), os.getloadavg()[0]
    summary = f"{usable} for this process, load {load:.1f}"
    if usable < min_cores:
        yield note("cores", summary, "record or fit, not both at once: one core has to do all of it")
    elif load > 2 * usable:
        yield note("cores", summary, "wait for other work to end before a run in real time")
    else:
        yield fine("cores", summary)


def check_clock(*, max_resolution: float = 1e-5) -> Iterator[Finding]:
    """Check the clock source of the kernel and its resolution (at most ``max_resolution`` s)."""
    resolution = time.get_clock_info("monotonic").resolution
    name = _read_text(CLOCKS / "current_clocksource")
    summary = f"{name or 'unknown to this system'}, counts in {1e9 * resolution:.0f} ns"
    if resolution > max_resolution:
        yield broken(
            "clock", summary, "stamps need 10 µs or finer: choose another clock source in the kernel"
        )
    elif name and name not in GOOD_CLOCKS:
        available = _read_text(CLOCKS / "available_clocksource")
        yield note(
            "clock", summary, f"each stamp costs microseconds; tsc is cheaper (available: {available})"
        )
    else:
        yield fine("clock", summary)


def check_timer(
    *, rate: float = 500.0, duration: float = 1.0, max_delay: float = 1e-3, max_share: float = 0.01
) -> Iterator[Finding]:
    """Measure the delays of a periodic loop.

    Args:
        rate: Rate of the loop, Hz.
        duration: Duration, s.
        max_delay: Delay from which a tick is late, s; the default is half a period at 500 Hz.
        max_share: Share of late ticks at most.
    """
    period = 1.0 / rate
    delays = []
    due = time.perf_counter() + period
    for _ in range(int(duration * rate)):
        time.sleep(max(0.0, due - time.perf_counter()))
        delays.append(time.perf_counter() - due)
        due += period
    delays.sort()
    share = sum(delay > max_delay for delay in delays) / len(delays)
    median, high = 1e6 * statistics.median(delays), 1e6 * delays[int(0.99 * len(delays))]
    worst = 1e6 * delays[-1]
    summary = f"{rate:g} Hz: late by {median:.0f} µs (median), {high:.0f} µs (99 %), {worst:.0f} µs at worst"
    if share > max_share:
        yield note(
            "timer",
            f"{summary}; {100 * share:.1f} % of the ticks came more than 1 ms late",
            "end other work, or allow real-time priority (below); samples are stamped, so gaps are seen",
        )
    else:
        yield fine("timer", summary)


def check_disk(
    folder: Path, *, min_free: int = 16 * 1024**2, low_free: int = 2 * 1024**3
) -> Iterator[Finding]:
    """Check that recordings can be written, and the free space.

    Args:
        folder: Where recordings would go.
        min_free: Free bytes below which the recorder ends a recording.
        low_free: Free bytes that do for short recordings only.
    """
    probe = folder / f".labhil-doctor-{os.getpid()}"
    try:
        probe.write_bytes(b"x")
        start = time.perf_counter()
        with probe.open("ab") as file:
            os.fsync(file.fileno())
        elapsed = time.perf_counter() - start
        probe.unlink()
    except OSError as error:
        yield broken(
            "disk",
            f"{folder.resolve()}: {error.strerror}",
            "go to a folder that can be written, or use --out",
        )
        return
    free = shutil.disk_usage(folder).free
    summary = f"{free / 1e9:.1f} GB free in {folder.resolve()}, a forced write took {1e3 * elapsed:.1f} ms"
    if free < min_free:
        yield broken("disk", summary, "make room: the recorder ends a recording with less than 16 MB left")
    elif free < low_free:
        yield note("disk", summary, "make room before long recordings (500 Hz of an arm: about 1 GB an hour)")
    else:
        yield fine("disk", summary)


def check_serial() -> Iterator[Finding]:
    """List the serial ports, and check that this user may open them."""
    from serial.tools.list_ports import comports

    ports = sorted(comports())
    if not ports:
        yield note("serial ports", "none found", "plug the device in; without one there are the twins")
        return
    for port in ports:
        description = f"{port.device} ({port.description})"
        if os.access(port.device, os.R_OK | os.W_OK):
            yield fine("serial ports", description)
        else:
            yield broken("serial ports", f"{description}: no permission", _serial_advice(port.device))


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
    """Check whether a control thread may have real-time priority and lock its memory."""
    try:
        import resource

        priority = resource.getrlimit(resource.RLIMIT_RTPRIO)[0]
        locked = resource.getrlimit(resource.RLIMIT_MEMLOCK)[0]
    except (ImportError, AttributeError):
        yield note("real time", "this system does not say", "")
        return
    is_real_time = _read_text(Path("/sys/kernel/realtime")) == "1"
    kernel = "a PREEMPT_RT kernel" if is_real_time else "an ordinary kernel"
    memory = "unlimited" if locked == resource.RLIM_INFINITY else f"{locked // 1024} kB"
    allowed = "any" if priority == resource.RLIM_INFINITY else str(priority)
    summary = f"{kernel}; priority {allowed}, locked memory {memory}"
    if priority == 0 and os.geteuid() != 0:
        advice = "not needed; for less jitter: '@labhil - rtprio 80' in /etc/security/limits.d/labhil.conf"
        yield note("real time", summary, advice)
    else:
        yield fine("real time", summary)


def _read_text(path: Path) -> str:
    try:
        return path.read_text(encoding="ascii").strip()
    except (OSError, UnicodeDecodeError):
        return ""

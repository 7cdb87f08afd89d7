"""Checks of Python and of the installed packages against the declared ones."""

from __future__ import annotations

import platform
import re
import sys
from collections.abc import Iterator
from importlib.metadata import PackageNotFoundError, distribution, requires, version

from labhil.doctor.finding import Finding, State, broken, fine, note
from labhil.errors import installed_as

MIN_PYTHON = (3, 11)
SUMS = ("all", "test")
"""Extras that consist of others, or are only for contributors."""

_REQUIREMENT = re.compile(r"\s*([A-Za-z0-9._-]+)\s*(?:\[[^]]*\])?\s*([^;]*)(?:;\s*(.*))?")
_EXTRA = re.compile(r"extra\s*==\s*['\"]([^'\"]+)['\"]")
_MACHINE = re.compile(r"(sys_platform|platform_machine)\s*==\s*['\"]([^'\"]+)['\"]")
_PYTHON = re.compile(r"python_version\s*(<)\s*['\"]([0-9.]+)['\"]")
_BOUND = re.compile(r"(>=|==|>|<=|<|!=|~=)\s*([0-9][0-9A-Za-z.]*)")


def check_python() -> Iterator[Finding]:
    """Check the version of Python."""
    interpreter = f"{platform.python_implementation()} {platform.python_version()} at {sys.executable}"
    oldest = ".".join(map(str, MIN_PYTHON))
    if sys.version_info < MIN_PYTHON:
        yield broken(
            "python", f"{interpreter}, expected {oldest} or newer", f"install Python {oldest} or newer"
        )
    else:
        yield fine("python", f"{interpreter} on {platform.platform()}")


def check_packages() -> Iterator[Finding]:
    """Check that each declared package is installed in a declared version; extras by their names."""
    name = installed_as()
    try:
        declared = requires(name) or []
    except PackageNotFoundError:
        yield broken(
            "labhil",
            "runs from source without being installed: its drivers, twins and versions are not registered",
            "pip install .",
        )
        return
    yield fine("labhil", f"{name} {version(name)} at {distribution(name).locate_file('')}")
    needed: list[Finding] = []
    extras: dict[str, list[Finding]] = {}
    for requirement in declared:
        if not _applies_here(requirement):
            continue
        finding, extra = check_requirement(requirement)
        (extras.setdefault(extra, []) if extra else needed).append(finding)
    yield from (finding for finding in needed if finding.state is State.BROKEN)
    good = [f"{finding.subject} {finding.found}" for finding in needed if finding.state is State.FINE]
    yield fine("packages", f"{len(good)} as declared: {', '.join(good)}")
    extras = {extra: findings for extra, findings in extras.items() if extra not in SUMS}
    for extra, findings in sorted(extras.items()):
        missing = [finding for finding in findings if finding.state is not State.FINE]
        if missing:
            summary = ", ".join(f"{finding.subject} {finding.found}" for finding in missing)
            yield note(f"extra {extra}", summary, f"pip install '{name}[{extra}]'")
        else:
            names = ", ".join(f"{finding.subject} {finding.found}" for finding in findings)
            yield fine(f"extra {extra}", names)


def check_requirement(requirement: str) -> tuple[Finding, str]:
    """Check one declared requirement; returns the finding and the extra that it belongs to ("" for none)."""
    match = _REQUIREMENT.match(requirement)
    assert match is not None, requirement
    name, bounds, marker = match.group(1), match.group(2).strip(), match.group(3) or ""
    extra = _EXTRA.search(marker)
    try:
        installed = version(name)
    except PackageNotFoundError:
        finding = broken(
            name, f"is not installed (expected {bounds or 'any version'})", f"pip install '{name}{bounds}'"
        )
        return finding, extra.group(1) if extra else ""
    unmet = [f"{sign}{bound}" for sign, bound in _BOUND.findall(bounds) if not _meets(installed, sign, bound)]
    if unmet:
        finding = broken(name, f"{installed}, expected {','.join(unmet)}", f"pip install '{name}{bounds}'")
    else:
        finding = fine(name, installed)
    return finding, extra.group(1) if extra else ""


def _applies_here(requirement: str) -> bool:
    """Return whether a requirement is for this system, processor and version of Python."""
    here = {"sys_platform": sys.platform, "platform_machine": platform.machine()}
    python = f"{sys.version_info.major}.{sys.version_info.minor}"
    return all(here[what] == wanted for what, wanted in _MACHINE.findall(requirement)) and all(
        _meets(python, sign, bound) for sign, bound in _PYTHON.findall(requirement)
    )


def _meets(installed: str, sign: str, bound: str) -> bool:
    have, want = _numbers(installed), _numbers(bound)
    length = max(len(have), len(want))
    have, want = have + (0,) * (length - len(have)), want + (0,) * (length - len(want))
    return {
        ">=": have >= want,
        "~=": have >= want,
        ">": have > want,
        "<=": have <= want,
        "<": have < want,
        "==": have == want,
        "!=": have != want,
    }[sign]


def _numbers(text: str) -> tuple[int, ...]:
    """Return the release numbers of a version: (1, 10, 0) of 1.10.0rc1."""
    leading = re.match(r"[0-9]+(?:\.[0-9]+)*", text)
    return tuple(int(part) for part in leading.group().split(".")) if leading else (0,)

"""Which calls of the unmodified client work on the simulated controller, version by version. A command:

    python benchmarks/measuring/measure_ur5_calls.py --versions 3.15.8 -o benchmarks/results/ur5_calls.json

Every check of ``tests/wire/ur5_calls.py`` runs in a process of its own, which is killed after ``LIMIT`` s:
the client can hang or take its interpreter along. Each version of the controller is a twin of its own. Which
of the client's public methods the checks call is read from their text. The twin gets real-time priority where
that is allowed: a controller is a machine of its own.
"""

from __future__ import annotations

import argparse
import ast
import json
import os
import subprocess
import sys
import time
from contextlib import suppress
from importlib.metadata import version
from pathlib import Path
from typing import Any

from labhil.service.child import Child

HOST = "127.77.0.3"
LIMIT = 90.0
"""s that one check may take."""
START = 120.0
CALLS = Path(__file__).parents[2] / "tests/wire/ur5_calls.py"
INTERFACES = {
    "rtde_control": "RTDEControlInterface",
    "rtde_receive": "RTDEReceiveInterface",
    "rtde_io": "RTDEIOInterface",
    "dashboard_client": "DashboardClient",
}


def checks() -> list[str]:
    """Names of all checks, in the order of the file."""
    tree = ast.parse(CALLS.read_text())
    functions = (node for node in tree.body if isinstance(node, ast.FunctionDef))
    return [node.name for node in functions if any(ast.unparse(d) == "check" for d in node.decorator_list)]


def since() -> dict[str, tuple[int, int]]:
    """From which version on a check can be made; read, for without a controller it cannot be imported."""
    for node in ast.parse(CALLS.read_text()).body:
        if isinstance(node, ast.Assign) and ast.unparse(node.targets[0]) == "SINCE":
            versions: dict[str, tuple[int, int]] = ast.literal_eval(node.value)
            return versions
    raise SystemExit(f"{CALLS}: expected a dictionary SINCE, found none")


def coverage() -> dict[str, Any]:
    """The public methods of each interface, by whether the checks name them."""
    named = {node.attr for node in ast.walk(ast.parse(CALLS.read_text())) if isinstance(node, ast.Attribute)}
    by_interface = {}
    for module, name in INTERFACES.items():
        methods = {method for method in dir(getattr(__import__(module), name)) if method[0].islower()}
        by_interface[name] = {"called": sorted(methods & named), "not_called": sorted(methods - named)}
    return by_interface


def outcome(check: str) -> tuple[str, float]:
    """What one check came to, and how long it took, s."""
    began = time.monotonic()
    try:
        done = subprocess.run(
            [sys.executable, CALLS, HOST, check], capture_output=True, text=True, timeout=LIMIT, check=False
        )
    except subprocess.TimeoutExpired:
        return f"killed after {LIMIT:g} s", LIMIT
    output = done.stdout.strip().removeprefix(f"{check}: ")
    if done.returncode != 0 and output in {"", "ok"}:
        output = f"{output} exit status {done.returncode} {done.stderr.strip()[-200:]}".strip()
    return output, round(time.monotonic() - began, 1)


def of_version(series: str) -> dict[str, Any]:
    """All checks that this version of the controller is up to."""
    numbers = tuple(int(part) for part in series.split(".")[:2])
    command = [sys.executable, "-P", "-m", "labhil", "twin", "ur5", "--host", HOST, "--series", series]
    results, needs = {}, since()
    with Child("the twin", [*command, "--set", "unlock_after=0.3"]) as twin:
        if twin.line(START) != HOST:
            raise SystemExit(f"the twin did not start{twin.last_error()}")
        with suppress(PermissionError):
            os.sched_setscheduler(twin.pid, os.SCHED_FIFO, os.sched_param(1))
        for check in checks():
            if numbers >= needs.get(check, (0, 0)):
                verdict, seconds = outcome(check)
                results[check] = {"outcome": verdict, "seconds": seconds}
                print(f"{series} {check}: {verdict} ({seconds} s)", file=sys.stderr, flush=True)
    good = sum(result["outcome"] == "ok" for result in results.values())
    return {"ok": good, "of": len(results), "checks": results}


def main() -> None:
    parser = argparse.ArgumentParser()
    parser.add_argument("--versions", nargs="+", default=["3.15.8", "5.11.1"])
    parser.add_argument("-o", "--out", type=Path)
    options = parser.parse_args()
    report = {
        "schema": "labhil.ur5_calls/1",
        "client": version("ur_rtde"),
        "limit_s": LIMIT,
        "methods": coverage(),
        "versions": {},
    }
    for series in options.versions:
        report["versions"][series] = of_version(series)
        report["load_average"] = round(os.getloadavg()[0], 1)
        if options.out is not None:
            options.out.write_text(json.dumps(report, indent=1) + "\n", encoding="utf-8")
    if options.out is None:
        print(json.dumps(report, indent=1))


if __name__ == "__main__":
    main()

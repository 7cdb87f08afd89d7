"""A list of every place where a thread begins, each with the test that lets it die."""

from __future__ import annotations

import ast
from collections.abc import Iterator
from pathlib import Path

ROOT = Path(__file__).parents[2]
ROOMS = ("labhil/bus", "labhil/campaign", "labhil/experiment", "labhil/service", "labhil/tui", "drivers")
"""What moves devices, records them or shows them; a thread of an analysis ends with it."""

STARTERS = {"SupervisedThread", "Thread", "ThreadPoolExecutor", "Timer", "run_worker", "work_in_background"}

BUS, SCREEN = "tests/bus/test_dead_threads.py", "tests/tui/test_dead_threads.py"
HOST, SERVE = "tests/run/test_dead_threads_of_a_host.py", "tests/run/test_dead_threads_of_a_lab.py"
BACKGROUND = (SCREEN, "test_work_in_the_background_that_raises_is_shown")

STRUCK = {
    "drivers/labhil_ur5/discovery.py find_controllers": (
        "tests/wire/test_ur5_discovery.py",
        "test_a_thread_that_dies_is_heard_of",
    ),
    "labhil/bus/ask.py Responder": (BUS, "test_one_that_answers"),
    "labhil/bus/publish.py StreamPublisher": (BUS, "test_one_that_publishes_keeps_nobody_waiting"),
    "labhil/bus/subscribe.py Subscription": (BUS, "test_one_that_listens"),
    "labhil/campaign/lab.py serve_lab": (SERVE, "test_a_lab_ends_with_what_its_worker_raised"),
    "labhil/campaign/studies/process.py Helper": (SCREEN, "test_a_process_that_is_not_heard_is_ended"),
    "labhil/campaign/studies/process.py read_further_lines": (
        SCREEN,
        "test_a_process_that_hears_nothing_ends",
    ),
    "labhil/experiment/devices.py run_concurrently": (
        BUS,
        "test_one_that_stops_a_device_keeps_no_other_from_it",
    ),
    "labhil/experiment/hooks.py Hook": (
        "tests/run/test_when_and_checks.py",
        "test_a_hook_that_raises_before_the_steps_ends_the_run_before_anything_moves",
    ),
    "labhil/service/child.py Child": (BUS, "test_one_that_reads_what_a_child_says"),
    "labhil/service/gateway.py Gateway": (BUS, "test_one_that_answers_guests"),
    "labhil/service/reconnect.py Search": (BUS, "test_one_that_looks_for_a_device"),
    "labhil/service/recorder.py Recorder": (
        "tests/run/test_strangers.py",
        "test_a_thread_that_dies_ends_the_run",
    ),
    "labhil/service/replay.py Replay": (SCREEN, "test_a_replay_says_what_ended_it"),
    "labhil/tui/background.py work_in_background": BACKGROUND,
    "labhil/tui/shutdown.py end_in_order": (SCREEN, "test_a_page_ends_where_its_server_is_watched_no_more"),
    "labhil/tui/session.py Session": (SCREEN, "test_a_view_that_is_out_of_date_says_so"),
    "labhil/tui/live.py LivePane": BACKGROUND,
    "labhil/tui/recording.py RecordingScreen": BACKGROUND,
    "labhil/tui/recordings_overlay.py RecordingsOverlay": BACKGROUND,
    "labhil/tui/shadow.py ShadowView": BACKGROUND,
    "labhil/tui/library_reader.py LibraryReader": BACKGROUND,
    "labhil/tui/emergency_stop.py EmergencyStop": (SCREEN, "test_an_emergency_stop_that_fails_says_so"),
    "labhil/tui/bus_watch.py BusWatch": (SCREEN, "test_a_view_that_is_out_of_date_says_so"),
}

BEST_EFFORT = {
    # stops the program a second way, beside the controller's own watchdog
    "drivers/labhil_ur5/motion.py Motion",
    # ends the process with the screen's own task group: Textual reports it
    "labhil/tui/palette.py",
}


def starts() -> Iterator[str]:
    """Where threads begin: the file, and the class or function at its top level."""
    for room in ROOMS:
        for path in sorted((ROOT / room).rglob("*.py")):
            for statement in ast.parse(path.read_text(encoding="utf-8")).body:
                for node in ast.walk(statement):
                    if isinstance(node, ast.Call) and _name(node.func) in STARTERS:
                        name = getattr(statement, "name", "")
                        yield f"{path.relative_to(ROOT)} {name}".strip()


def _name(called: ast.expr) -> str:
    return called.attr if isinstance(called, ast.Attribute) else getattr(called, "id", "")


def test_each_thread_is_struck_by_a_test() -> None:
    assert set(starts()) - BEST_EFFORT == set(STRUCK)
    for file, test in STRUCK.values():
        assert f"def {test}(" in (ROOT / file).read_text(encoding="utf-8"), f"{file} has no {test}"

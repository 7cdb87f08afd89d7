"""A recording of a run with many cuts, compared with what the wire sent; see ``measure_cuts.py``."""

from __future__ import annotations

import statistics
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from cut_kinds import Cut, Scene
from cut_wires import Sent
from labhil.recording.reader import read_recording
from labhil.recording.recording import Recording, StreamData
from labhil.signals import IntArray

FRESH = 0.25
"""s; a sample that is stamped later than this after the device sent it is an old one."""

FRESH_ARM = 0.3
MEASURED = {"ball_beam": "ball_position", "solenoid": "plunger_position", "ur5": "actual_q"}
PROBED = 300
UNCUT = ("noise", "device boots", "RTDE connections closed")
"""During these the device may hear its host."""

WRONG, UNKNOWN = -1, -2
"""Rows of samples that were sent otherwise, and of those whose number the log does not hold."""


@dataclass(frozen=True, slots=True)
class Matched:
    """The samples of a recording, and which of those sent each is: a row, ``WRONG`` or ``UNKNOWN``."""

    stream: StreamData
    rows: IntArray
    connections: IntArray


def match(
    stream: StreamData, values: np.ndarray, sent: Sent, seams_ns: Sequence[int], reach: float
) -> Matched:
    """Find each recorded sample among those that were sent.

    Within one connection number and clock of both differ by constants, and all values are equal. Connections
    begin at ``seams_ns``. ``reach`` (s) is how long before its stamp the first sample may have been sent.
    """
    connection = np.searchsorted(np.array(seams_ns, dtype=np.int64), stream.t_acq_ns, side="right")
    rows = rows_of(stream, values, sent, connection, reach)
    # a sample may bear a time shortly before its connection was announced: the newest that came with it
    late = (rows < 0) & (np.append(np.diff(connection), 0) > 0)
    while late.any():
        connection[late] += 1
        again = rows_of(stream, values, sent, connection, reach)
        late = (again < 0) & (rows < 0) & (np.append(np.diff(connection), 0) > 0) & ~late
        rows = again
    return Matched(stream, rows, connection)


def rows_of(
    stream: StreamData, values: np.ndarray, sent: Sent, connection: IntArray, reach: float
) -> IntArray:
    """Which row each recorded sample is, connection by connection."""
    rows = np.full(len(stream.seq), UNKNOWN)
    for number in np.unique(connection):
        here = np.flatnonzero(connection == number)
        first = int(here[0])
        near = np.abs(sent.t_ns - stream.t_acq_ns[first]) < reach * 1e9
        candidates = np.flatnonzero(near & (sent.values == values[first]).all(axis=1))
        # what stands still looks alike for long: a few hundred of the samples tell, the nearest in time first
        candidates = candidates[np.argsort(np.abs(sent.t_ns[candidates] - stream.t_acq_ns[first]))]
        some = here[:: max(len(here) // PROBED, 1)]
        best, best_count = -1, 0
        for candidate in candidates.tolist():
            count = np.count_nonzero(rows_from(stream, values, sent, some, candidate) >= 0)
            if count > best_count:
                best, best_count = candidate, count
            if best_count == len(some):
                break
        if best_count:
            rows[here] = rows_from(stream, values, sent, here, best)
    return rows


def rows_from(stream: StreamData, values: np.ndarray, sent: Sent, here: IntArray, candidate: int) -> IntArray:
    """Which row each sample of a connection is, if its first one is ``candidate``."""
    same_boot = np.flatnonzero(sent.boot == sent.boot[candidate])
    numbers = stream.seq[here] - stream.seq[here[0]] + sent.number[candidate]
    places = np.minimum(np.searchsorted(sent.number[same_boot], numbers), len(same_boot) - 1)
    found = same_boot[places]
    clock = stream.t_hw_ns[here] - stream.t_hw_ns[here[0]] + sent.t_hw_ns[candidate]
    good = (sent.number[found] == numbers) & (np.abs(sent.t_hw_ns[found] - clock) <= 1000)
    good &= (sent.values[found] == values[here]).all(axis=1)
    return np.where(sent.number[found] != numbers, UNKNOWN, np.where(good, found, WRONG))


def examine(scene: Scene, ending: str) -> dict[str, Any]:
    """Hold the recording against what was sent."""
    (path,) = scene.folder.glob("*.mcap")
    recording = read_recording(path)
    stream, sent = recording.stream_with(MEASURED[scene.rig]), scene.wire.sent()
    values = stream["actual_q"] if scene.rig == "ur5" else stream.values[:, : sent.values.shape[1]]
    seams = [
        event.t_ns
        for event in recording.events
        if event.body.get("kind") == "reconnected" and "configuration sent again" in event.body["message"]
    ]
    matched = match(stream, values, sent, seams, 3.0)
    known = matched.rows >= 0
    age = np.zeros(len(known))
    age[known] = (stream.t_acq_ns[known] - sent.t_ns[matched.rows[known]]) * 1e-9
    fresh = FRESH_ARM if scene.rig == "ur5" else FRESH
    result: dict[str, Any] = {
        "cuts": len(scene.cuts),
        "end": ending,
        "recorded": len(stream.seq),
        "not_sent_so": int(np.count_nonzero(matched.rows == WRONG)),
        "not_in_the_log": int(np.count_nonzero(matched.rows == UNKNOWN)),
        "out_of_order": int(
            np.count_nonzero(np.diff(stream.seq) <= 0)
            + np.count_nonzero(np.diff(stream.t_hw_ns) <= 0)
            + np.count_nonzero(np.diff(stream.t_acq_ns) < 0)
            + np.count_nonzero(np.diff(matched.rows[known]) <= 0)
        ),
        "old_as_new": int(np.count_nonzero(age > fresh)),
        "oldest_ms": round(1e3 * float(age.max()), 1),
        "old_after": old_after(scene, stream, age > fresh),
        "connections": len(seams) + 1,
        "configurations": len(scene.wire.configured),
        **gaps(scene, recording, matched, sent),
        **safety(scene, recording, sent),
    }
    result["kinds"] = {
        kind: times([cut for cut in scene.cuts if cut.kind == kind], scene, matched, sent)
        for kind in dict.fromkeys(cut.kind for cut in scene.cuts)
    }
    result["all"] = times(scene.cuts, scene, matched, sent)
    return result


def old_after(scene: Scene, stream: StreamData, old: np.ndarray) -> dict[str, int]:
    """How many old samples came during or right after which kind of cut, or at other times."""
    counts: dict[str, int] = {}
    for t_ns in stream.t_acq_ns[old].tolist():
        kind = next(
            (c.kind for c in scene.cuts if c.began_ns <= t_ns <= c.returned_ns + 500_000_000), "no cut"
        )
        counts[kind] = counts.get(kind, 0) + 1
    return counts


def times(cuts: Sequence[Cut], scene: Scene, matched: Matched, sent: Sent) -> dict[str, Any]:
    """From the return of the cable to the first fresh sample on the bus, and until the run went on, ms."""
    known = np.flatnonzero(matched.rows >= 0)
    sent_at = sent.t_ns[matched.rows[known]]
    to_fresh, to_steps = [], []
    for cut in cuts:
        after = known[np.flatnonzero(sent_at >= cut.returned_ns)]
        arrivals = (scene.heard.arrived.get(int(matched.stream.seq[row])) for row in after[:50])
        arrival = next((arrival for arrival in arrivals if arrival is not None), None)
        if arrival is not None:
            to_fresh.append((arrival - cut.returned_ns) * 1e-6)
        if cut.goes_on_ns is not None:
            to_steps.append(max(cut.goes_on_ns - cut.returned_ns, 0) * 1e-6)
    return {
        "cuts": len(cuts),
        "never_back": len(cuts) - len(to_fresh),
        "fresh_sample_ms": spread(to_fresh),
        "steps_go_on_ms": spread(to_steps),
    }


def spread(ms: Sequence[float]) -> dict[str, float] | None:
    """The median and the largest."""
    return {"median": round(statistics.median(ms), 1), "largest": round(max(ms), 1)} if ms else None


def gaps(scene: Scene, recording: Recording, matched: Matched, sent: Sent) -> dict[str, Any]:
    """Whether what is missing is marked: by holes in ``seq`` as long as it, and by events."""
    stream, rows = matched.stream, matched.rows
    rate = stream.stream.rate
    both = (rows[1:] >= 0) & (rows[:-1] >= 0)
    away = (sent.t_ns[rows[1:]] - sent.t_ns[rows[:-1]]) * 1e-9
    hole = np.diff(stream.seq) / rate
    # within a connection the numbers agree already; between two the hole is measured by the host's clock
    seam = both & (np.diff(matched.connections) > 0)
    events = [(event.t_ns, event.body.get("kind")) for event in recording.events]
    unmarked = []
    for cut in scene.cuts:
        low, high = cut.began_ns - 20_000_000, (cut.goes_on_ns or cut.returned_ns) + 500_000_000
        inside = (stream.t_acq_ns[1:] > low) & (stream.t_acq_ns[1:] < high) & both
        missing = inside & ((np.diff(sent.number[rows]) > 1) | (np.diff(sent.boot[rows]) > 0))
        is_marked = bool((np.diff(stream.seq)[missing] > 1).all())
        # a device that hears nothing makes itself safe, though its samples come in
        unheard = cut.kind == "line to the device dead" and cut.returned_ns - cut.began_ns > 0.35e9
        stated = {kind for t_ns, kind in events if low < t_ns < high}
        lost = unheard or bool(missing.any() and away[missing].max() > 0.35)
        if (
            not is_marked
            or (lost and not stated & {"lost", "quiet", "reconnected"})
            or (stated & {"lost"} and "reconnected" not in stated)
        ):
            unmarked.append(f"{cut.kind}: {sorted(map(str, stated - {None}))}")
    errors = np.abs(hole - away)[seam]
    return {
        "missing": int(np.sum(np.diff(stream.seq) - 1)),
        "cuts_not_marked": unmarked,
        "worst_hole_error_ms": round(1e3 * float(errors.max()), 1) if len(errors) else None,
    }


def safety(scene: Scene, recording: Recording, sent: Sent) -> dict[str, Any]:
    """How long after a cut a device was last not safe, before the run said that it goes on."""
    running = [e.t_ns for e in recording.events if e.device == "run" and e.body.get("kind") == "running"]
    after_ms = []
    for cut in scene.cuts:
        if cut.kind in UNCUT:
            continue
        until = min((t_ns for t_ns in running if t_ns >= cut.returned_ns), default=cut.returned_ns)
        if cut.goes_on_ns is None or until > cut.goes_on_ns + 10**9:
            until = cut.returned_ns  # it ended before anybody noticed
        during = (sent.t_ns > cut.began_ns) & (sent.t_ns < until)
        active = sent.t_ns[during & ~sent.safe]
        if sent.safe[during].any():
            after_ms.append((int(active[-1]) - cut.began_ns) * 1e-6 if len(active) else 0.0)
    return {"safe_after_ms": spread(after_ms), "made_safe": len(after_ms)}

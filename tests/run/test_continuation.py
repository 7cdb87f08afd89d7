"""Numbers and times go on across a gap: by the device's clock where it kept its boot, else the host's."""

from __future__ import annotations

import numpy as np
import pytest

from labhil.service.reconnect import WRAP_NS, Continuation
from labhil.signals import Batch

RATE = 100.0
PERIOD_NS = 10_000_000


def batch(first: int, clock_ns: int, host_ns: int, count: int = 3) -> Batch:
    steps = np.arange(count, dtype=np.int64)
    return Batch(
        first + steps, host_ns + steps * PERIOD_NS, clock_ns + steps * PERIOD_NS, np.zeros((count, 1))
    )


@pytest.mark.parametrize("late_ns", [0, 7_000_000, 90_000_000])
@pytest.mark.parametrize("wraps", [0, 1, 3])
def test_a_device_that_kept_its_boot_tells_how_long_the_gap_was(late_ns: int, wraps: int) -> None:
    continuation = Continuation(RATE, 1.0)
    before = continuation.apply(batch(5, 2_000_000_000, 50_000_000_000))
    continuation.note_new_connection(same_boot=True)
    gap_ns = wraps * WRAP_NS + 1_230_000_000
    shown_ns = (2_020_000_000 + gap_ns) % WRAP_NS
    after = continuation.apply(batch(900, shown_ns, 50_020_000_000 + gap_ns + late_ns))
    assert after.t_hw_ns[0] - before.t_hw_ns[-1] == gap_ns
    assert after.seq[0] - before.seq[-1] == round(gap_ns / PERIOD_NS)
    assert (np.diff(after.t_hw_ns) == PERIOD_NS).all() and (np.diff(after.seq) == 1).all()


@pytest.mark.parametrize("same_boot", [False, True])
def test_a_clock_that_began_anew_is_carried_on_by_the_hosts(same_boot: bool) -> None:
    """Also where it says that it is the same boot, but shows another time than has passed."""
    continuation = Continuation(RATE, 1.0)
    before = continuation.apply(batch(5, 2_000_000_000, 50_000_000_000))
    continuation.note_new_connection(same_boot=same_boot)
    after = continuation.apply(batch(0, 30_000_000, 53_020_000_000))
    assert after.t_hw_ns[0] - before.t_hw_ns[-1] == 3_000_000_000
    assert after.seq[0] - before.seq[-1] == 300
    again = continuation.apply(batch(3, 60_000_000, 53_050_000_000))
    assert again.seq[0] - after.seq[-1] == 1 and again.t_hw_ns[0] - after.t_hw_ns[-1] == PERIOD_NS


def test_a_faster_world_has_more_samples_in_a_gap() -> None:
    continuation = Continuation(4 * RATE, 4.0)
    before = continuation.apply(batch(0, 0, 0))
    continuation.note_new_connection(same_boot=True)
    after = continuation.apply(batch(7, 20_000_000 + 4_000_000_000, 20_000_000 + 1_003_000_000))
    assert after.t_hw_ns[0] - before.t_hw_ns[-1] == 4_000_000_000
    assert after.seq[0] - before.seq[-1] == 400

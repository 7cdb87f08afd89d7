"""How many cores a process uses, alone and beside others of its kind."""

from __future__ import annotations

from concurrent.futures import ProcessPoolExecutor
from multiprocessing import get_context

import pytest

from labhil.cores import cores, share_cores


@pytest.mark.parametrize("processes", [1, 2, 1000])
def test_processes_share_the_cores_and_each_has_one_at_least(processes: int) -> None:
    spawned = get_context("spawn")
    with ProcessPoolExecutor(1, mp_context=spawned, initializer=share_cores, initargs=(processes,)) as pool:
        assert pool.submit(cores).result() == max(1, cores() // processes)

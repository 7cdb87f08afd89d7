"""How many cores a process uses, alone and beside others of its kind."""

from __future__ import annotations

import time
from concurrent.futures import ProcessPoolExecutor
from multiprocessing import get_context

import pytest

from labhil.cores import cores, share_cores, side_by_side


@pytest.fixture
def two_cores(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("labhil.cores.cores", lambda: 2)


@pytest.mark.parametrize("processes", [1, 2, 1000])
def test_processes_share_the_cores_and_each_has_one_at_least(processes: int) -> None:
    spawned = get_context("spawn")
    with ProcessPoolExecutor(1, mp_context=spawned, initializer=share_cores, initargs=(processes,)) as pool:
        assert pool.submit(cores).result() == max(1, cores() // processes)


def square(number: int) -> int:
    return number * number


def squares(count: int) -> list[int]:
    return list(side_by_side(square, range(count)))


@pytest.mark.usefixtures("two_cores")
def test_what_runs_side_by_side_may_itself_ask_for_it_and_comes_in_order() -> None:
    assert list(side_by_side(squares, range(6))) == [squares(count) for count in range(6)]


@pytest.mark.usefixtures("two_cores")
def test_threads_of_a_process_are_not_missed_in_its_fork() -> None:
    expected = squares(5)
    with ProcessPoolExecutor(1, mp_context=get_context("fork")) as pool:
        assert pool.submit(squares, 5).result(timeout=60) == expected


@pytest.mark.usefixtures("two_cores")
def test_after_an_error_nothing_goes_on() -> None:
    done = []

    def work(number: int) -> int:
        if number == 0:
            raise ValueError(number)
        time.sleep(0.05)
        done.append(number)
        return number

    with pytest.raises(ValueError, match="0"):
        list(side_by_side(work, range(20)))
    reached = len(done)
    time.sleep(0.2)
    assert reached == len(done) < 19

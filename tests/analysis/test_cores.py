"""Work that shares itself out: BLAS starts no threads of its own in it, and gets them back afterwards."""

from __future__ import annotations

import numpy as np
import pytest
from threadpoolctl import threadpool_info, threadpool_limits

from labhil.cores import cores, shared_out


def threads():
    """How many threads each BLAS of this process has."""
    return [pool["num_threads"] for pool in threadpool_info() if pool["user_api"] == "blas"]


def test_blas_has_one_thread_while_work_is_shared_out():
    assert np.linalg.inv(np.eye(3)).shape == (3, 3)
    with threadpool_limits(limits=2, user_api="blas"):
        before = threads()
        assert before
        assert shared_out(threads)() == [1] * len(before)
        assert threads() == before


def test_blas_gets_its_threads_back_from_work_that_fails():
    @shared_out
    def fails():
        raise ArithmeticError("expected")

    before = threads()
    with pytest.raises(ArithmeticError, match="expected"):
        fails()
    assert threads() == before


def test_what_is_shared_out_keeps_its_name_and_its_arguments():
    @shared_out
    def power(base, *, exponent=2):
        """A power."""
        return base**exponent

    assert (power(3), power(2, exponent=3)) == (9, 8)
    assert (power.__name__, power.__doc__) == ("power", "A power.")
    assert cores() >= 1

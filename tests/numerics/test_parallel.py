"""Chunks: each item once, whatever the number of threads; failures come out and stop the rest."""

from __future__ import annotations

import threading
from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest

import kempe
from kempe import Mechanism
from kempe.errors import InputError
from kempe.numerics.pool import sum_over_chunks


@pytest.mark.parametrize("threads", [None, 1, 2, 3, 8])
@pytest.mark.parametrize("count", [0, 1, 9, 10, 11, 99, 100, 1001])
def test_every_item_is_worked_on_once_in_the_same_chunks(threads, count):
    seen = np.zeros(count, dtype=int)
    lock = threading.Lock()
    bounds = set()

    def work(i, j):
        with lock:
            seen[i:j] += 1
            bounds.add((i, j))
        return j - i

    assert sum_over_chunks(work, count, 10, threads, 20) == count
    assert (seen == 1).all()
    if threads != 1 and count >= 20:
        assert threads is None or bounds == {(i, min(i + 10, count)) for i in range(0, count, 10)}


def test_a_failure_comes_out_and_no_further_chunk_is_begun():
    begun = []

    def work(i, j):
        begun.append(i)
        raise ZeroDivisionError

    with pytest.raises(ZeroDivisionError):
        sum_over_chunks(work, 10_000, 1, 2, 0)
    assert len(begun) <= 4


@pytest.mark.parametrize("threads", [0, -1, 1.5, "two", True])
def test_odd_thread_counts_are_refused(threads):
    with pytest.raises(InputError, match="threads"):
        sum_over_chunks(lambda i, j: 0, 10, 1, threads, 0)


def test_many_python_threads_may_call_at_once():
    m = Mechanism("arm")
    last = m.ground
    for i in range(7):
        body = m.body(f"b{i}")
        m.revolute(f"j{i}", last, body, at=(0.1, 0.2, 0.3), axis=(i % 2, 1, 0.5))
        last = body
    robot = m.build()
    q = robot.random(0, 60_000)
    X = robot.fk(q, "b6", threads=1)
    J = robot.jacobian(q[:100], "b6")
    s = robot.ik(X[:300], "b6", budget=kempe.Budget(threads=1))

    def job(k):
        if k % 3 == 0:
            return np.array_equal(robot.fk(q, "b6"), X)
        if k % 3 == 1:
            return all(np.array_equal(robot.jacobian(q[i], "b6"), J[i]) for i in range(100))
        return np.array_equal(robot.ik(X[:300], "b6").q, s.q)

    with ThreadPoolExecutor(4) as pool:
        assert all(pool.map(job, range(12)))

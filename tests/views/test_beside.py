"""What is computed beside a page: that errors are said, and that the thread goes on after them."""

from __future__ import annotations

import queue

import pytest

from kempe.errors import InputError
from kempe.views.viewer.live import Beside


def raising(error):
    def work(check):
        raise error
        yield

    return work


@pytest.mark.parametrize(
    ("error", "said"),
    [
        (InputError("n is 0"), "n is 0"),
        (TypeError("no such thing"), "not done, by a defect of Kempe: TypeError: no such thing"),
        (MemoryError("1 TiB"), "not done, by a defect of Kempe: MemoryError: 1 TiB"),
    ],
)
def test_what_ends_in_an_error_is_said_and_others_go_on(error, said, capfd):
    actions = queue.Queue()
    texts = []
    beside = Beside(lambda key, action: actions.put(action), texts.append)
    try:
        beside.start_job("bad", raising(error))
        actions.get(timeout=60)()
        assert texts == [said]
        beside.start_job("good", lambda check: iter([lambda: texts.append("found")]))
        actions.get(timeout=60)()
        assert texts == [said, "found"]
    finally:
        beside.end_thread()
    assert ("Traceback" in capfd.readouterr().err) is not isinstance(error, InputError)

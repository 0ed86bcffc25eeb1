"""The comparison of two installations measures every row."""

from __future__ import annotations

import json
import sys

import compare
import pytest


@pytest.mark.slow
@pytest.mark.parametrize("code", ["SINGLE", "WARM", "BATCH"])
def test_each_row_is_a_time(code):
    times = json.loads(compare.process(sys.executable, "-c", getattr(compare, code)).printed)
    assert times and all(value > 0 for value in times.values())

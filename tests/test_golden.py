"""Verbs answer what the record says that they answered: `tools/golden.py` writes it, and lists the
differences.
"""

from __future__ import annotations

import re
import sys
from pathlib import Path

import pytest

sys.path.append(str(Path(__file__).parents[1] / "tools"))
import golden

RTOL = 1e-6
"""Rounding differs between processors; the bits are compared by hand, on one machine, before and
after a change."""


ROUNDED = ("ik_step", "spaces", "trace")
"""Verbs that rounding decides: which joints are at a limit where hardly any motion is possible, where
a sample closes, which way a trace begins. One commit answers differently on two kinds of processors,
so these are compared by hand, too: on one machine, before and after a change."""


NAMED = re.compile(r'.*, ik_path, status of .*: "(.*)" became "(.*)"')
"""A sentence of `ik_path` and another one: which of joints that are alike stops a symmetric mechanism
is decided by rounding, too."""


def differs_in_names_only(difference: str) -> bool:
    """Whether two sentences of `ik_path` are the same but for the names of joints."""
    found = NAMED.fullmatch(difference)
    return (
        found is not None and len({re.sub("'[^']*'", "''", text) for text in found.groups()}) == 1
    )


@pytest.mark.slow
@pytest.mark.parametrize("name", golden.names())
def test_answers_are_those_of_the_record(name):
    if name.endswith(".urdf") and not golden.ROBOTS:
        pytest.skip("example-robot-data is not installed")
    found = [
        x
        for x in golden.differences(name, RTOL)
        if not x.startswith(tuple(f"{name}, {verb}," for verb in ROUNDED))
        and not differs_in_names_only(x)
    ]
    assert not found, "\n".join(found)


def test_the_record_holds_every_system_and_verb():
    stored = golden.stored()
    assert list(stored) == golden.names()
    assert all(
        set(rows) == {verb for verb in golden.VERBS if (name, verb) not in golden.LEFT_OUT}
        for name, rows in stored.items()
    )
    assert golden.RECORD.stat().st_size < 5_000_000


def test_differences_are_seen():
    """Of one entry of an array, of a shape and of a sentence; within a tolerance small ones are
    not.
    """
    x = golden.np.linspace(0.0, 1.0, 24).reshape(6, 4)
    y = x.copy()
    y[3, 2] += 1e-9
    assert golden.difference(golden.entry(x), golden.entry(x.copy()), None) == ""
    assert golden.difference(golden.entry(x), golden.entry(y), None) and not golden.difference(
        golden.entry(x), golden.entry(y), 1e-6
    )
    y[3, 2] += 1e-3
    assert golden.difference(golden.entry(x), golden.entry(y), 1e-6)
    assert golden.difference(golden.entry(x), golden.entry(x.T), 1e-6)
    assert golden.difference(golden.entry("3 of 4 found"), golden.entry("4 of 4 found"), None)
    assert not golden.difference(golden.entry("3 of 4 found"), golden.entry("4 of 4 found"), 1e-6)
    assert golden.difference(golden.entry("none found"), golden.entry("found"), 1e-6)

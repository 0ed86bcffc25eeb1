"""The outcomes of questions: one enum, whose numbers are those of the kernels where these have any."""

from __future__ import annotations

import pickle
import re
from pathlib import Path

import numpy as np
import pytest

import kempe
from kempe.kernels.base import search_layout
from kempe.status import MEMBERS, PROOFS, Status, name_outcomes, to_status

SOURCE = Path(kempe.__file__).parent


@pytest.mark.parametrize(
    ("layout", "status"),
    [("SOLVED", Status.SOLVED), ("NOT_FOUND", Status.NOT_FOUND), ("BAD_INPUT", Status.BAD_INPUT)],
)
def test_numbers_of_kernels_are_those_of_the_members(layout, status):
    assert getattr(search_layout, layout) == status == status.value


def test_kernels_read_these_numbers_where_they_are_given():
    """No kernel module but the layout gives numbers of its own to these names."""
    given = re.compile(r"^.*\b(?:SOLVED|NOT_FOUND|BAD_INPUT)\b[^=\n]* = .*\d", re.M)
    modules = {path: given.findall(path.read_text()) for path in (SOURCE / "kernels").rglob("*.py")}
    assert [path.name for path, lines in modules.items() if lines] == ["search_layout.py"]


def test_the_mark_of_lateness_is_no_member_that_kernels_say():
    """A status of several tasks with LATE added is distinguished from all that kernels answer."""
    said = (search_layout.SOLVED, search_layout.NOT_FOUND, search_layout.BAD_INPUT)
    assert all(x < search_layout.LATE for x in said)
    assert len({x + late for x in said for late in (0, search_layout.LATE)}) == 6


def test_members_are_numbered_without_gaps_and_each_has_a_sentence_of_its_own():
    assert [int(s) for s in MEMBERS] == list(range(len(Status))) == [s.value for s in Status]
    assert len({s.sentence for s in Status}) == len(Status)
    assert all(s.sentence and s.sentence[-1] != "." and s.proof in (True, False) for s in Status)
    assert not any(
        s.proof for s in (Status.SOLVED, Status.NOT_FOUND, Status.OUT_OF_TIME, Status.BAD_INPUT)
    )
    assert set(PROOFS) == {s for s in Status if s.proof}


@pytest.mark.parametrize("status", Status)
def test_a_member_survives_pickling_and_says_its_name(status):
    assert (
        pickle.loads(pickle.dumps(status))
        is status
        is Status(status.value)
        is to_status(np.int64(status))
    )
    assert str(status) == f"{status}" == status.name == name_outcomes(status)
    assert name_outcomes(np.array([[status, 0]])) == [[status.name, "SOLVED"]]


def test_no_module_but_status_gives_numbers_to_outcomes():
    """Else they can collide: whole numbers from zero on, given to several names at once, one of a
    member among them.
    """
    given = re.compile(r"^((?:[A-Z_]+, )+[A-Z_]+) = 0, 1(?:, \d+)*$", re.M)
    for path in (
        p for layer in ("solvers", "analysis", "kinematics") for p in (SOURCE / layer).rglob("*.py")
    ):
        for names in given.findall(path.read_text()):
            assert not {*names.split(", ")} & {s.name for s in Status}, f"{path}: {names}"

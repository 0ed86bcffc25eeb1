"""The configuration that a verb starts from is `start`; its former names `seed` and `near` warn."""

from __future__ import annotations

import warnings

import numpy as np
import pytest

import kempe
from kempe.errors import CallError, InputError

ARM, LINKAGE, SEVEN = (kempe.load(n) for n in ("puma560", "four_bar", "iiwa14"))
TOOL = ARM.frame_names[-1]
Q = ARM.mid + 0.1
X = ARM.fk(Q + 0.05, TOOL)
START = LINKAGE.assemble({"A": 0.2}).q
POSES = kempe.convert.to_maximal(LINKAGE, START)
FREE = SEVEN.mid + 0.2

VERBS = {
    "ik": (lambda **o: ARM.ik(X, TOOL, **o), Q, "seed"),
    "ik of tasks": (lambda **o: ARM.ik([kempe.tasks.Pose(TOOL, X)], **o), Q, "seed"),
    "ik_path": (lambda **o: ARM.ik_path(X[None], TOOL, **o), Q, "seed"),
    "ik_all": (lambda **o: ARM.ik_all(X, TOOL, **o), Q, "near"),
    "ik_sweep": (lambda **o: SEVEN.inverse.sweep(SEVEN.fk(FREE, "tool"), "tool", **o), FREE, "near"),
    "assemble": (lambda **o: LINKAGE.assemble({"A": 0.3}, **o), START, "near"),
    "assembler": (lambda **o: LINKAGE.loops.assembler(["A"])([0.3], **o), START, "near"),
    "assembly_modes": (lambda **o: LINKAGE.assembly_modes({"A": 0.3}, **o), START, "near"),
    "from_maximal": (lambda **o: kempe.convert.from_maximal(LINKAGE, POSES, **o), START, "near"),
    "chart": (lambda **o: LINKAGE.independent(START).q([0.3], **o), START, "near"),
}


@pytest.mark.parametrize("verb", VERBS)
def test_former_names_warn_and_say_the_same(verb):
    call, start, former = VERBS[verb]
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        wanted = call(start=start)
    with pytest.warns(DeprecationWarning, match=f"'{former}' is the former name of 'start'") as said:
        found = call(**{former: start})
    assert said[0].filename == __file__
    assert str(found) == str(wanted)
    q, wanted_q = (getattr(x, "q", x) for x in (found, wanted))  # `q` of a chart is a method
    assert callable(q) or np.array_equal(q, wanted_q)


@pytest.mark.parametrize("verb", VERBS)
def test_both_names_are_refused(verb):
    call, start, former = VERBS[verb]
    with pytest.raises(InputError, match=f"'{former}' is the former name"):
        call(**{former: start, "start": start})


def test_verbs_without_a_start_have_no_such_option():
    with pytest.raises(CallError, match="no option 'seed'"):
        ARM.ik_step(Q, X, TOOL, dt=0.1, seed=Q)

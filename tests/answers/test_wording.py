"""Evidence is data; each kind has one sentence, in one module, which says its figures."""

from __future__ import annotations

import ast
import pickle
from pathlib import Path

import numpy as np
import pytest
import sources

import kempe
from kempe.answers import wording
from kempe.answers.evidence import (
    Evidence,
    list_limit_violations,
    make_evidence,
    make_limit_evidence,
    make_reach_evidence,
)

SOURCE = Path(kempe.__file__).parent
ARM = kempe.load("puma560")
KINDS = {**wording.PROOFS, **wording.FOUND_OUT}


def kinds_made() -> set[str]:
    """Kinds of all evidence that is made in solvers, read from their syntax trees."""
    calls = [
        node
        for path in SOURCE.rglob("*.py")
        for node in sources.nodes(path)
        if isinstance(node, ast.Call)
        and isinstance(node.func, ast.Name)
        and node.func.id == "make_evidence"
    ]
    return {ast.literal_eval(call.args[0]) for call in calls}


@pytest.mark.slow
def test_each_kind_of_evidence_is_found_out_somewhere_and_has_a_sentence():
    assert kinds_made() == set(KINDS) and not set(wording.PROOFS) & set(wording.FOUND_OUT)


@pytest.mark.parametrize(
    "kind, figures, said",
    [
        (
            "lengths",
            {"place": 0.5},
            "outside the workspace by at least 0.5 m, by the lengths of the links",
        ),
        (
            "lengths",
            {"place": 0.5, "turned": 0.75, "task": "t"},
            "'t' is outside the workspace by at least 0.5 m, with "
            "this orientation by at least 0.75 m, by the lengths of the links",
        ),
        ("lengths", {"plane": 2.0}, "outside the plane of the system by 2 m"),
        (
            "lengths",
            {"place": 873.5, "times": 2000.0},
            "outside the workspace by at least 873.5 m, by the lengths of the "
            "links; lengths are metres, and these look like millimetres",
        ),
        ("outside", {"count": 1}, "the only configuration that reaches it is outside"),
        (
            "contradiction",
            {"how": "turns", "off": 0.25, "first": "a", "second": "b"},
            "contradictory: 'a' and 'b': they turn one body to orientations 0.25 rad apart",
        ),
        (
            "no root",
            {"joint": "q1", "axes": [3, 4, 5], "what": "near", "off": 0.1},
            "no angle of 'q1' brings the point where axes 4, 5, 6 meet to its distance: 0.1 m too "
            "near",
        ),
        (
            "no root",
            {"joint": "q1", "axes": [3], "what": "direction", "off": 0.1},
            "no angle of 'q1' gives axis 4 the direction that is needed: 0.1 rad off",
        ),
        (
            "rank",
            {"equations": 6, "freedoms": 5, "frame": "tool", "position": True},
            "the task has 6 equations, but the "
            "chain moves this frame in 5 freedoms only (its position alone can be reached)",
        ),
        ("rank", {"equations": 6, "freedoms": 0, "frame": "tool"}, "no joint moves frame 'tool'"),
        (
            "rank",
            {"equations": 3, "freedoms": 2, "frame": "tool", "held": True},
            "the task has 3 equations, but the chain moves this frame in 2 freedoms only with the "
            "joints that are held",
        ),
        (
            "limits",
            {"names": ["a", "b"], "each": True},
            "without the limit of 'a' or of 'b' it is reached, so that may be what blocks it",
        ),
        (
            "limits",
            {"names": ["a", "b"], "done": "closes"},
            "without the limits of 'a', 'b' it closes, so these may be what blocks it",
        ),
        ("one-sided", {"violated": ["x", "y"], "known": True}, "what is known contradicts x, y"),
        (
            "short links",
            {"joint": "C", "longest": 1.0, "others": 0.75},
            "the loop of joint 'C' cannot be closed: one of its links is 1 m long, 0.25 m more than "
            "all its other links together",
        ),
        (
            "short links",
            {"joint": "C", "longest": 1.0, "others": 0.75, "known": True},
            "the loop of joint 'C' cannot be closed with these values: two of its joints are 1 m "
            "apart, 0.25 m more than all its other links together",
        ),
        ("not closed", {}, "with these values no closed configuration was found"),
        ("open", {"what": "nothing"}, "nothing is open"),
        (
            "open",
            {"what": "place", "names": ["a", "b"], "place": 0.25},
            "the place of 'a' or 'b' is missed by 0.25 m",
        ),
        (
            "open",
            {"what": "loop", "names": ["C"], "place": 0.25, "turn": 0.5},
            "the loop of joint 'C' stays open by 0.25 m and 0.5 rad",
        ),
        (
            "tried",
            {"held": [("q", 0.5)], "values": 1, "starts": 9},
            "no solution with 'q' at 0.5, and none from 9 starts of a search",
        ),
    ],
)
def test_a_sentence_says_the_figures(kind, figures, said):
    found = Evidence(kind, figures)
    assert found.text == str(found) == said and found.proof == (kind in wording.PROOFS)
    assert all(getattr(found, name) == value for name, value in figures.items())
    assert pickle.loads(pickle.dumps(found)) == found


def test_a_figure_that_is_not_there_is_an_attribute_that_is_missing():
    with pytest.raises(AttributeError, match="place"):
        make_evidence("outside", count=2).place  # noqa: B018
    assert make_reach_evidence(ARM) is None and make_reach_evidence(ARM, plane=1e-9) is not None


def test_targets_in_millimetres_are_suspected_and_those_a_little_too_far_are_not():
    near = ARM.fk(ARM.mid + 0.2, "tool")
    far = ARM.fk(ARM.mid + 0.2, "tool")
    far[:3, 3] *= 1000.0
    near[:3, 3] *= 4.0
    for X, wrong in ((far, True), (near, False)):
        said = [
            ARM.ik(X, "tool").status,
            ARM.ik_all(X, "tool").status,
            ARM.ik_path([X, X], "tool").status,
        ]
        assert ["look like millimetres" in x for x in said] == [wrong] * 3
        assert all("outside the workspace" in x for x in said)


def test_a_proof_within_evidence_makes_it_one():
    """Limits block a target where a proof says so, else they may."""
    proof = make_evidence("outside", count=2)
    text = make_evidence("limits", names=["a"], proof=proof).text
    assert text == f"blocked by the limit of 'a' ({proof.text}); without limits it is reachable"


def test_parts_that_are_empty_leave_no_mark():
    assert (
        wording.describe_failure("not reached", "", None, make_evidence("more starts"), 0)
        == "not reached: more starts find an answer"
    )
    assert wording.describe_failure("", "a", "b") == "a; b"


def test_coordinates_outside_of_their_limits_count_modulo_turns():
    s = kempe.load("two_link")
    turn = 6.283185307179586
    first, second = s.coordinate_names
    s = s.with_limits({first: (-1.0, 1.0), second: (2.0, 3.0)})
    assert list_limit_violations(s, np.array([0.5 + 3 * turn, 2.5 - turn])) == []
    assert list_limit_violations(s, np.array([1.5, 2.5 - turn]), turns=False) == [first, second]
    assert list_limit_violations(s, np.array([1.5, 2.5 - turn])) == [first]


def test_what_was_found_without_limits_tells_which_block():
    """Values beyond a limit, beyond it by a turn that counts, or inside: known by construction."""
    s = kempe.load("two_link")
    turn = 6.283185307179586
    first, second = s.coordinate_names
    s = s.with_limits({first: (-1.0, 1.0), second: (2.0, 3.0)})
    beyond = np.array([1.5, 2.5])
    wound = np.array([0.5, 2.5 - turn])
    assert make_limit_evidence(s, None) is None
    assert make_limit_evidence(s, beyond, task="t").names == [first]
    assert make_limit_evidence(s, wound).kind == "more starts"
    assert make_limit_evidence(s, wound, retry=lambda q: q).kind == "more starts"
    assert make_limit_evidence(s, wound, retry=lambda q: None).names == [second]
    inside = np.array([0.5, 2.5])
    assert make_limit_evidence(s, inside, retry=lambda q: None).kind == "more starts"

"""Over which tree loops are solved: marks `cut` do not choose it, unless they keep a free joint."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import kempe
from kempe import Mechanism, System
from kempe.model.characteristic_length import compute_characteristic_length
from kempe.model.own_tree import remove_cut_marks


def four_bar(*cut: str, **more) -> System:
    m = Mechanism("four-bar", dim=2)
    m.parameter("crank", 0.1)
    crank, coupler, rocker = (m.body(name) for name in ("crank", "coupler", "rocker"))
    places = {
        "A": (m.ground, crank, 0.0, 0.0),
        "B": (crank, coupler, "crank", 0.0),
        "C": (coupler, rocker, 0.5, 0.4),
        "D": (m.ground, rocker, 0.4, 0.0),
    }
    for name, (parent, child, at, child_at) in places.items():
        m.revolute(
            name,
            parent,
            child,
            at=(at, 0),
            child_at=(child_at, 0),
            cut=name in cut,
            **more.get(name, {}),
        )
    return m.build()


@pytest.mark.parametrize("cut", ["", "A", "B", "C", "D", "AB", "ABCD"])
def test_a_mark_changes_what_is_left_out_but_not_the_tree_of_solvers(cut):
    s = four_bar(*cut)
    plain = four_bar()
    tree = remove_cut_marks(s)
    assert tree.structure.topology == plain.structure.topology and tree.structure.closures == ("C",)
    assert (tree is s) == (s.structure.closures == ("C",))
    assert remove_cut_marks(s) is tree and remove_cut_marks(tree) is tree
    assert tree.coordinate_names == s.coordinate_names and np.array_equal(
        tree.structure.limits, s.structure.limits
    )


def test_other_parameters_and_limits_come_along():
    s = four_bar("B").with_limits({"A": (-1.0, 1.0)}).with_parameters(crank=0.15)
    assert isinstance(s, System)
    tree = remove_cut_marks(s)
    assert s.structure.closures == ("B",) and tree.structure.closures == ("C",)
    assert tree.structure.parameters["crank"] == 0.15 and tree.structure.limits[0].tolist() == [
        -1.0,
        1.0,
    ]


@pytest.mark.parametrize("planar", [True, False])
def test_bodies_that_hang_on_free_joints_stay_there(planar):
    """Marks say there that bodies are given by their poses; without them the free joint is left
    out.
    """
    m = Mechanism("free", dim=2 if planar else 3)
    m.free("body", m.ground, m.body("b"))
    m.revolute("J", m.ground, "b", cut=True)
    s = m.build()
    assert s.structure.closures == ("J",) and remove_cut_marks(s) is s
    m.joints["J"] = replace(m.joints["J"], cut=False)
    assert m.build().structure.closures == ("body",)


def test_a_fixed_joint_that_is_cut_does_not_make_two_links_of_one():
    """How long a typical link is must not depend on it."""
    lengths = []
    for cut in "AWD":
        m = Mechanism("welded", dim=2)
        crank, coupler, half, rocker = (
            m.body(name) for name in ("crank", "coupler", "half", "rocker")
        )
        m.revolute("A", m.ground, crank, cut=cut == "A")
        m.revolute("B", crank, coupler, at=(0.1, 0))
        m.joint("W", "fixed", coupler, half, at=(0.4, 0), cut=cut == "W")
        m.revolute("C", half, rocker, at=(0.1, 0), child_at=(0.4, 0))
        m.revolute("D", m.ground, rocker, at=(0.4, 0), cut=cut == "D")
        s = m.build()
        assert s.structure.closures == (cut,)
        lengths.append(compute_characteristic_length(s))
    assert lengths == [pytest.approx(0.4, rel=1e-12)] * 3


def test_files_without_marks_are_solved_over_their_own_tree():
    assert all(remove_cut_marks(s) is s for s in map(kempe.load, ("delta_ss", "jansen", "panda")))


def test_a_joint_that_holds_one_motion_is_not_kept_in_the_tree_by_a_mark():
    """Only one that holds nothing is."""
    for more, kept in (("", "J"), (" P(z)", "A")):
        m = Mechanism("loop")
        crank = m.body("crank")
        table = m.body("table")
        m.revolute("A", m.ground, crank, cut=True)
        m.revolute("B", crank, table, at=(1.0, 0.0, 0.0), rpy=(0.1, 0.2, 0.3))
        m.joint("J", "R(x) R(y) R(z) P(x) P(y)" + more, m.ground, table)
        s = m.build()
        assert s.structure.closures == ("A",) and remove_cut_marks(s).structure.closures == (kept,)

"""Mechanisms of the literature and of proofs have the degrees of freedom that are known of them."""

from __future__ import annotations

import numpy as np
import pytest
from literature import KNOWN, four_upu, look

from kempe.equations.closure_rows import compute_jacobian
from kempe.first_order.rank import compute_rank

PROVEN = {
    "K33 on a conic: shaky",
    "Cauchy: regular octahedron",
    "octahedron turned by 30 degrees: shaky",
    "four screws that do not fit",
    "Hoberman's ring of six",
    "double Cardan",
}
"""The others move by theorems about their lengths, which are not looked at."""


@pytest.mark.parametrize(("scale", "moved"), [(1.0, False), (1e-4, True), (1e4, True)])
@pytest.mark.parametrize("name", KNOWN)
def test_known_degrees_of_freedom(name, scale, moved):
    world, count, rank, dof = KNOWN[name]
    m = look(world, scale, moved)
    assert (m.gruebler, m.rank_dof, m.dof, m.certain) == (count, rank, dof, name in PROVEN), str(m)
    assert m.singular == (rank > dof) and m.redundant == rank - count
    assert sum(len(r.reactions) for r in m.redundancy.releases) == m.redundant


def test_all_four_legs_are_needed():
    m = look(four_upu(), actuated=["leg0", "leg1", "leg2", "leg3"])
    assert m.control.complete and m.control.excess == 0
    assert not look(four_upu(), actuated=["leg0", "leg1", "leg2"]).control.complete


@pytest.mark.parametrize("name", KNOWN)
def test_kernels_keep_all_loops_closed(name):
    system = KNOWN[name][0].build()
    rank = compute_rank(system, system.neutral)
    assert (
        np.abs(compute_jacobian(system, rank.q) @ (rank.null_space * rank.units[:, None])).max(
            initial=0.0
        )
        < 1e-9
    )

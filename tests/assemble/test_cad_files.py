"""Files of CAD programs with many loops: closed and drawn at once, with few decompositions.

The judge multiplies poses out in numpy and shares nothing with the solvers.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from cad_files import gripper, humanoid, mobile_robot
from robots import DATA

import kempe
from kempe.equations.judge import closure_error
from kempe.numerics import rank
from kempe.views.viewer.scene_nodes import Drawn

FILES = {
    "mobile robot": (mobile_robot, 11, 29, "left_arm6_slide", 0.003),
    "gripper": (gripper, 8, 1, "palm_slide", 0.004),
    "gripper of 4 decimals": (lambda: gripper(2, 4), 4, 1, "palm_slide", -0.004),
    "humanoid": (humanoid, 12, 24, "waist_l_crank_turn", 0.2),
}
"""File, loops and freedoms of the mechanism that is meant, and a coordinate that moves."""
TOLERANCE = 1e-4
"""More than numbers of 4 decimals are off by."""
DECOMPOSITIONS = 1000
"""Singular value decompositions of a first answer at most; each takes about 0.1 ms."""


@pytest.fixture
def count(monkeypatch: pytest.MonkeyPatch) -> list[int]:
    """The number of decompositions so far."""
    count = [0]
    compute_svd: Any = rank.compute_svd

    def count_svd(*given: Any, **how: Any) -> Any:
        count[0] += 1
        return compute_svd(*given, **how)

    monkeypatch.setattr(rank, "compute_svd", count_svd)
    return count


@pytest.mark.slow
@pytest.mark.parametrize("name", FILES)
def test_first_answers_close_the_loops_with_few_decompositions(name: str, count: list[int]):
    make, loops, freedoms, moved, by = FILES[name]
    system = kempe.load(make().text)
    assert len(system.structure.closures) == loops
    answer = system.assemble(tolerance=TOLERANCE)
    assert answer and count[0] < DECOMPOSITIONS
    found: Any = answer.within
    ideal = found.system
    assert np.abs(closure_error(ideal, answer.q)).max() < 1e-9
    assert found.tolerance < TOLERANCE and found.freedoms == freedoms
    answer = system.assemble({moved: by}, answer.q, tolerance=TOLERANCE)
    assert answer and system.q_dict(answer.q)[moved] == pytest.approx(by)
    assert np.abs(closure_error(ideal, answer.q)).max() < 1e-9
    # the given numbers miss by what they are rounded by, and no more
    assert np.abs(closure_error(system, answer.q)).max() < TOLERANCE


def test_first_answer_of_cassie(count: list[int]):
    found = [path for folder in DATA for path in folder.rglob("cassie.sdf")]
    if not found:
        pytest.skip("example-robot-data is not installed")
    system = kempe.load(found[0])
    answer = system.assemble()
    assert answer and answer.within is None and count[0] < DECOMPOSITIONS
    assert len(system.structure.closures) == 6
    assert np.abs(closure_error(system, answer.q)).max() < 1e-9


@pytest.mark.slow
@pytest.mark.parametrize("name", FILES)
def test_files_with_many_loops_are_drawn(name: str):
    system = kempe.load(FILES[name][0]().text)
    drawn = Drawn(system, system.assemble().q)
    links = range(1, len(drawn.rigid.heads))
    assert len(links) > FILES[name][1] and {p.carrier for p in drawn.rigid.parts} >= {*links}

"""What is said of a configuration that closes: how many freedoms are left, and a warning where it
has folded.
"""

from __future__ import annotations

import numpy as np
import pytest
from linkages import four_bar

import kempe
from kempe import Mechanism, System


def scissor(n: int, dim: int = 2) -> System:
    """n cells of two bars, pinned in the middle; at neutral all bars lie on each other."""
    m = Mechanism("scissor", dim=dim)
    x = (1.0, 0.0, 0.0)[:dim]
    half = (0.5, 0.0, 0.0)[:dim]
    a, b = ([m.body(f"{x}{i}") for i in range(n)] for x in "ab")
    m.revolute("A", m.ground, a[0])
    m.prismatic("S", m.ground, m.body("slider"), axis=x)
    m.revolute("B", "slider", b[0])
    for i in range(n):
        m.revolute(f"M{i}", a[i], b[i], at=half, child_at=half)
        if i + 1 < n:
            m.revolute(f"P{i}", a[i], b[i + 1], at=x)
            m.revolute(f"Q{i}", b[i], a[i + 1], at=x)
    return m.build()


def stretched(system: System, n: int, angle: float) -> np.ndarray:
    """All cells open by the same angle."""
    turn = np.pi - 2 * angle
    q = {"A": angle, "S": np.cos(angle), "B": np.pi - angle} | {f"M{i}": turn for i in range(n)}
    return system.q(
        q | {f"P{i}": turn for i in range(n - 1)} | {f"Q{i}": -turn for i in range(n - 1)}
    )


def test_an_open_chain_has_no_loops_to_close():
    arm = kempe.load("puma560")
    assert arm.assemble().status == "no loops to close; 6 freedoms left open"
    assert arm.assemble({"q1": 0.3}).status == "no loops to close; 5 freedoms left open"
    placed = arm.assemble({"tool": arm.fk(arm.mid, "tool")[:3, 3]})
    assert placed.status.startswith("closed: residual")


@pytest.mark.parametrize("n", [2, 10, 100, 150])
def test_a_scissor_that_closes_folded_says_so(n):
    system = scissor(n)
    answer = system.assemble(
        start=system.neutral + np.random.default_rng(0).normal(size=system.nq) * 0.3
    )
    assert answer.success
    assert (
        f"{n} freedoms left open, 1 by the count: the mechanism is folded or singular here"
        in answer.status
    )
    assert "P0 and Q0" in answer.status and answer.status.endswith("coincide")
    rng = np.random.default_rng(1)
    for _ in range(3):
        answer = system.assemble(start=stretched(system, n, 0.9) + rng.normal(size=system.nq) * 0.1)
        assert answer.success and answer.status.endswith("; 1 freedom left open")


@pytest.mark.parametrize("posture", [True, False])
def test_pins_that_coincide_are_named_in_space(posture):
    """The count is negative there; whether home is folded itself is not known without a posture."""
    system = scissor(4, 3)
    if posture:
        m = system.mechanism
        m.posture("closed", system.q_dict(stretched(system, 4, 0.9)))
        system = m.build()
    answer = system.assemble(
        start=system.neutral + np.random.default_rng(0).normal(size=system.nq) * 0.3
    )
    why = "the mechanism is folded or singular here, where" if posture else "it may be folded, for"
    assert f"; 4 freedoms left open, 1 in general: {why} P0 and Q0" in answer.status
    answer = system.assemble(start=stretched(system, 4, 0.9))
    assert answer.success and answer.status.endswith("; 1 freedom left open")


@pytest.mark.parametrize("rods", [3, 2])
def test_angles_of_a_ball_at_their_own_singularity_are_no_freedom(rods):
    m = Mechanism("platform")
    m.spherical("S", m.ground, m.body("plate"), angles=True)
    rng = np.random.default_rng(5)
    for k in range(rods):
        m.frame(f"g{k}", m.ground, at=rng.normal(size=3))
        m.frame(f"h{k}", "plate", at=rng.normal(size=3))
    bare = m.build()
    q = bare.q({"S.ry": np.pi / 2, "S.rx": 0.3})
    for k in range(rods):
        length = float(np.linalg.norm(bare.fk(q, f"g{k}")[:3, 3] - bare.fk(q, f"h{k}")[:3, 3]))
        m.distance(f"rod{k}", f"g{k}", f"h{k}", length)
    status = m.build().assemble(start=q).status
    assert "closed" in status and ("1 freedom left open" in status) == (rods == 2)


def test_three_hinges_in_gimbal_lock_keep_their_freedom():
    m = Mechanism("wrist")
    m.revolute("z", m.ground, m.body("a"), axis=(0, 0, 1))
    m.revolute("y", "a", m.body("b"), axis=(0, 1, 0))
    m.revolute("x", "b", m.body("c"), axis=(1, 0, 0))
    m.spherical("S", m.ground, "c")
    assert "3 freedoms left open" in m.build().assemble(start={"y": np.pi / 2}).status


def test_hunt_folded_cells(hunt):
    """A warning where pins of a cell coincide and more than one freedom is open, and none
    elsewhere.
    """
    rng = hunt.rng()
    seen = set()
    for _ in range(hunt.cases(50)):
        n = int(rng.integers(2, 9))
        system = scissor(n)
        start = stretched(system, n, rng.uniform(0.2, 1.3)) * rng.choice([0.0, 1.0])
        q = (
            answer := system.assemble(
                start=start + rng.normal(size=system.nq) * rng.choice([0.1, 0.4, 1.0])
            )
        ).q
        if not answer.success:
            continue
        ends = [system.fk(q, f"{x}{i}") @ [1, 0, 0, 1] for i in range(n - 1) for x in "ab"]
        starts = [system.fk(q, f"{x}{i + 1}")[:, 3] for i in range(n - 1) for x in "ab"]
        assert max(np.abs(a - b).max() for a, b in zip(ends[::2], starts[1::2], strict=True)) < 1e-9
        closed = any(np.linalg.norm(ends[2 * i] - ends[2 * i + 1]) < 1e-7 for i in range(n - 1))
        # the pins on the ground, where they coincide
        first = np.linalg.norm(system.fk(q, "slider")[:3, 3]) < 1e-7
        warned = "folded or singular" in answer.status
        left = int(answer.status.rpartition("; ")[2].split()[0]) if not warned else 2
        assert warned == ((closed or first) and "1 freedom left" not in answer.status), (
            answer.status
        )
        assert warned or left == 1
        seen.add(warned)
    assert seen == {True, False}


def test_a_change_point_is_compared_with_home():
    system = kempe.load("parallelogram")
    status = system.assemble(start=system.q("flat")).status
    assert status.endswith("2 freedoms left open, 1 at home: singular here, or on another branch")


@pytest.mark.parametrize(
    "name",
    ["bennett", "sarrus", "four_bar", "peaucellier", "rssr", "delta_ss", "delta_uu", "jansen"],
)
def test_no_warning_where_nothing_is_wrong(name):
    """Neither redundant constraints nor idle spins nor compound pins are anything to warn of."""
    system = kempe.load(name)
    assert system.assemble(start=system.q("closed")).status.endswith("left open")


def test_all_given_leaves_nothing_to_say():
    system = kempe.load("four_bar")
    assert "left" not in system.assemble({"A": 1.0}).status


@pytest.mark.parametrize("beyond", [1e-9, 1e-7, 1e-3])
def test_the_open_loop_is_named_however_little_it_is_open(beyond):
    s = four_bar(a=0.4, b=0.2, c=0.3, d=0.8)
    toggle = np.arccos((0.16 + 0.64 - 0.25) / (2 * 0.4 * 0.8))
    answer = s.assemble({"A": toggle + beyond})
    assert not answer and "the loop of joint" in answer.status


def test_a_violated_rod_and_a_violated_relation_are_named():
    m = Mechanism("rod", dim=2)
    crank = m.body("crank")
    block = m.body("block")
    m.revolute("A", m.ground, crank)
    m.prismatic("S", m.ground, block, axis=(1, 0), limits=(5, 6))
    m.distance("rod", crank, block, length=2.0, at=(1, 0))
    answer = m.build().assemble()
    assert not answer and "constraint 'rod' stays open by 2 m" in answer.status
    m = Mechanism("differential")
    for name in ("L", "R", "C"):
        m.revolute(name, m.ground, m.body(f"body {name}"), limits=(0, 1))
    m.couple("C", {"L": 1.0, "R": 1.0}, offset=5.0)
    answer = m.build().assemble()
    assert not answer and "the relation of 'C' is off by 4" in answer.status


def test_too_many_known_values_are_said_to_be_too_many():
    s = four_bar()
    assert (
        "2 coordinates are given, but it has 1 freedom" in s.assemble({"A": 1.0, "D": 1.0}).status
    )


def test_a_position_has_more_numbers_than_a_mechanism_of_one_freedom():
    s = kempe.load("four_bar")
    assert "the position of 'coupler_point' (2 numbers) is given, but it has 1 freedom" in (
        s.assemble({"coupler_point": [0.1, 0.2]}).status
    )
    assert "2 equations, but 1 freedom" in s.ik([0.1, 0.2], "coupler_point").status
    both = s.assemble({"A": 0.5, "coupler_point": [0.1, 0.2]}).status
    assert "1 coordinate and the position of 'coupler_point' (2 numbers) are given" in both


def test_a_value_given_to_what_cannot_move_is_said_to_be_too_many():
    truss = kempe.read("four_bar").lock({"A": 1.0}).build()
    assert "1 coordinate is given, but the mechanism cannot move (0 freedoms)" in (
        truss.assemble({"D": 0.5}).status
    )


def test_limits_are_said_as_they_were_given():
    arm = kempe.load("two_link").with_limits({"q1": (0.0, 1.0)})
    assert arm.assemble({"q1": 2.0}).status.endswith("q1 = 2 is not in [0, 1]")


def test_by_how_much_a_place_is_missed():
    m = Mechanism("arm", dim=2)
    m.revolute("A", m.ground, m.body("a"))
    m.revolute("B", "a", m.body("b"), at=(1, 0))
    s = m.build()
    assert "the place of 'b' is missed by 0.118034 m" in s.assemble({"b": [1.0, 0.5]}).status
    assert (
        "the place of 'ground' is missed by 1 m"
        in kempe.load("four_bar").assemble({"ground": [1, 0]}).status
    )

"""What mobility is certain of is true: hunts among mechanisms with known numbers, and the theorems
one by one.
"""

from __future__ import annotations

from itertools import pairwise
from math import cos, pi, sin

import known_truths
import numpy as np
import pytest
from frozen_mechanisms import Change, rebuilt
from hunts import Hunt, some
from known_truths import KINDS, dead_centres, gimbal, moved, row_of_parallelograms, scissor
from world_mechanisms import World

import kempe
from kempe import Mechanism, System
from kempe.equations.closure_rows import compute_residual
from kempe.first_order.counting import compute_group_basis, spans_lie_algebra
from kempe.mobility import dof_proofs
from kempe.mobility.answer import Mobility
from kempe.mobility.local_dimension import find_local_dimension
from kempe.mobility.mobility import mobility
from kempe.model.ball_angles import make_regular_chart
from kempe.numerics.newton import make_certificate
from kempe.spatial import matrix_to_quat_wxyz, rot_x, rot_y, rot_z

# ---- certain is never wrong


def hunted(hunt: Hunt, kind, cases: int) -> list[tuple[Mobility, int]]:
    rng = hunt.rng()
    out = []
    for _ in range(hunt.cases(cases)):
        found = kind(rng)
        if found is not None:
            system = found[0].build(**moved(rng, found[0]))
            out.append((mobility(system, system.neutral), found[1]))
    return out


ALWAYS = {
    "flat_loop",
    "row_of_parallelograms",
    "parallelograms_apart",
    "scissor",
    "sarrus",
    "frameworks",
    "bars",
    "hinges",
    "gimbal",
    "stopped_row",
    "three_cranks",
    "side_by_side",
}
"""Kinds of which every number is proven."""


SLOW = {
    "wunderlich",
    "side_by_side",
    "stopped_row",
    "row_of_parallelograms",
    "parallelograms_apart",
    "scissor",
}


def check(hunt: Hunt, kind, cases: int) -> None:
    for m, truth in hunted(hunt, kind, cases):
        assert (
            m.dof == truth if m.certain else "to order" in m.sentence or "probably" in m.sentence
        ), str(m)
        assert m.certain or kind.__name__ not in ALWAYS, str(m)


@pytest.mark.parametrize("kind", some(KINDS, 4), ids=lambda kind: kind.__name__)
def test_certain_is_never_wrong(kind, hunt):
    check(hunt, kind, 1 if kind.__name__ in ("wunderlich", "side_by_side") else 5)


@pytest.mark.slow
@pytest.mark.parametrize("kind", KINDS, ids=lambda kind: kind.__name__)
def test_certain_is_never_wrong_in_many_cases(kind, hunt):
    check(hunt, kind, 15 if kind.__name__ in SLOW else 75)


@pytest.mark.parametrize("stages", range(1, 8))
def test_dead_centres_in_a_row_are_rigid_or_not_certain(stages):
    """The obstruction is of order 2^stages: five stages need order 32."""
    w, _ = dead_centres(np.random.default_rng(0), stages)
    m = mobility(w.build(), w.build().neutral)
    if stages <= 3:
        assert (m.dof, m.certain) == (0, True)
    else:
        assert not m.certain and "to order 8" in m.sentence


@pytest.mark.parametrize("off", [1e-10, 1e-9, 1e-8, 1e-7])
def test_nothing_singular_is_proven_a_little_beside_it(off):
    """A stretched bar bent by less than the rank's tolerance moves; what holds on the line itself
    does not count.
    """
    w = World("bent", 2)
    for i, (a, b) in enumerate(pairwise(("ground", "one", "two", "three", "ground"))):
        w.turn(a, b, (float(i), off * (-1) ** i))
    m = mobility(w.build(), w.build().neutral)
    assert m.dof == 1 if m.certain else "to order 8" in m.sentence


@pytest.mark.slow
@pytest.mark.parametrize("stages", some([2, 10, 50, 100], 3))
def test_certainty_does_not_fade_with_size(stages):
    m = mobility(*scissor_of(stages))
    assert (m.dof, m.certain, m.local) == (1, True, None)
    assert m.rank.smallest_counted_value > 0.2 / stages  # not a power of it


def scissor_of(stages: int) -> tuple[System, np.ndarray]:
    class Fixed:
        def integers(self, *_):
            return stages

        def uniform(self, *_):
            return 0.8

    system = scissor(Fixed())[0].build()  # pyright: ignore[reportArgumentType]
    return system, system.neutral


# ---- charts


def ball_on_rods(angles: bool, ry: float, rods: int, rng: np.random.Generator, free: bool = False):
    """A body on a ball joint (or free) and rods, at a second angle `ry`, in angles or by
    quaternion.
    """
    m = Mechanism("ball")
    body = m.body("body")
    place = {
        "at": rng.uniform(-1, 1, 3),
        "rpy": rng.uniform(-1, 1, 3),
        "child_rpy": rng.uniform(-1, 1, 3),
    }
    m.joint("J", "free" if free else "spherical", m.ground, body, angles=angles, **place)
    z, x = rng.uniform(-3, 3, 2)
    R = rot_z(z) @ rot_y(ry) @ rot_x(x)
    values = (
        {"J.rz": z, "J.ry": ry, "J.rx": x}
        if angles
        else dict(
            zip(("J.qw", "J.qx", "J.qy", "J.qz"), matrix_to_quat_wxyz(R).tolist(), strict=True)
        )
    )
    values |= (
        dict(zip(("J.x", "J.y", "J.z"), rng.uniform(-1, 1, 3).tolist(), strict=True))
        if free
        else {}
    )
    tree = m.build()
    pose = tree.fk(tree.q(values))[-1]
    for k in range(rods):
        a = rng.uniform(-2, 2, 3)
        b = rng.uniform(-1, 1, 3)
        m.distance(
            f"rod{k}",
            m.ground,
            body,
            at=a,
            child_at=b,
            length=float(np.linalg.norm(pose[:3] @ [*b, 1.0] - a)),
        )
    system = m.build()
    return system, system.q(values)


@pytest.mark.parametrize("free", [False, True])
def test_freedoms_of_a_chart_are_no_freedoms(free, hunt):
    """The same body by quaternion is the judge, at and near the angles' own singularity."""
    rng = hunt.rng()
    for _ in range(hunt.cases(12)):
        rods = int(rng.integers(1, 5 + 3 * free))
        seed = int(rng.integers(2**31))
        ry = float(rng.choice([-1, 1])) * pi / 2 + float(
            rng.choice([0.0, 0.0, 1e-9, 1e-6, 1e-3, 0.3])
        )
        system, q = ball_on_rods(True, ry, rods, np.random.default_rng(seed), free)
        m = mobility(system, q)
        other = mobility(*ball_on_rods(False, ry, rods, np.random.default_rng(seed), free))
        assert (m.dof, m.certain, m.rank_dof, m.redundant) == (
            other.dof,
            True,
            other.rank_dof,
            other.redundant,
        )
        assert (
            m.dof == max((6 if free else 3) - rods, 0)
            and find_local_dimension(system, q).dim == m.dof
        )
        assert (
            max(
                np.abs(compute_residual(system, found.q)).max()
                for found in (m, find_local_dimension(system, q))
            )
            < 1e-9
        )


def test_hinges_in_gimbal_lock_are_free():
    """Three hinges are no chart: where two of them are in line, the one between them turns."""
    world, truth = gimbal(np.random.default_rng(4))
    system = world.build()
    m = mobility(system, system.neutral)
    assert (m.dof, m.certain) == (truth, True)


def test_coupled_angles_have_a_meaning_of_their_own():
    """Angles of a ball that gears tie to each other stay what they are."""
    m = Mechanism("geared ball")
    body = m.body("body")
    m.spherical("J", m.ground, body, angles=True)
    m.couple("J.rz", {"J.rx": 1.0})
    m.distance("rod", m.ground, body, at=(1, 1, 0), child_at=(0.3, 0.2, 0.9), length=1.0)
    m.posture("closed", {"J.ry": pi / 2})
    system = m.build()
    q = system.assemble({"J.ry": pi / 2}).q
    assert make_regular_chart(system, q)[0] is system


# ---- numbers of branches


@pytest.mark.parametrize("rods", [True, False])
@pytest.mark.parametrize("seed", range(2))
def test_branches_of_one_linkage_in_two_models(rods, seed):
    """Five motions of two freedoms and eight of one, whether bars are bodies or distances of
    particles.
    """
    system = kempe.load("wunderlich")
    q = system.q("closed")
    if rods:
        system, q = box_of_rods(0.9, 0.6, 0.3)
    m = mobility(system, q, rng=seed)
    assert m.dof == 2 and sorted(m.local.branch_dims) == [1] * 8 + [2] * 5
    assert (
        not m.local.counted
        and "13 branches were found, of dimensions 2 (5 times), 1 (8 times)" in m.kind
    )


def box_of_rods(*length: float) -> tuple[System, np.ndarray]:
    corners = [(i, j, k) for i in (0, 1) for j in (0, 1) for k in (0, 1)]
    points = [(float(np.dot(c, length)), 0.0) for c in corners]
    edges = [
        (a, b)
        for a in range(8)
        for b in range(a)
        if np.abs(np.subtract(corners[a], corners[b])).sum() == 1
    ]
    system = known_truths.framework("box", points, edges, (0, 4), 2).build()
    return system, system.neutral


def test_two_curves_that_cross_are_counted():
    system = kempe.load("parallelogram")
    m = mobility(system, system.q("flat"))
    assert m.local.counted and "2 branches meet" in m.kind


def test_a_long_row_of_flat_parallelograms():
    class Long(np.random.Generator):
        def integers(self, *_):  # pyright: ignore[reportIncompatibleMethodOverride]
            return 5

    system = row_of_parallelograms(Long(np.random.PCG64(1)))[0].build()
    m = mobility(system, system.neutral)
    assert (m.rank_dof, m.dof, m.certain) == (6, 1, True)


# ---- what cannot change it


@pytest.mark.parametrize(
    ("name", "posture"),
    [
        ("four_bar_spatial", "closed"),
        ("sarrus", "closed"),
        ("bennett", "closed"),
        ("double_parallelogram", "flat"),
        ("row_of_four_bars", "flat"),
        ("kite", "change_point"),
        ("three_upu_snu", "closed"),
    ],
)
def test_certain_is_not_wrong_however_it_is_described(name, posture, hunt):
    system = kempe.load(name)
    q = system.q(posture)
    rng = hunt.rng()
    truth = mobility(system, q)
    names = [j.name for j in system.structure.joints.values()]
    assert truth.certain
    for _ in range(hunt.cases(4)):
        change = Change(
            order=tuple(rng.permutation(len(names)).tolist()),
            cut=str(rng.choice(names)),
            ground=str(rng.choice(list(system.body_names))),
            scale=10.0 ** rng.uniform(-5, 5),
            prefix="new_",
            mirror=bool(rng.random() < 0.5),
            move=kempe.spatial.exp_se3(
                rng.uniform(-1, 1, 6) * (1 if system.dim == 3 else [1, 1, 0, 0, 0, 1])
            ),
        )
        other = rebuilt(system, q, change)
        assert (m := mobility(other, other.neutral)).dof == truth.dof or not m.certain, (
            str(m),
            change,
        )


# ---- the theorems


def test_newton_and_kantorovich():
    """x^2 = a: regular at sqrt(a) as long as that is above the root of rounding, and the root is
    within the radius.
    """
    for power in np.arange(0, 9, 0.25):
        a = 10.0**-power
        x = float(np.sqrt(10.0**-power)) * (1 + 1e-9)
        sure = make_certificate(np.array([2 * x]), (1, 1), abs(x * x - a), 2.0, 1e-16, 1)
        assert sure.regular and abs(np.sqrt(a) - x) <= sure.radius
    assert not make_certificate(np.array([2e-8]), (1, 1), 1e-16, 2.0, 1e-16, 1).regular
    assert not make_certificate(np.array([1.0, 0.0]), (2, 3), 0.0, 1.0, 1e-16, 6).regular


@pytest.mark.parametrize("dim", [1, 2, 3])
def test_common_zeros_of_quadratic_forms(dim):
    """x y, y z, z x vanish together on three lines; with x^2 + 2 y^2 + 3 z^2 at 0 only, complex
    ones too.
    """
    x = np.eye(3)
    pairs = [np.outer(x[i], x[k]) + np.outer(x[k], x[i]) for i, k in ((0, 1), (1, 2), (0, 2))]
    rng = np.random.default_rng(0)
    assert dof_proofs._has_no_zero(np.array(pairs), dim, rng) == (dim < 3)
    assert dof_proofs._has_no_zero(np.array([*pairs, np.diag([1.0, 2.0, 3.0])]), dim, rng)
    sphere = np.array([np.eye(3), np.diag([1.0, 2.0, 3.0]), np.diag([1.0, 4.0, 9.0])])
    assert dof_proofs._has_no_zero(sphere, dim, rng)
    assert not dof_proofs._has_no_zero(sphere[:2], 3, rng)  # no real zero, but complex ones
    assert dof_proofs._has_definite_combination(
        sphere[:2], rng
    ) and not dof_proofs._has_definite_combination(np.array(pairs), rng)


def test_groups_are_filled_or_not():
    def turn(p: tuple[float, float, float], tilt: float = 0.0) -> np.ndarray:
        return np.r_[np.cross(p, [0.0, tilt, 1.0]), 0.0, tilt, 1.0]

    three = np.stack([turn(p) for p in ((0, 0, 0), (1, 0, 0), (0, 1, 0))], axis=1)
    assert spans_lie_algebra(three, 1e-12, 1e-5) and not spans_lie_algebra(
        three[:, :2], 1e-12, 1e-5
    )
    assert compute_group_basis(three[:, :2], 1e-12).shape == (6, 3)
    nearly = np.stack([turn((0, 0, 0)), turn((1, 0, 0), 1e-9)], axis=1)
    assert compute_group_basis(nearly, 1e-12).shape[1] == 6


def test_bennett_in_any_configuration(hunt):
    """All around its motion; two links a little longer are not proven to move."""
    system = kempe.load("bennett")
    rng = hunt.rng()
    path = system.trace("q1")
    for q in path.resample(200).q[rng.choice(200, 8)]:
        m = mobility(system, q)
        assert (m.dof, m.certain) == (1, True), str(m)


def test_a_trammel_turns_as_it_slides():
    """Slides and turns at once: not proven, and said to be known to an order."""
    w = World("trammel", 2)
    w.joint("free", "ground", "rod")
    for k in range(3):
        e = np.array([cos(0.3 + pi * k / 3), sin(0.3 + pi * k / 3)])
        w.line("ground", "rod", (np.array([cos(0.7), sin(0.7)]) @ e) * e, e)
    system = w.build()
    m = mobility(system, system.neutral)
    assert (m.dof, m.certain) == (1, False) and m.sentence.startswith(
        "1 degree of freedom to order 8 (Grübler count: 0"
    )


@pytest.mark.parametrize("off", some([1e-12, 1e-10, 1e-8, 1e-6], 4))
def test_axes_that_nearly_meet_leave_lengths_typical(off, hunt):
    """Two balls of three hinges whose axes miss each other by little: links of that length are no
    unit of measure.
    """
    rng = hunt.rng()
    for _ in range(hunt.cases(5)):
        centers = rng.uniform(-1, 1, (2, 3))
        around = rng.normal(size=(6, 3, 3))
        joints = [
            ("revolute", centers[i // 3] + off * p, z / np.linalg.norm(z))
            for i, (p, z, _) in enumerate(around)
        ]
        system = known_truths.loop("two balls of hinges", joints).build()
        m = mobility(system, system.neutral)
        assert m.closed and system.assemble(start=system.neutral).success
        assert m.dof == 0 if m.certain else m.dof in (0, 1)

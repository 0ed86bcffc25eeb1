"""Counting as a computed fact: what joints take away from two free bodies, by the rank of their
constraints.
"""

from __future__ import annotations

import numpy as np
import pytest
from closed_graphs import pose_of, stays_in_plane
from own_joints import OWN, PRODUCTS, random_product, random_type, variants
from reference import twist_between

import kempe
from kempe import Mechanism, System
from kempe import constraints as c
from kempe.constraints import OnSurface
from kempe.equations import closure_rows
from kempe.first_order.constraint_graph import build_constraint_graph
from kempe.first_order.screws import Screws, compute_screws
from kempe.forward.maximal import maximal_q
from kempe.joints import TYPES, JointType, P, make_joint_type

TABLE = [kind(**options) for kind in TYPES.values() for options in variants(kind, 0.3)]
EVERY = [*TABLE, *map(make_joint_type, PRODUCTS), *(kind() for kind in OWN)]
CASES = [
    (kind, dim)
    for kind in EVERY
    for dim in (2, 3)
    if dim == 3 or (kind.planar and stays_in_plane(kind))
]
HIDDEN = {"coaxial", "telescope"}
"""Types of which only sums of coordinates can be seen."""


def between_free_bodies(
    kind: JointType, dim: int, rng: np.random.Generator
) -> tuple[System, np.ndarray]:
    """Two bodies that move freely, tied by a joint of this kind in odd frames; closed at the
    configuration given.
    """
    m = Mechanism("two bodies", dim)
    slider = any(p.kind == P and p.axis == "z" for p in kind.layout(dim)[1]) and dim == 2

    def place(prefix: str) -> dict:
        at = {prefix + "at": rng.uniform(-1, 1, dim)}
        if slider:
            return at
        return at | (
            {prefix + "rpy": rng.uniform(-1, 1, 3)}
            if dim == 3
            else {prefix + "angle": rng.uniform(-1, 1)}
        )

    a = m.body("a")
    b = m.body("b")
    m.free("A", m.ground, a)
    m.free("B", m.ground, b)
    m.joint(
        "J",
        kind,
        a,
        b,
        cut=True,
        **place(""),
        **place("child_"),
        **({"axis": (0.6, 0.8)} if slider else {}),
    )
    s = m.build()
    assert s.structure.closures == ("J",)
    # the joint is given values, and b is put where it then is
    q = s.random(rng)
    known = {n: x for n, x in s.q_dict(q).items() if n.split(".")[0] in ("A", "J")}
    found = s.assemble(known, start=q)
    assert found.success
    return s, found.q


def rank(J: np.ndarray) -> int:
    return int(np.linalg.matrix_rank(J, tol=1e-8)) if J.size else 0


def taken(s: System, q: np.ndarray) -> int:
    """What the joint takes away: the rank of its equations, less that of what its own coordinates
    can give in.
    """
    J = closure_rows.compute_jacobian(s, q)
    own = [i for i, n in enumerate(s.structure.velocity_names) if n.split(".")[0] == "J"]
    return rank(J) - rank(J[:, own])


def seen(kind: JointType, dim: int, values: np.ndarray) -> int:
    """Freedoms of the joint by differences of its pose, written out elsewhere."""
    steps = kind.layout(dim)[1]
    h = 1e-6
    along = (0.6, 0.8) if dim == 2 else None
    twists = []
    for i in range(len(values)):
        ahead = values.copy()
        back = values.copy()
        ahead[i], back[i] = ahead[i] + h, back[i] - h
        twists.append(
            twist_between(
                pose_of(steps, back.tolist(), dim, along),
                pose_of(steps, ahead.tolist(), dim, along),
                2 * h,
            )
        )
    return int(np.linalg.matrix_rank(np.array(twists), tol=1e-4)) if twists else 0


def check(kind: JointType, dim: int, rng: np.random.Generator) -> int:
    s, q = between_free_bodies(kind, dim, rng)
    full = 6 if dim == 3 else 3
    values = np.array([s.q_dict(q)[n] for n in s.structure.coordinates_of_joint("J")])
    found = taken(s, q)
    assert found == full - seen(kind, dim, values)
    m = s.mobility(q, local=False)
    idle = kind.dof(dim) - (full - found)  # coordinates that move nothing
    assert m.counting.free == 2 * full and m.rank_dof is not None
    assert m.counting.free - (m.rank_dof - idle) == found
    assert m.counting.taken == kind.constraints(dim)
    return found


@pytest.mark.parametrize(("kind", "dim"), CASES, ids=str)
def test_rank_of_joints_between_free_bodies(kind, dim):
    """A joint takes away 6 less its freedoms, in the plane 3; more is taken only where coordinates
    move nothing.
    """
    found = check(kind, dim, np.random.default_rng(3))
    if kind.type_name not in HIDDEN:
        assert found == kind.constraints(dim)


def test_random_types_between_free_bodies(hunt):
    rng = hunt.rng()
    for k in range(hunt.cases(100)):
        dim = int(rng.choice([2, 3]))
        kind = (
            make_joint_type(random_product(rng, dim)) if k % 2 else random_type(rng, f"t{k}", dim)
        )
        check(kind, dim, rng)


@pytest.mark.slow
def test_random_types_between_free_bodies_at_length(hunt):
    rng = hunt.rng()
    for k in range(hunt.cases(1000)):
        dim = int(rng.choice([2, 3]))
        kind = (
            make_joint_type(random_product(rng, dim)) if k % 2 else random_type(rng, f"t{k}", dim)
        )
        check(kind, dim, rng)


@pytest.mark.parametrize(
    ("name", "dim"),
    [
        (n, d)
        for n, t in TYPES.items()
        for d in (2, 3)
        if all(p.kind == P for p in t().layout(d, True)[1]) and (d == 3 or t.planar)
    ],
)
def test_rank_of_joints_of_particles(name, dim):
    m = Mechanism("particle", dim)
    body = m.body("a")
    point = m.particle("p")
    m.free(
        "A",
        m.ground,
        body,
        **({"at": (0.3, 0.1), "angle": 0.4} if dim == 2 else {"rpy": (0.3, 0.2, 0.1)}),
    )
    m.free("B", m.ground, point)
    m.joint(
        "J",
        name,
        body,
        point,
        cut=True,
        **({"axis": (0.6, 0.8)} if dim == 2 and name == "prismatic" else {}),
    )
    s = m.build()
    q = s.assemble(start=s.random(1)).q
    assert taken(s, q) == TYPES[name]().constraints(dim, True)


# ------------------------------------------------------------------ each constraint removes one
# freedom, but for these


def platform(rods: list[tuple[float, float, float]]) -> System:
    """A platform on rods that stand upright: where each is in the ground and on it, and how long it
    is.
    """
    m = Mechanism("platform", 2)
    m.free("P", m.ground, m.body("platform"), at=(0.0, 1.0))
    for k, (ground, top, length) in enumerate(rods):
        m.distance(f"rod {k}", m.ground, "platform", length, at=(ground, 0), child_at=(top, 0))
    return m.build()


@pytest.mark.parametrize(
    ("rods", "numbers"),
    [
        ([], (3, 3, 3)),
        ([0], (2, 2, 2)),
        ([0, 1], (1, 1, 1)),
        ([0, 1, 2], (0, 1, 1)),
        ([0, 1, 2, 3], (-1, 1, 1)),
    ],
)
def test_parallel_rods_of_one_length(rods, numbers):
    """The parallelogram: from the third rod on they remove nothing (a fifth link, with the ground
    and the platform).
    """
    m = platform([(x, x, 1.0) for x in rods]).mobility({"P.x": 0.0, "P.y": 0.0, "P.rz": 0.0})
    assert (m.gruebler, m.rank_dof, m.dof) == numbers


def test_a_third_rod_that_is_not_parallel_removes_the_last_freedom():
    m = platform([(0, 0, 1.0), (1, 1, 1.0), (2.5, 2, np.hypot(0.5, 1.0))]).mobility([0.0, 0.0, 0.0])
    assert (m.gruebler, m.rank_dof, m.dof) == (0, 0, 0)


@pytest.mark.parametrize(("slider", "rank_dof"), [(3.5, 0), (4.0, 1), (2.0, 1)])
def test_holding_a_slider_at_its_dead_centre(slider, rank_dof):
    """It removes the last freedom, but the rank sees it only where the slider is not in its extreme
    position.
    """
    m = Mechanism("engine", 2)
    m.revolute("A", m.ground, m.body("crank"))
    m.prismatic("S", m.ground, m.body("slider"), axis=(1, 0))
    m.distance("rod", "crank", "slider", 3.0, at=(1, 0))
    free = m.build()
    start = free.assemble({"S": slider}, start={"A": 0.3 if slider > 2.1 else np.pi, "S": slider}).q
    assert free.mobility(start).dof == 1
    held = m.lock({"S": slider}).build()
    found = held.mobility(held.assemble(start=[start[0]]).q)
    assert (found.gruebler, found.rank_dof, found.dof) == (0, rank_dof, 0)


def test_sarrus_counts_to_nothing_and_moves():
    m = kempe.convert.maximal(kempe.load("sarrus")).mobility()
    assert (m.counting.free, m.counting.taken, m.counting.free - m.rank_dof, m.dof) == (
        30,
        30,
        29,
        1,
    )


# ------------------------------------------------------------------ expressions count as other
# constraints do


def rods(count: int, recorded: bool, rng: np.random.Generator, twice: bool = False) -> System:
    """A body on rods, or on as many spheres that are said as expressions; at home when nothing is
    moved.
    """
    m = Mechanism("rods")
    m.free("P", m.ground, m.body("b"))
    for k in range(count):
        a, b = rng.uniform(-1, 1, (2, 3))
        if recorded:
            x, y, z = (f"({v} - {c})^2" for v, c in zip("xyz", a.tolist(), strict=True))
            for copy in range(1 + twice):
                law = OnSurface("b", f"{x} + {y} + {z} - {float((b - a) @ (b - a))}", b)
                m.constrain(law, f"rod {k} {copy}")
        else:
            for copy in range(1 + twice):
                m.distance(
                    f"rod {k} {copy}", m.ground, "b", float(np.linalg.norm(b - a)), at=a, child_at=b
                )
    return m.build()


@pytest.mark.parametrize("twice", [False, True])
@pytest.mark.parametrize("count", range(1, 7))
def test_expressions_count_as_rods_do(count, twice):
    found = [
        rods(count, recorded, np.random.default_rng(count), twice) for recorded in (False, True)
    ]
    reports = [s.mobility(s.neutral) for s in found]
    numbers = [(m.gruebler, m.rank_dof, m.dof, m.redundant, m.redundant_here) for m in reports]
    assert (
        numbers[0]
        == numbers[1]
        == (6 - count * (1 + twice), 6 - count, 6 - count, count * twice, count * twice)
    )
    said = reports[1].redundancy
    assert said is not None and said.number == count * twice
    assert not reports[1].certain  # nothing bounds second derivatives of expressions
    q = found[1].neutral
    assert (
        kempe.convert.maximal(found[1]).mobility(maximal_q(found[1], q), local=False).rank_dof
        == 6 - count
    )


@pytest.mark.parametrize(
    ("law", "at", "numbers"),
    [
        ("(x/2)^2 + y^2 + z^2 = 1", (2.0, 0.0, 0.0), (2, 2, 2, False)),
        ("x^2 + y^2 - z^2", (1.0, 0.0, 1.0), (2, 2, 2, False)),
        ("x^2 + y^2 - z^2", (0.0, 0.0, 0.0), (2, 3, 2, True)),  # the apex of a cone
        ("x^2 + y^2", (0.0, 0.0, 0.5), (2, 3, 1, True)),  # one equation, but a line
    ],
)
def test_points_on_surfaces(law, at, numbers):
    m = Mechanism("point")
    m.translation("P", m.ground, m.particle("p"))
    m.constrain(OnSurface("p", law), "surface")
    found = m.build().mobility(at)
    assert (found.gruebler, found.rank_dof, found.dof, found.singular) == numbers


def test_a_ball_that_rolls_is_held_at_its_height():
    m = Mechanism("ball")
    m.free("P", m.ground, m.body("ball"))
    m.rolls("r", "ball", 0.1)
    s = m.build()
    found = s.mobility(s.q({"P.z": 0.1}))
    assert (found.gruebler, found.dof, found.velocity_dof) == (5, 5, 3)


# ------------------------------------------------------------------ what a declared constraint
# takes from two bodies

TAKEN = {
    "pose": ((3, 6), lambda dim: c.Pose("tip", np.eye(dim + 1))),
    "position": ((2, 3), lambda dim: c.Position("tip", (0.3, 0.2, 0.1)[:dim])),
    "orientation": ((1, 3), lambda dim: c.Orientation("tip", np.eye(dim + 1), other="eye")),
    "pointing": ((1, 2), lambda dim: c.Pointing("tip", (0.6, 0.8, 0.0)[:dim], other="eye")),
    "look_at": ((1, 2), lambda dim: c.LookAt("tip", (2.0, 1.0, 3.0)[:dim])),
    "distance": ((1, 1), lambda dim: c.Distance("tip", "eye", 0.9)),
    "on_line": (
        (1, 2),
        lambda dim: c.OnLine("tip", (0.1, 0.2, 0.0)[:dim], (1.0, 2.0, 0.5)[:dim], other="eye"),
    ),
    "relative_pose": ((3, 6), lambda dim: c.RelativePose("tip", "eye", np.eye(dim + 1))),
}


@pytest.mark.parametrize("dim", [2, 3])
@pytest.mark.parametrize("name", TAKEN)
def test_declared_constraints_take_what_they_hold(name, dim):
    """Once, and no more if they are declared twice; rows of screws span those of the equations."""
    taken, make = TAKEN[name]
    for times in (1, 2):
        m = Mechanism("two", dim)
        for body, frame in (("a", "tip"), ("b", "eye")):
            m.free(f"J{body}", m.ground, m.body(body))
            m.frame(
                frame,
                body,
                at=(0.2, 0.1, 0.4)[:dim],
                **({"rpy": (0.1, 0.2, 0.3)} if dim == 3 else {"angle": 0.3}),
            )
        for k in range(times):
            m.constrain(make(dim), f"it {k}")
        s = m.build()
        q = s.assemble(start=s.random(5)).q
        found = s.mobility(q, local=False)
        count = taken[dim - 2]
        assert (found.rank_dof, found.redundant_here) == (s.nv - count, count * (times - 1))
        at = compute_screws(s, q)
        free = np.linalg.svd(closure_rows.compute_jacobian(s, q))[2][count:].T
        for i, edge in enumerate(e for e in build_constraint_graph(s).edges if not e.is_joint):
            W = at.compute_wrench_rows(i + 2, edge.of, dim)
            moves = about_center(s, q, edge.of.child, at) - about_center(s, q, edge.of.parent, at)
            assert (
                len(W) == np.linalg.matrix_rank(W) == count
                and np.abs(W @ moves @ free).max() < 1e-9
            )


def about_center(s: System, q: np.ndarray, body: str, at: Screws) -> np.ndarray:
    """Scaled twists (6, nv) of a body, read at the reference point of screws."""
    J = s.jacobian(q, body)
    v = J[:3] + np.cross(J[3:], at.center - s.fk(q, body)[:3, 3], axisb=0, axisa=0, axisc=0)
    return np.vstack([v / at.length, J[3:]])


@pytest.mark.parametrize(
    ("axis", "rpy"), [("x", (0, -np.pi / 2, 0)), ("y", (np.pi / 2, 0, 0)), ("z", (0, 0, 0))]
)
def test_what_a_hinge_holds_already_is_redundant_in_a_pose(axis, rpy):
    """Of the six directions of a pose, in its own axes, only the turn about the hinge is needed."""
    m = Mechanism("door")
    m.revolute("hinge", m.ground, m.body("door"), at=(0.4, 0.1, 0.2), rpy=(0.2, 0.3, 0.4))
    m.frame("knob", "door", at=(0, 0, 0.3), rpy=rpy)  # its `axis` is the hinge's
    s = m.build()
    m.constrain(c.Pose("knob", s.fk(s.q({"hinge": 0.7}), "knob")), "pose")
    found = m.build().mobility({"hinge": 0.7})
    (release,) = found.redundancy.releases
    assert (found.dof, found.redundant, release.joint) == (0, 5, "pose")
    assert set(release.reactions) == {"Fx", "Fy", "Fz", "Mx", "My", "Mz"} - {f"M{axis}"}
    assert (
        release.pair
        == f"a joint that slides along x, y, z and turns about {', '.join(sorted(set('xyz') - {axis}))}"
    )

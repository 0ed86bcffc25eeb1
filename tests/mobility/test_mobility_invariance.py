"""What mobility says does not depend on names, orders, cuts, the ground, units, handedness; and
agrees with oracles.
"""

from __future__ import annotations

import numpy as np
import pytest
from frozen_mechanisms import SWAPPABLE, Change, rebuilt
from hunts import examples, some
from hypothesis import given, settings
from hypothesis import strategies as st

import kempe
from kempe import Mechanism, System
from kempe.equations.closure_rows import compute_jacobian
from kempe.first_order.counting import find_group_dimensions
from kempe.first_order.rank import compute_rank
from kempe.first_order.redundant_constraints import describe_reactions, name_pair
from kempe.mobility.answer import Mobility
from kempe.mobility.mobility import mobility
from kempe.poses import make_placement_from_pose
from kempe.spatial import adjoint, exp_se3

NAMES = [
    "four_bar",
    "slider_crank",
    "double_parallelogram",
    "peaucellier",
    "three_rpr",
    "bennett",
    "goldberg_5r",
    "sarrus",
    "delta_uu",
    "delta_ss",
    "stewart_sps",
    "rssr",
    "three_upu",
]


@st.composite
def changes(draw, system: System) -> Change:
    joints = list(system.structure.joints.values())
    bodies = system.body_names
    planar = system.dim == 2
    seed = draw(st.integers(0, 2**16))
    rng = np.random.default_rng(seed)
    twist = rng.uniform(-1, 1, 6) * ([1, 1, 0, 0, 0, 1] if planar else 1)
    mirror = draw(st.booleans())
    swappable = [j.name for j in joints if j.type.type_name in SWAPPABLE]
    return Change(
        order=tuple(rng.permutation(len(joints)).tolist()),
        swap=frozenset(n for n in swappable if rng.random() < 0.4),
        cut=draw(st.sampled_from([None, *(j.name for j in joints)])),
        ground=draw(st.sampled_from([None, *bodies])),
        scale=draw(st.sampled_from([1.0, 1e-7, 37.0, 1e7])),
        mirror=mirror,
        move=exp_se3(twist),
        prefix=draw(st.sampled_from(["", "new_"])),
    )


def facts(m: Mobility, prefix: str = "") -> dict:
    """Everything that must not change; names of joints without their prefix."""
    return {
        "gruebler": (m.gruebler, m.gruebler_spatial),
        "rank": m.rank_dof,
        "generic": m.generic_rank_dof,
        "redundant": m.redundant,
        "released": sum(len(r.reactions) for r in m.redundancy.releases),
        "idle": m.idle,
        "singular": m.singular,
        "owners": {j.removeprefix(prefix) for j, _ in m.redundancy.stressed},
        "clusters": sorted((c.gruebler, c.rank_dof, c.redundant) for c in m.clusters),
    }


@pytest.mark.parametrize("name", some(NAMES, 3))
@settings(max_examples=examples(8))
@given(data=st.data())
def test_names_orders_cuts_ground_units_and_hands_do_not_matter(name, data):
    system = kempe.load(name)
    q = system.q("closed")
    passive = rebuilt(system, q, Change())
    change = data.draw(changes(system))
    other = rebuilt(system, q, change)
    want, got = (mobility(s, s.neutral, local=False) for s in (passive, other))
    reported = facts(want)
    seen = facts(got, change.prefix)
    # what spins about the ground is a swing
    if any(change.ground in f.bodies for f in want.idle_freedoms):
        assert reported.pop("idle") - seen.pop("idle") in (0, 1)
    assert got.closed and seen == reported
    if name != "delta_uu":  # what the original says, motors aside
        assert want.rank_dof == mobility(system, local=False).rank_dof


@pytest.mark.parametrize("name", ["bennett", "double_parallelogram", "sarrus"])
@settings(max_examples=examples(5))
@given(data=st.data())
def test_the_truth_does_not_change_either(name, data):
    system = kempe.load(name)
    q = system.q("closed")
    other = rebuilt(system, q, data.draw(changes(system)))
    assert mobility(other, other.neutral).dof == mobility(system, q).dof == 1


# ---- random mechanisms closed by construction

KINDS = ["revolute", "prismatic", "cylindrical", "universal", "planar", "spherical", "helical"]


@st.composite
def closed_mechanisms(draw) -> System:
    """A random tree at random coordinates, with joints added whose frames coincide there: closed at
    zero of these.
    """
    rng = np.random.default_rng(draw(st.integers(0, 2**16)))
    n = draw(st.integers(3, 8))
    loops = draw(st.integers(1, 3))
    tree = Mechanism("random")

    def random_pose() -> np.ndarray:
        return exp_se3(rng.uniform(-1, 1, 6))

    def add(
        m: Mechanism, name: str, kind: str, a: str, b: str, X: np.ndarray, Y: np.ndarray
    ) -> None:
        options = {"pitch": 0.2} if kind == "helical" else {}
        m.joint(
            name,
            kind,
            a,
            b,
            at=make_placement_from_pose(X),
            child_at=make_placement_from_pose(Y),
            **options,
        )

    for k in range(n):
        tree.body(f"b{k}")
        parent = "ground" if k == 0 else f"b{rng.integers(max(k - 2, 0), k)}"
        add(
            tree,
            f"j{k}",
            KINDS[rng.integers(len(KINDS))],
            parent,
            f"b{k}",
            random_pose(),
            random_pose(),
        )
    arm = tree.build()
    q = arm.random(rng)
    pose = dict(zip(arm.body_names, arm.fk(q), strict=True))
    for k in range(loops):
        a, b = (
            ("ground", f"b{n - 1}")
            if k == 0
            else tuple(rng.choice(list(arm.body_names), 2, replace=False))
        )
        X = random_pose()
        Y = np.linalg.inv(pose[str(b)]) @ pose[str(a)] @ X
        Y[3] = 0, 0, 0, 1
        add(tree, f"c{k}", KINDS[rng.integers(len(KINDS))], str(a), str(b), X, Y)
    values = arm.q_dict(q)
    couple(tree, values, rng, draw(st.integers(0, 3)))
    tree.posture("closed", {n: x for n, x in values.items() if n not in tree.couplings})
    return tree.build()


def couple(m: Mechanism, values: dict[str, float], rng: np.random.Generator, count: int) -> None:
    """Gears (one source) and relations (two), of turns and slides alike, that hold at these values."""
    free = [c for c in m.build().coordinate_names if not c.rpartition(".")[2].startswith("q")]
    rng.shuffle(free)
    for _ in range(count):
        if len(free) > 3:
            of = free.pop()
            sources = free[: int(rng.integers(1, 3))]
            ratios = {s: float(rng.uniform(0.5, 2.0)) for s in sources}
            offset = values.get(of, 0.0) - sum(r * values.get(s, 0.0) for s, r in ratios.items())
            m.couple(of, ratios, offset)


@settings(max_examples=examples(40))
@given(closed_mechanisms())
def test_random_mechanisms_agree_with_the_equations(system):
    """The rank, against the Jacobian of the equations themselves; without dependent ones the count
    is the truth.
    """
    m = mobility(system, local=False)
    J = compute_jacobian(system, m.q)
    assert m.closed and m.rank_dof == system.nv - np.linalg.matrix_rank(J, 1e-7)
    assert m.rank_dof - m.gruebler == m.redundant_here
    null_space = m.rank.null_space * m.rank.units[:, None]
    assert null_space.shape[1] == m.rank_dof and np.abs(J @ null_space).max(initial=0.0) < 1e-9
    if not m.redundant_here:
        assert m.dof == m.gruebler == m.rank_dof and m.singular is False
    assert sum(len(r.reactions) for r in m.redundancy.releases) == m.redundant
    assert m.control is None and sum(c.gruebler for c in m.clusters) + m.outside == m.gruebler


@settings(max_examples=examples(15))
@given(st.integers(0, 2**16), st.integers(0, 4))
def test_three_loops_of_any_generic_dimension(seed, extra):
    """Three loops, each with its own chain of 6 or more revolute joints: 18 joints fill up 18
    equations.
    """
    rng = np.random.default_rng(seed)
    m = Mechanism("three loops")
    hub = m.body("hub")
    # links between ground and hub; joints are one more: 22 in all, 3 loops take 18
    chains = [
        4,
        4,
        5,
        5,
    ]
    total = extra
    pose = lambda: make_placement_from_pose(exp_se3(rng.uniform(-1, 1, 6)))  # noqa: E731
    world = {"hub": exp_se3(rng.uniform(-1, 1, 6))}
    for c, links in enumerate(chains):
        links += 1 if total > c else 0
        before = "ground"
        for k in range(links):
            body = m.body(f"c{c}_{k}").name
            m.revolute(f"J{c}_{k}", before, body, at=pose(), child_at=pose())
            before = body
        X = exp_se3(rng.uniform(-1, 1, 6))
        Y = _at_hub(m, before, X, world)
        m.revolute(
            f"J{c}_{links}",
            before,
            hub,
            at=make_placement_from_pose(X),
            child_at=make_placement_from_pose(Y),
        )
    report = mobility(m.build(), m.build().neutral)
    assert report.closed and report.gruebler == report.rank_dof == report.dof == 4 + min(extra, 4)


def _at_hub(m: Mechanism, body: str, X: np.ndarray, world: dict) -> np.ndarray:
    """Where on the hub a frame of a body is, with all coordinates zero."""
    T = np.eye(4)
    chain = []
    while body != "ground":
        joint = next(j for j in m.joints.values() if j.child == body)
        chain.append(joint)
        body = joint.parent
    for joint in reversed(chain):
        T = T @ joint.X_PF.evaluate_pose({}) @ np.linalg.inv(joint.X_CM.evaluate_pose({}))
    out = np.linalg.inv(world["hub"]) @ T @ X
    out[3] = 0, 0, 0, 1
    return out


# ---- pieces


def screw(axis, point, pitch=0.0):
    axis = np.asarray(axis, float)
    return np.r_[np.cross(point, axis) + pitch * axis, axis]


SLIDE = np.eye(6)[:, :3]


@pytest.mark.parametrize(
    ("screws", "group"),
    [
        ([screw((0, 0, 1), (0, 0, 0))], (1, 1)),
        ([screw((0, 0, 1), (0, 0, 0)), screw((0, 0, 1), (1, 0, 0))], (3, 1)),
        ([screw((0, 0, 1), (0, 0, 0)), screw((0, 1, 0), (0, 0, 0))], (3, 3)),
        ([screw((0, 0, 1), (0, 0, 0)), SLIDE[:, 2]], (2, 1)),
        ([SLIDE[:, 0], SLIDE[:, 1]], (2, 0)),
        ([screw((0, 0, 1), (0, 0, 0)), SLIDE[:, 0], SLIDE[:, 2]], (4, 1)),
        ([screw((0, 0, 1), (0, 0, 0)), screw((0, 1, 0), (1, 0, 0))], (6, 3)),
        ([screw((0, 0, 1), (0, 0, 0), 0.3), screw((0, 0, 1), (1, 0, 0), 0.3)], (3, 1)),
    ],
)
def test_groups_of_motions(screws, group):
    """Herve's list of subgroups of displacements (1978), wherever they are and whatever spans them."""
    rng = np.random.default_rng(0)
    own = np.array(screws, dtype=float).T
    for _ in range(5):
        mixed = (
            adjoint(exp_se3(rng.uniform(-1, 1, 6)))
            @ own
            @ rng.uniform(-1, 1, (own.shape[1], own.shape[1]))
        )
        assert find_group_dimensions(own) == find_group_dimensions(mixed) == group


def test_pairs_have_names_whatever_their_axes_are_called():
    assert name_pair({"rz"}) == name_pair({"rx"}) == "a revolute joint"
    assert (
        name_pair({"z", "rx", "ry", "rz"})
        == name_pair({"y", "rx", "ry", "rz"})
        != name_pair({"rx", "ry", "rz"})
    )
    assert name_pair({"z", "rz"}) == "a cylindrical joint" == name_pair({"x", "rx"})
    assert name_pair({"z", "rx"}) == "a pin in a slot"
    assert (
        name_pair({"x", "y", "z", "rx", "ry"})
        == "a joint that slides along x, y, z and turns about x, y"
    )
    assert (
        describe_reactions(("Mx", "My", "Fz")) == "two moments and one force"
        and describe_reactions(("Fx",)) == "one force"
    )


def test_kernels_are_those_of_each_group_and_free_joints():
    system = kempe.load("seven_bodies_loop")
    r = compute_rank(system, mobility(system, local=False).q)
    np.testing.assert_allclose(r.null_space.T @ r.null_space, np.eye(r.nullity), atol=1e-12)

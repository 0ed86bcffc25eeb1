"""True local dimensions against published values, motions in closed form, and what cannot change
them.
"""

from __future__ import annotations

from math import cos, pi, sin

import numpy as np
import pytest
from hunts import examples, some
from hypothesis import assume, given, settings
from hypothesis import strategies as st
from linkages import double_watt, place
from literature import BENT, HEXAGON, look
from mechanisms import PLANAR, SINGULAR, Case, branches
from mechanisms_spatial import SPATIAL, Spatial
from world_mechanisms import World, X, Y, Z, on_rods

import kempe
from kempe import Mechanism, System, constraints
from kempe.equations import closure_rows
from kempe.errors import InputError
from kempe.mobility import lyapunov_schmidt
from kempe.mobility.local_dimension import LocalDimension, find_local_dimension, sample_dimension
from kempe.mobility.local_equations import Equations

# ---- small mechanisms, drawn at a scale, mirrored or not, cut anywhere


def chain(
    lengths: list[float],
    angles: list[float],
    scale: float = 1.0,
    mirrored: bool = False,
    cut: int = -1,
    name: str = "",
) -> tuple[System, np.ndarray]:
    """A planar loop of links one after the other at these angles to the ground, the last back to
    (lengths[-1], 0).
    """
    m = Mechanism("chain", dim=2)
    n = len(lengths) - 1
    way = -1.0 if mirrored else 1.0
    names = [f"{name}j{i}" for i in range(n + 1)]
    before = m.ground
    q = {}
    for i in range(n):
        link = m.body(f"{name}b{i}")
        at = (0.0, 0.0) if i == 0 else (scale * lengths[i - 1], 0.0)
        m.revolute(names[i], before, link, at=at, cut=cut == i)
        q[names[i]] = way * (angles[i] - (angles[i - 1] if i else 0.0))
        before = link
    end = (scale * lengths[n - 1], 0.0)
    m.revolute(names[n], m.ground, before, at=(scale * lengths[n], 0.0), child_at=end, cut=cut == n)
    q[names[n]] = way * angles[-1]
    system = m.build()
    return system, system.q(q)


def flat(lengths: list[float], signs: list[int], **how) -> tuple[System, np.ndarray]:
    return chain(lengths, [0.0 if s > 0 else pi for s in signs], **how)


def dead_centres_in_a_row(
    scale: float = 1.0, mirrored: bool = False, cut: str = ""
) -> tuple[System, np.ndarray]:
    """Two stretched bars shift a slider by -s^2, which another bar, at its own dead centre,
    forbids: s^4 = 0.
    """
    m = Mechanism("dead centres", dim=2)
    way = -1.0 if mirrored else 1.0
    a = m.body("a")
    b = m.body("b")
    k = m.body("k")
    c = m.body("c")
    m.revolute("j1", m.ground, a)
    m.revolute("j2", a, b, at=(scale, 0), cut=cut == "j2")
    m.prismatic("s", m.ground, k, at=(2 * scale, 0), axis=(1, 0))
    m.revolute("j3", b, k, at=(scale, 0), cut=cut == "j3")
    m.revolute("j4", m.ground, c, at=place(2, 1, scale, mirrored), cut=cut == "j4")
    m.revolute("j5", c, k, at=(scale, 0), cut=cut == "j5")
    system = m.build()
    return system, system.q({"j4": -way * pi / 2, "j5": way * pi / 2})


def tripod(
    seed: int, bars: int, scale: float = 1.0, mirrored: bool = False, flip: bool = False
) -> Mechanism:
    """A random planar mechanism of `bars` bodies with two joints more than a tree has, closed at
    neutral.
    """
    rng = np.random.default_rng(seed)
    m = Mechanism("random", dim=2)
    m_bodies = [m.ground] + [m.body(f"{'z' if flip else 'b'}{i}") for i in range(bars)]
    edges = [(int(rng.integers(0, i)), i) for i in range(1, bars + 1)]
    while len(edges) < bars + 3:
        i, j = sorted(rng.choice(bars + 1, size=2, replace=False).tolist())
        edges.append((i, j))
    for k, (i, j) in enumerate(edges):
        x, y = place(*rng.uniform(-1, 1, size=2), scale, mirrored)
        a, b = (m_bodies[j], m_bodies[i]) if flip else (m_bodies[i], m_bodies[j])
        m.revolute(f"j{k}", a, b, at=(x, y), child_at=(x, y), cut=flip and k % 3 == 0)
    return m


# ---- published values


def of_library(name: str, posture: str) -> LocalDimension:
    system = kempe.load(name)
    return find_local_dimension(system, system.q(posture))


@pytest.mark.parametrize("case", PLANAR + SINGULAR, ids=str)
def test_planar_mechanisms(case: Case):
    found = of_library(case.name, case.posture)
    assert (found.rank_dim, found.dim) == (case.rank, case.true), str(found)
    assert found.certain, str(found)
    if case.branches:
        assert sorted(found.branch_dims) == sorted(case.branches), str(found)
    assert found.smooth == (case.rank == case.true and len(case.branches) < 2)


TO_AN_ORDER = {
    "bricard_trihedral",
    "bricard_rectangular",
    "bricard_line_symmetric",
    "goldberg_5r",
    "schatz",
    "delta_uu",
}
"""Mechanisms that move by theorems about their lengths, which are not looked at."""


@pytest.mark.parametrize("case", SPATIAL, ids=lambda c: c.name)
def test_spatial_mechanisms(case: Spatial):
    found = of_library(case.name, "closed")
    assert (found.rank_dim, found.dim) == (case.rank, case.dof), str(found)
    assert found.certain == (case.name not in TO_AN_ORDER), str(found)
    assert found.certain or "to order 8, not proven" in str(found) and not found.doubts
    assert found.smooth == (case.rank == case.dof)
    assert (found.sampled is None) == (found.smooth and found.certain)


@pytest.mark.parametrize(
    "name", ["parallelogram", "kite", "slider_crank_equal", "row_of_four_bars", "wunderlich"]
)
def test_branches_are_the_motions_in_closed_form(name):
    """Each motion through the posture is found once: the tangent is its derivative, and the nearby
    point is on it.
    """
    case = next(c for c in (*SINGULAR, *PLANAR) if c.name == name and c.branches)
    system = kempe.load(name)
    found = of_library(name, case.posture)
    scale = Equations(system).scale[:, None]
    free = list(range(len(found.branches)))
    for dim, motion in branches(name):
        h = 1e-4
        steps = [[h if i == j else 0.0 for j in range(dim)] for i in range(dim)]
        T = np.stack(
            [
                system.configuration_space.difference(
                    system.q(motion(*[-x for x in s])), system.q(motion(*s))
                )
                for s in steps
            ],
            1,
        )
        T = np.linalg.qr(T / scale)[0]
        distance = {}
        for i in free:
            if found.branches[i].dim == dim:
                U = found.branches[i].tangent / scale
                distance[i] = np.linalg.norm(U - T @ (T.T @ U))
        best = min(distance, key=lambda i: distance[i])
        assert distance[best] < 1e-2, (name, distance)
        assert np.abs(system.loops.closure_error(found.branches[best].q)).max() < 1e-10
        free.remove(best)
    assert not free


# ---- shaky structures, cusps


def test_stretched_bars_are_isolated_of_the_second_order():
    system, q = flat([1, 1, 2], [1, 1])
    found = find_local_dimension(system, q)
    assert (found.rank_dim, found.dim, found.obstruction_order, found.isolated) == (1, 0, 2, True)
    assert found.branches == () and not found.smooth and found.certain
    assert "shaky of order 1" in str(found)


def test_leading_coefficient_of_stretched_bars():
    """Turn the bars, of lengths a and b, by u/a and -u/b: their end comes nearer by u^2 (1/a + 1/b)
    / 2 + O(u^4).
    """
    a = 1.0
    b = 1.6
    system, q = flat([a, b, a + b], [1, 1])
    equations = Equations(system)
    at = lyapunov_schmidt.split_equations(equations, q)
    g = lyapunov_schmidt._solve_coefficients(
        equations, at, lyapunov_schmidt.make_lines(np.ones((1, 1)), 4), None
    )[0][0]
    turn = at.null_space[list(system.structure.velocity_names).index("j0"), 0]  # of the first bar
    assert abs(g[2, 0]) == pytest.approx(
        0.5 * (a * turn) ** 2 * (1 / a + 1 / b) / equations.length, rel=1e-12
    )
    assert np.abs(g[[1, 3]]).max() < 1e-14  # mirrored motions are alike


def test_dead_centres_in_a_row_are_isolated_of_the_fourth_order():
    found = find_local_dimension(*dead_centres_in_a_row())
    assert (found.rank_dim, found.dim, found.obstruction_order) == (1, 0, 4) and found.certain
    assert found.sampled == 0


@pytest.mark.parametrize(("second", "turned"), [(1.0, True), (0.6, False)])
def test_double_watt_has_a_cusp(second, turned):
    """Connelly and Servatius, 1994: it moves, but along no curve with a velocity."""
    found = find_local_dimension(*double_watt(second, turned))
    assert (found.rank_dim, found.dim, found.branch_dims) == (2, 1, (1,)), str(found)
    assert found.branches[0].cusp and found.branches[0].ends == 2 and found.certain
    assert "cusp" in str(found)


def test_branches_that_touch_too_closely_are_not_counted():
    """Two equal linkages of Watt: the bar translates, or turns by a fourth power: two curves that
    nearly coincide.
    """
    found = find_local_dimension(*double_watt(1.0, False))
    assert (found.rank_dim, found.dim) == (2, 1)
    assert not found.counted and "nearly coincide" in str(found)


def beside_a_pendulum(system: System, q: np.ndarray) -> tuple[System, np.ndarray]:
    """The mechanism with a pendulum of its own on the ground: one freedom more, everywhere."""
    m = system.mechanism
    m.revolute("swing", m.ground, m.body("bob"), at=(0, -1))
    more = m.build()
    return more, more.q({**system.q_dict(q), "swing": 0.3})


@pytest.mark.parametrize("seed", some(range(5), 3))
def test_a_pendulum_beside_shaky_structures(seed):
    """One freedom, shaky everywhere, also of the fourth order, whose roots are known to 1e-4 only."""
    found = find_local_dimension(*beside_a_pendulum(*flat([1, 1.5, 2.5], [1, 1])), rng=seed)
    assert key(found) == (1, 2, 2, [1], False) and found.certain and found.branches[0].multiple
    found = find_local_dimension(*beside_a_pendulum(*dead_centres_in_a_row()), rng=seed)
    assert (found.rank_dim, found.dim, found.obstruction_order) == (2, 1, 4)


def test_four_stretched_bars_are_rigid_though_the_rank_says_two():
    system, q = flat([1, 1, 1, 3], [1, 1, 1])
    found = find_local_dimension(system, q)
    assert (found.rank_dim, found.dim, found.sampled) == (2, 0, 0) and found.certain


@pytest.mark.parametrize(
    ("lengths", "signs", "dims"),
    [
        ([1.0, 2.0, 1.0, 2.0], [1, 1, -1], (1, 1)),
        ([1.0, 1.0, 1.0, 1.0], [1, 1, -1], (1, 1)),
        ([1.0, 1.0, 2.0, 2.0], [1, -1, 1], (1, 1)),
        ([1.0, 2.0, 2.0, 1.0], [1, 1, -1], (1, 1)),
        ([1.0, 1.3, 0.7, 3.0], [1, 1, 1], ()),
        ([3.0, 1.0, 0.7, 1.3], [1, -1, -1], ()),
        ([1.0, 2.5, 2.0, 1.5], [1, 1, -1], (1, 1)),
    ],
)
def test_flat_four_bars(lengths, signs, dims):
    """A flat four-bar is rigid where the longest link equals the sum of the others; else two
    branches cross.
    """
    system, q = flat(lengths, signs)
    found = find_local_dimension(system, q)
    assert found.rank_dim == 2 and found.branch_dims == dims and found.certain, str(found)
    assert all(b.ends == 2 and not b.cusp for b in found.branches)


@pytest.mark.slow
@settings(max_examples=examples(25), deadline=None)
@given(st.integers(0, 10**6), st.integers(3, 6))
def test_flat_loops_by_the_signature_of_their_quadratic_form(seed, links):
    """Links l_i, turned by t_i out of a line (s_i = +-1 along it), stay closed if sum s_i l_i sin
    t_i = 0 and sum s_i l_i (1 - cos t_i) = 0. The form sum s_i l_i t_i^2 on the plane sum s_i l_i
    t_i = 0 decides: definite, the loop is rigid; else its zeros are a cone, two lines where there
    are two unknowns (Morse's lemma).
    """
    rng = np.random.default_rng(seed)
    lengths = rng.uniform(0.6, 1.4, size=links)
    signs = rng.choice([1, -1], size=links)
    if (lengths * signs).sum() < 0.3:
        signs = -signs
    w = lengths * signs
    plane = np.linalg.svd(w[None])[2][1:]
    eigen = np.linalg.eigvalsh(plane @ np.diag(w) @ plane.T)
    assume(w.sum() >= 0.3 and np.abs(eigen).min() >= 0.1)
    system, q = flat([*lengths, w.sum()], signs.tolist())
    found = find_local_dimension(system, q, rng=seed)
    assert (found.rank_dim, found.obstruction_order, found.certain) == (links - 1, 2, True), str(
        found
    )
    if eigen[0] > 0 or eigen[-1] < 0:
        assert found.dim == 0 and not found.branches
    elif links == 3:
        assert found.branch_dims == (1, 1) and not any(b.cone for b in found.branches)
    else:
        assert found.branch_dims == (links - 2,) and found.branches[0].cone, str(found)


# ---- generic mechanisms against velocities of bodies


def freedoms_of_bodies(m: Mechanism) -> int:
    """Nullity of the constraints of all joints on the planar velocities (x, y, turn) of all bodies
    at neutral.
    """
    column = {b: 3 * (i - 1) for i, b in enumerate(m.bodies)}
    G = np.zeros((2 * len(m.joints), 3 * (len(m.bodies) - 1)))
    for k, joint in enumerate(m.joints.values()):
        x, y = joint.X_PF.evaluate_pose({})[:2, 3]
        for body, sign in ((joint.parent, -1.0), (joint.child, 1.0)):
            if column[body] >= 0:
                G[2 * k : 2 * k + 2, column[body] : column[body] + 3] += sign * np.array(
                    [[1, 0, -y], [0, 1, x]]
                )
    return G.shape[1] - int(np.linalg.matrix_rank(G, tol=1e-9))


@pytest.mark.slow
@settings(max_examples=examples(12), deadline=None)
@given(st.integers(0, 10**6), st.integers(4, 8))
def test_random_mechanisms_of_three_loops(seed, bars):
    m = tripod(seed, bars)
    system = m.build()
    assert len(system.structure.closures) == 3
    found = find_local_dimension(system, system.neutral)
    expected = freedoms_of_bodies(m)
    assert found.rank_dim == expected
    # at random points a part with more constraints than it needs is rigid: then all first-order
    # motions are motions; where several parts share what is redundant there may be no proof, and
    # the answer says so
    assert (
        found.dim == expected and found.smooth and (found.certain or "not proven" in str(found))
    ), str(found)
    assert found.dim - found.corank == 3 * bars - 2 * len(m.joints)


# ---- what cannot change the answer


def key(found: LocalDimension) -> tuple:
    return (
        found.dim,
        found.rank_dim,
        found.obstruction_order,
        sorted(found.branch_dims),
        found.smooth,
    )


@settings(max_examples=examples(8), deadline=None)
@given(st.floats(-3, 3), st.booleans(), st.integers(-1, 3), st.integers(0, 1000))
def test_a_flat_parallelogram_anyhow(power, mirrored, cut, seed):
    system, q = flat(
        [1, 2, 1, 2], [1, 1, -1], scale=10.0**power, mirrored=mirrored, cut=cut, name="any "
    )
    found = find_local_dimension(system, q, rng=seed)
    assert key(found) == (1, 2, 2, [1, 1], False) and found.certain


@settings(max_examples=examples(6), deadline=None)
@given(st.floats(-3, 3), st.booleans(), st.sampled_from(["", "j2", "j3", "j4", "j5"]))
def test_dead_centres_anyhow(power, mirrored, cut):
    found = find_local_dimension(*dead_centres_in_a_row(10.0**power, mirrored, cut))
    assert key(found) == (0, 1, 4, [], False) and found.certain


@pytest.mark.slow
@settings(max_examples=examples(6), deadline=None)
@given(st.floats(-3, 3), st.booleans(), st.sampled_from(["m1", "m2", "l1", "l2"]))
def test_a_cusp_anyhow(power, mirrored, cut):
    found = find_local_dimension(*double_watt(0.7, False, 10.0**power, mirrored, cut))
    assert key(found) == (1, 2, 2, [1], False) and found.branches[0].cusp


@settings(max_examples=examples(6), deadline=None)
@given(st.integers(0, 10**6), st.floats(-3, 3), st.booleans())
def test_random_mechanisms_anyhow(seed, power, mirrored):
    plain = tripod(seed, 6).build()
    other = tripod(seed, 6, 10.0**power, mirrored, flip=True).build()
    one = find_local_dimension(plain, plain.neutral)
    two = find_local_dimension(other, other.neutral)
    assert key(one) == key(two)


@pytest.mark.parametrize("name", ["bennett", "sarrus", "bricard_trihedral"])
def test_an_overconstrained_loop_away_from_its_library_posture(name):
    """Assembled anew elsewhere on the same motion it is the same."""
    system = kempe.load(name)
    first = find_local_dimension(system, system.q("closed"))
    at = lyapunov_schmidt.split_equations(Equations(system), first.q)
    equations = Equations(system)
    found = equations.project_points(
        equations.move_configurations(first.q, 0.3 * at.null_space[:, 0]), first.q
    )
    assert found.residual[0] < 1e-12 and found.distance[0] > 0.2
    assert key(find_local_dimension(system, found.q[0])) == key(first) == (1, 1, None, [1], True)


def test_both_methods_are_independent_of_the_seed():
    system = kempe.load("three_upu_snu")
    answers = {
        key_tuple(find_local_dimension(system, system.q("closed"), rng=seed)) for seed in range(4)
    }
    assert answers == {(3, 5, 2, (3, 3), False)}


def key_tuple(found: LocalDimension) -> tuple:
    return tuple(tuple(x) if isinstance(x, list) else x for x in key(found))


# ---- the equations


def tied() -> System:
    """An arm of a slide, hinges and a ball, with a differential, surfaces and a law of coordinates;
    in centimetres.
    """
    m = Mechanism("tied")
    m.prismatic("p", m.ground, m.body("cart"), axis=(1, 0, 0))
    m.revolute("a", "cart", m.body("upper"), at=(0.01, 0, 0.02), axis=(0, 1, 0))
    m.revolute("b", "upper", m.body("lower"), at=(0.03, 0, 0), axis=(0, 0, 1))
    m.spherical("s", "lower", m.body("hand"), at=(0.02, 0.01, 0))
    m.couple("b", {"a": 0.5, "p": -20.0}, offset=0.1)
    m.equation("law", "100*p - sin(a) = 0.2")
    m.frame("tip", "hand", at=(0.02, 0, 0.01))
    m.constrain(constraints.OnSurface("tip", "x^2 + 4*y^2 + z^2 = 0.005"), "egg")
    m.postures["closed"] = m.build().q_dict(m.build().assemble(start=m.build().random(1)).q)
    return m.build()


@pytest.mark.parametrize(
    "name", ["sarrus", "stewart", "delta_uu", "three_rps", "wunderlich", "slider_crank", "tied"]
)
def test_equations_say_the_same_as_the_loops(name):
    """Their Jacobians at a closed configuration have the same null space as those of
    `kinematics.loops`.
    """
    system = tied() if name == "tied" else kempe.load(name)
    q = system.q("closed")
    equations = Equations(system)
    value, J = equations.linearise_equations(q)
    assert np.abs(value).max() < 1e-12
    other = closure_rows.compute_jacobian(system, q) * equations.scale
    at = lyapunov_schmidt.split_jacobian(q, J[0])
    assert J[0].shape == other.shape and at.rank == np.linalg.matrix_rank(other, tol=1e-7)
    assert np.abs(other @ at.null_space).max() < 1e-12 * max(1.0, equations.length)


def test_declared_constraints_and_relations_count():
    """A rod makes a planar two-link arm a four-bar; a relation of both angles then holds it."""
    m = Mechanism("arm", dim=2)
    upper = m.body("upper")
    lower = m.body("lower")
    m.revolute("a", m.ground, upper)
    m.revolute("b", upper, lower, at=(1, 0))
    m.distance("rod", m.ground, lower, at=(2, 1), child_at=(1, 0), length=1.0)
    system = m.build()
    found = find_local_dimension(system, system.neutral)
    assert (found.dim, found.smooth, found.corank) == (1, True, 0)
    d = Equations(system).linearise_equations(system.neutral)[1][0, 0]
    ab = [list(system.structure.velocity_names).index(n) for n in "ab"]
    assert d[ab[0]] == pytest.approx(2 * d[ab[1]])  # by symmetry: lever arms 2 and 1
    assert (
        sample_dimension(
            Equations(system),
            lyapunov_schmidt.split_equations(Equations(system), system.neutral),
            np.random.default_rng(0),
        )
        == 1
    )
    m.equation("law", "a + b = 0")
    assert find_local_dimension(m.build(), system.neutral).dim == 0


# ---- answers and errors


def test_trees_are_manifolds():
    system = kempe.load("two_link")
    found = find_local_dimension(system, system.neutral)
    assert (found.dim, found.rank_dim, found.smooth, found.certain) == (
        system.nv,
        system.nv,
        True,
        True,
    )


def test_open_configurations_are_refused_with_the_joint():
    system, q = flat([1, 2, 1, 2], [1, 1, -1])
    with pytest.raises(InputError, match=r"open: 'j\d' \((x|y|rz)\) by .*assemble"):
        find_local_dimension(system, q + 0.1)
    with pytest.raises(InputError, match="open"):
        find_local_dimension(system, np.full(system.nq, np.nan))
    with pytest.raises(InputError, match="one configuration"):
        find_local_dimension(system, np.stack([q, q]))
    with pytest.raises(InputError, match="order"):
        find_local_dimension(system, q, order=1)


def test_last_digits_are_corrected():
    a = 0.4
    b = 0.5
    system, q = chain([1.0, 1.0, 1.0, 2 * cos(a) + cos(b)], [a, -b, -a], name="")
    assert abs(sin(a) - sin(b) - sin(a)) > 0.1  # not closed: a guess
    equations = Equations(system)
    closed = equations.project_points(q, q).q[0]
    rough = closed + 1e-8 * np.array([1.0, -1.0, 1.0, 1.0])
    found = find_local_dimension(system, rough)
    assert np.abs(equations.linearise_equations(found.q)[0]).max() < 1e-14 and found.dim == 1


def test_without_sampling():
    system, q = flat([1, 1, 2], [1, 1])
    assert find_local_dimension(system, q, sampling=False).sampled is None


@pytest.mark.slow
def test_a_platform_on_parallel_legs_of_one_length_translates():
    """All legs are one vector of that length: a sphere of translations; the turn about the legs is
    to first order.
    """
    m = look(on_rods("translation", BENT, BENT + [0.3, 0.2, 1.4]))
    assert (m.gruebler, m.rank_dof, m.dof, m.local.branch_dims, m.local.doubts) == (
        0,
        3,
        2,
        (2,),
        (),
    )


@pytest.mark.slow
@pytest.mark.parametrize("seed", some(range(3), 3))
def test_branches_with_the_same_null_space_are_distinguished(seed):
    """Legs on a circle, straight up: it translates (2), or turns while it sinks (1); three null
    vectors along both.
    """
    m = look(on_rods("circle", HEXAGON, HEXAGON + [0, 0, 1.4]), rng=seed)
    assert (m.rank_dof, m.dof, m.local.branch_dims, m.local.doubts) == (3, 2, (2, 1), ()), str(m)


def in_a_row(stages: int) -> World:
    """Stretched bars shift a slider by s^2, which at the dead centre of the next shifts that by
    s^4, and so on.
    """
    w = World("dead centres", 2)
    w.turn("ground", "a", (0, 0))
    w.turn("a", "b", (1, 0))
    p = np.array([2.0, 0.0])
    along = np.array([1.0, 0.0])
    w.turn("b", "k0", p)
    w.slide("k0", "ground", along, p)
    for i in range(1, stages):
        along = np.array([-along[1], along[0]])
        end = "ground" if i == stages - 1 else f"k{i}"
        w.turn(f"k{i - 1}", f"c{i}", p)
        p = p + along
        w.turn(f"c{i}", end, p)
        if end != "ground":
            w.slide(end, "ground", along, p)
    return w


@pytest.mark.parametrize("stages", [2, 3, 4])
def test_what_is_shaky_of_a_high_order_is_not_called_mobile_for_certain(stages):
    """Rigid, though s^(2^stages) = 0 is all that says so; s^16 is beyond rounding for s = 0.1."""
    m = look(in_a_row(stages))
    assert m.rank_dof == 1
    assert m.dof == 0 or not m.certain and "of freedom to order 8" in m.sentence
    assert stages > 3 or (m.dof, m.local.obstruction_order) == (0, 2**stages)


def torus(at, normal) -> World:
    """A point of an arm of two hinges, at distance 1 from the second, in a plane that touches its
    torus.
    """
    w = World("torus")
    w.turn("ground", "a", (0, 0, 0), Z)
    w.turn("a", "b", (2, 0, 0), Y)
    w.plane("ground", "b", at, normal)
    return w


@pytest.mark.parametrize("moved", [False, True])
@pytest.mark.parametrize(
    ("at", "normal", "dof", "generic", "branches"),
    [((3, 0, 0), X, 0, 2, ()), ((1, 0, 0), X, 1, 1, (1, 1)), ((2, 0, 1), Z, 1, 2, (1,))],
    ids=["outside: a point", "inside: a node", "on top: a circle, twice"],
)
def test_a_plane_that_touches_a_torus(at, normal, dof, generic, branches, moved):
    m = look(torus(at, normal), moved=moved)
    assert (m.gruebler, m.rank_dof, m.dof, m.singular) == (1, 2, dof, True), str(m)
    assert m.generic_rank_dof == generic and m.local.branch_dims == branches


def test_nothing_to_move():
    assert find_local_dimension(Mechanism("empty").build(), []).dim == 0
    frame = World("frame")
    frame.joint("fixed", "ground", "a")
    frame.joint("fixed", "a", "b", (1, 0, 0))
    frame.joint("fixed", "b", "ground", (0, 1, 0))
    assert find_local_dimension(frame.build(), []).dim == 0 and look(frame).redundant == 6

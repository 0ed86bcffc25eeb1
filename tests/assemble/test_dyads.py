"""Dyads in closed form: exact solutions, circles by hand, random mechanisms closed by construction,
edge cases.
"""

from __future__ import annotations

import cmath
import contextlib
import math
import pickle

import numpy as np
import pytest
import sympy as sp
from dyad_chains import DYADS, Chain, random_chain
from hypothesis import given
from hypothesis import strategies as st

import kempe
from kempe import Mechanism
from kempe.assemble.dyads import Incomplete, Plan, find_closed_form, solve_branch
from kempe.equations import closure_rows
from kempe.errors import InputError, UnknownNameError, UnsupportedError

seeds = st.integers(0, 2**32)


def plan_of(system, *known) -> Plan:
    plan = find_closed_form(system, known)
    assert isinstance(plan, Plan), str(plan)
    return plan


def four_bar(a=1.0, b=3.0, c=2.5, d=3.5, **limits) -> kempe.System:
    m = Mechanism("four-bar", dim=2)
    crank = m.body("crank")
    coupler = m.body("coupler")
    rocker = m.body("rocker")
    m.revolute("A", m.ground, crank)
    m.revolute("B", crank, coupler, at=(a, 0))
    m.revolute("C", coupler, rocker, at=(b, 0), child_at=(c, 0), **limits)
    m.revolute("D", m.ground, rocker, at=(d, 0))
    return m.build()


def slider_crank(r=1.0, rod=3.0, offset=0.5) -> kempe.System:
    m = Mechanism("slider-crank", dim=2)
    crank = m.body("crank")
    link = m.body("rod")
    piston = m.body("piston")
    m.revolute("A", m.ground, crank)
    m.revolute("B", crank, link, at=(r, 0))
    m.revolute("C", link, piston, at=(rod, 0))
    m.prismatic("S", m.ground, piston, at=(0, offset), axis=(1, 0))
    return m.build()


def assert_closed(system, q, tolerance=1e-12):
    assert np.abs(system.loops.closure_error(q)).max(initial=0.0) < tolerance


def angle_between(a, b):
    return np.abs(np.angle(np.exp(1j * (np.asarray(a) - np.asarray(b)))))


# ---- exact solutions


def test_four_bar_as_sympy_solves_it():
    """Crank at the angle of the 3-4-5 triangle; both closures as exact roots of two polynomials."""
    system = four_bar(1.0, 3.0, 2.5, 3.5)
    x, y = sp.symbols("x y", real=True)
    px, py, b, c, d = (sp.Rational(n, 10) for n in (6, 8, 30, 25, 35))
    roots = sp.solve([(x - px) ** 2 + (y - py) ** 2 - b**2, (x - d) ** 2 + y**2 - c**2], [x, y])
    assert len(roots) == 2
    plan = plan_of(system, "A")
    q, mask = plan.all([math.atan2(4, 3)])
    assert mask.all() and plan.signs == 1
    for signs, row in zip(plan.branches(), q, strict=True):
        C = system.fk(row, "rocker") @ [2.5, 0, 0, 1]
        exact = [[float(v.evalf(30)) for v in root] for root in roots]
        apart = [math.hypot(C[0] - ex, C[1] - ey) for ex, ey in exact]
        assert min(apart) < 1e-14
        ex, ey = exact[int(np.argmin(apart))]
        B = np.array([0.6, 0.8])
        D = np.array([3.5, 0.0])
        left = (D - B)[0] * (ey - B[1]) - (D - B)[1] * (ex - B[0])
        assert signs[0] == np.sign(left), "the sign is the side of C on the way from B to D"
        assert abs(row[0] - math.atan2(4, 3)) == 0.0
        assert angle_between(row[3], math.atan2(ey, ex - 3.5)) < 1e-14
    assert_closed(system, q)


def test_slider_crank_as_sympy_solves_it():
    system = slider_crank(1.0, 3.0, 0.5)
    s = sp.symbols("s", real=True)
    roots = sorted(
        sp.solve((s - sp.Rational(3, 5)) ** 2 + (sp.Rational(1, 2) - sp.Rational(4, 5)) ** 2 - 9, s)
    )
    plan = plan_of(system, "A")
    slides = [plan.solve([math.atan2(4, 3)], sign)[0][3] for sign in ("-", "+")]
    assert np.abs(np.array(slides) - [float(r.evalf(30)) for r in roots]).max() < 1e-15


def test_five_bar_with_both_cranks_known():
    m = Mechanism("five-bar", dim=2)
    a, b, c, d = (m.body(n) for n in ("a", "b", "c", "d"))
    m.revolute("A", m.ground, a)
    m.revolute("B", a, b, at=(1, 0))
    m.revolute("C", b, c, at=(2, 0), child_at=(2, 0))
    m.revolute("D", d, c, at=(1, 0))
    m.revolute("E", m.ground, d, at=(1.5, 0))
    system = m.build()
    q, mask = plan_of(system, "A", "E").all([[2.0, 1.0], [1.5, 1.5]])
    assert mask.all() and q.shape == (2, 2, 5)
    assert_closed(system, q)
    tips = system.fk(q, "b") @ [2, 0, 0, 1]
    for values, pair in zip([[2.0, 1.0], [1.5, 1.5]], tips, strict=True):
        p = cmath.exp(1j * values[0])
        o = 1.5 + cmath.exp(1j * values[1])
        half = (o - p) / 2
        by_hand = [
            p + half + 1j * side * half / abs(half) * math.sqrt(4 - abs(half) ** 2)
            for side in (1, -1)
        ]
        assert {complex(*np.round(t[:2], 12)) for t in pair} == {
            complex(np.round(z, 12)) for z in by_hand
        }
    assert isinstance(find_closed_form(system, ["A"]), Incomplete)


@pytest.mark.parametrize("name", ["bennett", "rssr", "delta_uu"])
def test_what_has_no_closed_form_says_so_when_it_is_used(name):
    """All that a plan has: the reason, and what to ask in its place."""
    system = kempe.load(name)
    none = find_closed_form(system, [system.coordinate_names[0]])
    assert isinstance(none, Incomplete) and "is not planar" in none.describe()
    for use in ("formulas", "solve", "close", "all", "heights", "branch_of"):
        assert hasattr(Plan, use)
        with pytest.raises(
            UnsupportedError, match="is not planar; `assemble` and `assembly_modes` find"
        ):
            getattr(none, use)()


# ---- circles by hand


def meet(p: complex, r: float, c: complex, s: float, side: int) -> complex:
    """Where two circles meet, to the left (+1) or to the right (-1) of the way from p to c."""
    d = abs(c - p)
    x = (r * r - s * s + d * d) / (2 * d)
    return p + (c - p) / d * complex(x, side * math.sqrt(r * r - x * x))


def jansen() -> kempe.System:
    """Leg with a b c d e f g h i j k l m = 38 41.5 39.3 40.1 55.8 39.4 36.7 65.7 49 50 61.9 7.8 15
    (Jansen, 2007).
    """
    m = Mechanism("jansen", dim=2)
    crank, j, k, bde, c, f, ghi = (m.body(n) for n in ("crank", "j", "k", "bde", "c", "f", "ghi"))
    e = corner(41.5, 40.1, 55.8)
    m.revolute("O", m.ground, crank)
    m.revolute("Mj", crank, j, at=(15, 0))
    m.revolute("Mk", crank, k, at=(15, 0))
    m.revolute("Kb", m.ground, bde, at=(-38, -7.8))
    m.revolute("Kc", m.ground, c, at=(-38, -7.8))
    m.revolute("Bj", j, bde, at=(50, 0), child_at=(41.5, 0))
    m.revolute("Dk", k, c, at=(61.9, 0), child_at=(39.3, 0))
    m.revolute("Ef", bde, f, at=(e.real, e.imag))
    m.revolute("Gf", f, ghi, at=(39.4, 0))
    m.revolute("Gc", c, ghi, at=(39.3, 0), child_at=(36.7, 0))
    i = corner(36.7, 49.0, 65.7)
    m.frame("foot", ghi, at=(i.real, i.imag))
    return m.build()


def corner(base: float, start: float, end: float) -> complex:
    """The third corner of a triangle on a base along x, at these distances from the base's start
    and end.
    """
    return meet(0j, start, complex(base, 0), end, 1)


def jansen_by_hand(angle: float, signs) -> list[complex]:
    M = 15 * cmath.exp(1j * angle)
    K = complex(-38, -7.8)
    B = meet(M, 50, K, 41.5, signs[0])
    D = meet(M, 61.9, K, 39.3, signs[1])
    E = K + (B - K) / 41.5 * corner(41.5, 40.1, 55.8)
    G = meet(E, 39.4, D, 36.7, signs[2])
    return [B, D, E, G]


def all_by_hand(angle: float) -> list:
    """Those of the eight branches at a crank angle of which all circles meet."""
    hands = []
    for signs in np.ndindex(2, 2, 2):
        with contextlib.suppress(ValueError):
            hands.append(jansen_by_hand(angle, 1 - 2 * np.array(signs)))
    return hands


def test_jansen_by_chained_circles():
    """All eight branches at many crank angles, by hand: 2^3 dyads, the joints where the circles
    meet.
    """
    system = jansen()
    plan = plan_of(system, "O")
    assert plan.signs == 3 and [d.kind for d in plan.dyads] == ["RRR"] * 3
    angles = np.linspace(-math.pi, math.pi, 37)
    q, mask = plan.all(angles[:, None])
    assert_closed(system, q[mask], 1e-11)
    X = system.fk(q)
    number = {b: i for i, b in enumerate(system.body_names)}
    point = lambda body, x, y: (X[..., number[body], :, :] @ [x, y, 0, 1])[..., :2] @ [1, 1j]  # noqa: E731
    places = np.stack(
        [point("j", 50, 0), point("k", 61.9, 0), point("f", 0, 0), point("f", 39.4, 0)], -1
    )
    compared = 0
    for n, angle in enumerate(angles):
        hands = all_by_hand(angle)
        ours = places[n][mask[n]]
        assert len(ours) == len(hands)
        for hand in hands:
            assert np.abs(ours - np.array(hand)).max(axis=-1).min() < 1e-9
            compared += 1
    assert compared > 200


def peaucellier(star: bool) -> kempe.System:
    """Inversor; `star`: the three links of a vertex are joined to one of them, else one after the
    other.
    """
    m = Mechanism("peaucellier", dim=2)
    a, b, crank, ca, cb, da, db = (m.body(n) for n in ("a", "b", "crank", "ca", "cb", "da", "db"))
    m.revolute("Q", m.ground, crank, at=(1, 0))
    m.revolute("Oa", m.ground, a)
    m.revolute("Ob", m.ground, b)
    m.revolute("Ca", crank, ca, at=(1, 0))
    m.revolute("Cb", *((crank, cb) if star else (ca, cb)), at=(1, 0) if star else (0, 0))
    m.revolute("Aa", a, ca, at=(3, 0), child_at=(1.6, 0))
    m.revolute("Da", *((a, da) if star else (ca, da)), at=(3, 0) if star else (1.6, 0))
    m.revolute("Bb", cb, b, at=(1.6, 0), child_at=(3, 0))
    m.revolute("Db", *((b, db) if star else (cb, db)), at=(3, 0) if star else (1.6, 0))
    m.revolute("D", da, db, at=(1.6, 0), child_at=(1.6, 0))
    return m.build()


@pytest.mark.parametrize("star", [True, False])
def test_peaucellier_draws_a_straight_line(star):
    """D runs on x = (3^2 - 1.6^2) / 2 = 3.22, whichever links a pin of three is said to join."""
    system = peaucellier(star)
    plan = plan_of(system, "Q")
    assert plan.signs == 3
    angles = np.linspace(-0.9, 0.9, 101)[:, None]
    straight = 0
    for signs in plan.branches():
        q, ok, gap = plan.solve(angles, signs)
        assert ok.all() and gap.max() < 1e-13
        assert_closed(system, q)
        C, D = (
            (system.fk(q, b) @ [1.0 if b == "crank" else 1.6, 0, 0, 1])[:, :2]
            for b in ("crank", "da")
        )
        A, B = ((system.fk(q, b) @ [3.0, 0, 0, 1])[:, :2] for b in "ab")
        if np.abs(A - B).max() > 1e-9 and np.abs(C - D).max() > 1e-9:
            assert np.abs(D[:, 0] - 3.22).max() < 1e-12
            straight += 1
    assert straight == 2, "A above B and the mirror image; in the other six A = B or C = D"


# ---- random mechanisms, closed by construction


def check(chain: Chain, ground: str = "ground") -> None:
    """The configuration that the mechanism was built around is found again, and all others close."""
    system = chain.system(ground)
    plan = plan_of(system, *chain.known)
    reference = system.q(chain.values)
    values = [chain.values[k] for k in chain.known]
    assert plan.signs == chain.two_roots
    q, ok, gap = plan.solve(values, start=reference)
    assert ok and gap < 1e-12 and np.abs(q - reference).max() < 1e-8
    every, mask = plan.all(values)
    assert mask.any()
    assert_closed(system, every[mask])
    assert np.array_equal(plan.branch_of(every[mask]), plan.branches()[mask])


@pytest.mark.parametrize("kind", DYADS)
def test_each_kind_of_dyad(kind):
    for seed in range(8):
        chain = random_chain(seed, (kind,), most=2, variable=False)
        assert set(chain.kinds) == {kind}
        check(chain)


@given(seeds)
def test_random_chains_of_dyads(seed):
    check(random_chain(seed))


@pytest.mark.slow
@given(seeds)
def test_any_body_can_be_the_ground(seed):
    """Then rings close that do not contain the ground."""
    chain = random_chain(seed, most=3)
    for ground in list(chain.poses)[1:]:
        check(chain, ground)


@given(seeds)
def test_order_of_declaration_does_not_matter(seed):
    chain = random_chain(seed)
    plans = [plan_of(chain.system(), *chain.known) for _ in range(2)]
    values = [chain.values[k] for k in chain.known]
    for signs in plans[0].branches():
        first, second = (p.system.q_dict(p.solve(values, signs)[0]) for p in plans)
        for name, x in first.items():
            assert abs(x - second[name]) < 1e-7 or angle_between(x, second[name]) < 1e-7
    assert [d.joints for d in plans[0].dyads] == [d.joints for d in plans[1].dyads]


@pytest.mark.parametrize("scale, side", [(7.0, 1.0), (1.0, -1.0), (1e-6, -1.0), (1e5, 1.0)])
@given(seeds)
def test_mirrored_and_scaled(scale, side, seed):
    """A mirror turns the signs of RRR dyads, a change of size does not."""
    chain = random_chain(seed, ("RRR",), variable=False)
    image = Chain(chain.rng)
    image.poses = chain.poses
    image.known = chain.known
    slides = {name for name, kind, *_ in chain.joints if kind == "prismatic"}
    for name, kind, a, b, where in chain.joints:
        new = {k: side * x for k, x in where.items() if k.endswith("angle")}
        new |= {
            k: (scale * x[0], scale * side * x[1]) for k, x in where.items() if k.endswith("at")
        }
        if kind == "prismatic":
            new["axis"] = (where["axis"][0], side * where["axis"][1])
        image.joints.append((name, kind, a, b, new))
        image.values[name] = chain.values[name] * (scale if name in slides else side)
    plan = plan_of(chain.system(), *chain.known)
    other = plan_of(image.system(), *chain.known)
    here = plan.system.q(chain.values)
    there = other.system.q(image.values)
    signs = plan.branch_of(here)
    assert np.array_equal(other.branch_of(there), side * signs)
    assert np.allclose(
        other.heights(there), side * scale * plan.heights(here), rtol=1e-9, atol=1e-12 * scale
    )
    assert other.solve([image.values[k] for k in chain.known], side * signs)[1]


@pytest.mark.parametrize("sign", "+-")
def test_signs_stay_along_a_motion(sign):
    """A branch is continuous: small steps of the crank give small steps of all, on each sign."""
    system = four_bar()
    plan = plan_of(system, "A")
    angles = np.linspace(0, 2 * math.pi, 2001)[:, None]
    q, ok, _ = plan.solve(angles, sign)
    assert ok.all() and np.all(plan.branch_of(q) == (1 if sign == "+" else -1))
    steps = np.abs(np.exp(1j * q[1:]) - np.exp(1j * q[:-1]))
    assert steps.max() < 0.02
    height = plan.heights(q)
    assert np.all(np.sign(height[:, 0]) == (1 if sign == "+" else -1))


# ---- what is over-constrained, touching or undetermined


def test_double_parallelogram_is_a_check():
    m = Mechanism("double parallelogram", dim=2)
    cranks = [m.body(f"crank{i}") for i in (1, 2, 3)]
    coupler = m.body("coupler")
    for i, crank in enumerate(cranks):
        m.revolute(f"A{i + 1}", m.ground, crank, at=(0.7 * i, 0))
        m.revolute(f"B{i + 1}", crank, coupler, at=(0.4, 0), child_at=(0.7 * i, 0))
    system = m.build()
    plan = plan_of(system, "A1")
    assert plan.signs == 1
    q, mask = plan.all([1.1])
    assert mask.sum() == 1, "the antiparallelogram does not fit the third crank"
    assert np.abs(system.q_dict(q[mask][0])["A3"] - 1.1) < 1e-14
    assert_closed(system, q[mask])
    open_ = plan.solve([1.1], plan.branches()[~mask][0])
    assert not open_[1] and open_[2] > 0.1


def test_what_does_not_fit_is_open_by_that():
    """Three cranks upright, the last of them 1 mm too long."""
    m = Mechanism("misfit", dim=2)
    coupler = m.body("coupler")
    for i, length in enumerate((0.4, 0.4, 0.401)):
        crank = m.body(f"crank{i}")
        m.revolute(f"A{i}", m.ground, crank, at=(0.7 * i, 0))
        m.revolute(f"B{i}", crank, coupler, at=(length, 0), child_at=(0.7 * i, 0))
    plan = plan_of(m.build(), "A0")
    assert plan.signs == 1
    gaps = [plan.solve([math.pi / 2], sign)[1:] for sign in "+-"]
    assert not any(ok for ok, _ in gaps)
    assert abs(min(gap for _, gap in gaps) - 1e-3) < 1e-14


@pytest.mark.parametrize("b, gap", [(2.0, 0.5), (2.5, 0.0), (1.0, 1.5)])
def test_circles_that_do_not_meet_nearly_touch(b, gap):
    """Crank at pi: 4.5 to the other pivot, and links of 2 and b metres."""
    system = four_bar(1.0, b, 2.0, 3.5)
    plan = plan_of(system, "A")
    q, ok, got = plan.solve([math.pi])
    assert abs(got - gap) < 1e-12 and ok == (gap == 0.0)
    tip = system.fk(q, "coupler") @ [b, 0, 0, 1]
    assert np.abs(tip[:2] - [-1.0 + b, 0.0]).max() < 1e-12
    assert abs(np.linalg.norm(system.loops.closure_error(q)[0, :3]) - gap) < 1e-12
    double = plan.all([math.pi])[0]
    assert np.abs(double[0] - double[1]).max() < 1e-12 or angle_between(*double).max() < 1e-12


def test_one_circle_inside_the_other():
    system = four_bar(1.0, 6.0, 0.5, 3.5)
    q, ok, gap = plan_of(system, "A").solve([0.0])
    assert not ok and abs(gap - (6.0 - 2.5 - 0.5)) < 1e-12


def test_line_that_misses_the_circle():
    system = slider_crank(1.0, 1.0, 3.0)
    q, ok, gap = plan_of(system, "A").solve([math.pi / 2])
    assert not ok and abs(gap - 1.0) < 1e-14
    assert abs(q[3]) < 1e-15, "the slider is right above the crank pin"


def test_coinciding_centres_are_undetermined_but_closed():
    """The rhombus: at crank 0 with equal links, the crank's pin sits on the other pivot."""
    system = four_bar(2.0, 1.5, 1.5, 2.0)
    plan = plan_of(system, "A")
    closed = plan.close([[0.0], [0.5]])
    assert closed.ok.all() and closed.undetermined.tolist() == [1, 0]
    assert_closed(system, closed.q)


def test_link_without_length():
    """A coupler of no length: closed only where crank and rocker meet, and free to turn there."""
    system = four_bar(2.0, 0.0, 2.0, 2.0)
    plan = plan_of(system, "A")
    closed = plan.close([[math.pi / 3], [0.1]])
    assert closed.ok.tolist() == [True, False] and (closed.undetermined > 0).all()
    assert np.isfinite(closed.q).all()
    assert_closed(system, closed.q[0])
    assert abs(closed.gap[1] - abs(2 - abs(2 * cmath.exp(0.1j) - 2))) < 1e-14


def test_parallel_slides_are_undetermined():
    """Elliptic trammel with both slots in one direction, one of which can be turned."""
    m = Mechanism("slots", dim=2)
    slot = m.body("slot")
    a = m.body("a")
    b = m.body("b")
    m.revolute("T", m.ground, slot)
    m.prismatic("S", m.ground, a, axis=(1, 0))
    m.prismatic("U", slot, b, axis=(1, 0))
    m.revolute("R", a, b)
    system = m.build()
    closed = plan_of(system, "T").close([[0.0], [0.3]])
    assert closed.undetermined.tolist() == [1, 0] and closed.ok.all()
    assert_closed(system, closed.q)


# ---- constraints that are not joints


def test_a_distance_is_a_rod():
    """The four-bar without its coupler, whose ends keep their distance: crank and rocker stand as
    in the four-bar.
    """
    m = Mechanism("rod", dim=2)
    crank = m.body("crank")
    rocker = m.body("rocker")
    m.revolute("A", m.ground, crank)
    m.revolute("D", m.ground, rocker, at=(3.5, 0))
    m.parameter("l", 3.0)
    m.distance("rod", crank, rocker, at=(1, 0), child_at=(2.5, 0), length="l")
    system = m.build()
    plan = plan_of(system, "A")
    whole = plan_of(four_bar(1.0, 3.0, 2.5, 3.5), "A")
    angles = np.linspace(-3, 3, 41)[:, None]
    assert "rod (rocker) lies to the left of the way from D to rod (crank)" in plan.describe()
    for sign, same in ("+-", "-+"):  # the four-bar's sign is for the way from B to D
        q, ok, _ = plan.solve(angles, sign)
        assert ok.all() and np.abs(closure_rows.compute_residual(system, q)).max() < 1e-12
        assert np.abs(q - whole.solve(angles, same)[0][:, [0, 3]]).max() < 1e-12
        assert np.all(plan.branch_of(q) == (1 if sign == "+" else -1))
    short = plan_of(system.with_parameters(l=1.0), "A").solve([math.pi])
    assert not short[1] and abs(short[2] - 1.0) < 1e-12


@pytest.mark.parametrize("turned", [False, True])
@pytest.mark.parametrize("sign", "+-")
def test_a_point_on_a_line_is_a_block(sign, turned):
    """The slider-crank without its piston, whose rod ends on the line; or the line is on the rod (a
    swinging block).
    """
    m = Mechanism("line", dim=2)
    crank = m.body("crank")
    rod = m.body("rod")
    m.revolute("A", m.ground, crank)
    m.revolute("B", crank, rod, at=(1, 0))
    if turned:
        m.point_on_line("line", rod, m.ground, at=(0, 0.2), child_at=(3.0, 0.5), axis=(1, 0))
    else:
        m.point_on_line("line", m.ground, rod, at=(0, 0.5), child_at=(3, 0), axis=(1, 0))
    system = m.build()
    plan = plan_of(system, "A")
    angles = np.linspace(-3, 3, 41)[:, None]
    q, ok, _ = plan.solve(angles, sign)
    assert ok.all() and np.abs(closure_rows.compute_residual(system, q)).max() < 1e-12
    assert np.all(plan.branch_of(q) == (1 if sign == "+" else -1))
    if not turned:
        whole = plan_of(slider_crank(1.0, 3.0, 0.5), "A").solve(angles, sign)[0]
        assert np.abs(np.exp(1j * q) - np.exp(1j * whole[:, :2])).max() < 1e-12


# ---- angles, limits, followers, relations


def test_angles_are_near_to_a_reference():
    system = four_bar()
    plan = plan_of(system, "A")
    q = plan.solve([0.3], "+")[0]
    far = q + 2 * math.pi * np.array([0, 3, -2, 1])
    assert np.abs(plan.solve([0.3], "+", start=far + 0.1)[0] - far).max() < 1e-12
    assert np.abs(plan.solve([0.3 + 2 * math.pi], "+", start=q)[0][1:] - q[1:]).max() < 1e-12


@pytest.mark.parametrize("low", [-10.0, -4.0, 0.5, 7.0])
@pytest.mark.parametrize("sign", "+-")
def test_angles_are_inside_the_limits_where_one_is(sign, low):
    plan = plan_of(four_bar(limits=(low, low + 2 * math.pi)), "A")
    free = plan_of(four_bar(), "A")
    c = plan.solve([0.3], sign)[0][2]
    assert low - 1e-12 <= c <= low + 2 * math.pi + 1e-12
    assert angle_between(c, free.solve([0.3], sign)[0][2]) < 1e-12


def test_gears_drive_and_are_driven():
    """A geared five-bar needs one crank; a coordinate that follows a solved joint moves a further
    body.
    """
    m = Mechanism("geared", dim=2)
    a, b, c, d, wheel = (m.body(n) for n in ("a", "b", "c", "d", "wheel"))
    m.revolute("A", m.ground, a)
    m.revolute("B", a, b, at=(1, 0))
    m.revolute("C", b, c, at=(2, 0), child_at=(2, 0))
    m.revolute("D", d, c, at=(1, 0))
    m.revolute("E", m.ground, d, at=(1.5, 0))
    m.revolute("W", m.ground, wheel, at=(5, 0))
    m.gear("E", "A", -1.0, 0.4)
    m.gear("W", "C", 2.0, 0.1)
    system = m.build()
    plan = plan_of(system, "A")
    q, ok, _ = plan.solve([[2.0], [1.0]], "+")
    assert ok.all()
    assert_closed(system, q)
    with pytest.raises(InputError, match="follows 'A'"):
        find_closed_form(system, ["E"])
    assert np.abs(solve_branch(system, {"E": -2.0 + 0.4}, "+") - q[0]).max() < 1e-14


def test_a_follower_that_contradicts_is_open():
    m = four_bar().mechanism
    m.gear("D", "A", 1.0)
    q, ok, gap = plan_of(m.build(), "A").solve([0.5])
    assert not ok and gap > 1e-3


def test_a_relation_of_several_gives_the_last():
    m = Mechanism("sum", dim=2)
    a = m.body("a")
    b = m.body("b")
    c = m.body("c")
    m.revolute("A", m.ground, a)
    m.revolute("B", a, b, at=(1, 0))
    m.revolute("C", b, c, at=(1, 0))
    m.couple("C", {"A": 0.5, "B": -2.0}, 0.25)
    system = m.build()
    q, ok, gap = plan_of(system, "A", "B").solve([0.3, 0.4])
    assert ok and abs(q[2] - (0.15 - 0.8 + 0.25)) < 1e-15
    assert np.abs(plan_of(system, "A", "C").solve([0.3, q[2]])[0] - q).max() < 1e-15
    q, ok, gap = plan_of(system, "A", "B", "C").solve([0.3, 0.4, q[2] + 0.5])
    assert not ok and abs(gap - 0.5) < 1e-14, "half a radian, at a length of one metre"


def test_locked_and_fixed_joints_are_part_of_the_bodies():
    m = slider_crank().mechanism
    tool = m.body("tool")
    m.fixed("weld", "rod", tool, at=(0.2, 0.3), angle=0.4)
    m.revolute("T", tool, m.body("arm"), at=(0.1, 0))
    m.revolute("U", "arm", m.body("bar"), at=(0.9, 0))
    m.revolute("V", "bar", m.ground, at=(2.0, 0), child_at=(1.0, 1.0))
    m.lock({"S": 3.2})
    system = m.build()
    plan = plan_of(system)
    assert plan.known == () and plan.signs == 2
    q, mask = plan.all([])
    assert mask.any()
    assert_closed(system, q[mask])


# ---- the interface


def test_shapes_and_batches():
    system = four_bar()
    plan = plan_of(system, "A")
    values = np.linspace(0, 6, 23)
    q, ok, gap = plan.solve(values[:, None], "-")
    assert q.shape == (23, 4) and ok.shape == gap.shape == (23,)
    for i, x in enumerate(values):
        assert np.array_equal(plan.solve([x], "-")[0], q[i]), "no row depends on the others"
    signs = np.where(np.arange(23) % 2, 1.0, -1.0)[:, None]
    mixed = plan.solve(values[:, None], signs)[0]
    assert np.array_equal(mixed[::2], q[::2]) and np.array_equal(plan.branch_of(mixed), signs)
    near = plan.solve(values[:, None], start=mixed)[0]
    assert np.array_equal(near, mixed)
    assert plan.solve(np.zeros((0, 1)))[0].shape == (0, 4)
    assert plan.solve(np.zeros((2, 3, 1)))[0].shape == (2, 3, 4)
    assert plan.all(np.zeros((2, 3, 1)))[0].shape == (2, 3, 2, 4)
    single = plan.solve([0.1])
    assert isinstance(single[1], bool) and isinstance(single[2], float)
    assert plan.heights(q[0]).shape == (1,)


def test_threads_do_not_change_answers():
    plan = plan_of(four_bar(), "A")
    values = np.random.default_rng(0).uniform(-3, 3, (30_000, 1))
    assert np.array_equal(plan.solve(values, threads=1)[0], plan.solve(values, threads=3)[0])


def test_bad_numbers_give_nan_rows():
    plan = plan_of(slider_crank(), "A")
    q, ok, gap = plan.solve([[0.1], [math.nan], [math.inf], [0.2]])
    assert ok.tolist() == [True, False, False, True]
    assert np.isnan(q[1:3, 1:]).all() and np.isfinite(q[[0, 3]]).all()


@pytest.mark.parametrize("turns", [1e9, -3e12])
def test_large_angles_are_reduced_as_the_library_of_c_does(turns):
    system = four_bar()
    plan = plan_of(system, "A")
    q, ok, _ = plan.solve([turns], "+")
    assert ok
    near = plan.solve([math.atan2(math.sin(turns), math.cos(turns))], "+")[0]
    assert np.abs(q[1:] - near[1:]).max() < 1e-12


def test_describe_names_what_signs_mean():
    text = plan_of(slider_crank(), "A").describe()
    assert "RRP" in text and "S slides farther" in text and "sign 1" in text
    assert "C lies to the left of the way from B to D" in str(plan_of(four_bar(), "A"))


def test_what_is_left_over_is_named():
    three = kempe.load("three_rrr")
    answer = find_closed_form(three, ["A1", "A2", "A3"])
    assert not answer and "platform" in answer.bodies and "higher class" in str(answer)
    answer = find_closed_form(three, ["A1", "A2"])
    assert not answer and "1 more coordinate must be known" in str(answer)
    arm = kempe.load("panda")
    assert "not planar" in str(find_closed_form(arm, []))
    m = Mechanism("block", dim=2)
    m.planar("P", m.ground, m.body("b"))
    assert "planar" in str(find_closed_form(m.build(), ["P.x"]))


def test_refused_arguments():
    system = four_bar()
    plan = plan_of(system, "A")
    with pytest.raises(UnknownNameError, match="did you mean"):
        find_closed_form(kempe.load("three_rpr"), ["S11"])
    for call in (
        lambda: find_closed_form(system, ["A", "A"]),
        lambda: plan.solve([0.1, 0.2]),
        lambda: plan.solve(0.1),
        lambda: plan.solve("x"),
        lambda: plan.solve([0.1], "++"),
        lambda: plan.solve([0.1], "x"),
        lambda: plan.solve([0.1], [0.5]),
        lambda: plan.solve([0.1], start=np.full(4, np.nan)),
        lambda: plan.solve([0.1], start=np.zeros((3, 4))),
    ):
        with pytest.raises(InputError):
            call()


def test_the_plan_is_made_once_and_can_be_pickled():
    system = four_bar()
    assert find_closed_form(system, "A") is find_closed_form(system, ("A",))
    plan = pickle.loads(pickle.dumps(plan_of(system, "A")))
    assert np.array_equal(plan.solve([0.4])[0], plan_of(system, "A").solve([0.4])[0])


@pytest.mark.slow
def test_many_loops_are_planned_without_recursion():
    m = Mechanism("row", dim=2)
    before = m.ground
    for i in range(300):
        crank = m.body(f"a{i}")
        bar = m.body(f"b{i}")
        rocker = m.body(f"c{i}")
        m.revolute(f"A{i}", before, crank, at=(0, 0) if i == 0 else (1.0, 0))
        m.revolute(f"B{i}", crank, bar, at=(1, 0))
        m.revolute(f"C{i}", bar, rocker, at=(1.5, 0), child_at=(1, 0))
        m.revolute(f"D{i}", m.ground, rocker, at=(1.5 + 1.5 * i, 0))
        before = rocker
        if i:
            m.lock({f"A{i}": 0.0})
    system = m.build()
    plan = plan_of(system, "A0")
    assert plan.signs == 300
    q, ok, gap = plan.solve([1.2], np.ones(300))
    assert np.isfinite(q).all()

"""Assembly modes: published counts, independent roots, merging, limits, sets that are not finite,
honesty.
"""

from __future__ import annotations

import math

import numpy as np
import pytest
from dyad_chains import DYADS, random_chain
from hypothesis import given
from hypothesis import strategies as st
from linkages import four_bar

import kempe
from kempe import Mechanism, System
from kempe.answers.problem import Problem
from kempe.assemble.dyads import find_closed_form
from kempe.assemble.modes import (
    SOLVERS,
    Modes,
    assembly_modes,
    estimate_coverage,
    explain_missing_dyads,
    find_modes_by_dyads,
    find_modes_by_starts,
)
from kempe.assemble.same_configuration import get_metric
from kempe.errors import InputError, UnknownNameError
from kempe.numerics import clock


def inputs(system: System, *names: str) -> dict[str, float]:
    """Values of these coordinates in the posture `closed`."""
    q = system.q_dict(system.q("closed"))
    return {n: q[n] for n in names}


def assert_closed(modes: Modes, known: dict[str, float]) -> None:
    names = modes.system.coordinate_names
    assert np.abs(modes.system.loops.closure_error(modes.q)).max(initial=0.0) < 1e-12
    for name, x in known.items():
        assert np.all(modes.q[:, names.index(name)] == x)


# ---- by structure


@pytest.mark.parametrize(
    "name, known, count",
    [
        ("four_bar", ["A"], 2),
        ("slider_crank", ["A"], 2),
        ("five_bar", ["A", "D"], 2),
        ("jansen", ["O"], 8),
    ],
)
def test_published_counts(name, known, count):
    system = kempe.load(name)
    modes = assembly_modes(system, inputs(system, *known))
    assert len(modes) == count and modes.complete and modes.coverage is None
    assert modes.status.startswith("complete: every dyad in closed form")
    assert (
        len(set(modes.branches)) == count
        and np.all(modes.multiplicity == 1)
        and not modes.freedoms.any()
    )
    assert_closed(modes, inputs(system, *known))


@pytest.mark.parametrize(
    "name, known", [("four_bar", "A"), ("slider_crank", "A"), ("klann", None), ("jansen", "O")]
)
def test_structure_and_search_agree(name, known):
    """The same set by closed forms and by random starts, which share no code."""
    system = kempe.load(name)
    known = known or next(j.name for j in system.structure.joints.values() if j.actuated)
    given_ = inputs(system, known)
    modes = assembly_modes(system, given_)
    found = SOLVERS[-1].run(question_of(system, given_))
    assert len(found) == len(modes)
    for q in modes.q:
        assert np.abs(np.exp(1j * found.q) - np.exp(1j * q)).max(axis=-1).min() < 1e-8


def question_of(system: System, known: dict[str, float], starts: int = 512):
    return Problem(system, "all", known=known, budget=kempe.Budget(starts=starts))


@given(st.integers(0, 2**32))
def test_every_closed_branch_of_a_random_chain_is_there_once(seed):
    chain = random_chain(seed, most=3)
    system = chain.system()
    known = {k: chain.values[k] for k in chain.known}
    modes = assembly_modes(system, known, start=system.q(chain.values))
    plan = find_closed_form(system, tuple(known))
    assert plan and modes.multiplicity.sum() == plan.all([*known.values()])[1].sum()
    assert np.abs(modes.q[0] - system.q(chain.values)).max() < 1e-7, "sorted, the nearest first"
    signs = "".join("+" if s > 0 else "-" for s in plan.branch_of(system.q(chain.values)))
    assert modes.branches[0] == signs


def test_peaucellier_moves_where_its_rhombus_is_folded():
    """With A = B the rhombus is folded: C is the centre of D's circle. Four of the eight branches
    are like that.
    """
    system = kempe.load("peaucellier")
    modes = assembly_modes(system, inputs(system, "Q"))
    assert (
        len(modes) == 8
        and not modes.complete
        and modes.status.startswith("infinitely many: 4 of 8")
    )
    A, B = (system.fk(modes.q, b)[:, :2] @ [3.0, 0, 0, 1] for b in ("arm_a", "arm_b"))
    folded = np.linalg.norm(A - B, axis=-1) < 1e-9
    assert np.array_equal(modes.freedoms > 0, folded) and folded.sum() == 4


def test_a_double_root_is_one_with_multiplicity_two():
    """Slider-crank with equal links and no offset, crank upright: both roots at the pivot."""
    m = Mechanism("tangent", dim=2)
    crank = m.body("crank")
    rod = m.body("rod")
    piston = m.body("piston")
    m.revolute("A", m.ground, crank)
    m.revolute("B", crank, rod, at=(1, 0))
    m.revolute("C", rod, piston, at=(1, 0))
    m.prismatic("S", m.ground, piston, axis=(1, 0))
    modes = assembly_modes(m.build(), {"A": math.pi / 2})
    assert len(modes) == 1 and modes.multiplicity.tolist() == [2] and modes.branches == ("0",)
    assert modes.complete and "1 multiple root" in modes.status
    assert abs(modes.q[0, 3]) < 1e-7


def test_none_closes():
    m = Mechanism("open", dim=2)
    a = m.body("a")
    b = m.body("b")
    c = m.body("c")
    m.revolute("A", m.ground, a)
    m.revolute("B", a, b, at=(1, 0))
    m.revolute("C", b, c, at=(1, 0), child_at=(0.5, 0))
    m.revolute("D", m.ground, c, at=(1.0, 0))
    modes = assembly_modes(m.build(), {"A": math.pi})
    assert not modes and len(modes) == 0 and modes.complete
    assert "none of the 2 branches closes; the best is open by 0.5 m" in modes.status


def test_limits_drop_or_flag():
    system = kempe.load("four_bar")
    m = system.mechanism
    m.joints["C"].limits[""] = (0.0, 3.0)
    limited = m.build()
    known = inputs(system, "A")
    modes = assembly_modes(limited, known)
    assert len(modes) == 1 and modes.outside == 1 and modes.branches == ("+",)
    assert "1 is outside the limits" in modes.status
    flagged = assembly_modes(limited, known, limits=False)
    assert len(flagged) == 2 and flagged.inside.tolist() == [True, False] and flagged.outside == 0


def test_sorted_by_nearness():
    system = kempe.load("four_bar")
    known = inputs(system, "A")
    plain = assembly_modes(system, known)
    for q in plain.q:
        modes = assembly_modes(system, known, start=q + 0.05)
        assert np.abs(modes.q[0] - q).max() < 1e-12
    turned = assembly_modes(system, known, start=plain.q[1] + [0, 4 * math.pi, 0, -2 * math.pi])
    assert np.abs(turned.q[0] - plain.q[1] - [0, 4 * math.pi, 0, -2 * math.pi]).max() < 1e-12


def test_followers_can_be_given():
    m = kempe.load("four_bar").mechanism
    motor = m.body("motor")
    m.revolute("M", m.ground, motor, at=(-1, 0))
    m.gear("M", "A", -2.0, 0.1)
    system = m.build()
    modes = assembly_modes(system, {"M": -2.0 * 0.7 + 0.1})
    assert len(modes) == 2 and np.abs(modes.q[:, 0] - 0.7).max() < 1e-15


# ---- what is undetermined, however far behind it a failure to close lies


def folded_kite(x: float, y: float, link: float, reach: float) -> tuple[System, float]:
    """A four-bar whose crank tip lies on the rocker's pivot (x, y), and a dyad between the rocker's
    end and the ground; the crank angle. The rocker can stand at any angle at which the dyad closes:
    some do where `reach` is below 2.
    """
    m = Mechanism("folded kite", dim=2)
    m.revolute("A", m.ground, m.body("crank"))
    m.revolute("B", "crank", m.body("coupler"), at=(math.hypot(x, y), 0))
    m.revolute("C", "coupler", m.body("rocker"), at=(link, 0), child_at=(link, 0))
    m.revolute("D", m.ground, "rocker", at=(x, y))
    m.revolute("E", "rocker", m.body("rod"), at=(link, 0))
    m.revolute("F", "rod", m.body("arm"), at=(1, 0), child_at=(1, 0))
    m.revolute("G", m.ground, "arm", at=(x, y + link + reach))
    return m.build(), math.atan2(y, x)


def check_folded_kite(x: float, y: float, link: float, reach: float) -> None:
    system, angle = folded_kite(x, y, link, reach)
    modes = system.assembly_modes({"A": angle})
    assert not modes.complete and len(modes) and modes.freedoms.any(), modes.status
    assert "infinitely many" in modes.status and "centres coincide" in modes.status
    assert np.abs(system.loops.closure_error(modes.q)).max() < 1e-9


def test_hunt_a_dyad_behind_a_continuum_is_no_proof(hunt):
    """Whether the second dyad closes depends on the position that was chosen for the first."""
    rng = hunt.rng()
    for _ in range(hunt.cases(60)):
        check_folded_kite(
            *np.round(rng.uniform(0.2, 2.0, 3), 2).tolist(),
            float(np.round(rng.uniform(0.5, 1.9), 2)),
        )


def test_a_continuum_from_which_the_rest_is_out_of_reach_is_a_proof():
    """Wherever the rocker stands, the second dyad is more than a metre short."""
    system, angle = folded_kite(1.0, 0.5, 0.7, 3.1)
    modes = system.assembly_modes({"A": angle})
    assert modes.complete and not modes and "none of the 4 branches closes" in modes.status


def drawn(*joints: tuple[str, str, str, tuple[float, float], float | None]) -> System:
    """A mechanism that is closed at q = 0: joints (name, parent, child, place, angle of a slide or
    None).
    """
    m = Mechanism("drawn", dim=2)
    for body in sorted({b for j in joints for b in j[1:3]} - {"ground"}):
        m.body(body)
    for name, parent, child, place, slide in joints:
        if slide is None:
            m.revolute(name, parent, child, at=place, child_at=place)
        else:
            m.prismatic(
                name,
                parent,
                child,
                at=place,
                child_at=place,
                axis=(math.cos(slide), math.sin(slide)),
            )
    return m.build()


def holds(modes: Modes, q: np.ndarray) -> bool:
    """Whether a configuration is among the modes."""
    return bool(len(modes) and get_metric(modes.system).compute_distances(modes.q, q).min() < 1e-5)


@pytest.mark.slow
def test_hunt_a_root_at_the_square_root_of_rounding_is_kept(hunt):
    """A slide at right angles to its link, which is a double root, then a link without length on
    the slider.
    """
    rng = hunt.rng()
    for _ in range(hunt.cases(80)):
        (px, py), u, w, crank = (
            np.round(rng.uniform(-2.0, 2.0, (2,)), 1),
            *np.round(rng.uniform(-2, 2, (3, 2)), 1),
        )
        along = np.array([1.0, -1.0]) * rng.integers(1, 4)
        system = drawn(
            ("A", "ground", "crank", (crank[0], crank[1]), None),
            ("S", "crank", "slider", (u[0], u[1]), -0.25 * math.pi),
            ("R", "slider", "link", (px, py), None),
            ("T", "link", "ground", (px + along[0], py - along[1]), None),
            ("U", "slider", "bar", (w[0] + 3.0, w[1]), None),
            ("V", "bar", "point", (w[0], w[1]), None),
            ("W", "point", "crank", (w[0], w[1]), None),
        )
        modes = system.assembly_modes({"A": 0.0})
        assert not modes.complete and len(modes), modes.status
        assert_closed(modes, {"A": 0.0})


def integer_chain(rng: np.random.Generator) -> System:
    """Dyads on points of a small lattice, so that points coincide, lie on lines and have the same
    distances.
    """
    digits, scale = (0, 2.0) if rng.random() < 0.6 else (1, 1.5)
    there = ["ground", "crank"]
    joints = []

    def joint(name: str, parent: str, child: str, slides: bool) -> None:
        place = tuple(np.round(rng.uniform(-scale, scale, 2), digits).tolist())
        ends = (parent, child) if rng.random() < 0.5 else (child, parent)
        joints.append((name, *ends, place, math.pi / 4 * int(rng.integers(8)) if slides else None))

    joint("A", "ground", "crank", False)
    for k in range(int(rng.integers(1, 4))):
        kind = str(rng.choice(DYADS)) if rng.random() < 0.4 else "RRR"
        one = f"u{k}"
        two = f"v{k}"
        ends = [str(rng.choice(there)), one, two, str(rng.choice(there))]
        for letter, parent, child, slides in zip(
            "abc", ends, ends[1:], [x == "P" for x in kind], strict=False
        ):
            joint(f"{letter}{k}", parent, child, slides)
        there += [one, two]
    return drawn(*joints)


def check_integer_chain(system: System, starts: np.random.Generator) -> int:
    """What is called complete has the drawn configuration, and all that least squares find; 1 if it
    is.
    """
    if explain_missing_dyads(Problem(system, "all", {"A": 0.0})) is not None:
        return 0
    modes = system.assembly_modes({"A": 0.0})
    if modes.complete:
        assert holds(modes, system.neutral), modes.status
        guesses = starts.uniform(-3.0, 3.0, (12, system.nq))
        found = system.assemble({"A": np.zeros(12)}, start=guesses, limits=False)
        for q in found.q[np.asarray(found.success)]:
            assert holds(modes, q), (modes.status, q)
    return modes.complete


@pytest.mark.slow
def test_hunt_what_is_complete_has_the_configuration_by_which_it_was_drawn(hunt):
    rng = hunt.rng()
    complete = 0
    for _ in range(cases := hunt.cases(160)):
        complete += check_integer_chain(integer_chain(rng), rng)
    assert complete > cases / 3


@pytest.mark.slow
def test_long_hunt_for_what_is_complete_and_is_not(hunt):
    rng = hunt.rng()
    complete = 0
    for _ in range(cases := hunt.cases(1000)):
        complete += check_integer_chain(integer_chain(rng), rng)
    assert complete > cases / 3


@given(st.integers(0, 2**32))
def test_regular_chains_are_still_complete(seed):
    chain = random_chain(seed, most=4)
    assert assembly_modes(chain.system(), {k: chain.values[k] for k in chain.known}).complete


def test_whole_turns_that_move_a_wheel_are_modes():
    """A wheel geared one to two stands otherwise after a turn of the rocker, one geared two to one
    does not.
    """
    for ratio, count, turns in (
        (0.5, 4, (-math.inf, math.inf)),
        (2.0, 2, (-math.inf, math.inf)),
        (0.5, 2, (-3.0, 3.0)),
    ):
        m = four_bar().mechanism
        m.body("wheel")
        m.revolute("W", m.ground, "wheel", at=(5, 0))
        m.joints["D"].limits[""] = turns
        m.gear("W", "D", ratio)
        modes = m.build().assembly_modes({"A": 0.5})
        assert len(modes) == count and modes.complete == (count == 2), modes.status


# ---- by many starts


def three_rpr(base, platform) -> System:
    m = Mechanism("3-RPR", dim=2)
    body = m.body("platform")
    for i, (a, b) in enumerate(zip(base, platform, strict=True), 1):
        cylinder = m.body(f"cylinder{i}")
        rod = m.body(f"rod{i}")
        m.revolute(f"A{i}", m.ground, cylinder, at=a)
        m.prismatic(f"S{i}", cylinder, rod, axis=(1, 0))
        m.revolute(f"B{i}", rod, body, child_at=b)
    return m.build()


def platform_angles(base, platform, lengths) -> np.ndarray:
    """Orientations of a 3-RPR platform, from its sextic (Hunt, 1983): real ones are roots of
    modulus 1.

    For a given orientation two differences of the leg equations are linear in the position; put
    into the first they leave a Laurent polynomial in exp(i angle), whose coefficients come from
    samples on the circle.
    """
    n = 32
    z = np.exp(2j * np.pi * np.arange(n) / n)
    w = [
        np.stack([z.real * b[0] - z.imag * b[1] - a[0], z.imag * b[0] + z.real * b[1] - a[1]])
        for a, b in zip(base, platform, strict=True)
    ]
    rows = [2 * (w[i] - w[0]) for i in (1, 2)]
    right = [
        lengths[i] ** 2 - lengths[0] ** 2 - (w[i] ** 2).sum(0) + (w[0] ** 2).sum(0) for i in (1, 2)
    ]
    det = rows[0][0] * rows[1][1] - rows[0][1] * rows[1][0]
    x = right[0] * rows[1][1] - right[1] * rows[0][1]
    y = rows[0][0] * right[1] - rows[1][0] * right[0]
    f = (x + w[0][0] * det) ** 2 + (y + w[0][1] * det) ** 2 - (lengths[0] * det) ** 2
    c = np.fft.fftshift(np.fft.fft(f) / n)
    c = c[np.abs(c) > 1e-11 * np.abs(c).max()]
    roots = np.roots(c[::-1])
    assert len(roots) == 6
    return np.sort(np.angle(roots[np.abs(np.abs(roots) - 1) < 1e-7]))


@pytest.mark.parametrize(
    "base, platform, lengths, count",
    [
        (
            [(0, 0), (2.56, 0), (1.45, 1.14)],
            [(0, 0), (1.1, 0), (-0.41, 1.69)],
            (1.64, 0.99, 1.66),
            6,
        ),
        (
            [(0, 0), (2.83, 0), (1.15, -0.51)],
            [(0, 0), (2.28, 0), (-1.13, 1.32)],
            (2.14, 2.21, 2.55),
            4,
        ),
        (
            [(0, 0), (1.25, 0), (2.46, 0.93)],
            [(0, 0), (1.52, 0), (-1.88, 0.83)],
            (1.44, 0.73, 2.15),
            2,
        ),
    ],
)
def test_three_rpr_has_up_to_six_modes(base, platform, lengths, count):
    system = three_rpr(base, platform)
    known = {f"S{i + 1}": x for i, x in enumerate(lengths)}
    assert not find_closed_form(system, tuple(known))
    expected = platform_angles(base, platform, lengths)
    assert len(expected) == count
    modes = assembly_modes(system, known)
    assert len(modes) == count and not modes.complete and "not proven complete" in modes.status
    assert 0.95 < modes.coverage < 1.0 and modes.expected == count
    assert_closed(modes, known)
    X = system.fk(modes.q, "platform")
    assert np.abs(np.sort(np.arctan2(X[:, 1, 0], X[:, 0, 0])) - expected).max() < 1e-7
    assert np.array_equal(assembly_modes(system, known).q, modes.q), (
        "the same arguments give the same answer"
    )


@pytest.mark.slow
def test_dietmaier_has_forty_modes():
    """Dietmaier, 1998: a Stewart-Gough platform all of whose forty assembly modes are real."""
    system = kempe.load("stewart_dietmaier")
    known = inputs(system, *(f"leg{i}" for i in range(1, 7)))
    modes = assembly_modes(system, known, frame="platform", limits=False)
    assert len(modes) == 40 and not modes.complete
    assert_closed(modes, known)
    assert abs(modes.expected - 40) < 1e-9


def test_a_frame_counts_poses():
    """The legs of a Stewart platform turned over on their universal joints do not count with
    `frame`.
    """
    system = kempe.load("stewart")
    known = inputs(system, *(f"leg{i}" for i in range(1, 7)))
    few = assembly_modes(
        system, known, frame="platform", limits=False, budget=kempe.Budget(starts=1024)
    )
    X = system.fk(few.q, "platform")[:, :3]
    apart = np.abs(X[:, None] - X[None]).max(axis=(2, 3)) + np.eye(len(X))
    assert 1 <= len(few) <= 40 and apart.min() > 1e-6
    many = assembly_modes(system, known, limits=False, budget=kempe.Budget(starts=256))
    assert len(many) > len(few)


def test_what_moves_is_not_called_finite():
    """Bennett with nothing known, and the lecture's four links with one input of two."""
    modes = assembly_modes(kempe.load("bennett"))
    assert (
        modes.status.startswith("infinitely many")
        and modes.freedoms.tolist() == [1]
        and not modes.complete
    )
    assert len(assembly_modes(kempe.load("bennett"), {"q1": 1.0})) == 1
    links = kempe.load("four_links")
    modes = assembly_modes(links, inputs(links, links.coordinate_names[0]))
    assert modes.status.startswith("infinitely many") and modes.freedoms.tolist() == [1]


def test_shaky_is_not_called_moving():
    """Rank says that one freedom is left in the straight three-bar chain; it cannot be followed."""
    m = Mechanism("shaky", dim=2)
    a = m.body("a")
    b = m.body("b")
    m.revolute("A", m.ground, a)
    m.revolute("B", a, b, at=(1, 0))
    m.revolute("C", b, m.ground, at=(1, 0), child_at=(2, 0))
    question = question_of(m.build(), {})
    modes = find_modes_by_starts(question)
    assert not modes.freedoms.any() and len(modes) == 1
    assert explain_missing_dyads(question) is None and len(find_modes_by_dyads(question)) == 1


@pytest.mark.parametrize(("requested", "limit"), [(None, 120.0), (5.0, 5.0), (math.inf, None)])
def test_the_time_limit_is_the_one_that_was_given(requested, limit, monkeypatch):
    """Also none at all, which must not become the usual one where solvers complete the budget."""
    seen = []

    class Seen(clock.TimeLimit):
        def __init__(self, value):
            seen.append(value)
            super().__init__(value)

    monkeypatch.setattr(clock, "TimeLimit", Seen)
    system = kempe.load("bennett")
    assembly_modes(
        system,
        {system.coordinate_names[0]: 0.5},
        budget=kempe.Budget(starts=8, time_limit=requested),
    )
    assert seen and set(seen) == {limit}


def test_none_found():
    system = three_rpr([(0, 0), (9, 0), (4, 9)], [(0, 0), (1, 0), (0, 1)])
    modes = assembly_modes(
        system, {"S1": 4.2, "S2": 4.2, "S3": 5.7}, budget=kempe.Budget(starts=64)
    )
    assert not modes and not modes.complete
    assert modes.status.startswith("none found from 64 starts, without proof: the loop of joint")


def test_a_proof_by_lengths_is_that_of_the_values_given():
    """In turns with values that close, for one system: nothing of one call is left to the next."""
    system = kempe.load("rssr")
    closed = system.assemble()
    A = system.coordinate_names[0]
    few = kempe.Budget(starts=64)
    far = system.with_parameters(coupler=90.0)
    for _ in range(2):
        assert len(system.assembly_modes({A: float(closed.q[0])}, budget=few))
        assert far.assembly_modes({A: 0.4}, budget=few).complete
    legs = three_rpr([(0, 0), (9, 0), (4, 9)], [(0, 0), (1, 0), (0, 1)])
    for _ in range(2):
        assert assembly_modes(legs, dict.fromkeys(("S1", "S2", "S3"), 1.0), budget=few).complete
        found = assembly_modes(legs, dict.fromkeys(("S1", "S2", "S3"), 6.0), budget=few)
        assert len(found) and not found.complete


def test_modes_told_apart_by_a_frame_are_listed_by_its_poses():
    """Not by the quaternions of all balls; in the plane by x, y and the angle."""
    system = four_bar()
    modes = assembly_modes(system, {"A": 0.8}, frame="coupler")
    assert len(modes) == 2
    for q in modes.q:
        X = system.fk(q, "coupler")
        angle = math.atan2(X[1, 0], X[0, 0])
        row = f"x of 'coupler' = {X[0, 3]:.9g}, y = {X[1, 3]:.9g}, yaw = {angle:.9g}"
        assert row in str(modes)
    assert "C = " not in str(modes)


def test_a_frame_can_be_known():
    """The end of a two-link arm at a place: elbow up and elbow down."""
    arm = kempe.load("two_link")
    frame = [f for f in arm.frame_names if f not in arm.body_names][0]
    q = np.array([0.4, 0.9])
    target = arm.fk(q, frame)[:3, 3]
    modes = assembly_modes(arm, {frame: target})
    assert len(modes) == 2
    assert np.abs(arm.fk(modes.q, frame)[:, :3, 3] - target).max() < 1e-9


def test_estimates():
    """Good-Turing and Chao1 by hand: two modes seen once, one twice, one five times."""
    coverage, expected = estimate_coverage(np.array([1, 1, 2, 5]))
    x = 1.0 - coverage  # two or less of nine have probability 5 %
    assert abs((1 - x) ** 9 + 9 * x * (1 - x) ** 8 + 36 * x**2 * (1 - x) ** 7 - 0.05) < 1e-9
    assert expected == 4 + 2 * 1 / (2 * 2)
    assert estimate_coverage(np.array([], dtype=int)) == (0.0, 0.0)


# ---- the interface


def test_text_and_table():
    system = kempe.load("four_bar")
    modes = assembly_modes(system, inputs(system, "A"))
    assert str(modes).startswith(
        "2 configurations of four_bar; complete"
    ) and "D = 1.57079633" in str(modes)
    assert "<th>B [rad]</th>" in modes._repr_html_() and "A =" not in str(modes)
    assert [q.shape for q in modes] == [(4,), (4,)] and np.array_equal(modes[1], modes.q[1])


def test_refused_arguments():
    system = kempe.load("four_bar")
    with pytest.raises(UnknownNameError):
        assembly_modes(system, {"Z": 1.0})
    for call in (
        lambda: assembly_modes(system, {"A": math.nan}),
        lambda: assembly_modes(system, {"A": [1.0, 2.0]}),
        lambda: assembly_modes(system, {"A": "x"}),
        lambda: assembly_modes(system, [1.0]),  # type: ignore[arg-type]
        lambda: assembly_modes(system, {"A": 1.0}, start=np.zeros((2, 4))),
        lambda: assembly_modes(system, {"A": 1.0}, budget=kempe.Budget(starts=0)),
        lambda: assembly_modes(system, {"A": 1.0}, budget=kempe.Budget(rng="x")),  # type: ignore[arg-type]
        lambda: assembly_modes(kempe.load("three_rpr"), {"S1": [0.3, 0.4], "S2": 0.3, "S3": 0.3}),
    ):
        with pytest.raises(InputError):
            call()


@pytest.mark.parametrize("cut", [None, "B", "D"])
@pytest.mark.parametrize(
    ("driven", "driver", "ratio", "count"), [("D", "A", -0.3, 6), ("B", "C", -0.5, 4)]
)
def test_all_modes_of_a_gear_that_comes_back_after_several_turns(cut, driven, driver, ratio, count):
    """Counts by sign changes over all turns of the driver, from the closed form of the four-bar."""
    m = four_bar(cut=cut).mechanism
    m.gear(driven, driver, ratio, 0.4)
    s = m.build()
    modes = s.assembly_modes({})
    assert len(modes) == count and not modes.complete
    assert max(np.abs(s.loops.closure_error(q)).max() for q in modes) < 1e-8


@pytest.mark.slow
def test_a_search_among_thousands_of_modes_ends():
    m = Mechanism("row", dim=2)
    before = m.body("r0")
    m.revolute("A0", m.ground, before)
    for k in range(1, 21):
        coupler = m.body(f"c{k}")
        rocker = m.body(f"r{k}")
        m.revolute(f"B{k}", before, coupler, at=(0, 0.5))
        m.revolute(f"C{k}", coupler, rocker, at=(1, 0), child_at=(0, 0.5))
        m.revolute(f"A{k}", m.ground, rocker, at=(k, 0))
        before = rocker
    modes = m.build().assembly_modes({"A0": 0.4})
    assert len(modes) > 500 and not modes.complete and modes.coverage < 0.9


def test_a_system_without_coordinates_has_one_mode():
    modes = kempe.load("joint_fixed").assembly_modes({})
    assert modes.q.shape == (1, 0)


@pytest.mark.parametrize("t", [0.0, 0.3, -1.0])
def test_modes_at_a_time(t):
    """Crank 0.1, rod 0.3, driven by A = 2 t: the slide is at 0.1 cos(2 t) +- sqrt(0.09 - 0.01
    sin^2(2 t)).
    """
    m = kempe.Mechanism("crank", dim=2)
    crank = m.body("crank")
    rod = m.body("rod")
    slide = m.body("slide")
    m.revolute("A", m.ground, crank)
    m.revolute("B", crank, rod, at=(0.1, 0))
    m.revolute("C", rod, slide, at=(0.3, 0))
    m.prismatic("D", m.ground, slide, axis="x")
    m.constrain(kempe.constraints.Equation("A - 2*t", time=True), "drive")
    found = m.build().assembly_modes({"t": t})
    there = 0.1 * np.cos(2.0 * t) + np.array([-1.0, 1.0]) * np.sqrt(
        0.09 - 0.01 * np.sin(2.0 * t) ** 2
    )
    np.testing.assert_allclose(np.sort(found.q[:, 3]), there, atol=1e-9)
    np.testing.assert_allclose(found.q[:, 0], 2.0 * t, atol=1e-9)
    assert np.all(found.judged.holds)
    with pytest.raises(InputError, match="t is .*; it must be one finite number"):
        m.build().assembly_modes({"t": [0.0, t]})

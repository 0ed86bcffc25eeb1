"""Assembly modes, none missing: mirror images, parity, counts by other methods; no more is claimed
than is known.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pytest
from mode_oracles import Framework, Rssr, k33, prism, six_sps
from own_joints import registered

import kempe
from kempe import Mechanism, System
from kempe.assemble.modes import assembly_modes, estimate_coverage, has_even_count, search_modes
from kempe.joints import JointType, P, Primitive
from kempe.poses import make_placement_from_pose
from kempe.spatial import exp_se3


def missing(modes: np.ndarray, wanted: np.ndarray) -> int:
    """How many of the wanted places (n, ...) are not among the modes (k, ...)."""
    if not len(wanted):
        return 0
    axes = tuple(range(2, modes.ndim + 1))
    return int(
        (
            np.abs(wanted[:, None] - modes[None]).max(axis=axes).min(axis=1, initial=np.inf) > 1e-5
        ).sum()
    )


def check_framework(f: Framework, rng: np.random.Generator, starts: int) -> None:
    system = f.system()
    found = assembly_modes(system)
    places = f.places(system, found.q)
    assert missing(places, places * [1.0, -1.0]) == 0, "each mirror image is there"
    assert len(found) % 2 == 0 and not found.freedoms.any()
    assert missing(places, f.modes(rng, starts)) == 0, "what Newton finds is there"
    assert found.coverage < 1.0 and not found.complete


def rssr_system(r: Rssr, end: str = "spherical") -> System:
    """The linkage, with one of its balls as a joint or as three hinges."""
    m = Mechanism("RSSR")
    crank = m.body("crank")
    rod = m.body("rod")
    rocker = m.body("rocker")
    m.revolute("A", m.ground, crank)
    if end == "spherical":
        m.spherical("B", crank, rod, at=(r.crank, 0, 0))
    else:
        m.revolute("B1", crank, m.body("link1"), at=(r.crank, 0, 0), axis=(1, 0, 0))
        m.revolute("B2", "link1", m.body("link2"), axis=(0, 1, 0))
        m.revolute("B3", "link2", rod, axis=(0, 0, 1))
    m.spherical("C", rod, rocker, at=(r.rod, 0, 0), child_at=(r.rocker, 0, 0))
    K = np.eye(4)
    K[:3, :3] = r.frame()
    K[:3, 3] = r.place
    m.joint("D", "revolute", m.ground, rocker, at=make_placement_from_pose(K))
    return m.build()


# ---- cases that were once missed


@pytest.mark.parametrize("case", [0, 122])
def test_no_mirror_image_is_missing(case):
    """Frameworks of which 128 starts find 7 of 8 modes: that can be no number of them."""
    points = np.random.default_rng([1, case]).uniform(-1, 1, (6, 2))
    points[0], points[3] = 0, (np.linalg.norm(points[3]), 0)
    edges = [(i, k) for i in range(3) for k in range(3, 6) if (i, k) != (0, 3)]
    f = Framework(points, edges, (0, 3))
    modes = assembly_modes(f.system())
    assert len(modes) == 8
    assert missing(f.places(modes.system, modes.q), f.points[None][:, f.free] * [1, -1]) == 0


@pytest.mark.parametrize("frame", [None, "rocker"])
def test_an_idle_spin_does_not_make_modes_infinitely_many(frame):
    modes = kempe.load("rssr").assembly_modes({"A": 0.4}, frame=frame)
    assert (
        len(modes) == 2
        and not modes.freedoms.any()
        and modes.status.startswith("not proven complete: 2 found")
    )
    assert np.abs(np.sort(modes.q[:, -1]) - [-1.94625781, 0.69620855]).max() < 1e-8
    assert ("idle spin left out: coupler spins" in modes.status) == (frame is None)


@pytest.mark.parametrize("frame", [None, "platform"])
def test_legs_between_balls_are_counted_by_their_platform(frame):
    system = kempe.load("stewart_sps")
    q = system.q_dict(system.q("closed"))
    known = {n: q[n] for n in system.coordinate_names if n.startswith("leg")} or {
        j.name: q[j.name] for j in system.structure.joints.values() if j.actuated
    }
    modes = assembly_modes(system, known, frame=frame, limits=False)
    heights = system.fk(modes.q, "platform")[:, 2, 3]
    assert len(modes) == 8 and not modes.freedoms.any()
    assert np.abs(np.sort(heights) + np.sort(heights)[::-1]).max() < 1e-8, (
        "half of them below the base"
    )


@pytest.mark.parametrize("end", ["spherical", "hinges"])
def test_balls_made_of_hinges_count_like_others(end):
    """Their links can stand in two ways each, and spin with the rod: the rocker has two angles all
    the same.
    """
    r = Rssr.random(np.random.default_rng(2))
    modes = rssr_system(r, end).assembly_modes({"A": r.angle})
    got = np.sort(np.angle(np.exp(1j * modes.q[:, modes.system.coordinate_names.index("D")])))
    assert len(got) == 2 and np.abs(np.exp(1j * got) - np.exp(1j * r.angles())).max() < 1e-6
    assert not modes.freedoms.any() and "1 idle spin left out" in modes.status


def test_what_moves_besides_the_spin_is_still_not_finite():
    modes = kempe.load("rssr").assembly_modes()
    assert (
        modes.status.startswith("infinitely many: there are sets of them with 1 degree of")
        and len(modes) == 1
    )


def test_a_known_spin_is_none():
    """The rod held by its ball: the spin is given, and nothing is left out."""
    system = kempe.load("rssr")
    closed = system.q_dict(system.q("closed"))
    known = {n: closed[n] for n in ("A", "B.qw", "B.qx", "B.qy", "B.qz")}
    modes = assembly_modes(system, known)
    assert "idle" not in modes.status and not modes.freedoms.any()


@pytest.mark.slow
def test_a_search_that_ends_early_has_all_mirror_images():
    """Starts that are at an end are no reason to leave out what is known for nothing."""
    rng = np.random.default_rng(8)
    seen = set()
    for _ in range(20):
        f = k33(rng)
        system = f.system()
        found = assembly_modes(system, budget=kempe.Budget(starts=12))
        places = f.places(system, found.q)
        assert missing(places, places * [1.0, -1.0]) == 0 and len(found) % 2 == 0
        seen.add(bool((found.multiplicity == 0).any()))
    assert True in seen


# ---- parity


def found(system, known=None, frame=None):
    return search_modes(system, known or {}, None, frame, np.random.default_rng(0), 128)


def test_where_the_number_is_even_by_theorem():
    rng = np.random.default_rng(0)
    assert has_even_count(found(k33(rng).system()))
    system, known = six_sps(rng, False)
    assert has_even_count(found(system, known)) and not has_even_count(
        found(system, known, "platform")
    )
    system = kempe.load("three_rrr")
    assert has_even_count(
        found(system, {n: system.q_dict(system.q("closed"))[n] for n in ("A1", "A2", "A3")})
    )
    assert has_even_count(found(kempe.load("rssr"), {"A": 0.4}))


@dataclass(frozen=True)
class Sledge(JointType):
    """Slides along y, then along x: a particle's place by another name."""

    type_name = "sledge"
    planar = True

    def layout(self, dim: int = 3, particle: bool = False):
        """Two slides."""
        return ("y", "x"), (Primitive(P, "y", 0), Primitive(P, "x", 1))


def test_places_of_particles_are_known_by_what_their_joints_do():
    framework = k33(np.random.default_rng(0))
    with registered([Sledge]):
        assert has_even_count(found(framework.system("sledge")))


def test_where_it_need_not_be():
    """Three slides reach each place once, and a slide that a hinge turns twice."""
    m = Mechanism("gantry")
    for a, b, axis in (("ground", "x", (1, 0, 0)), ("x", "y", (0, 1, 0)), ("y", "z", (0, 0, 1))):
        m.prismatic(f"P{b}", a, m.body(b), axis=axis)
    m.fixed("F", m.ground, "z", at=(0.1, 0.2, 0.3))
    s = found(m.build())
    assert len(s.clusters.q) == 1 and not has_even_count(s) and not s.odd
    modes = assembly_modes(m.build())
    assert len(modes) == 1 and "missing" not in modes.status


def test_an_odd_number_is_called_incomplete(monkeypatch):
    """With too few starts to find the last one and no look at images, the answer says that it is
    there.
    """
    from kempe.assemble import modes as many

    f = k33(np.random.default_rng([1, 0]))
    monkeypatch.setattr(many.ModesSearch, "try_suggested_modes", lambda self: False)
    modes = assembly_modes(f.system(), budget=kempe.Budget(starts=128))
    assert len(modes) == 7 and modes.expected >= 8
    assert "one is missing at least, since their number is even" in modes.status
    assert len(assembly_modes(f.system())) == 8, "more starts find it, since the search goes on"


# ---- limits


def two_rods(limits: dict[str, tuple[float, float]] | None = None) -> System:
    """A plate on a universal joint, held by two rods from cranks beside it."""
    m = Mechanism("plate on two rods")
    m.universal("U", m.ground, m.body("plate"), **({"limits": limits} if limits else {}))
    for name, y, length in (("L", 0.06, 0.27), ("R", -0.06, 0.22)):
        m.revolute(f"m{name}", m.ground, m.body(f"crank{name}"), at=(-0.02, y, length), axis="y")
        m.distance(
            f"rod{name}", f"crank{name}", "plate", length, at=(-0.06, 0, 0), child_at=(-0.08, y, 0)
        )
    return m.build()


def test_without_limits_starts_are_drawn_all_over_and_inside_them_nothing_is_missing_by_parity():
    """Where the limits hold one of several modes, their number need not be even; without limits all
    are found.
    """
    free = two_rods()
    q = free.q_dict(free.assemble({"U.rx": 0.05, "U.ry": 0.45}).q)
    known = {name: q[name] for name in ("mL", "mR")}
    every = free.assembly_modes(known)
    bounded = two_rods({"rx": (-0.5, 0.5), "ry": (-0.8, 0.8)})
    whole = bounded.assembly_modes(known, limits=False)
    inside = bounded.assembly_modes(known)
    assert len(every) >= 4 and len(whole) == len(every) and "drawn inside" not in whole.status
    assert len(inside) == int(whole.inside.sum()) == 1
    assert (
        "missing" not in inside.status
        and "starts were drawn inside the limits only" in inside.status
    )


def test_hunt_limits_hide_no_mode_from_a_search_without_them(hunt):
    """Frameworks of four-bars in space with random limits: the same modes as without limits in the
    model.
    """
    rng = hunt.rng()
    for _ in range(hunt.cases(12)):
        r = Rssr.random(rng)
        m = rssr_system(r).mechanism
        m.joints["D"].limits[""] = tuple(np.sort(rng.uniform(-3.0, 3.0, 2)).tolist())
        system = m.build()
        modes = system.assembly_modes({"A": r.angle}, frame="rocker", limits=False)
        got = np.sort(np.angle(np.exp(1j * modes.q[:, system.coordinate_names.index("D")])))
        assert len(got) == 2 and np.abs(np.exp(1j * got) - np.exp(1j * r.angles())).max() < 1e-6
        assert "missing" not in system.assembly_modes({"A": r.angle}, frame="rocker").status


# ---- what is claimed


@pytest.mark.parametrize("n", [1, 20, 128, 5000])
def test_the_bound_is_the_exact_one_for_nothing_new(n):
    """Not one of n starts led elsewhere: probability (1 - x)^n = 5 %."""
    coverage, expected = estimate_coverage(np.array([n] if n > 1 else [2]))
    n = max(n, 2)
    assert abs(coverage - 0.05 ** (1 / n)) < 1e-9 and expected == 1


def test_the_bound_holds_as_often_as_it_says():
    """Draws from known shares: what is missed exceeds the bound in about 5 % of cases at most."""
    rng = np.random.default_rng(0)
    wrong = 0
    cases = 2000
    for _ in range(cases):
        shares = rng.dirichlet(np.full(12, 0.4))
        hits = np.bincount(rng.choice(12, size=100, p=shares), minlength=12)
        wrong += shares[hits == 0].sum() > 1.0 - estimate_coverage(hits[hits > 0])[0]
    assert wrong < 0.06 * cases


def test_no_search_claims_all():
    system = kempe.load("three_rrr")
    modes = assembly_modes(
        system, {n: system.q_dict(system.q("closed"))[n] for n in ("A1", "A2", "A3")}
    )
    assert (
        0.9 < modes.coverage < 1.0
        and "100 %" not in modes.status
        and "95 % confidence" in modes.status
    )


# ---- hunts


def check_rssr(r: Rssr) -> None:
    for frame in (None, "rocker"):
        modes = rssr_system(r).assembly_modes({"A": r.angle}, frame=frame)
        got = np.sort(np.angle(np.exp(1j * modes.q[:, modes.system.coordinate_names.index("D")])))
        assert len(got) == 2 and np.abs(np.exp(1j * got) - np.exp(1j * r.angles())).max() < 1e-6


def check_six_sps(rng: np.random.Generator) -> None:
    flat = rng.random() < 0.3
    system, known = six_sps(rng, flat)
    modes = system.assembly_modes(known, frame="platform")
    assert len(modes) % 2 == 0 and 2 <= len(modes) <= 40 and not modes.freedoms.any()
    if flat:
        places = system.fk(modes.q, "platform")[:, :3, 3]
        assert missing(places, places * [1, 1, -1]) == 0


def test_hunt_modes(hunt):
    """Random frameworks, platforms and RSSR linkages: nothing that other methods find is missing."""
    rng = hunt.rng()
    for _ in range(hunt.cases(5)):
        check_framework(k33(rng), rng, 300)
        check_framework(prism(rng), rng, 300)
        check_rssr(Rssr.random(rng))
        check_six_sps(rng)


@pytest.mark.slow
def test_hunt_many_frameworks(hunt):
    rng = hunt.rng()
    for _ in range(hunt.cases(40)):
        check_framework(k33(rng), rng, 600)
        check_framework(prism(rng), rng, 600)


@pytest.mark.slow
def test_hunt_many_loops(hunt):
    rng = hunt.rng()
    for _ in range(hunt.cases(80)):
        check_rssr(Rssr.random(rng))
        check_six_sps(rng)


@pytest.mark.parametrize("factors", [(1.0, 1.0), (0.5, -1.0)], ids=str)
def test_angles_that_wind_up_make_no_modes(factors):
    """A differential's angles may go around together, and all bodies are where they were: no mode
    is listed twice.
    """
    rng = np.random.default_rng(3)
    m = Mechanism("7R with a differential")
    bodies = ["ground", *(m.body(f"b{i}") for i in range(7)), "ground"]
    for i in range(8):
        place = make_placement_from_pose(exp_se3(rng.uniform(-2, 2, 6)))
        m.revolute(f"J{i}", bodies[i], bodies[i + 1], at=place, child_at=place)
    m.couple("J5", {"J1": factors[0], "J2": factors[1]})
    system = m.build()
    counts = set()
    for seed in range(3):
        found = system.assembly_modes({"J3": 0.0}, budget=kempe.Budget(rng=seed))
        poses = system.fk(found.q)
        apart = np.abs(poses[:, None] - poses[None]).max(axis=(2, 3, 4)) + 10.0 * np.eye(len(poses))
        assert len(found.q) > 1 and apart.min() > 1e-5
        counts.add(len(found.q))
    assert len(counts) == 1

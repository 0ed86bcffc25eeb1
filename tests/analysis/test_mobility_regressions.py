"""Mechanisms of the literature and of proofs with known degrees of freedom, and defects that they once showed."""

from __future__ import annotations

from math import cos, pi, sin, sqrt

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from world_mechanisms import World, X, Y, Z, framework, loop, on_rods, unit

import kempe
from kempe import Mechanism, System
from kempe.analysis.first_order.rank import decide, rank_at
from kempe.analysis.local.local import local_dimension
from kempe.analysis.mobility.mobility import Mobility, mobility
from kempe.errors import InputError
from kempe.kinematics.closure_rows import jacobian
from kempe.spatial import exp_se3

FAR = exp_se3(np.array([3.0, -1.0, 2.0, 0.4, -0.7, 0.5]))
FAR_FLAT = exp_se3(np.array([3.0, -1.0, 0.0, 0.0, 0.0, 0.6]))


def look(world: World, scale: float = 1.0, moved: bool = False, **options) -> Mobility:
    system = world.build(scale, (FAR if world.dim == 3 else FAR_FLAT) if moved else None)
    return mobility(system, system.neutral, **options)


def around(*angles: float, radius: float = 1.0, z: float = 0.0) -> list[tuple[float, float, float]]:
    return [(radius * cos(a), radius * sin(a), z) for a in angles]


# ---- known degrees of freedom

OCTAHEDRON = [(i, k) for i in range(6) for k in range(i + 1, 6) if (i, k) not in ((0, 1), (2, 3), (4, 5))]
A, B, C = np.random.default_rng(5).normal(size=(3, 3))
HALF_TURN, MIRROR = np.diag([-1.0, -1.0, 1.0]), np.diag([1.0, 1.0, -1.0])
SQUARE = [(0.0, 0.0, 0.0), (1.0, 0.0, 0.0), (1.4, 0.8, 0.0), (0.4, 0.8, 0.0)]
ON_AXES = [(1, 0), (-1.7, 0), (0.6, 0), (0, 1.2), (0, -0.8), (0, 2.1)]
HEXAGON = np.array(around(0.1, 0.9, 2.2, 3.0, 4.3, 5.1))
TILTED = Rotation.from_rotvec([0.3, -0.2, 0.5]).as_matrix()
BENT = np.array([(1, 0.1, 0), (0.7, 0.9, 0), (-0.5, 1.1, 0), (-1.2, 0.2, 0), (-0.3, -1, 0), (0.6, -0.7, 0)])


def bipartite(m: int, n: int) -> list[tuple[int, int]]:
    return [(i, m + k) for i in range(m) for k in range(n)]


def helical(pitches: list[float]) -> World:
    return loop("four screws", [("helical", p, Z, {"pitch": h}) for p, h in zip(SQUARE, pitches, strict=True)])


def trammel(n: int) -> World:
    """A point of a circle that rolls in one twice as large moves along a diameter (Cardano): any number of slots."""
    w = World("trammel", 2)
    w.joint("free", "ground", "rod")
    for k in range(n):
        e = np.array([cos(0.3 + pi * k / n), sin(0.3 + pi * k / n)])
        w.line("ground", "rod", (np.array([cos(0.7), sin(0.7)]) @ e) * e, e)
    return w


def hoberman(n: int, inner: float = 1.4, outer: float = 2.3) -> World:
    """A ring of n pairs of angulated bars (Hoberman, 1990); the first bar is the ground."""
    w = World("ring", 2)
    half = pi / n
    middle = (inner + outer) / 2 / cos(half)

    def ray(k: int, r: float) -> tuple[float, float]:
        return r * cos(k * half), r * sin(k * half)

    for i in range(n):
        j = (i + 1) % n
        a, b = "ground" if i == 0 else f"a{i}", "ground" if j == 0 else f"a{j}"
        w.turn(a, f"b{i}", ray(2 * i, middle))
        w.turn(a, f"b{j}", ray(2 * i + 1, outer))
        w.turn(f"b{i}", b, ray(2 * i + 1, inner))
    return w


def four_upu() -> World:
    """Legs between crosses whose outer axes are parallel: all motions but two turns (Zhao and Huang, 2000)."""
    w = World("4-UPU")
    base, top = [(2, 0, 0), (0, 2, 0), (-2, 0.3, 0), (0.1, -2, 0)], [(0.6, 0.1), (0.2, 0.7), (-0.5, 0.1), (0.1, -0.6)]
    for i, (a, b) in enumerate(zip(base, top, strict=True)):
        a, b = np.array(a, dtype=float), np.array([*b, 1.4])
        across = unit(np.cross(Z, b - a))
        w.cross("ground", f"a{i}", a, Z, across)
        w.slide(f"a{i}", f"b{i}", b - a, a, name=f"leg{i}")
        w.cross(f"b{i}", "top", b, across, Z)
    return w


def cardan_shafts(first: float, second: float) -> World:
    w = World("two Cardan joints")
    d, e = np.array([sin(first), 0, cos(first)]), np.array([sin(first + second), 0, cos(first + second)])
    w.turn("ground", "in", -Z, Z)
    w.cross("in", "mid", np.zeros(3), Y, np.cross(Y, d))
    w.cross("mid", "out", d, np.cross(Y, d), Y)
    w.turn("out", "ground", d + e, e)
    return w


def miura(nx: int, ny: int, fold: float) -> World:
    """Panels of Miura's fold, all alike; flat at 0. The first panel is the ground."""
    w, corner = World("Miura"), 1.0
    deep = sqrt(1 + cos(fold) ** 2 * np.tan(corner) ** 2)
    step, shift, high = cos(fold) * np.tan(corner) / deep, 1 / deep, sin(fold) * sin(corner)
    long = sqrt(1 - (sin(fold) * sin(corner)) ** 2)

    def at(i: int, j: int) -> np.ndarray:
        return np.array([i * step, j * long + (i % 2) * shift, (j % 2) * high])

    def panel(i: int, j: int) -> str:
        return f"p{i}{j}" if (i, j) != (0, 0) else "ground"

    for i in range(nx):
        for j in range(ny):
            if i + 1 < nx:
                w.turn(panel(i, j), panel(i + 1, j), at(i + 1, j), at(i + 1, j + 1) - at(i + 1, j))
            if j + 1 < ny:
                w.turn(panel(i, j), panel(i, j + 1), at(i, j + 1), at(i + 1, j + 1) - at(i, j + 1))
    return w


def griffis_duffy() -> World:
    """Corners of each triangle under middles of the other's sides (Griffis, Duffy, 1993; Husty, Karger, 2000)."""
    corners = np.array([(0, 0, 0), (1, 0, 0), (0.5, sqrt(3) / 2, 0)])
    middles = (corners.sum(axis=0) - corners) / 2
    top = np.concatenate([middles, corners]) - corners.mean(axis=0)
    return on_rods("Griffis-Duffy", np.concatenate([corners, middles]), top @ TILTED.T + [0.5, 0.3, 1.0])


def prism(turn: float) -> World:
    bottom, top = around(0, 2 * pi / 3, 4 * pi / 3), around(turn, turn + 2 * pi / 3, turn + 4 * pi / 3, z=1.0)
    edges = [(3, 4), (4, 5), (3, 5), *((i, 3 + i) for i in range(3)), *(((i + 1) % 3, 3 + i) for i in range(3))]
    return framework("twisted prism", bottom + top, edges, pinned=(0, 1, 2))


TWO_TRIANGLES = [(i, k) for i in (0, 1) for k in range(2, 8)] + [(2, 3), (3, 4), (2, 4), (5, 6), (6, 7), (5, 7)]
ELLIPSE = [(2 * cos(t), sin(t)) for t in (0.2, 1.5, 3.9, 0.9, 2.6, 5.1)]
SPREAD = np.random.default_rng(8).normal(size=(10, 3))
ELLIPSOID = SPREAD / np.linalg.norm(SPREAD, axis=1, keepdims=True) * [1.0, 1.5, 0.7]
RECTANGLES = [(s * a, t * b) for a, b in ((1.0, 0.4), (0.5, 1.3)) for s in (1, -1) for t in (1, -1)]

KNOWN = {  # the count, the rank, the truth
    "Dixon, 1899, first": (framework("K33", ON_AXES, bipartite(3, 3), (0, 3), 2), 0, 1, 1),
    "Dixon, 1899, second": (framework("K44", RECTANGLES, bipartite(4, 4), (0, 4), 2), -3, 1, 1),
    "K33 on a conic: shaky": (framework("K33", ELLIPSE, bipartite(3, 3), (0, 3), 2), 0, 1, 0),
    "Bricard, 1897, line": (
        framework("octahedron", [A, HALF_TURN @ A, B, HALF_TURN @ B, C, HALF_TURN @ C], OCTAHEDRON, (0, 2, 4)), 0, 1, 1,
    ),
    "Bricard, 1897, plane": (
        framework("octahedron", [A, MIRROR @ A, B, MIRROR @ B, (0.3, 1.2, 0), (-1, -0.4, 0)], OCTAHEDRON, (0, 2, 4)),
        0, 1, 1,
    ),
    "Cauchy: regular octahedron": (framework("octahedron", [X, -X, Y, -Y, Z, -Z], OCTAHEDRON, (0, 2, 4)), 0, 0, 0),
    "octahedron turned by 30 degrees: shaky": (prism(5 * pi / 6), 0, 1, 0),
    "double banana": (framework("bananas", SPREAD[:8], TWO_TRIANGLES, (2, 3, 4)), 0, 1, 1),
    "K46 on a quadric: Bolker and Roth, 1980": (framework("K46", ELLIPSOID, bipartite(4, 6)), 6, 7, 6),
    "Griffis-Duffy": (griffis_duffy(), 0, 1, 1),
    "similar hexagons on circles: Ma and Angeles, 1991": (
        on_rods("similar", HEXAGON, 0.6 * HEXAGON @ TILTED.T + [0.3, 0.2, 1.4]), 0, 1, 1,
    ),
    "three parallel rods of one length": (
        on_rods("parallel", [(0, 0), (2, 0), (0.7, 1.1)], [(0.4, 1.5), (2.4, 1.5), (1.1, 2.6)], 2), 0, 1, 1,
    ),
    "Delassus, 1922: parallelogram of screws": (helical([0.1, 0.3, 0.5, 0.3]), -2, 1, 1),
    "four screws that do not fit": (helical([0.1, 0.3, 0.5, 0.2]), -2, 0, 0),
    "trammel with five slots": (trammel(5), -2, 1, 1),
    "Hoberman's ring of six": (hoberman(6), -3, 1, 1),
    "4-UPU": (four_upu(), 2, 4, 4),
    "double Cardan": (cardan_shafts(0.5, -0.5), 0, 1, 1),
    "folded Miura": (miura(3, 3, 0.6), -12, 1, 1),
}  # fmt: skip


PROVEN = {
    "K33 on a conic: shaky", "Cauchy: regular octahedron", "octahedron turned by 30 degrees: shaky",
    "four screws that do not fit", "Hoberman's ring of six", "double Cardan",
}  # fmt: skip
"""The others move by theorems about their lengths, which are not looked at."""


@pytest.mark.parametrize("name", KNOWN)
def test_known_degrees_of_freedom(name):
    world, count, rank, dof = KNOWN[name]
    for scale, moved in ((1.0, False), (1e-4, True), (1e4, True)):
        m = look(world, scale, moved)
        assert (m.gruebler, m.rank_dof, m.dof, m.certain) == (count, rank, dof, name in PROVEN), str(m)
        assert m.singular == (rank > dof) and m.redundant == rank - count
        assert sum(len(r.reactions) for r in m.redundancy.releases) == m.redundant


def test_all_four_legs_are_needed():
    m = look(four_upu(), actuated=["leg0", "leg1", "leg2", "leg3"])
    assert m.control.complete and m.control.excess == 0
    assert not look(four_upu(), actuated=["leg0", "leg1", "leg2"]).control.complete


# ---- all joints on one point, away from the origin


@pytest.mark.parametrize("scale", [1e-4, 1.0, 1e4])
def test_axes_through_one_point_away_from_the_origin(scale):
    """The spread of the joints is rounding there, and no length."""
    spherical = loop("spherical", [("revolute", np.zeros(3), unit(z)) for z in SPREAD[:5]])
    m = look(spherical, scale, moved=True)
    assert (m.gruebler, m.rank_dof, m.dof, m.redundant) == (-1, 2, 2, 3)
    assert m.loops[0].motion == "turns about one point"
    jack = [("revolute", np.zeros(3), Z), ("helical", np.zeros(3), Z, {"pitch": 0.1}), ("prismatic", np.zeros(3), Z)]
    m = look(loop("screw jack", jack), scale, moved=True)
    assert (m.gruebler, m.rank_dof, m.dof) == (-3, 1, 1)


# ---- idle freedoms


@pytest.mark.parametrize("scale", [1e-4, 1.0, 1e4])
def test_a_roller_on_its_pin_is_idle_and_links_that_happen_to_be_in_line_are_not(scale):
    """Textbooks' idle freedom: a roller between an arm and a block. A rhombus folded for good is no such thing."""
    w = World("roller", 2)
    w.turn("ground", "arm", (0, 0))
    w.turn("arm", "roller", (1, 0.5))
    w.turn("roller", "block", (1, 0.5))
    w.slide("block", "ground", (0.3, 1), (1, 0.5))
    m = look(w, scale, moved=True)
    assert (m.gruebler, m.dof, m.idle, m.useful) == (1, 1, 1, 0)
    w.joints[-1] = ("bar", "revolute", "block", "bar", np.array([2.0, 1.0, 0.0]), np.eye(3), {})
    w.turn("bar", "ground", (2, 0))
    m = look(w, scale, moved=True)
    assert (m.dof, [f.bodies for f in m.idle_freedoms], m.useful) == (2, [("roller",)], 1)
    folded = World("rhombus", 2)
    for a, b, p in (("ground", "a", (0, 0)), ("a", "b", (1, 0)), ("b", "c", (1.6, 0.8)), ("c", "ground", (1, 0))):
        folded.turn(a, b, p)
    assert look(folded).idle == 0


# ---- shaky along a whole branch, and branches with the same kernel


def test_a_platform_on_parallel_legs_of_one_length_translates():
    """All legs are one vector of that length: a sphere of translations; the turn about the legs is to first order."""
    m = look(on_rods("translation", BENT, BENT + [0.3, 0.2, 1.4]))
    assert (m.gruebler, m.rank_dof, m.dof, m.local.branch_dims, m.local.doubts) == (0, 3, 2, (2,), ())


@pytest.mark.parametrize("seed", range(3))
def test_branches_with_the_same_null_space_are_distinguished(seed):
    """Legs on a circle, straight up: it translates (2), or turns while it sinks (1); the kernel is 3 all along both."""
    m = look(on_rods("circle", HEXAGON, HEXAGON + [0, 0, 1.4]), rng=seed)
    assert (m.rank_dof, m.dof, m.local.branch_dims, m.local.doubts) == (3, 2, (2, 1), ()), str(m)


def dead_centres(stages: int) -> World:
    """Stretched bars shift a slider by s^2, which at the dead centre of the next shifts that by s^4, and so on."""
    w = World("dead centres", 2)
    w.turn("ground", "a", (0, 0))
    w.turn("a", "b", (1, 0))
    p, along = np.array([2.0, 0.0]), np.array([1.0, 0.0])
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
    m = look(dead_centres(stages))
    assert m.rank_dof == 1
    assert m.dof == 0 or not m.certain and "the truth to order 8" in m.sentence or "1 to order 8" in m.sentence
    assert stages > 3 or (m.dof, m.local.obstruction_order) == (0, 2**stages)


@pytest.mark.parametrize("seed", range(4))
def test_redundancy_does_not_depend_on_the_seed_where_branches_meet(seed):
    """Flat, Miura's panels fold along both straight lines at once (2), or in ways of one freedom."""
    m = look(miura(3, 3, 0.0), rng=seed)
    assert (m.gruebler, m.dof, m.local.branch_dims[0], m.local.branch_dims[-1]) == (-12, 2, 2, 1)
    assert (m.generic_rank_dof, m.redundant) == (1, 13)


# ---- equations that are all singular at once


def torus(at, normal) -> World:
    """A point of an arm of two hinges, at distance 1 from the second, in a plane that touches its torus."""
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


def test_the_rank_can_be_zero():
    assert decide(np.array([1e-16]), 2, 1.0)[0] == 0 and decide(np.array([1e-16]), 2)[0] == 1
    assert decide(np.array([1e-2]), 2, 1.0)[0] == 1


# ---- near to singular


@pytest.mark.parametrize("off", [1e-6, 1e-7, 1e-8])
def test_what_is_nearly_a_mechanism_is_none_for_certain_or_probably_one(off):
    """A Bennett linkage whose axes are off by this much is no mechanism, but nearly one."""
    system = kempe.load("bennett")
    rng = np.random.default_rng(0)
    pose = dict(zip(system.body_names, system.fk(system.q("closed")), strict=True))
    world = World("nearly")
    for j in system.structure.joints.values():
        F = pose[j.parent] @ j.X_PF.evaluate(system.structure.parameters)
        p, z = F[:3, 3] + off * rng.normal(size=3), F[:3, 2] + off * rng.normal(size=3)
        world.turn(*("ground" if b == system.body_names[0] else b for b in (j.parent, j.child)), p, z)
    report = look(world)
    assert report.dof == 0 if report.certain else "probably" in report.sentence


# ---- arguments and words


def empty() -> System:
    return Mechanism("empty").build()


def test_wrong_arguments_are_refused():
    system = kempe.load("four_bar")
    q = system.q("closed")
    with pytest.raises(InputError, match="list of names"):
        mobility(system, q, actuated=3)  # pyright: ignore[reportArgumentType]
    for tolerance in (0.0, -1.0, 1.0, 2.0, float("nan")):
        with pytest.raises(InputError, match="tolerance"):
            local_dimension(system, q, tolerance=tolerance)


def test_nothing_to_move():
    assert local_dimension(empty(), []).dim == 0
    frame = World("frame")
    frame.joint("fixed", "ground", "a")
    frame.joint("fixed", "a", "b", (1, 0, 0))
    frame.joint("fixed", "b", "ground", (0, 1, 0))
    assert local_dimension(frame.build(), []).dim == 0 and look(frame).redundant == 6


def test_counts_are_sentences():
    m = kempe.load("four_bar").mechanism
    m.lock({"A": m.postures["closed"]["A"]})
    assert "1 locked coordinate takes away one" in mobility(m.build()).counting.steps[-1]
    assert "5 on-line constraints x 1" in look(trammel(5)).counting.steps[1]


def test_control_says_that_it_counts_to_first_order():
    """The slider is not driven by the pendulum, but the dead centre keeps it: P alone is what truly moves."""
    report = mobility(kempe.load("pendulum_dead_centre"), actuated=["P"])
    assert (report.control.controlled, report.control.useful) == (1, 2)
    assert "counted to first order, where the rank sees 2 freedoms; truly there is 1" in str(report)


def test_kernels_keep_all_loops_closed():
    for world, *_ in KNOWN.values():
        system = world.build()
        rank = rank_at(system, system.neutral)
        assert np.abs(jacobian(system, rank.q) @ (rank.kernel * rank.units[:, None])).max(initial=0.0) < 1e-9

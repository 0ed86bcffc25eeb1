"""Workspaces in given orientations, of orientations, without limits in a box; bounds that are
proven.
"""

from __future__ import annotations

import itertools
import math
from functools import cache

import numpy as np
import pytest
from hunts import Hunt
from reached_sets import ANNULUS, two_bars

import kempe
from kempe import Budget, Mechanism, Status, constraints
from kempe.errors import InputError, UnknownNameError, UnsupportedError
from kempe.workspace.answer import compute_outer_measure
from kempe.workspace.cell_map import Grid
from kempe.workspace.kinds import (
    WorkspaceKind,
    compute_rotation_coordinates,
    compute_rotations,
    spread_rotations,
)
from kempe.workspace.legs import find_legs, find_possible_places

A = 0.5
B = 0.3
H = 0.1
"""Links of the planar arm of three turns, the last one of which carries the tool."""


@cache
def three_bars(limits=None):
    m = Mechanism("three bars", dim=2)
    first = m.body("first")
    second = m.body("second")
    third = m.body("third")
    m.revolute("q1", m.ground, first)
    m.revolute("q2", first, second, at=(A, 0), limits=limits)
    m.revolute("q3", second, third, at=(B, 0))
    m.frame("tool", third, (H, 0))
    return m.build()


@cache
def hexapod():
    return kempe.load("stewart").with_limits({f"leg{i}": (0.35, 0.45) for i in range(1, 7)})


def joints_of(system):
    """Places (6, 3) of the joints at the base, and of those at the platform in the tool's frame."""
    q = system.q("closed")
    back = np.linalg.inv(system.fk(q, "tool"))
    low = [system.fk(q, f"lower{k}")[:3, 3] for k in range(1, 7)]
    return np.array(low), np.array([(back @ system.fk(q, f"upper{k}"))[:3, 3] for k in range(1, 7)])


def turn(x):
    return np.array(
        [[math.cos(x), -math.sin(x), 0.0], [math.sin(x), math.cos(x), 0.0], [0.0, 0.0, 1.0]]
    )


# ---- against closed forms


@pytest.mark.slow
def test_a_hexapod_in_one_orientation():
    """Each leg leaves a spherical shell: Gosselin, "Determination of the workspace of 6-DOF
    parallel manipulators", J. Mechanical Design 112 (1990).
    """
    system = hexapod()
    R = turn(0.2)
    low, high = joints_of(system)
    w = system.workspace(
        "tool", orientation=R, box=[(-0.2, 0.2), (-0.2, 0.2), (0.2, 0.5)], n=400, cells=12
    )
    points = np.random.default_rng(0).uniform((-0.2, -0.2, 0.2), (0.2, 0.2, 0.5), (200_000, 3))
    lengths = np.linalg.norm(points[:, None] + high @ R.T - low, axis=-1)
    inside = ((lengths > 0.35) & (lengths < 0.45)).all(axis=1)
    value, error = w.volume
    assert abs(value - inside.mean() * 0.048) < 1.5 * error and 0.0 < error < 0.6 * value
    assert w.kind == "constant-orientation" and w.bounds[0] < inside.mean() * 0.048 < w.bounds[1]
    clear = (np.abs(lengths[:150] - 0.35) > 1e-4).all(axis=1) & (
        np.abs(lengths[:150] - 0.45) > 1e-4
    ).all(axis=1)
    assert np.array_equal(w.contains(points[:150], check=True)[clear], inside[:150][clear])


def test_a_planar_parallel_robot_in_one_orientation():
    """Three annuli meet: Gosselin, Angeles, "The optimum kinematic design of a planar
    three-degree-of-freedom parallel manipulator", J. Mechanisms 110 (1988).
    """
    robot = kempe.load("three_rrr")
    angle = 0.2
    thirds = 2.0 * math.pi / 3.0 * np.arange(3)
    low = 0.5 * np.column_stack([np.cos(thirds), np.sin(thirds)])
    high = 0.15 * np.column_stack([np.cos(thirds + angle), np.sin(thirds + angle)])
    w = robot.workspace("tool", orientation=angle, cells=48)
    points = np.random.default_rng(1).uniform(-0.4, 0.4, (500_000, 2))
    far = np.linalg.norm(points[:, None] + high - low, axis=-1)
    inside = ((far > 0.05) & (far < 0.55)).all(axis=1)
    truth = 0.64 * inside.mean()
    off = 0.64 * 4.0 * 0.5 / math.sqrt(500_000)
    assert abs(w.area[0] - truth) < off and abs(w.estimate[0] - truth) < off + 1.5 * w.estimate[1]
    assert np.array_equal(w.contains(points[:400], check=True), inside[:400])


def dexterous(points):
    """Whether a circle of radius H about each lies in the annulus of the wrist."""
    far = np.linalg.norm(points, axis=-1)
    return (far + H <= A + B) & (np.abs(far - H) >= A - B)


@pytest.mark.slow
def test_a_planar_arm_in_all_orientations():
    w = three_bars().workspace("tool", kind="dexterous", cells=40)
    ring = math.pi * ((A + B - H) ** 2 - (A - B + H) ** 2)
    spot = math.pi * max(H - (A - B), 0.0) ** 2
    value, error = w.area
    assert abs(value - ring - spot) < 1.5 * error < 0.15
    points = np.random.default_rng(2).uniform(-0.9, 0.9, (60, 2))
    assert np.array_equal(w.contains(points, check=True), dexterous(points))
    assert "in all 180 orientations" in w.status


@pytest.mark.slow
def test_an_arm_with_a_spherical_wrist_turns_everywhere_inside_its_shell():
    """Wrist centres fill a spherical shell; the tool, beside it by H, is dexterous inside a thinner
    one.
    """
    m = Mechanism("arm")
    names = ["hip", "upper", "lower", "w1", "w2", "hand"]
    bodies = [m.ground, *(m.body(n) for n in names)]
    for k, (axis, at) in enumerate([("z", 0), ("y", 0), ("y", A), ("x", B), ("y", 0), ("x", 0)]):
        m.revolute(f"q{k + 1}", bodies[k], bodies[k + 1], at=(at, 0, 0), axis=axis)
    m.frame("tool", bodies[-1], (H, 0, 0))
    arm = m.build()
    whole = arm.workspace("tool", kind="dexterous", cells=10)
    one = arm.workspace("tool", orientation=(0.3, -0.2, 0.9), cells=12)
    shell = 4.0 / 3.0 * math.pi * ((A + B) ** 3 - (A - B) ** 3)
    assert abs(one.volume[0] - shell) < 1.5 * one.volume[1]
    thin = 4.0 / 3.0 * math.pi * ((A + B - H) ** 3 - (A - B + H) ** 3)
    assert abs(whole.volume[0] - thin) < 1.5 * whole.volume[1]
    points = np.random.default_rng(3).uniform(-0.9, 0.9, (150, 3))
    far = np.linalg.norm(points, axis=1)
    # between the orientations that are tried
    sure = np.abs(far[:, None] - [A + B - H, A - B + H]).min(axis=1) > 0.01
    assert np.array_equal(whole.contains(points, check=True)[sure], dexterous(points)[sure])


def test_orientations_at_a_place():
    """The wrist is on a circle of radius H about the place, of which the annulus has an arc, by the
    law of cosines.
    """
    place = np.array([0.75, 0.1])
    far = float(np.linalg.norm(place))
    half = math.acos((far**2 + H**2 - (A + B) ** 2) / (2.0 * far * H))
    w = three_bars().workspace("tool", at=place)
    value, error = w.length
    assert abs(value - 2.0 * half) < 1.5 * error < 0.1 and w.kind == "orientation"
    outward = math.atan2(place[1], place[0])
    angles = np.linspace(-3.1, 3.1, 101)
    off = np.abs((angles - outward + math.pi) % (2.0 * math.pi) - math.pi)
    assert np.array_equal(w.contains(angles, check=True), off < half)
    assert w.bounds[1] == pytest.approx(2.0 * math.pi)
    with pytest.raises(UnsupportedError, match="not of orientations"):
        w.distance(0.1)


def test_orientations_in_space():
    """Two turns of a wrist about axes at right angles reach a surface of orientations, three turns
    all of them.
    """
    m = Mechanism("wrist")
    a = m.body("a")
    b = m.body("b")
    c = m.body("c")
    m.revolute("q1", m.ground, a, axis="z", limits=(0.0, math.pi))
    m.revolute("q2", a, b, axis="y", limits=(0.0, math.pi))
    m.revolute("q3", b, c, axis="z")
    w = m.build().workspace("c", at=(0, 0, 0), cells=12)
    # azimuths from 0 to pi, of 8 pi^2 in all
    assert abs(w.volume[0] - 4.0 * math.pi**2) < 1.5 * w.volume[1]
    R = compute_rotations(np.array([[0.5, 0.3, 1.0], [-0.5, 0.3, 1.0]]), 3)
    assert w.contains(R, check=True).tolist() == [True, False]
    assert list(w.map.axes) == ["azimuth", "height", "roll"] and w.map.unit == "rad"


def test_coordinates_of_orientations():
    R = spread_rotations(500, 3)
    assert np.abs(compute_rotations(compute_rotation_coordinates(R, 3), 3) - R).max() < 1e-12
    assert (
        np.abs(
            compute_rotations(compute_rotation_coordinates(np.eye(3)[None], 3), 3) - np.eye(3)
        ).max()
        < 1e-12
    )
    apart = np.linalg.norm(R[:, None] - R, axis=(2, 3)) + 9.0 * np.eye(500)
    assert apart.min(axis=1).min() > 0.5 * apart.min(axis=1).mean()  # spread evenly


def test_of_a_system_with_loops_leg_by_leg_is_as_by_all_equations():
    robot = kempe.load("three_rrr").with_limits({"A1": (-3.0, 0.5), "C2": (-1.0, 2.5)})
    assert [leg.joint_names for leg in find_legs(robot, "tool")] == [
        tuple(f"{c}{k}" for c in "ABC") for k in (1, 2, 3)
    ]
    w = robot.workspace("tool", orientation=0.1, cells=8)
    p = np.random.default_rng(5).uniform(-0.2, 0.2, (60, 2))
    X = np.tile(np.eye(4), (60, 1, 1))
    X[:, :2, 3] = p
    X[:, :3, :3] = turn(0.1)
    assert np.array_equal(w.contains(p, check=True), robot.ik(X, "tool").success)


@pytest.mark.parametrize("name", ["jansen", "delta_uu", "puma560"])
def test_what_is_not_made_of_legs(name):
    system = kempe.load(name)
    assert find_legs(system, system.frame_names[-1]) == ()


# ---- slides without limits, bounds


def test_a_box_stands_for_limits_of_slides():
    """On a rail without end the arm reaches a strip."""
    m = Mechanism("rail", dim=2)
    cart = m.body("cart")
    arm = m.body("arm")
    m.prismatic("rail", m.ground, cart, axis="x")
    m.revolute("turn", cart, arm)
    m.frame("tip", arm, (0.3, 0))
    system = m.build()
    w = system.workspace("tip", box=[(5.0, 7.0), (-1.0, 1.0)], cells=40)
    assert abs(w.area[0] - 1.2) < 1.5 * w.area[1] and w.bounds[1] < 1.4
    assert w.contains([[6.0, 0.2], [6.0, 0.4], [90.0, 0.1]]).tolist() == [True, False, True]
    box = [(-0.1, 0.1), (-0.1, 0.1), (0.3, 0.4)]
    w = kempe.load("stewart").workspace(
        "tool", kind="constant-orientation", orientation=np.eye(3), box=box, cells=4
    )
    assert w.volume[0] == pytest.approx(0.004)


def test_an_axis_that_stays_where_it_is_need_not_be_in_the_middle_of_a_box():
    m = Mechanism()
    a = m.body("a")
    b = m.body("b")
    m.revolute("A", m.ground, a, at=(0, 0, 0.7), axis="z")
    m.revolute("B", a, b, at=(0.5, 0, 0), axis="z")
    m.frame("tip", b, (0.3, 0, 0))
    w = m.build().workspace("tip", n=2e5, box=[(-1, 1), (-1, 1), (0, 1)])
    assert abs(w.area[0] - ANNULUS) < 1.5 * w.area[1]
    assert m.build().workspace("tip", n=100, box=[(-1, 1), (-1, 1), (0, 0.5)]).area[0] == 0.0


def test_bounds_of_an_annulus():
    """Lengths alone have it exactly but for the cells along its edges."""
    low, high = two_bars(0.5, 0.3).workspace("tip", n=1e5).bounds
    assert 0.98 * ANNULUS < low < ANNULUS < high < 1.05 * ANNULUS


def random_chain(rng):
    m = Mechanism("random", dim=int(rng.integers(2, 4)))
    body = m.ground
    for k in range(int(rng.integers(1, 7))):
        at = rng.normal(size=m.dim)
        child = m.body(f"b{k}")
        limits = np.sort(rng.uniform(-3.0, 3.0, 2))
        rpy = {} if m.dim == 2 else {"rpy": rng.uniform(-3.0, 3.0, 3)}
        if rng.random() < 0.65:
            m.revolute(
                f"q{k}",
                body,
                child,
                at=at,
                limits=None if rng.random() < 0.3 else tuple(limits),
                **rpy,
            )
        elif rng.random() < 0.8 or m.dim == 2:
            axis = rng.normal(size=m.dim)
            m.prismatic(f"q{k}", body, child, at=at, axis=axis, limits=tuple(limits), **rpy)
        else:
            m.spherical(f"q{k}", body, child, at=at, **rpy)
        body = child
    m.frame("tip", body, rng.normal(size=m.dim))
    return m.build()


def test_hunt_for_places_outside_their_bounds(hunt: Hunt):
    """A place that is reached, and a box about it, however small, is never shut out."""
    rng = hunt.rng()
    for _ in range(hunt.cases(40)):
        system = random_chain(rng)
        assert find_possible_places(
            system, "tip", system.fk(system.random(rng, 100), "tip")[:, :3, 3]
        ).all()
        for p in system.fk(system.random(rng, 4), "tip")[:, :3, 3]:
            size = 10.0 ** rng.uniform(-6.0, 0.0)
            part = rng.random(3) if system.dim == 3 else np.append(rng.random(2), 0.5)
            low, high = (tuple((p + size * x).tolist()) for x in (-part, 1.0 - part))
            grid = Grid(low, high, (1, 1, 1), ("x", "y", "z")[: system.dim])
            assert compute_outer_measure(system, "tip", grid) > 0.0


@pytest.mark.parametrize(
    "make", [three_bars, hexapod, lambda: kempe.load("puma560"), lambda: kempe.load("stanford")]
)
def test_places_beyond_all_lengths_need_no_inverse_model(make, monkeypatch):
    system = make()
    tried = []
    workspace = system.workspace("tool", n=4096, cells=10)
    monkeypatch.setattr(
        WorkspaceKind,
        "_find_reached",
        lambda _, system, frame, points, seed: (
            tried.append(points) or np.ones(len(points), dtype=bool)
        ),
    )
    far = np.random.default_rng(0).normal(size=(50, 3)) * [1.0, 1.0, system.dim == 3]
    far *= 10.0 ** np.arange(1, 6)[:, None].repeat(10, 0) / np.linalg.norm(far, axis=1)[:, None]
    assert not workspace.contains(far[:, : system.dim]).any() and not any(map(len, tried))


def test_bounds_of_loops_are_those_of_each_leg():
    system = hexapod()
    low, high = joints_of(system)
    grid = Grid((-0.6, -0.6, -0.6), (0.6, 0.6, 0.6), (24, 24, 24), ("x", "y", "z"))
    outer = compute_outer_measure(system, "tool", grid)
    points = np.random.default_rng(0).uniform(-0.6, 0.6, (20_000, 3))
    arms = np.linalg.norm(high, axis=1) + 0.45
    ball = (np.linalg.norm(points[:, None] - low, axis=-1) < arms).all(axis=1).mean() * 1.2**3
    assert outer == pytest.approx(ball, rel=0.15)


# ---- what is kept, broken off, refused


def test_maps_of_other_kinds_are_kept_and_gone_on_with(tmp_path):
    pytest.importorskip("zarr")
    path = tmp_path / "map.zarr"
    said = []
    arm = three_bars()
    first = arm.workspace("tool", orientation=0.4, cells=20, path=path, n=200)
    again = arm.workspace(
        "tool",
        orientation=0.4,
        cells=20,
        path=path,
        n=400,
        budget=Budget(progress=lambda *x: said.append(x)),
    )
    memory = arm.workspace("tool", orientation=0.4, cells=20, n=400)
    assert (
        first.samples == 200
        and np.array_equal(again.map.counts, memory.map.counts)
        and said[-1] == (400, 400)
    )
    opened = kempe.open_workspace(path)
    assert opened.workspace_kind == memory.workspace_kind and opened.area == memory.area
    with pytest.raises(InputError, match="belongs to another map"):
        arm.workspace("tool", orientation=0.5, cells=20, path=path, n=400)


@pytest.mark.parametrize("threads", [1, 3])
def test_the_time_limit_keeps_what_was_done(threads, looks):
    looks(190)
    w = hexapod().workspace(
        "tool", kind="dexterous", n=1e9, budget=Budget(time_limit=0.3, threads=threads)
    )
    assert (
        w.code is Status.OUT_OF_TIME
        and 0 < w.samples < 1e9
        and w.map.counts.sum() + w.left_out == w.samples
    )


BAD = {
    "kind": (UnknownNameError, {"kind": "reachabel"}),
    "needs an orientation: an angle": (InputError, {"kind": "constant-orientation"}),
    "reads no orientation": (InputError, {"kind": "reachable", "orientation": 0.1}),
    "needs at": (InputError, {"kind": "orientation"}),
    "reads no at": (InputError, {"kind": "dexterous", "at": (0, 0)}),
    "one place (2,)": (InputError, {"at": (0, 0, 0)}),
    "one orientation, not 3": (
        InputError,
        {"kind": "constant-orientation", "orientation": [0.1, 0.2, 0.3]},
    ),
    "finite": (InputError, {"orientation": math.nan}),
    "at least one": (InputError, {"kind": "dexterous", "orientation": []}),
    "no rotation": (InputError, {"orientation": 2.0 * np.eye(3)}),
    "of the plane": (InputError, {"orientation": np.diag([1.0, -1.0, -1.0])}),
    "box is for places": (InputError, {"at": (0.1, 0.2), "box": [(0, 1), (0, 1)]}),
    "it reads none": (InputError, {"at": (0.1, 0.2), "orientation": 0.1}),
}


@pytest.mark.parametrize("words", BAD)
def test_wrong_questions_are_refused(words):
    kind, given = BAD[words]
    with pytest.raises(kind) as error:
        three_bars().workspace("tool", n=10, **given)
    assert words in str(error.value)


def test_a_particle_has_no_orientation():
    m = Mechanism("bead", dim=2)
    m.prismatic("s", m.ground, m.particle("bead"), axis="x", limits=(0, 1))
    with pytest.raises(InputError, match="particle"):
        m.build().workspace("bead", orientation=0.1)


def test_samples_come_to_each_cell_once():
    w = three_bars().workspace("tool", orientation=0.0, cells=31, n=31 * 31)
    assert w.map.counts.max() == 1 and w.samples == w.map.counts.size == math.prod(w.map.grid.shape)
    assert all(x % 1 == 0 for x in itertools.chain(w.map.counts.ravel()))


def test_turns_that_a_constraint_tells_apart_have_no_end():
    """1.2 - a - b >= 0 holds after some turns back: all of the annulus is reached, which `ik`,
    `ik_all`, the map and the configuration space say alike.
    """
    m = Mechanism("two", dim=2)
    m.revolute("a", m.ground, m.body("A"))
    m.revolute("b", "A", m.body("B"), at=(0.4, 0))
    m.frame("tip", "B", at=(0.3, 0))
    m.constrain(constraints.Inequality("1.2 - a - b"), "c")
    system = m.build()
    p = 0.69 * np.array([np.cos(2.0), np.sin(2.0)])
    assert system.configuration_space.shape == "R^2"
    with pytest.raises(
        InputError,
        match="'a' and 'b' have no limits, and a constraint tells their whole turns apart",
    ):
        system.workspace("tip")
    found = system.ik(p, "tip")
    every = system.ik_all(p, "tip", limits=True)
    assert found.success and found.q[0] < -np.pi
    assert not len(every) and not every.complete and not every.code.proof
    assert "at other whole turns of 'a' and 'b' they may not" in every.status
    workspace = system.workspace("tip", box=[(-0.8, 0.8)] * 2, n=1e3)
    value, error = workspace.area
    assert abs(value - np.pi * (0.7**2 - 0.1**2)) < 2 * error < 0.06
    assert workspace.contains(p, check=True) and workspace.contains(p)
    limited = system.with_limits({"a": (-np.pi, np.pi), "b": (-np.pi, np.pi)})
    assert (
        limited.configuration_space.shape == "T^2"
        and limited.ik_all(p, "tip", limits=True).code.proof
    )
    with pytest.raises(InputError, match="box: x is from 1 to -1; the first must be less"):
        limited.workspace("tip", box=[(1, -1), (0, 1)])

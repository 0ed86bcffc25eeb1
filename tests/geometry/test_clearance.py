"""Distances between bodies: in closed form, beside Pinocchio's collision model, and what is said of
bad input.
"""

from __future__ import annotations

import itertools
import math
from pathlib import Path

import numpy as np
import pytest
from command import Result
from robots import urdf_files

import kempe
from kempe.errors import InputError, KempeError, UnknownNameError

pytest.importorskip("coal")


def arm(**shape: object) -> kempe.Mechanism:
    """One link that turns about y at (0, 0, 1), with a shape at (1, 0, 0) of it."""
    m = kempe.Mechanism("arm")
    link = m.body("link")
    m.revolute("A", m.ground, link, at=(0, 0, 1), axis="y")
    m.shape(link, at=(1, 0, 0), **shape)
    return m


def two_bodies(first: dict, second: dict) -> kempe.System:
    """Two free bodies with a shape each."""
    m = kempe.Mechanism("two")
    for name, shape in (("a", first), ("b", second)):
        body = m.body(name)
        m.free(name.upper(), m.ground, body)
        m.shape(body, **shape)
    return m.build()


def test_a_sphere_in_front_of_a_wall():
    m = arm(kind="sphere", radius=0.1)
    m.obstacle("wall", "box", size=(0.2, 4, 4), at=(1.5, 0, 1))
    s = m.build()
    assert s.geometry.pairs == (("link", "wall"),)
    q = np.linspace(-1.2, 1.2, 7)[:, None]
    expected = 1.4 - np.cos(q[:, 0]) - 0.1
    np.testing.assert_allclose(s.geometry.clearance(q), expected, atol=1e-6)
    n = s.geometry.nearest([0.5])
    assert n.pairs == (("link", "wall"),)
    x, z = math.cos(0.5), 1.0 - math.sin(0.5)
    np.testing.assert_allclose(n.points[0], [[x + 0.1, 0, z], [1.4, 0, z]], atol=1e-6)
    np.testing.assert_allclose(n.gradient[0], [math.sin(0.5)], atol=1e-6)
    assert "'link' and 'wall'" in n.status and "m apart" in n.status


def test_the_command_says_which_configuration_it_took(tmp_path):
    m = arm(kind="sphere", radius=0.1)
    m.obstacle("wall", "box", size=(0.2, 2, 2), at=(1.5, 0, 1))
    file = m.build().with_limits({"A": (0.5, 1.0)}).mechanism.save(tmp_path / "arm.toml")
    without = Result("clearance", file)
    assert (
        without.err == "kempe: without --q: at the neutral configuration, outside the limits of A\n"
    )
    given = Result("clearance", file, "--q", "0")
    assert given.err == "" and given.out == without.out


def test_overlap_is_negative_and_says_so():
    m = arm(kind="sphere", radius=0.3)
    m.obstacle("wall", "box", size=(0.2, 4, 4), at=(1.2, 0, 1))
    s = m.build()
    # the sphere lies between 0.7 and 1.3, the wall begins at 1.1
    np.testing.assert_allclose(s.geometry.clearance([0.0]), -0.2, atol=1e-6)
    n = s.geometry.nearest([0.0])
    assert "overlap by 0.2 m" in n.status


def test_hunt_spheres_and_capsules_in_closed_form(hunt):
    """Two spheres, and a sphere and a capsule: the distance of a point and a segment."""
    rng = hunt.rng()
    for _ in range(hunt.cases(60)):
        r, t, length = rng.uniform(0.05, 0.4, 3)
        s = two_bodies(
            {"kind": "sphere", "radius": r}, {"kind": "capsule", "radius": t, "length": length}
        )
        q = s.random(rng)
        A, B = s.fk(q, "a"), s.fk(q, "b")
        along = np.clip((A[:3, 3] - B[:3, 3]) @ B[:3, 2], -length / 2, length / 2)
        apart = np.linalg.norm(A[:3, 3] - B[:3, 3] - along * B[:3, 2]) - r - t
        assert math.isclose(s.geometry.clearance(q), apart, abs_tol=1e-6)


SHAPES = (
    {"kind": "sphere", "radius": 0.2},
    {"kind": "box", "size": (0.2, 0.3, 0.5)},
    {"kind": "cylinder", "radius": 0.2, "length": 0.4},
    {"kind": "capsule", "radius": 0.1, "length": 0.5},
    {"kind": "ellipsoid", "radii": (0.1, 0.2, 0.3)},
)


@pytest.mark.parametrize(("i", "j"), list(itertools.combinations_with_replacement(range(5), 2)))
def test_distances_do_not_depend_on_the_order_and_change_by_their_gradient(i, j):
    rng = np.random.default_rng(10 * i + j)
    s = two_bodies(SHAPES[i], SHAPES[j])
    turned = two_bodies(SHAPES[j], SHAPES[i])
    compared = 0
    for _ in range(8):
        q = s.random(rng)
        d = s.geometry.clearance(q)
        assert math.isclose(
            d, turned.geometry.clearance(np.concatenate([q[7:], q[:7]])), abs_tol=2e-6
        )
        assert math.isclose(d, s.geometry.clearance(q, [("b", "a")]), abs_tol=2e-6)
        n = s.geometry.nearest(q)
        if d < 0.05:
            continue
        compared += 1
        v = rng.normal(size=s.nv)
        step = 1e-5
        ahead, behind = (
            s.geometry.clearance(s.structure.layout.integrate_velocity(q, x * v))
            for x in (step, -step)
        )
        assert math.isclose((ahead - behind) / (2 * step), n.gradient[0] @ v, abs_tol=1e-2)
    assert compared > 2


def test_pairs_are_all_but_neighbours_and_ignored_ones_and_those_that_always_touch():
    m = kempe.Mechanism("chain")
    last = m.ground
    for k, name in enumerate("abcd"):
        body = m.body(name)
        m.revolute(name.upper(), last, body, at=(0.5 if k else 0, 0, 0), limits=(-0.5, 0.5))
        m.shape(body, "capsule", radius=0.05, length=0.3, at=(0.25, 0, 0), axis="x")
        last = body
    tool = m.body("tool")
    m.fixed("T", "d", tool, at=(0.5, 0, 0))
    m.shape(tool, "sphere", radius=0.6)
    m.obstacle("floor", "box", size=(9, 9, 0.1), at=(0, 0, -0.5))
    every = set(m.build().geometry.pairs)
    # 'tool' always touches 'c': it is 0.6 m large and 0.5 to 1 m away; it is fixed to 'd'
    assert every == {
        ("a", "c"), ("a", "d"), ("b", "d"), ("a", "tool"), ("b", "tool"),
        ("a", "floor"), ("b", "floor"), ("c", "floor"), ("d", "floor"),
    }  # fmt: skip
    m.ignore_pair("a", "floor")
    assert set(m.build().geometry.pairs) == every - {("a", "floor")}


def test_the_smallest_of_many_distances_is_that_of_the_deepest_overlap():
    """Which pairs are measured does not show, also where balls are deep in a slab."""
    m = kempe.Mechanism("balls")
    for k, radius in enumerate((0.02, 0.05, 0.1)):
        m.translation(f"t{k}", m.ground, m.body(f"ball {k}"))
        m.shape(f"ball {k}", "sphere", radius=radius)
    m.obstacle("slab", "box", size=(2.0, 1.0, 0.6), at=(0.0, 0.0, 0.0))
    m.obstacle("rod", "capsule", radius=0.03, length=1.0, at=(0.0, 0.0, 0.5), axis="x")
    s = m.build()
    q = np.random.default_rng(0).uniform(-0.8, 0.8, (200, s.nq))
    every = np.array([s.geometry.nearest(x).distance.min() for x in q])
    np.testing.assert_allclose(s.geometry.clearance(q), every, atol=1e-9)
    assert (every < -0.15).any() and (every > 0.0).any()


def test_shapes_that_are_drawn_only_do_not_count():
    m = arm(kind="sphere", radius=0.1)
    m.obstacle("wall", "box", size=(0.2, 4, 4), at=(1.5, 0, 1))
    m.shape("link", "box", size=(3, 3, 3), collision=False)
    assert math.isclose(m.build().geometry.clearance([0.0]), 0.3, abs_tol=1e-6)


def test_a_batch_has_any_shape_and_unknown_numbers_are_nan():
    m = arm(kind="sphere", radius=0.1)
    m.obstacle("wall", "box", size=(0.2, 4, 4), at=(1.5, 0, 1))
    s = m.build()
    q = np.zeros((2, 3, 1))
    q[1, 2] = np.nan
    d = s.geometry.clearance(q)
    assert d.shape == (2, 3) and math.isnan(d[1, 2]) and np.isfinite(d.ravel()[:-1]).all()
    assert isinstance(s.geometry.clearance([0.0]), float)


def test_in_the_plane_and_in_a_closed_loop():
    m = kempe.Mechanism("four-bar", dim=2)
    for name in ("crank", "coupler", "rocker"):
        m.body(name)
    m.revolute("A", m.ground, "crank")
    m.revolute("B", "crank", "coupler", at=(0.1, 0))
    m.revolute("C", "coupler", "rocker", at=(0.5, 0), child_at=(0.4, 0))
    m.revolute("D", m.ground, "rocker", at=(0.4, 0))
    m.shape("crank", "sphere", radius=0.01, at=(0.1, 0))
    m.shape("rocker", "sphere", radius=0.02, at=(0.4, 0))
    s = m.build()
    q = s.assemble({"A": 0.4}).q
    B, C = (s.fk(q, name) @ [x, 0, 0, 1] for name, x in (("crank", 0.1), ("rocker", 0.4)))
    assert math.isclose(s.geometry.clearance(q), np.linalg.norm(B - C) - 0.03, abs_tol=1e-6)
    assert math.isclose(np.linalg.norm(B - C), 0.5, abs_tol=1e-9)


PYRAMID = """solid p
facet normal 0 0 -1
outer loop
vertex 0 0 0
vertex 0 1 0
vertex 1 0 0
endloop
endfacet
facet normal 0 -1 0
outer loop
vertex 0 0 0
vertex 1 0 0
vertex 0 0 1
endloop
endfacet
facet normal -1 0 0
outer loop
vertex 0 0 0
vertex 0 0 1
vertex 0 1 0
endloop
endfacet
facet normal 1 1 1
outer loop
vertex 1 0 0
vertex 0 1 0
vertex 0 0 1
endloop
endfacet
endsolid p
"""
URDF = """<robot name="r"><link name="base"/>
<link name="tip"><collision><geometry><sphere radius="0.1"/></geometry></collision></link>
<link name="rock"><collision><origin xyz="2 0 0"/>
<geometry><mesh filename="{}" scale="2 2 2"/></geometry></collision></link>
<joint name="j" type="prismatic"><parent link="base"/><child link="tip"/><axis xyz="1 0 0"/>
<limit lower="-9" upper="9" effort="1" velocity="1"/></joint>
<joint name="k" type="fixed"><parent link="base"/><child link="rock"/></joint></robot>"""


@pytest.mark.slow
def test_meshes_are_scaled_and_placed(tmp_path):
    pytest.importorskip("trimesh")
    (tmp_path / "pyramid.stl").write_text(PYRAMID)
    (tmp_path / "r.urdf").write_text(URDF.format("pyramid.stl"))
    s = kempe.load(tmp_path / "r.urdf")
    np.testing.assert_allclose(s.geometry.clearance([[0.0], [1.0]]), [1.9, 0.9], atol=1e-6)
    # beyond the apex at (4, 0, 0)
    np.testing.assert_allclose(s.geometry.clearance([5.0]), 0.9, atol=1e-5)


@pytest.mark.parametrize(
    ("file", "text", "said"),
    [
        ("gone.stl", None, "collision shape of 'rock'.*gone.stl"),
        ("empty.stl", "solid a\nendsolid a\n", "collision shape of 'rock': mesh empty.stl"),
        ("broken.stl", "no mesh at all", "collision shape of 'rock': mesh broken.stl"),
    ],
)
def test_meshes_that_cannot_be_read_are_named(file, text, said, tmp_path):
    pytest.importorskip("trimesh")
    if text is not None:
        (tmp_path / file).write_text(text)
    (tmp_path / "r.urdf").write_text(URDF.format(file))
    with pytest.raises(KempeError, match=said):
        kempe.load(tmp_path / "r.urdf").geometry.clearance([0.0])


def test_what_cannot_be_is_refused():
    with pytest.raises(InputError, match="no body of 'two_link' has a collision shape"):
        kempe.load("two_link").geometry.clearance([0.0, 0.0])
    m = arm(kind="sphere", radius=0.1)
    m.obstacle("wall", "box", size=(0.2, 4, 4), at=(1.5, 0, 1))
    m.body("bare")
    m.fixed("B", "link", "bare")
    s = m.build()
    with pytest.raises(UnknownNameError, match="lnk"):
        s.geometry.clearance([0.0], [("lnk", "wall")])
    with pytest.raises(InputError, match="'bare' has no collision shape"):
        s.geometry.clearance([0.0], [("bare", "wall")])
    with pytest.raises(InputError, match="two names of different bodies"):
        s.geometry.clearance([0.0], [("wall", "wall")])
    with pytest.raises(InputError, match="one configuration"):
        s.geometry.nearest([[0.0]])
    with pytest.raises(InputError, match="not finite"):
        s.geometry.nearest([math.nan])
    with pytest.raises(KempeError, match="wall"):
        m.obstacle("wall", "box", size=(1, 1, 1))
    with pytest.raises(KempeError, match="size"):
        m.obstacle("post", "box", radius=1.0)
    assert "post" not in m.bodies and "post" not in m.joints


def test_an_obstacle_is_a_body_that_is_kept_by_files(tmp_path):
    m = arm(kind="sphere", radius=0.1)
    m.obstacle("wall", "box", size=(0.2, 4, 4), at=(1.5, 0, 1), rpy=(0, 0, 0.3))
    d = m.build().geometry.clearance([0.2])
    for name in ("arm.toml", "arm.urdf"):
        m.save(tmp_path / name)
        assert math.isclose(kempe.load(tmp_path / name).geometry.clearance([0.2]), d, abs_tol=1e-9)


@pytest.mark.slow
@pytest.mark.parametrize("robot", ["ur5_robot.urdf", "panda.urdf", "solo12.urdf"])
def test_robots_as_in_pinocchio(robot):
    """Its own reading of the file and of the meshes, whose hulls it makes itself."""
    pin = pytest.importorskip("pinocchio")
    coal = pytest.importorskip("coal")
    pytest.importorskip("trimesh")
    path = next((p for n, p in urdf_files().items() if n.endswith(robot)), None)
    if path is None:
        pytest.skip("example-robot-data is not installed")
    s = kempe.load(path)
    model = pin.buildModelFromUrdf(str(path))
    folders = [str(Path(path).parents[k]) for k in range(1, 5)]
    shapes = pin.buildGeomFromUrdf(
        model, str(path), pin.GeometryType.COLLISION, package_dirs=folders
    )
    for o in shapes.geometryObjects:
        if isinstance(o.geometry, coal.BVHModelBase):
            o.geometry.buildConvexHull(True, "Qt")
            o.geometry = o.geometry.convex
    of = {o.name: model.frames[o.parentFrame].name for o in shapes.geometryObjects}
    data, placed = model.createData(), shapes.createData()
    rng = np.random.default_rng(0)
    compared = 0
    for _ in range(4):
        q = s.random(rng)
        x = kempe.convert.to_pinocchio(s, q, model)
        pin.updateGeometryPlacements(model, data, shapes, placed, x)
        n = s.geometry.nearest(q)
        ours = dict(zip(n.pairs, n.distance, strict=True))
        theirs: dict[frozenset, float] = {}
        for a, b in itertools.combinations(range(len(of)), 2):
            A, B = shapes.geometryObjects[a], shapes.geometryObjects[b]
            key = frozenset((of[A.name], of[B.name]))
            result = coal.DistanceResult()
            d = coal.distance(
                A.geometry,
                coal.Transform3s(placed.oMg[a].rotation, placed.oMg[a].translation),
                B.geometry,
                coal.Transform3s(placed.oMg[b].rotation, placed.oMg[b].translation),
                coal.DistanceRequest(),
                result,
            )
            theirs[key] = min(d, theirs.get(key, math.inf))
        for pair, d in ours.items():
            assert math.isclose(d, theirs[frozenset(pair)], abs_tol=1e-5), (pair, d)
            compared += 1
        assert math.isclose(s.geometry.clearance(q), min(ours.values()), abs_tol=1e-5)
    assert compared > 40

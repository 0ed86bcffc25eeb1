"""Pictures: that the artists are where closed forms or `fk` say; nothing is compared by pixels."""

from __future__ import annotations

import subprocess
import sys
from dataclasses import dataclass, field
from types import SimpleNamespace

import numpy as np
import pytest
from drawn import artists
from hunts import some

import kempe
from kempe import Mechanism, constraints, library
from kempe.equations.judge import judge_configurations
from kempe.errors import CallError, InputError, UnknownNameError, UnsupportedError
from kempe.model.configurations import find_home

pytest.importorskip("matplotlib")
from kempe.views import plots
from kempe.views.drawing import callouts, labels, page, shapes, symbols
from kempe.views.drawing.plot_request import choose_configuration
from kempe.views.drawing.scene import build_scene
from kempe.views.drawing.solids import Solids, find_flat_hull, find_hull

PLANAR = [
    "four_bar",
    "four_links",
    "parallelogram",
    "jansen",
    "peaucellier",
    "stephenson_six_bar",
    "slider_crank",
    "three_rpr",
    "scissor",
    "two_link",
]
SPATIAL = [
    "stewart",
    "delta_uu",
    "bennett",
    "sarrus",
    "puma560",
    "panda",
    "stanford",
    "seven_bodies_loop",
]


def start(system):
    return system.q("closed") if "closed" in system.structure.posture_names else system.mid


def centres(system, q) -> dict[str, np.ndarray]:
    """Origin (3,) of frame M of every joint that moves, by way of `fk` of its child alone."""
    out = {}
    for name, joint in system.structure.joints.items():
        if joint.type.dof(system.dim):
            X = system.fk(q, joint.child) @ joint.X_CM.evaluate_pose(system.structure.parameters)
            out[name] = X[:3, 3]
    return out


def middle(patch) -> np.ndarray:
    """Middle of the box around an outline."""
    extents = patch.get_path().get_extents()
    return np.array([0.5 * (extents.x0 + extents.x1), 0.5 * (extents.y0 + extents.y1)])


@dataclass
class Motion:
    """An answer as `trace` gives it, as far as pictures read it."""

    system: kempe.System
    q: np.ndarray
    s: np.ndarray
    driver: str | None = None
    singular_points: tuple = field(default_factory=tuple)
    turning_points: tuple = field(default_factory=tuple)


def parallelogram(n: int = 40) -> tuple[kempe.System, np.ndarray]:
    """A parallelogram, flat at q = 0, and one turn of it: the crank at angle a gives q = (a, -a, a,
    a).
    """
    m = Mechanism("bars", dim=2)
    crank, coupler, rocker = (m.body(b) for b in ("crank", "coupler", "rocker"))
    m.revolute("A", m.ground, crank, actuated=True)
    m.revolute("B", crank, coupler, at=(0.2, 0))
    m.revolute("C", coupler, rocker, at=(0.4, 0), child_at=(0.2, 0), cut=True)
    m.revolute("D", m.ground, rocker, at=(0.4, 0))
    m.frame("P", coupler, at=(0.3, 0.1))
    system = m.build()
    a = np.linspace(0.0, 2 * np.pi, n)
    q = np.zeros((n, system.nq))
    for name, sign in (("A", 1), ("B", -1), ("C", 1), ("D", 1)):
        q[:, system.coordinate_names.index(name)] = sign * a
    return system, q


# ---- the plane


@pytest.mark.parametrize("name", some(PLANAR, 3))
def test_a_circle_at_every_revolute_joint(name):
    system = kempe.load(name)
    found = artists(plots.plot(system))
    for joint, p in centres(system, start(system)).items():
        if system.structure.joints[joint].type.type_name == "revolute":
            (patch,) = found[f"joint:{joint}"]
            assert np.allclose(middle(patch), p[:2], atol=1e-9), joint
            assert patch.get_facecolor()[:3] == (1, 1, 1), "white"


def test_the_four_bar_stands_where_its_file_says():
    """Crank and rocker upright, the coupler from (0, 0.1) to (0.4, 0.4): independent of `fk`."""
    found = artists(plots.plot(kempe.load("four_bar")))
    for joint, p in {"A": (0, 0), "B": (0, 0.1), "C": (0.4, 0.4), "D": (0.4, 0)}.items():
        assert np.allclose(middle(found[f"joint:{joint}"][0]), p, atol=1e-12)
    X = kempe.load("four_bar").fk(kempe.load("four_bar").q("closed"), "coupler_point")
    assert np.allclose(middle(found["frame:coupler_point"][0]), X[:2, 3], atol=1e-12)


@pytest.mark.parametrize("name", some(PLANAR, 3))
def test_ground_symbols_at_ground_pivots_only(name):
    system = kempe.load(name)
    found = artists(plots.plot(system))
    at = centres(system, start(system))
    ground = system.body_names[0]
    pivots = {
        n: at[n][:2]
        for n, j in system.structure.joints.items()
        if j.type.type_name == "revolute" and ground in (j.parent, j.child)
    }
    drawn = [a[0].get_path().vertices[0] for gid, a in found.items() if gid.startswith("ground:")]
    assert {tuple(np.round(p, 9)) for p in drawn} == {
        tuple(np.round(p, 9)) for p in pivots.values()
    }
    assert len([g for g in found if g.startswith("hatch:")]) == len(drawn)


@pytest.mark.parametrize("name", some(PLANAR, 3))
def test_links_cover_their_joints_and_frames(name):
    """The outline of a link is its convex hull widened by the half-width of a bar: it holds every
    point of it.
    """
    system = kempe.load(name)
    q = start(system)
    found = artists(plots.plot(system))
    scene = build_scene(system, q)
    for link in scene.links[1:]:
        points = scene.list_points(link)[:, :2]
        if len(points) > 1:
            (patch,) = found[f"link:{link.name}"]
            path = patch.get_path()
            assert path.contains_points(points).all(), link.name
            box = path.get_extents()
            room = np.array([points[:, 0].min() - box.x0, box.x1 - points[:, 0].max()])
            assert np.allclose(room, room[0], rtol=1e-3), "by the half-width of a bar"
            assert 0 < room[0] < 0.04 * scene.size


def test_rounded_outlines_have_the_area_of_hull_and_rim():
    """Area of a convex set widened by r: area + r perimeter + pi r^2 (Steiner)."""

    def area(path):
        x, y = path.to_polygons()[0].T  # curves are flattened
        return 0.5 * abs(float(x[:-1] @ y[1:] - x[1:] @ y[:-1]))

    for points, size, round_ in (
        ([(0, 0), (4, 3)], 0.0, 10.0),
        ([(0, 0), (4, 0), (4, 3), (2, 1)], 6.0, 12.0),
    ):
        r = 0.5
        path = shapes.make_rounded_outline(np.array(points, dtype=float), r)
        assert area(path) == pytest.approx(size + r * round_ + np.pi * r * r, rel=2e-3)
    assert area(shapes.make_rounded_outline(np.array([[1.0, 2.0]]), 2.0)) == pytest.approx(
        4 * np.pi, rel=2e-3
    )


def test_the_hull_drops_what_lies_inside_and_on_sides():
    points = np.array([[0, 0], [2, 0], [1, 0], [2, 2], [0, 2], [1, 1], [0, 1]], dtype=float)
    assert find_hull(points).tolist() == [[0, 0], [2, 0], [2, 2], [0, 2]]


def test_bodies_joined_by_fixed_joints_are_one_link():
    """What is fixed to the ground is ground, whichever way the fixed joint was written."""
    m = Mechanism("mounted", dim=2)
    base = m.body("base")
    arm = m.body("arm")
    tool = m.body("tool")
    m.fixed("mount", base, m.ground)
    m.revolute("A", base, arm, at=(0.2, 0.1))
    m.fixed("flange", arm, tool, at=(0.5, 0.0))
    m.frame("tip", tool, at=(0.1, 0.0))
    system = m.build()
    found = artists(plots.plot(system, [0.0]))
    assert np.allclose(found["ground:A"][0].get_path().vertices[0], (0.2, 0.1))
    assert [g for g in found if g.startswith("link:")] == ["link:arm"]
    assert found["link:arm"][0].get_path().contains_points([(0.2, 0.1), (0.8, 0.1)]).all()


def test_a_slider_is_a_block_on_a_hatched_rail():
    system = kempe.load("slider_crank")
    q = start(system)
    found = artists(plots.plot(system))
    (name,) = [n for n, j in system.structure.joints.items() if j.type.type_name == "prismatic"]
    block = found[f"block:{name}"][0]
    rail = found[f"rail:{name}"][0]
    joint = system.structure.joints[name]
    axis = (system.fk(q, joint.parent) @ joint.X_PF.evaluate_pose(system.structure.parameters))[
        :2, 2
    ]
    centre = centres(system, q)[name][:2]
    assert np.allclose(block.get_path().vertices[:4].mean(axis=0), centre, atol=1e-12)
    ends = rail.get_path().vertices[:2]
    assert abs(float(np.linalg.det([ends[1] - ends[0], axis]))) < 1e-12, (
        "the rail runs along the axis"
    )
    assert len(rail.get_path().vertices) > 8, "hatching"
    side = block.get_path().vertices
    assert np.min(np.abs((side - ends[0]) @ np.array([-axis[1], axis[0]]))) < 1e-12, (
        "the block stands on the rail"
    )


def test_the_rail_reaches_as_far_as_the_path_and_the_limits():
    m = Mechanism("slide", dim=2)
    m.prismatic("x", m.ground, m.body("b"), axis=[1, 0])
    system = m.build()
    path = np.linspace(-1.0, 2.0, 7)[:, None]
    ends = artists(plots.plot(system, path=path))["rail:x"][0].get_path().vertices[:2]
    assert ends[:, 0].min() < -1.0 and ends[:, 0].max() > 2.0
    m = Mechanism("slide", dim=2)
    m.prismatic("x", m.ground, m.body("b"), axis=[0, 1], limits=(-0.4, 0.3))
    ends = artists(plots.plot(m.build()))["rail:x"][0].get_path().vertices[:2]
    assert ends[:, 1].min() < -0.4 and ends[:, 1].max() > 0.3


def test_driven_legs_are_cylinder_and_rod():
    system = kempe.load("three_rpr")
    found = artists(plots.plot(system))
    at = centres(system, start(system))
    legs = [n for n, j in system.structure.joints.items() if j.type.type_name == "prismatic"]
    assert len(legs) == 3
    for leg in legs:
        assert found[f"cylinder:{leg}"] and found[f"driver:{leg}"]
        rod = found[f"rod:{leg}"][0].get_path().vertices[:4]
        far = 0.5 * (rod[1] + rod[2])
        assert np.allclose(far, at[leg][:2], atol=1e-12), "the rod ends where M is"


def test_drivers_are_marked():
    system = kempe.load("four_bar")
    plain = {g for g in artists(plots.plot(system)) if g.startswith("driver:")}
    actuated = {f"driver:{n}" for n, j in system.structure.joints.items() if j.actuated}
    assert {g for g in plain if not g.endswith(":head")} == actuated
    q = start(system)[None]
    found = artists(plots.plot(system, path=Motion(system, q, np.zeros(1), driver="D")))
    assert "driver:D" in found
    arc = found["driver:D"][0].get_xydata()
    radius = np.linalg.norm(arc - (0.4, 0.0), axis=1)
    assert np.allclose(radius, radius[0]) and radius[0] > 0, "an arc round the joint"


def test_open_loops_are_shown():
    system = kempe.load("four_bar")
    q = start(system)
    assert "open:C" not in artists(plots.plot(system))
    q[system.coordinate_names.index("A")] += 0.2
    line = artists(plots.plot(system, q))["open:C"][0].get_xydata()
    crank = system.fk(q, "coupler") @ system.structure.joints["C"].X_PF.evaluate_pose(
        system.structure.parameters
    )
    assert np.allclose(line, [crank[:2, 3], (0.4, 0.4)], atol=1e-12)


def test_rods_and_slots_of_constraints():
    m = Mechanism("rods", dim=2)
    crank = m.body("crank")
    rocker = m.body("rocker")
    m.revolute("A", m.ground, crank)
    m.revolute("D", m.ground, rocker, at=(0.4, 0))
    m.distance("rod", crank, rocker, at=(0.1, 0), child_at=(0, 0.4), length=0.5)
    m.point_on_line("slot", rocker, crank, child_at=(0.1, 0.2), axis=[1, 2])
    system = m.build()
    found = artists(plots.plot(system, [0.0, 0.0]))
    ends = sorted(tuple(np.round(middle(a), 9)) for a in found["rod:rod:end"])
    assert ends == [(0.1, 0.0), (0.4, 0.4)]
    assert np.allclose(middle(found["line:slot:point"][0]), (0.1, 0.2))
    wrong = artists(plots.plot(system, [0.5, 0.0]))["rod:rod"][0].get_edgecolor()
    assert wrong != found["rod:rod"][0].get_edgecolor(), "a rod of the wrong length"


def test_curves_are_fk_over_the_path():
    system, q = parallelogram()
    ax = plots.plot(system, path=q, ghosts=3)
    found = artists(ax)
    a = np.linspace(0.0, 2 * np.pi, len(q))
    circle = np.stack([0.3 + 0.2 * np.cos(a), 0.1 + 0.2 * np.sin(a)], axis=1)
    assert np.allclose(found["curve:P"][0].get_xydata(), circle, atol=1e-12), (
        "the coupler only translates"
    )
    assert np.allclose(found["here:P"][0].get_xydata(), [(0.5, 0.1)], atol=1e-12), (
        "the pose nearest to mid"
    )
    assert len({g.split(":")[0] for g in found if g.startswith("ghost")}) == 3
    here = artists(plots.plot(system, q[10], path=q, frames=["crank", "P"]))
    assert np.allclose(here["here:P"][0].get_xydata(), circle[10:11], atol=1e-12)
    assert np.allclose(here["curve:crank"][0].get_xydata(), 0.0)
    named = artists(plots.plot(system, path=SimpleNamespace(q=q, frames=("rocker",))))
    assert "curve:rocker" in named and "curve:P" not in named


@pytest.mark.parametrize("name", some([*PLANAR, *SPATIAL], 4))
def test_marked_frames_show_their_axes(name):
    """The axes of every body and frame, in the plane and in space, lie where `fk` says; others are
    not marked.
    """
    system = kempe.load(name)
    q = start(system)
    names = [*system.body_names, *system.frame_names][::2]
    axes = "xyz"[: system.dim]
    bare = artists(plots.plot(system, q))
    found = artists(plots.plot(system, q, frames=names))
    assert not [gid for gid in bare if gid.startswith("mark:")]
    drawn = {gid for gid in found if gid.startswith("mark:") and not gid.endswith(":head")}
    assert drawn == {f"mark:{n}{part}" for n in names for part in ("", *(f":{a}" for a in axes))}
    for n in names:
        X = system.fk(q, n)
        assert len(found[f"label:{n}"]) == 1
        for k, a in enumerate(axes):
            (line,) = found[f"mark:{n}:{a}"]
            points = np.stack(line.get_data_3d() if system.dim == 3 else line.get_data(), axis=-1)
            np.testing.assert_allclose(points[0], X[: system.dim, 3], atol=1e-12)
            along = points[1] - points[0]
            np.testing.assert_allclose(along / np.linalg.norm(along), X[: system.dim, k], atol=1e-9)


def test_marks_of_one_name_and_without_labels():
    system = kempe.load("two_link")
    found = artists(plots.plot(system, [0.4, 0.8], frames="B2"))
    assert {
        "mark:B2",
        "mark:B2:x",
        "mark:B2:y",
        "label:B2",
    } <= found.keys() and "mark:e" not in found
    assert "label:B2" not in artists(plots.plot(system, [0.4, 0.8], frames="B2", labels=False))
    for either in (system, kempe.load("puma560")):
        with pytest.raises(UnknownNameError, match="no frame 'nobody'"):
            plots.plot(either, frames=["nobody"])


def test_gaps_in_a_path_stay_gaps():
    system, q = parallelogram(12)
    q[5] = np.nan
    curve = artists(plots.plot(system, path=q))["curve:P"][0].get_xydata()
    assert np.isnan(curve[5]).all() and np.isfinite(np.delete(curve, 5, axis=0)).all()


def test_all_is_inside_the_limits():
    system, q = parallelogram()
    for ax in (plots.plot(system), plots.plot(system, path=q, ghosts=4)):
        assert ax.get_aspect() == 1.0
        (x0, x1) = ax.get_xlim()
        (y0, y1) = ax.get_ylim()
        for patch in ax.patches:
            if patch.get_gid():
                box = patch.get_path().get_extents()
                assert x0 <= box.x0 and box.x1 <= x1 and y0 <= box.y0 and box.y1 <= y1, (
                    patch.get_gid()
                )


def test_the_axes_know_what_is_on_them():
    """Who draws on them may let matplotlib choose the limits anew."""
    ax = kempe.load("four_bar").plot()
    patches = [p.get_extents().transformed(ax.transData.inverted()) for p in ax.patches]
    ax.autoscale()
    (left, right), (low, high) = ax.get_xlim(), ax.get_ylim()
    assert len(patches) > 5
    for box in patches:
        assert left <= box.x0 and box.x1 <= right and low <= box.y0 and box.y1 <= high


@pytest.mark.parametrize(
    "name", ["jansen", "peaucellier", "stephenson_six_bar", "three_rpr", "four_bar"]
)
def test_labels_cover_neither_each_other_nor_pins(name):
    """Measured in pixels by the renderer, not by the boxes that the placing worked with."""
    ax = plots.plot(kempe.load(name))
    renderer = ax.figure.canvas.get_renderer()
    ax.figure.canvas.draw()
    found = artists(ax)
    boxes = {
        g: a[0].get_window_extent(renderer) for g, a in found.items() if g.startswith("label:")
    }
    assert len(boxes) > 3
    for g, box in boxes.items():
        for other, second in boxes.items():
            assert g == other or not box.overlaps(second), (g, other)
        for gid, (patch, *_) in found.items():
            if gid.startswith("joint:"):
                x, y = ax.transData.transform(middle(patch))
                assert not (box.x0 < x < box.x1 and box.y0 < y < box.y1), (g, gid)


def test_labels_can_be_left_out():
    assert not any(
        g.startswith("label:") for g in artists(plots.plot(kempe.load("four_bar"), labels=False))
    )
    assert not any(
        g.startswith("label:") for g in artists(plots.plot(kempe.load("bennett"), labels=False))
    )


def test_a_label_goes_where_nothing_is():
    obstacles = labels.Obstacles()
    obstacles.add_segment(np.array([-5.0, 0.0]), np.array([5.0, 0.0]), 0.5)
    obstacles.add_segment(np.array([0.0, 0.0]), np.array([0.0, 5.0]), 0.5)
    first = obstacles.find_free_place(np.zeros(2), (1.0, 0.6), 0.8, np.array([1.0, 0.0]))
    assert abs(first[1]) > 0.5 + 0.3 - 1e-9
    second = obstacles.find_free_place(np.zeros(2), (1.0, 0.6), 0.8, np.array([1.0, 0.0]))
    assert abs(first[0] - second[0]) >= 1.0 - 1e-9 or abs(first[1] - second[1]) >= 0.6 - 1e-9


def test_the_scale_bar_has_its_length():
    ax = plots.plot(kempe.load("four_bar"))
    found = artists(ax)
    x = found["scale"][0].get_xdata()
    number, unit = found["scale:text"][0].get_text().split()
    assert x.max() - x.min() == pytest.approx(float(number) * {"m": 1.0, "mm": 1e-3}[unit])


@pytest.mark.parametrize(
    ("length", "rounded"),
    [
        (0.7, 0.5),
        (0.2, 0.2),
        (0.19, 0.1),
        (1.0, 1.0),
        (4e-5, 2e-5),
        (99, 50),
    ],
)
def test_nice_lengths(length, rounded):
    assert page.round_length(length) == pytest.approx(rounded)


# ---- space


def solids_of(system, q) -> tuple[Solids, float]:
    scene = build_scene(system, q)
    solids = Solids()
    r = symbols.choose_radius(scene)
    symbols.add_scene(solids, scene, r, None)
    return solids, r


def vertices(solids: Solids, name: str) -> np.ndarray:
    return np.concatenate([solids.faces[k] for k in solids.named[name]])


@pytest.mark.parametrize("name", SPATIAL)
def test_a_symbol_at_every_joint_along_its_axis(name):
    system = kempe.load(name)
    q = start(system)
    solids, r = solids_of(system, q)
    scene = build_scene(system, q)
    for joint in scene.joints:
        p = vertices(solids, f"joint:{joint.name}")
        box = 0.5 * (p.min(axis=0) + p.max(axis=0))
        if joint.kind == "prismatic":
            on_axis = box - joint.F[:3, 3]
            assert np.linalg.norm(np.cross(on_axis, joint.axis)) < 1e-9, "somewhere on its axis"
        else:
            assert np.allclose(box, centres(system, q)[joint.name], atol=0.02 * r), joint.name
        if joint.kind == "revolute":
            along = (p - joint.centre) @ joint.axis
            across = np.linalg.norm(p - joint.centre - along[:, None] * joint.axis, axis=1)
            assert along.max() == pytest.approx(1.7 * r) and across.max() <= 1.03 * r


@pytest.mark.slow
@pytest.mark.parametrize("name", some(SPATIAL, 3))
def test_all_solids_are_in_the_picture_with_equal_scales(name):
    system = kempe.load(name)
    q = start(system)
    ax = plots.plot(system)
    solids, _ = solids_of(system, q)
    (collection,) = artists(ax)["solids"]
    assert len(collection.get_facecolor()) in (0, len(solids.faces)) and len(solids.faces) > 50
    p = np.concatenate(solids.faces)
    limits = np.array([ax.get_xlim(), ax.get_ylim(), ax.get_zlim()])
    assert (p.min(axis=0) >= limits[:, 0]).all() and (p.max(axis=0) <= limits[:, 1]).all()
    aspect = np.asarray(ax._box_aspect)
    assert np.allclose(aspect / aspect[0], np.ptp(limits, axis=1) / np.ptp(limits[0])), (
        "one metre is one metre"
    )
    ax.figure.canvas.draw()


@pytest.mark.parametrize("name", SPATIAL)
def test_tubes_join_the_joints_of_a_link(name):
    """Each joint centre and frame of a link is on one of the lines that the link is drawn along."""
    scene = build_scene(kempe.load(name), start(kempe.load(name)))
    drawn: dict[int, list[np.ndarray]] = {}
    for link, line in symbols.iterate_link_lines(scene):
        drawn.setdefault(link.number, []).append(line)
    for link in scene.links[1:]:
        points = scene.list_points(link)
        if len(points) > 1:
            corners = np.concatenate(drawn[link.number])
            gaps = np.linalg.norm(points[:, None] - corners, axis=-1).min(axis=1)
            assert gaps.max() < 1e-9, link.name


def test_links_follow_axes_and_common_normals():
    """A link from (0,0,0) about z to (1,0,1) about y: up the first axis, then along the common
    normal.
    """
    A = np.eye(4)
    B = np.eye(4)
    B[:3, :3] = np.array([[1, 0, 0], [0, 0, 1], [0, -1, 0]])
    B[:3, 3] = 1, 0, 1
    line = symbols._connect_axes(A, B, True, True)
    assert any(np.allclose(p, (0, 0, 1)) for p in line) and len(line) >= 3
    assert len(symbols._connect_axes(A, B, False, False)) == 2, "straight between ball joints"


def test_ground_marks_hang_below_ground_joints():
    system = kempe.load("bennett")
    q = start(system)
    solids, _ = solids_of(system, q)
    ground = system.body_names[0]
    joints = [n for n, j in system.structure.joints.items() if ground in (j.parent, j.child)]
    tips = [vertices(solids, n)[0] for n in solids.named if n.startswith("ground:")]
    at = centres(system, q)
    assert {tuple(np.round(t, 9)) for t in tips} == {tuple(np.round(at[j], 9)) for j in joints}
    assert all(
        vertices(solids, n)[:, 2].min() < t[2]
        for n, t in zip(["ground:0", "ground:1"], tips, strict=True)
    )


def test_rails_in_space_run_along_the_axis():
    m = Mechanism("gantry")
    m.prismatic("x", m.ground, m.body("b"), axis=[1, 2, 2], at=(0.1, 0, 0), limits=(-0.3, 0.9))
    system = m.build()
    solids, r = solids_of(system, system.q({"x": 0.3}))
    rel = vertices(solids, "rail:x") - (0.1, 0, 0)
    axis = np.array([1, 2, 2]) / 3.0
    along = rel @ axis
    assert along.min() < -0.3 and along.max() > 0.9
    assert np.linalg.norm(rel - along[:, None] * axis, axis=1).max() < r


def test_curves_in_space_are_fk_over_the_path():
    system = kempe.load("puma560")
    q = np.linspace(system.mid, system.mid + 0.5, 9)
    name = next(iter(system.structure.frames))
    found = artists(plots.plot(system, path=q, frames=name, ghosts=2))
    curve = np.array(found[f"curve:{name}"][0].get_data_3d()).T
    assert np.allclose(curve, system.fk(q, name)[:, :3, 3], atol=1e-12)
    here = np.array(found[f"here:{name}"][0].get_data_3d()).T
    assert np.allclose(here, system.fk(q[:1], name)[:, :3, 3], atol=1e-12), "mid is on the path"
    assert len({g.split(":")[0] for g in found if g.startswith("ghost")}) == 2


def test_symbols_are_of_joint_types():
    """Types without a symbol of their own are drawn by their primitives: see
    tests/test_joint_loops.py.
    """
    from kempe.joints import TYPES

    assert set(symbols.SYMBOLS) <= set(TYPES) - {"fixed"}


def test_tubes_and_balls_have_their_sizes():
    solids = Solids()
    a = np.array([1.0, 2.0, 3.0])
    b = np.array([2.0, 0.0, 5.0])
    solids.add_tube("t", a, b, 0.25, "#808080")
    u = (b - a) / 3.0
    p = vertices(solids, "t") - a
    along = p @ u
    assert along.min() == pytest.approx(0.0, abs=1e-12) and along.max() == pytest.approx(3.0)
    assert np.linalg.norm(p - along[:, None] * u, axis=1).max() == pytest.approx(0.25)
    solids.add_ball("b", a, 0.5, "#808080")
    assert np.allclose(np.linalg.norm(vertices(solids, "b") - a, axis=1), 0.5)
    assert all(len(f) == 4 for f in solids.faces)


def test_flat_hulls():
    square = np.array([[0, 0, 1], [1, 0, 1], [0.5, 0.5, 1], [1, 1, 1], [0, 1, 1]], dtype=float)
    assert sorted(find_flat_hull(square, 1e-6) or ()) == [0, 1, 3, 4]
    square[2, 2] = 2.0
    assert find_flat_hull(square, 1e-6) is None
    assert find_flat_hull(np.outer(np.arange(4.0), [1, 2, 3]), 1e-6) is None


# ---- everything


@pytest.mark.parametrize(
    "name", ["ball", "car", "joint_fixed", "joint_free", "joint_helical", "joint_planar"]
)
def test_odd_systems_can_be_drawn(name, tmp_path):
    plots.plot(kempe.load(name)).figure.savefig(tmp_path / "a.png", dpi=30)
    assert (tmp_path / "a.png").stat().st_size > 500


@pytest.mark.slow
@pytest.mark.parametrize("name", sorted(library.list_models()))
def test_every_model_can_be_drawn(name, tmp_path):
    import warnings

    with warnings.catch_warnings():
        warnings.simplefilter("error")
        plots.plot(kempe.load(name)).figure.savefig(tmp_path / "a.png", dpi=30)
    assert (tmp_path / "a.png").stat().st_size > 1000


@pytest.mark.slow
def test_vector_output_names_its_parts(tmp_path):
    plots.plot(kempe.load("four_bar")).figure.savefig(tmp_path / "a.svg")
    text = (tmp_path / "a.svg").read_text()
    assert 'id="joint:A"' in text and 'id="ground:D"' in text
    plots.plot(kempe.load("bennett")).figure.savefig(tmp_path / "a.pdf")
    assert (tmp_path / "a.pdf").read_bytes().startswith(b"%PDF")


def test_axes_of_the_caller_are_used():
    figure = page.make_figure()
    left = figure.add_subplot(1, 2, 1)
    right = figure.add_subplot(1, 2, 2, projection="3d")
    assert plots.plot(kempe.load("four_bar"), ax=left) is left and "joint:A" in artists(left)
    assert plots.plot(kempe.load("bennett"), ax=right) is right and "solids" in artists(right)
    limits = np.array([right.get_xlim(), right.get_ylim(), right.get_zlim()])
    assert np.allclose(
        right._box_aspect / right._box_aspect[0], np.ptp(limits, axis=1) / np.ptp(limits[0])
    )
    figure.canvas.draw()
    with pytest.raises(InputError, match="planar system"):
        plots.plot(kempe.load("four_bar"), ax=right)
    with pytest.raises(InputError, match="projection='3d'"):
        plots.plot(kempe.load("bennett"), ax=left)


def test_wrong_calls_say_what_is_allowed():
    system, q = parallelogram(5)
    with pytest.raises(UnknownNameError, match="'P'"):
        plots.plot(system, path=q, frames=["p"])
    with pytest.raises(InputError, match="at most 32 are drawn"):
        plots.plot(system, np.repeat(q, 7, axis=0))
    with pytest.raises(
        InputError, match="labels has 'body'; allowed are 'joints', 'frames', 'bodies'"
    ):
        plots.plot(system, labels="body")
    with pytest.raises(CallError, match="no option 'dimension'; did you mean 'dimensions'"):
        plots.plot(system, dimension=True)
    with pytest.raises(InputError, match=r"must be \(n, 4\)"):
        plots.plot(system, path=q[0])
    with pytest.raises(InputError, match="not all of it NaN"):
        plots.plot(system, path=np.full((3, 4), np.nan))
    with pytest.raises(InputError, match="finite"):
        plots.plot(system, [0, np.nan, 0, 0])
    with pytest.raises(InputError, match="ghosts"):
        plots.plot(system, path=q, ghosts=-1)
    with pytest.raises(InputError, match="needs 4"):
        plots.plot(system, [0.0])


# ---- coordinates over arc length


def test_answers_draw_their_coordinates():
    bar = kempe.load("four_bar")
    arm = kempe.load("puma560")
    path = bar.trace("A")
    ax = path.plot_curve(["A", "D"])
    found = artists(ax)
    assert np.array_equal(
        found["coordinate:D"][0].get_xydata(), np.stack([path.s, path.values("D")], axis=1)
    )
    assert ax.get_xlabel() == "arc length" and "coordinate:B" not in found
    follow = arm.ik_path(arm.fk(np.linspace(arm.mid, arm.mid + 0.1, 4), "tool"), "tool", arm.mid)
    ax = follow.plot_curve()
    assert ax.get_xlabel() == "row" and np.array_equal(
        artists(ax)["coordinate:q1"][0].get_xdata(), [0, 1, 2, 3]
    )
    with pytest.raises(UnknownNameError, match="no coordinate 'E'"):
        path.plot_curve(["E"])


def test_coordinates_over_arc_length():
    system = kempe.load("slider_crank")
    q = np.linspace(start(system), start(system) + 1.0, 6)
    s = np.linspace(0.0, 3.0, 6)
    event = SimpleNamespace(s=1.2, q=q[2])
    found = artists(
        ax := plots.plot_path(
            Motion(system, q, s, None, (event,), (SimpleNamespace(s=0.3, q=q[0]),))
        )
    )
    for i, name in enumerate(system.coordinate_names):
        assert np.array_equal(
            found[f"coordinate:{name}"][0].get_xydata(), np.stack([s, q[:, i]], axis=1)
        )
    assert np.allclose(found["singular:0"][0].get_xdata(), 1.2) and np.allclose(
        found["turning:0"][0].get_xdata(), 0.3
    )
    assert np.allclose(found["singular:0:values"][0].get_ydata(), q[2])
    assert ax.get_ylabel() == "angles [rad], slides [m]"
    one = artists(plots.plot_path(Motion(system, q, s), names=["A"]))
    assert [g for g in one if g.startswith("coordinate:")] == ["coordinate:A"]


def test_wrong_paths_are_refused():
    system, q = parallelogram(5)
    with pytest.raises(UnknownNameError, match="coordinate 'X'"):
        plots.plot_path(Motion(system, q, np.arange(5.0)), names=["X"])
    with pytest.raises(InputError, match="shape"):
        plots.plot_path(Motion(system, q, np.arange(4.0)))
    with pytest.raises(InputError, match="system"):
        plots.plot_path(SimpleNamespace(q=q, s=np.arange(5.0)))


# ---- no display, no global state, no hard dependency


def run(code: str) -> str:
    return subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, check=True
    ).stdout.strip()


@pytest.mark.slow
def test_no_global_state_is_touched():
    code = (
        "import sys, matplotlib\nbefore = matplotlib.rcParams.copy()\nimport kempe\nfrom "
        "kempe.views.plots import plot\nplot(kempe.load('four_bar')), "
        "plot(kempe.load('bennett'))\nsame = matplotlib.rcParams.copy() == before\nimport "
        "matplotlib.pyplot as plt\nprint(plt.get_fignums(), same)"
    )
    assert run(code) == "[] True"


@pytest.mark.slow
def test_figures_are_those_of_pyplot_where_it_is_in_use():
    code = (
        "import matplotlib\nmatplotlib.use('agg')\nimport matplotlib.pyplot as plt\nimport kempe\n"
        "ax = kempe.load('four_bar').plot()\nprint(plt.get_fignums(), plt.gcf() is ax.figure)"
    )
    assert run(code) == "[1] True"


def test_without_matplotlib_the_error_names_the_extra():
    code = (
        "import sys\nsys.modules['matplotlib'] = None\nimport kempe\ntry:\n    import "
        "kempe.views.plots\nexcept kempe.errors.MissingExtraError as e:\n    print(e.package, "
        "e.extra)"
    )
    assert run(code) == "matplotlib view"


# ---- where constraints hold


@pytest.mark.parametrize("name", library.list_models())
def test_what_is_drawn_by_default_holds(name):
    """The default configuration satisfies all that is declared, where assembling from home can."""
    system = kempe.load(name)
    q = choose_configuration(system, None)
    assert judge_configurations(system, q) or not system.assemble(start=find_home(system))


def test_a_ball_rests_on_its_ground():
    solids = kempe.load("ball").plot()
    assert solids.get_zlim()[0] <= 1e-9 and solids.get_zlim()[1] >= 0.2 - 1e-9
    q = choose_configuration(kempe.load("ball"), None)
    assert q[2] >= 0.1 - 1e-9


def test_wheels_of_a_car_stand_along_it():
    found = artists(kempe.load("car").plot(kempe.load("car").q({"drive.rz": 0.5})))
    for k in (0, 1):
        (wheel,) = found[f"mark:rear axle:wheel{k}"]
        p = wheel.get_path().vertices[:4]
        long = max((p[i] - p[i - 1] for i in range(1, 4)), key=lambda d: float(np.hypot(*d)))
        assert abs(long @ (-np.sin(0.5), np.cos(0.5))) < 1e-9 * np.hypot(*long)
    assert "mark:rear axle:axle" in found


@pytest.mark.parametrize("dim", [2, 3])
def test_what_rolls_stands_on_its_plane(dim):
    m = Mechanism("coin", dim)
    m.free("J", m.ground, m.body("coin"))
    m.constrain(constraints.Rolls("coin", radius=0.3, shape="disc"), "rolls")
    scene = build_scene(system := m.build(), choose_configuration(system, None))
    (mark,) = scene.marks
    assert mark.symbol == "wheel" and mark.disc and mark.radius == 0.3
    np.testing.assert_allclose(np.linalg.norm(mark.point - mark.plane[0]), 0.3, atol=1e-8)
    system.plot()


# ---- what options add


def text_of(ax, gid: str) -> str:
    return next(t.get_text() for t in ax.texts if t.get_gid() == gid)


def test_the_two_link_arm_with_its_frames_angles_and_lengths():
    """As in the figure of the lecture: x_0, x_1, x_2, x_e, arcs of q1 and q2 by their size, l1 and
    l2.
    """
    arm = kempe.load("two_link")
    q = np.array([0.5, 0.9])
    ax = arm.plot(q, axes="all", angles=True, dimensions=True, labels=("bodies", "joints"))
    found = artists(ax)
    for name, below in (("ground", "0"), ("B1", "1"), ("B2", "2"), ("e", "e")):
        assert text_of(ax, f"label:{name}:x") == f"$x_{{{below}}}$"
        assert np.allclose(found[f"mark:{name}:x"][0].get_xydata()[0], arm.fk(q, name)[:2, 3])
    assert "mark:p" not in found, "a target on the ground"
    for joint, value, at in (("q1", 0.5, (0, 0)), ("q2", 0.9, arm.fk(q, "B2")[:2, 3])):
        arc = found[f"angle:{joint}"][0].get_xydata() - at
        (tip,) = found[f"angle:{joint}:head"]
        tip = tip.get_path().vertices[0] - at
        assert np.ptp(np.linalg.norm(arc, axis=1)) < 1e-9
        start = np.arctan2(*arc[0][::-1])
        assert start == pytest.approx({"q1": 0.0, "q2": 0.5}[joint]), "from x of the link before"
        assert np.arctan2(*tip[::-1]) - start == pytest.approx(value)
    for name, body, length in (("l1", "B1", 0.5), ("l2", "B2", 0.4)):
        assert text_of(ax, f"label:dimension:{body}:0") == name
        line = found[f"dimension:{body}:0"][0].get_xydata()
        assert np.linalg.norm(line[1] - line[0]) == pytest.approx(length)
    assert text_of(ax, "label:body:B1") == "B1" and "label:q1" not in found, "the angle says it"


def test_the_angles_alpha_and_beta_of_the_inverse_model():
    """alpha = atan2(p_y, p_x), beta = atan2(l2 s2, l1 + l2 c2), and q1 = alpha - beta."""
    arm = kempe.load("two_link")
    q = np.array([0.5, 0.9])
    found = artists(arm.plot(q, angles="e"))
    p = arm.fk(q, "e")[:2, 3]
    way = {
        "alpha": np.arctan2(p[1], p[0]),
        "beta": np.arctan2(0.4 * np.sin(0.9), 0.5 + 0.4 * np.cos(0.9)),
    }
    assert way["alpha"] - way["beta"] == pytest.approx(0.5)
    for name, angle in way.items():
        start = np.arctan2(*found[f"angle:{name}"][0].get_xydata()[0][::-1])
        tip = found[f"angle:{name}:head"][0].get_path().vertices[0]
        assert np.arctan2(*tip[::-1]) - start == pytest.approx(angle)


def test_labels_say_values_bodies_and_parameters():
    bar = kempe.load("four_bar")
    ax = bar.plot(bar.assemble({"A": 1.0}), labels="all")
    assert {t.get_text() for t in ax.texts} >= {
        "ground",
        "1 crank",
        "2 coupler",
        "3 rocker",
        "A = 1 rad",
    }
    assert "a = 0.1" in ax.get_title(loc="left") and ax.texts
    slide = kempe.load("slider_crank").plot(labels=("joints", "coordinates"))
    assert any(t.get_text().endswith(" m") for t in slide.texts if "=" in t.get_text())


def test_several_configurations_lie_over_one_another():
    arm = kempe.load("two_link")
    both = arm.ik_all([0.6, 0.3], "e")
    ax = arm.plot(both, workspace="e")
    found = artists(ax)
    titles = {text_of(ax, f"label:configuration{k}") for k in (0, 1)}
    assert titles == {"elbow-up", "elbow-down"} == set(both.titles)
    middle_of = found["configuration1:q2"][0].get_path().get_extents()
    elbow = 0.5 * np.array([middle_of.x0 + middle_of.x1, middle_of.y0 + middle_of.y1])
    assert np.allclose(elbow, arm.fk(both.q[1], "B2")[:2, 3]), "the second elbow"
    box = found["workspace:0"][0].get_path().get_extents()
    assert np.allclose([box.x0, box.x1], [-0.9, 0.9], atol=1e-3), "l1 + l2"
    assert arm.plot(arm.ik([0.6, 0.3], "e")) and arm.plot("elbow_up") and both.plot()


@pytest.mark.slow
def test_several_configurations_side_by_side():
    bar = kempe.load("four_bar")
    modes = bar.assembly_modes({"A": 1.0})
    axes = modes.plot(side_by_side=True)
    assert [ax.get_title() for ax in axes] == list(modes.branches) == ["+", "-"]
    assert axes[0].get_xlim() == axes[1].get_xlim() and axes[0].get_ylim() == axes[1].get_ylim()
    for ax, q in zip(axes, modes.q, strict=True):
        assert np.allclose(middle(artists(ax)["joint:C"][0]), centres(bar, q)["C"][:2])
    named = bar.plot(modes.q, side_by_side=True, titles=("open", "crossed"))
    assert [ax.get_title() for ax in named] == ["open", "crossed"]
    arm = kempe.load("puma560")
    every = arm.ik_all(arm.fk(arm.mid + 0.3, "tool"), "tool")
    assert len(arm.plot(every.q[:2], side_by_side=True)) == 2
    with pytest.raises(InputError, match="must be 2 matplotlib axes"):
        bar.plot(modes, side_by_side=True, ax=axes[0])


def shown_boxes(ax, words):
    """The boxes on the screen of texts in space with these words."""
    from matplotlib.transforms import Bbox
    from mpl_toolkits.mplot3d.proj3d import proj_transform

    ax.figure.canvas.draw()
    out = []
    for t in (t for t in ax.texts if t.get_text() in words):
        size = t.get_window_extent()
        at = ax.transData.transform(proj_transform(*t.get_position_3d(), ax.get_proj())[:2])
        out.append(Bbox([at - 0.5 * np.array(size.size), at + 0.5 * np.array(size.size)]))
    return out


@pytest.mark.slow
def test_many_solutions_have_numbers_and_a_key_and_differ_in_grey():
    """Eight of an arm in space: no number covers another, all lies in the figure, and no two have
    the same dashes.
    """
    arm = kempe.load("ur5")
    every = arm.ik_all(arm.fk(arm.random(4), "tool"), "tool")
    ax = every.plot()
    wide = arm.plot(every.q[0]).figure.get_figwidth()
    numbers = shown_boxes(ax, set("12345678"))
    legend = ax.get_legend()
    assert [t.get_text() for t in legend.get_texts()] == [
        f"{k}  {name}" for k, name in enumerate(every.names, 1)
    ]
    assert len(numbers) == 8 and not any(
        a.overlaps(b) for k, a in enumerate(numbers) for b in numbers[:k]
    )
    boxes = [*numbers, legend.get_window_extent()]
    sheet = ax.figure.bbox
    assert all(
        sheet.x0 <= b.x0 and b.x1 <= sheet.x1 and sheet.y0 <= b.y0 and b.y1 <= sheet.y1
        for b in boxes
    )
    assert legend.get_window_extent().x0 > 72 * wide, "beside what is drawn"
    dashes = [
        str(artists(ax)[f"configuration{k}:link2"][0]._unscaled_dash_pattern) for k in range(1, 8)
    ]
    assert len(set(dashes)) == 7
    axes = every.plot(side_by_side=True)
    places = {
        (round(a.get_subplotspec().rowspan.start), a.get_subplotspec().colspan.start) for a in axes
    }
    assert places == {(row, column) for row in range(2) for column in range(4)}


def test_starts_of_a_history_differ_in_grey():
    """Each has a mark, filled or open, that no other has; the one that came nearest is the
    thickest.
    """
    found = (
        kempe.load("ur5")
        .ik([2.0, 0.0, 0.5], "tool", history=True, budget=kempe.Budget(starts=14))
        .history
    )
    lines = found.plot().get_lines()
    looks = {(line.get_marker(), line.get_markerfacecolor() == "white") for line in lines}
    assert len(looks) == len(lines) == 14
    nearest = found.start[np.argmin(found.position_error)]
    assert max(lines, key=lambda line: line.get_linewidth()).get_gid() == f"position:{nearest}"


def test_a_motion_is_a_path():
    bar = kempe.load("four_bar")
    path = bar.trace("A")
    one = artists(bar.plot(path))
    two = artists(bar.plot(path=path))
    assert one.keys() == two.keys() and "curve:coupler_point" in one


@pytest.mark.parametrize("name", ["four_bar", "slider_crank", "four_links"])
def test_an_arrow_for_each_freedom_in_the_plane(name):
    system = kempe.load(name)
    drawn = [
        g
        for g in artists(system.plot(motion=True))
        if g.startswith("motion:") and not g.endswith("head")
    ]
    assert len(drawn) == sum(j.type.dof(2) for j in system.structure.joints.values())


@pytest.mark.parametrize(
    "name", ["joint_revolute", "joint_cylindrical", "joint_spherical", "joint_universal"]
)
def test_an_arrow_for_each_freedom(name):
    """Those of a joint go round its axes, or along them; a ball has three."""
    system = kempe.load(name)
    assert system.plot(motion=True).collections
    scene = build_scene(system, start(system))
    solids = Solids()
    (joint,) = scene.joints
    lines = callouts.draw_freedoms_in_space(solids, joint, 1.0)
    (own,) = (j for j in system.structure.joints.values() if j.type.dof(3))
    assert len(lines) == own.type.dof(3) and len(solids.named[f"motion:{joint.name}"]) > 50 * len(
        lines
    )
    for line in lines:
        arc = np.ptp(np.linalg.norm(line - joint.centre, axis=1)) < 1e-9
        straight = np.linalg.norm(np.cross(line - line[0], line[-1] - line[0]), axis=1).max() < 1e-9
        assert arc != straight


def test_the_values_of_a_free_joint_stand_in_lines():
    """All seven of them, three words a line."""
    texts = [t.get_text() for t in kempe.load("joint_free").plot(labels="all").texts]
    (one,) = (text for text in texts if "joint.x" in text)
    lines = one.split("\n")
    assert one.count(" = ") == 7 and max(len(line.rstrip(",").split(", ")) for line in lines) == 3
    wide, high = labels.measure_text(one, 9.0)
    assert (
        wide < 0.6 * labels.measure_text(one.replace("\n", " "), 9.0)[0]
        and high > 2.5 * labels.measure_text("x", 9.0)[1]
    )


def test_joints_show_both_bodies():
    """A knuckle and a barrel, a socket and a ball, two forks: each half is as near to its link as
    it can be.
    """
    for name, parts in (
        ("spherical", ("joint", "socket")),
        ("universal", ("joint", "fork")),
        ("revolute", ("joint",)),
    ):
        solids, _ = solids_of(system := kempe.load(f"joint_{name}"), system.mid)
        colours = {solids.colours[k][:3] for part in parts for k in solids.named[f"{part}:joint"]}
        greens = [c[1] for c in colours]
        assert any(0.2 < g < 0.4 for g in greens) and any(0.45 < g < 0.75 for g in greens), (
            "dark parent, light child"
        )


def test_options_are_written_out():
    import inspect

    from kempe.views.plot_options import PlotOptions

    names = list(inspect.signature(kempe.System.plot).parameters)
    assert names[:3] == ["self", "q", "path"] and set(names[3:]) == set(
        PlotOptions.__dataclass_fields__
    )
    for option in ("workspace", "angles"):
        with pytest.raises(UnsupportedError, match="planar"):
            kempe.load("puma560").plot(**{option: "tool"})
        for name in ("puma560", "two_link"):
            with pytest.raises((UnknownNameError, UnsupportedError), match="nix|planar"):
                kempe.load(name).plot(**{option: "nix"})


def test_a_system_that_cannot_move_is_drawn():
    rigid = kempe.load("joint_fixed")
    assert rigid.plot(rigid.mid, labels=()).figure is not None


def test_curves_of_coordinates_differ_without_colours():
    """Of a path each curve has a mark of its own, at points that are spread, as in the legend."""
    ax = kempe.load("four_bar").trace("A").plot_curve()
    lines = [line for line in ax.get_lines() if str(line.get_gid()).startswith("coordinate:")]
    assert len({line.get_marker() for line in lines}) == len(lines) == 4
    assert len({line.get_markevery()[0] for line in lines}) == 4


def test_no_pose_lies_under_the_legend():
    """The legend of reached poses stands beside the axes."""
    arm = kempe.load("two_link")
    ax = arm.reach.poses(np.array([[0.5, 0.3], [0.9, 0.9]]), "e", task="position").plot()
    ax.figure.canvas.draw()
    assert ax.get_legend().get_window_extent().x0 >= ax.get_window_extent().x1


# ---- files without frames, long names, many labels


TOOLED = """<robot name="arm"><link name="base"/><link name="upper"/><link name="lower"/><link name="tool"/>
<joint name="lift" type="continuous"><parent link="base"/><child link="upper"/><axis xyz="0 1 0"/></joint>
<joint name="elbow" type="continuous"><parent link="upper"/><child link="lower"/><origin xyz="0 0 0.5"/>
<axis xyz="0 1 0"/></joint>
<joint name="flange" type="fixed"><parent link="lower"/><child link="tool"/><origin xyz="0 0 0.4"/></joint></robot>"""


def test_the_tool_of_a_file_without_frames_is_drawn(tmp_path):
    """A body that is fixed at the end of a chain is the end of the last link, by name; not a stub."""
    (tmp_path / "arm.urdf").write_text(TOOLED)
    arm = kempe.load(tmp_path / "arm.urdf")
    scene = build_scene(arm, arm.neutral)
    assert list(scene.links[-1].frames) == ["tool"] and np.allclose(
        scene.list_points(scene.links[-1])[-1], [0, 0, 0.9]
    )
    ax = arm.plot()
    assert ax.get_zlim()[1] > 0.9 and "tool" in [t.get_text() for t in ax.texts]


def test_labels_look_at_what_is_near_them(hunt):
    """Which covers the same points as all segments do."""
    rng = hunt.rng()
    crowd = labels.Obstacles()
    a, b = rng.uniform(0, 100, (2, 2000, 2))
    for p, q in zip(a, b, strict=True):
        crowd.add_segment(
            p, p + 0.02 * (q - p), float(rng.uniform(0.1, 2.0)), float(rng.uniform(0.1, 2.0))
        )
    points = rng.uniform(0, 100, (40, 1, 2)) + rng.uniform(-1, 1, (40, 9, 2))
    weights = np.zeros(points.shape[:-1])
    for x0, y0, x1, y1, radius, weight in crowd.segments:
        d = np.array([x1 - x0, y1 - y0])
        t = np.clip((points - (x0, y0)) @ d / (d @ d), 0, 1)
        gap = np.linalg.norm(points - (x0, y0) - t[..., None] * d, axis=-1)
        weights = np.where(gap < radius, np.maximum(weights, weight), weights)
    np.testing.assert_array_equal(crowd.find_covering_weights(points), weights)
    assert len(crowd.select_near_segments(points[0])) < 100


def test_long_names_are_shortened_in_pictures():
    name = "manipulator_of_the_second_station_on_the_left_hand_side"
    for dim in (2, 3):
        m = Mechanism("long", dim=dim)
        m.revolute(f"{name}_joint", m.ground, m.body("a"))
        m.frame(f"{name}_tip", "a", at=(0.5, 0))
        said = [t.get_text() for t in m.build().plot().texts]
        assert {"manipulator_of_…_hand_side_joint", "manipulator_of_…ft_hand_side_tip"} <= set(said)
    assert labels.shorten_label("$x_{0}$" * 9) == "$x_{0}$" * 9
    assert labels.shorten_label("a.qw = 1, a.qx = 0, a.qy = 0, a.qz = 0, b.rx = 0") == (
        "a.qw = 1, a.qx = 0, a.qy = 0, a.qz = 0,\nb.rx = 0"
    )


def test_titles_and_ghosts_that_do_not_fit_are_refused():
    """One name for one configuration stands above it; numbers that differ, and ghosts of no motion,
    are errors.
    """
    two = kempe.load("two_link")
    assert two.plot([0.3, 0.4], titles=["start"]).get_title() == "start"
    with pytest.raises(InputError, match="titles has 1 name, and 2 configurations are drawn"):
        two.plot([[0.3, 0.4], [0.5, 0.6]], titles=["start"])
    with pytest.raises(InputError, match="ghosts is 3, and there is no motion: path gives one"):
        two.plot([0.3, 0.4], ghosts=3)


@pytest.mark.parametrize(
    ("name", "joint"), [("four_bar", "C"), ("jansen", "W"), ("delta_uu", None)]
)
def test_opened_systems_keep_their_links_in_pictures(name, joint):
    """Where a joint was taken out its links reach as far as before; a frame stands at each of its
    ends.
    """
    whole = kempe.load(name)
    system = whole.open_loops(joint)
    q = whole.assemble().q
    given = {n: x for n, x in whole.q_dict(q).items() if n in system.coordinate_names}
    before = build_scene(whole, q)
    after = build_scene(system, system.q(given))
    for link in before.links[1:]:
        same = next(x for x in after.links if x.name == link.name)
        for p in before.list_points(link):
            assert np.linalg.norm(after.list_points(same) - p, axis=1).min() < 1e-6, (link.name, p)

"""The page of the viewer in a browser, by mouse events only, and what is drawn of a system without
one.
"""

from __future__ import annotations

import http.client
import io
import itertools
import json
import socket
import subprocess
import sys
import time
from pathlib import Path
from urllib.parse import urlsplit

import numpy as np
import pytest
import trimesh
from chromium import draw_plainly, measure_picture, project_point
from hunts import some
from robots import DATA

import kempe
from kempe.description.meshes import PlacedMesh, read_body_meshes
from kempe.equations.judge import closure_error, judge_configurations
from kempe.errors import InputError, UnknownNameError
from kempe.views.drawing.scene import build_scene
from kempe.views.viewer.scene_nodes import Drawn, Nodes, RigidParts, write_glb
from kempe.views.viewer.session import Session

WIDE = 960
HIGH = 400
TALOS = "talos_data/robots/talos_reduced.urdf"
SOON = 300.0
"""Seconds after which what is waited for does not come."""
BLOCKS = (8, 12)
"""Blocks of a picture of the space beside the panel, high and wide, whose mean colours are
compared."""
ALIKE = 0.04
"""How much the mean colour of a block may differ, from 0 (black) to 1 (white): a joint that moved
by 0.3 rad differs more, another version of a browser less."""
PICTURES = Path(__file__).with_name("pictures.json")
"""Mean colours of blocks by system, six hexadecimal digits a block; written by
`python tests/views/test_viewer.py`."""
DRAWN = (
    "panda",
    "four_bar",
    "slider_crank",
    "three_rpr",
    "watt_straight",
    "bennett",
    "stewart_sps",
    "car",
    "ball",
    "joint_helical",
    "joint_planar",
    "joint_universal",
    "seven_bodies_loop",
)


# ---- without a browser


@pytest.mark.parametrize("name", some(DRAWN, 4))
def test_parts_move_with_their_links(name):
    """What is drawn of each model is on links or rods, finite, and rods end where their constraints
    hold.
    """
    system = kempe.load(name)
    q = system.q("closed") if "closed" in system.structure.posture_names else system.mid
    rigid = RigidParts(system, q)
    assert {p.carrier for p in rigid.parts} <= set(range(rigid.carriers))
    assert all(np.isfinite(p.corners).all() and len(p.triangles) for p in rigid.parts)
    scene = build_scene(system, q)
    X = rigid.compute_poses(q)
    for k, (_, _, ends, _) in enumerate(scene.rods, len(rigid.heads)):
        assert np.allclose(X[k, :3, 3], ends[0]) and np.allclose(
            X[k, :3, 2] * np.linalg.norm(ends[1] - ends[0]), ends[1] - ends[0]
        )


def test_a_pin_is_drawn_where_its_joint_is():
    """The drawing at one configuration, moved to another, is the drawing of that other: corners of
    links agree.
    """
    bar = kempe.load("four_bar")
    motion = bar.trace("A").q
    here = RigidParts(bar, motion[0])
    there = RigidParts(bar, motion[len(motion) // 3])
    X = here.compute_poses(motion[len(motion) // 3])
    for a, b in zip(here.parts, there.parts, strict=True):
        if a.carrier:
            moved = a.corners @ X[a.carrier, :3, :3].T + X[a.carrier, :3, 3]
            own = b.corners @ X[b.carrier, :3, :3].T + X[b.carrier, :3, 3]
            assert np.allclose(moved.min(axis=0), own.min(axis=0), atol=0.3 * here.r)
            assert np.allclose(moved.max(axis=0), own.max(axis=0), atol=0.3 * here.r)


@pytest.mark.parametrize("name", some(("panda", "ur5", "iiwa14", "gen3", "irb6640"), 3))
def test_bearings_of_an_arm_lie_side_by_side_on_their_axes(name):
    """Also where axes meet in a point; the links are drawn alike from any configuration."""
    arm = kempe.load(name)
    here = RigidParts(arm, arm.mid)
    plain = build_scene(arm, here.q)
    for old, new in zip(plain.joints, here.scene.joints, strict=True):
        off = new.centre - old.centre
        assert np.allclose(np.cross(off, old.axis), 0.0, atol=1e-12)
        assert np.allclose(new.F[:3, 3] - old.F[:3, 3], off)
    places = np.array([j.centre for j in here.scene.joints])
    assert np.linalg.norm(np.diff(places, axis=0), axis=1).min() > here.r
    q = arm.random(0)
    moved = here.compute_stretched_maps(q) @ np.linalg.inv(here.compute_stretched_maps(here.q))
    pieces, anew = (here._record_pieces(here._build_scene(x)) for x in (here.q, q))
    # how the faces of tubes and balls are turned differs: the means of all that has one name agree,
    # but for handles, which are as long as the drawing is large
    means = [dict[str, list[np.ndarray]]() for _ in range(2)]
    for piece, carrier, there in zip(pieces, here.carrying, anew, strict=True):
        corners = piece.corners @ moved[carrier, :3, :3].T + moved[carrier, :3, 3]
        for found, points in zip(means, (corners, there.corners), strict=True):
            found.setdefault(piece.name, []).extend(points)
    for name, points in means[0].items():
        off = np.mean(points, axis=0) - np.mean(means[1][name], axis=0)
        assert np.abs(off).max() < 0.5 * here.r, name


def parts_at(rigid: RigidParts, q: np.ndarray) -> np.ndarray:
    """Triangles (n, 3, 3) of what a page shows at a configuration."""
    X, lengths = rigid.compute_places(q)
    X = X.copy()
    X[:, :3, 2] *= lengths[:, None]
    return np.concatenate(
        [
            (p.corners @ X[p.carrier, :3, :3].T + X[p.carrier, :3, 3])[p.triangles]
            for p in rigid.parts
        ]
    )


def bare_part(
    triangles: np.ndarray, a: np.ndarray, z: np.ndarray, along: float, wide: float
) -> float:
    """The longest piece of the line from a (3,) by `along` z (3,) near which nothing is drawn."""
    t = (triangles - a) @ z
    off = triangles - a - t[..., None] * z
    near = (np.linalg.norm(off, axis=-1) < wide).all(axis=1)
    at = min(0.0, along)
    most = 0.0
    for low, high in sorted(zip(t[near].min(axis=1), t[near].max(axis=1), strict=True)):
        if low > at:
            most = max(most, min(low, max(0.0, along)) - at)
        at = max(at, high)
    return max(most, max(0.0, along) - at)


SLIDING = (
    "stewart",
    "three_rps",
    "stanford",
    "three_upu",
    "cobra600",
    "stewart_sps",
    "joint_cylindrical",
    "three_rpr",
    "joint_helical",
    "peaucellier",
    "ladder",
    "seven_bodies",
)


@pytest.mark.parametrize("name", some(SLIDING, 3))
def test_sliding_joints_are_whole_at_every_configuration(name):
    """From one half of a joint to the other something is drawn, as where it is drawn anew (which
    `plot` does).
    """
    system = kempe.load(name)
    session = Session(system)
    rigid = RigidParts(system, session.q)
    for _ in range(2):
        session.go_to_random()
        scene = build_scene(system, session.q)
        here = parts_at(rigid, session.q)
        anew = parts_at(RigidParts(system, session.q), session.q)
        ends = [
            (j.F[:3, 3], j.axis, float(j.axis @ (j.centre - j.F[:3, 3])))
            for j in scene.joints
            if j.kind in ("prismatic", "cylindrical", "helical")
        ]
        for a, z, along in ends:
            assert (
                bare_part(here, a, z, along, 3.0 * rigid.r)
                <= bare_part(anew, a, z, along, 3.0 * rigid.r) + rigid.r
            )


@pytest.mark.parametrize("dim", [2, 3])
def test_a_pin_stays_in_its_slot(dim):
    """A point on a line that slides far: the bar reaches to it, and the slot or the bar is about
    it.
    """
    m = kempe.Mechanism("slot", dim=dim)
    bar = m.body("bar")
    arm = m.body("arm")
    zero = (0.0,) * dim
    m.revolute("A", m.ground, bar, at=zero, **({"axis": (0, 0, 1)} if dim == 3 else {}))
    m.prismatic("x", m.ground, arm, at=(0.0, 0.3, 0.0)[:dim], axis=(1.0, 0.0, 0.0)[:dim])
    m.frame("pin", arm)
    m.frame("line", bar)
    m.constrain(
        kempe.constraints.OnLine("pin", other="line", direction=(1.0, 0.0, 0.0)[:dim]), name="slot"
    )
    system = m.build()
    first, far = (system.assemble({"x": x}).q for x in (0.1, 3.0))
    rigid = RigidParts(system, first)
    _, _, A, point = build_scene(system, far).lines[0]
    along = float(A[:3, 2] @ (point - A[:3, 3]))
    here = parts_at(rigid, far)
    z = A[:3, 2]
    assert abs(along) > 1.0
    assert bare_part(here, point - 3.0 * rigid.r * z, z, 6.0 * rigid.r, 3.0 * rigid.r) < rigid.r
    if dim == 2:
        assert bare_part(here, A[:3, 3], z, along, 3.0 * rigid.r) < rigid.r


def test_a_rail_is_as_long_as_its_joint_on_the_page():
    """The nodes of a page are stretched by what the joint slides: a Stewart platform's legs."""
    system = kempe.load("stewart")
    with system.show(port=0, browser=False) as viewer:
        nodes = Nodes(viewer.server.scene, viewer.drawn, viewer.q)
        session = Session(system)
        session.go_to_random()
        nodes.move_links(session.q)
        lengths = viewer.drawn.rigid.compute_places(session.q)[1]
        changed = [k for k in nodes.stretched if abs(lengths[k] - 1.0) > 1e-9]
        assert len(changed) >= 6
        assert all(
            node.scale == (1.0, 1.0, lengths[k]) for k in changed for node in nodes.stretched[k]
        )


ROUND = 24 * np.sin(np.pi / 12) / (2 * np.pi)
"""Area of a polygon of 24 sides, by that of its circle."""


@pytest.mark.slow
@pytest.mark.parametrize(
    ("kind", "sizes", "extents", "volume", "least"),
    [
        ("box", {"size": (1, 2, 3)}, (1, 2, 3), 6.0, 1.0),
        ("sphere", {"radius": 1}, (2, 2, 2), 4 / 3 * np.pi, 0.95),
        ("cylinder", {"radius": 1, "length": 3}, (2, 2, 3), 3 * np.pi, ROUND),
        ("capsule", {"radius": 1, "length": 3}, (2, 2, 5), (3 + 4 / 3) * np.pi, 0.95),
        ("ellipsoid", {"radii": (1, 2, 3)}, (2, 4, 6), 8 * np.pi, 0.95),
    ],
)
def test_shapes_are_drawn_in_their_size_place_and_colour(kind, sizes, extents, volume, least):
    """The triangles lie inside the true shape, whose volume has a closed form."""
    m = kempe.Mechanism("m")
    m.revolute("q", m.ground, m.body("a"))
    m.shape("a", kind, **sizes, at=(5, 6, 7), color=(1, 0.5, 0, 0.25))
    found, lost = read_body_meshes(m)
    (drawn,) = found["a"]
    mesh = trimesh.Trimesh(drawn.corners, drawn.triangles, process=False)
    assert not lost and mesh.is_watertight
    np.testing.assert_allclose(mesh.extents, extents, rtol=0.01)
    np.testing.assert_allclose(mesh.bounds.mean(axis=0), (5, 6, 7), rtol=0, atol=1e-6)
    assert least * volume * (1 - 1e-6) <= mesh.volume <= volume * (1 + 1e-6)
    assert drawn.drawn.color == (255, 128, 0, 64)
    shape = next(
        s for s in Drawn(m.build(), np.zeros(1)).shapes if len(s.mesh.triangles) == len(mesh.faces)
    )
    assert shape.mesh.opacity == 64 / 255


@pytest.mark.slow
def test_what_collides_is_drawn_where_nothing_else_is_seen():
    m = kempe.Mechanism("m")
    for name in ("seen", "hidden", "bare"):
        m.revolute(f"q {name}", m.ground, m.body(name))
    for name in ("seen", "hidden"):
        m.shape(name, "box", size=(1, 1, 1), visual=False)
    m.shape("seen", "sphere", radius=1, collision=False)
    found, lost = read_body_meshes(m)
    assert not lost and {name: len(meshes) for name, meshes in found.items()} == {
        "seen": 1,
        "hidden": 1,
    }
    assert len(found["hidden"][0].triangles) == 12 and len(found["seen"][0].triangles) > 12


def test_colours_of_a_file_are_kept_and_others_get_that_of_the_shape(tmp_path):
    box = trimesh.creation.box((1, 1, 1))
    box.export(tmp_path / "plain.stl")
    box.visual.vertex_colors = (0, 255, 0, 255)
    box.export(tmp_path / "green.ply")
    m = kempe.Mechanism("m")
    m.revolute("q", m.ground, m.body("a"))
    m.roots = (str(tmp_path),)
    for name in ("plain.stl", "green.ply"):
        m.shape("a", "mesh", path=name, scale=2, color=(1, 0, 0))
    found, lost = read_body_meshes(m)
    plain, green = found["a"]
    assert not lost and plain.drawn.color == (255, 0, 0, 255)
    assert green.drawn.color == (0, 255, 0, 255)
    for mesh in (plain, green):
        assert np.allclose(np.ptp(mesh.corners, axis=0), 2)
        assert (as_trimesh(mesh).visual.vertex_colors == mesh.drawn.color).all()


def as_trimesh(mesh: PlacedMesh) -> trimesh.Trimesh:
    """The GLB that a page gets, read by trimesh and placed as on the page."""
    out = trimesh.load_mesh(io.BytesIO(mesh.drawn.glb), file_type="glb", process=False)
    out.apply_scale(mesh.scale)
    return out.apply_transform(mesh.X)


@pytest.mark.slow
def test_glb_and_triangles_are_the_same_mesh(tmp_path):
    """Scaled by different numbers, one of them negative, and turned; written by trimesh and here."""
    trimesh.creation.icosphere(1, 0.5).apply_translation((1, 2, 3)).export(tmp_path / "ball.stl")
    m = kempe.Mechanism("m")
    m.revolute("q", m.ground, m.body("a"))
    m.roots = (str(tmp_path),)
    at = trimesh.transformations.compose_matrix(angles=(0.1, 0.7, -1.2), translate=(4, 5, 6))
    m.shape("a", "mesh", path="ball.stl", scale=(1, -2, 3), at=at)
    (mesh,) = read_body_meshes(m)[0]["a"]
    placed = as_trimesh(mesh)
    there = trimesh.load_mesh(tmp_path / "ball.stl", process=False)
    there.apply_scale((1, -2, 3)).apply_transform(at)
    here = trimesh.Trimesh(mesh.corners, mesh.triangles, process=False)
    assert here.is_volume == there.is_volume and here.volume > 0.0
    assert np.allclose(here.volume, there.volume) and np.allclose(here.bounds, there.bounds)
    assert np.allclose(placed.bounds, there.bounds)


def test_written_glb_is_read_by_trimesh_as_it_was():
    rng = np.random.default_rng(0)
    corners = rng.normal(size=(30, 3))
    a, b, c = corners.reshape(-1, 3, 3).swapaxes(0, 1)
    normals = np.repeat(np.cross(b - a, c - a), 3, axis=0)
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    colours = rng.integers(0, 256, (30, 4)).astype(np.uint8)
    file = io.BytesIO(write_glb(corners, normals, colours))
    mesh = trimesh.load_mesh(file, file_type="glb", process=False)
    assert np.allclose(mesh.triangles, corners.reshape(-1, 3, 3), atol=1e-6)
    assert np.allclose(mesh.vertex_normals, normals, atol=1e-6)
    assert np.array_equal(mesh.visual.vertex_colors, colours)


@pytest.mark.parametrize("name", some(DRAWN, 4))
def test_a_page_gets_the_triangles_of_a_drawing(name):
    """Corners that are alike are sent once; the mirror image of a corner is another one."""
    system = kempe.load(name)
    for _, mesh in Drawn(system, system.mid).shapes:
        sent = as_trimesh(mesh)
        corners = mesh.corners[mesh.triangles]
        assert len(sent.vertices) <= corners.shape[0] * 3
        assert np.allclose(sent.triangles, corners, atol=1e-6 * max(1.0, np.abs(corners).max()))


def test_shapes_that_a_page_cannot_hold_are_named():
    m = kempe.Mechanism("m")
    m.revolute("q", m.ground, m.body("a"))
    m.shape("a", "cylinder", radius=1e300, length=1)
    m.shape("a", "box", size=(1, 2, 3), at=(1e10, 0, 0))
    found, lost = read_body_meshes(m)
    assert not found and len(lost) == 2
    assert lost[0].startswith("a: the radius of its cylinder is 1e+300; it must be below 1e+09")
    assert lost[1].startswith("a: the place of its box")


@pytest.mark.slow
@pytest.mark.skipif(not DATA, reason="example-robot-data is not installed")
def test_meshes_are_those_of_the_model_and_missing_ones_do_not_block():
    """In the package of the file all are found; without a file each is named, and links are drawn in
    their place.
    """
    found, lost = read_body_meshes(kempe.load(DATA[0] / TALOS).mechanism)
    assert len(found) > 20 and not lost
    bare = kempe.load((DATA[0] / TALOS).read_text())
    none, lost = read_body_meshes(bare.mechanism)
    assert len(none) < 10 and len(lost) > 20 and "looked in" in lost[0]
    assert len(RigidParts(bare, bare.mid).parts) > 20


def test_importing_loads_no_viewer():
    code = (
        "import sys, kempe; kempe.load('four_bar'); print('viser' in sys.modules, 'trimesh' in "
        "sys.modules)"
    )
    run = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert run.stdout.split() == ["False", "False"]


def test_what_is_missing_is_named(monkeypatch):
    monkeypatch.setitem(sys.modules, "viser", None)
    for name in ("live", "server"):
        monkeypatch.delitem(sys.modules, f"kempe.views.viewer.{name}", raising=False)
    with pytest.raises(kempe.KempeError, match=r"viser.*kempe\[view\].*pip install"):
        kempe.load("two_link").show(browser=False)


def test_wrong_calls_of_the_viewer_are_refused(tmp_path):
    arm = kempe.load("two_link")
    with socket.socket() as taken:
        taken.bind(("127.0.0.1", 0))
        taken.listen()
        with pytest.raises(InputError, match=f"port {taken.getsockname()[1]} cannot be used"):
            arm.show(port=taken.getsockname()[1], browser=False)
    with pytest.raises(InputError, match="port is 'x'"):
        arm.show(port="x", browser=False)
    with pytest.raises(UnknownNameError, match="nix"):
        arm.show(frame="nix", browser=False)
    for switch in ("share", "browser"):
        with pytest.raises(InputError, match=f"{switch} is 'yes'; it must be True or False"):
            arm.show(**{"port": 0, "browser": False, switch: "yes"})
    with pytest.raises(InputError, match="q has"):
        arm.show([1.0, 2.0, 3.0], browser=False)
    with pytest.raises(UnknownNameError, match="nix"):
        arm.save_html(tmp_path / "x.html", frame="nix")
    for wrong in ("robot.png", tmp_path / "no" / "robot.html", 3):
        with pytest.raises(InputError):
            arm.save_html(wrong)
    with pytest.raises(InputError, match="seconds"):
        arm.save_html(tmp_path / "x.html", seconds=-1)


def test_a_viewer_is_on_this_machine_only_and_ends():
    """It listens on 127.0.0.1, and on nothing any more after it was closed."""
    with kempe.load("two_link").show(port=0, browser=False) as viewer:
        address = urlsplit(viewer.url)
        assert (
            viewer.url.startswith("http://127.0.0.1:") and viewer.server.get_host() == "127.0.0.1"
        )
        viewer.q = {"q1": 0.5}
        assert viewer.q[0] == 0.5
    connection = http.client.HTTPConnection(address.netloc)
    try:
        connection.request("GET", address.path)
        code = connection.getresponse().status
    except OSError as error:
        code = error
    assert code != 200, "another server may have the port by now, but not the token"
    assert "closed" in repr(viewer)


# ---- in a browser


class Seen:
    """A page in the browser, with what it requested, and the mouse over what is in space.

    It has shadows and reflections, as users see it, only where `lit`.
    """

    def __init__(
        self,
        browser,
        viewer,
        wide: int = WIDE,
        high: int = HIGH,
        density: int = 1,
        lit: bool = False,
    ):
        self.browser = browser
        self.viewer = viewer
        if not lit:
            draw_plainly(viewer.server)
        self.requests = []
        self.open(wide, high, density)

    def open(self, wide: int = WIDE, high: int = HIGH, density: int = 1) -> None:
        viewer = self.viewer
        size = {"width": wide, "height": high}
        self.tab = self.browser.new_page(viewport=size, device_scale_factor=density)
        self.tab.on("request", lambda r: self.requests.append(r.url))
        self.tab.goto(viewer.url)
        assert self.until(lambda: viewer.pages and next(iter(viewer.pages.values())).spent)
        self.page = next(iter(viewer.pages.values()))
        self.tab.get_by_text("random", exact=True).wait_for()
        # drawn without a graphics card
        self.tab.add_style_tag(content=".mantine-Notification-root {display: none}")
        self.tab.wait_for_timeout(500)

    def until(self, what, soon: float = SOON) -> bool:
        end = time.monotonic() + soon
        while not what() and time.monotonic() < end:
            self.tab.wait_for_timeout(50)
        return bool(what())

    def shows(self, right) -> bool:
        """Whether a picture (*BLOCKS, 3) comes that is right; else the page is opened once more.

        Browsers without a graphics card lose what they draw on now and then, and do not draw again.
        What is wrong is printed with the camera.
        """
        for again in (True, False):
            if self.until(lambda: right(self.picture()), 0.25 * SOON):
                return True
            camera = self.page.client.camera
            print("camera", camera.position, camera.look_at, camera.up_direction, camera.fov)
            print("picture", np.round(255 * self.picture()).astype(int).tolist())
            if again:
                self.tab.close()
                assert self.gone()
                self.open()
        return False

    def gone(self) -> bool:
        """Whether the viewer knows that the page was closed."""
        end = time.monotonic() + SOON
        while self.viewer.pages and time.monotonic() < end:
            time.sleep(0.05)
        return not self.viewer.pages

    def at(self, p) -> tuple:
        """Where a point (..., 3) is on the screen."""
        return project_point(self.tab, self.page.client.camera, p)

    def press(self, text: str, row: str | None = None) -> None:
        """Click on a button or a check box of the panel, of several with this text on the one
        beside a label.
        """
        those = self.tab.get_by_text(text, exact=True)
        those.first.wait_for()  # what the server has sent may not be there yet
        found = those.all()
        if row is not None:
            y = self.tab.get_by_text(row, exact=True).bounding_box()["y"]
            found.sort(key=lambda one: abs(one.bounding_box()["y"] - y))
        found[0].scroll_into_view_if_needed()
        box = found[0].bounding_box()
        before = None
        while box != before:  # sentences above it may still come
            self.tab.wait_for_timeout(200)
            box, before = found[0].bounding_box(), box
        self.tab.mouse.click(box["x"] + 0.5 * box["width"], box["y"] + 0.5 * box["height"])

    def drag(self, a, b, steps: int = 5) -> None:
        self.tab.mouse.move(*a)
        self.tab.mouse.down()
        for t in np.linspace(0.0, 1.0, steps + 1)[1:]:
            self.tab.mouse.move(*(np.asarray(a) + t * (np.asarray(b) - a)))
            self.tab.wait_for_timeout(40)
        self.tab.mouse.up()

    def picture(self) -> np.ndarray:
        """Mean colours of blocks (*BLOCKS, 3) of what is seen beside the panel, from 0 to 1, once
        it is at rest.
        """
        import io

        from matplotlib.image import imread

        wide, high = measure_picture(self.tab)
        old = np.zeros(())
        clip = {"x": 0, "y": 0, "width": wide, "height": high}
        for _ in range(20):
            new = imread(io.BytesIO(self.tab.screenshot(clip=clip)), format="png")[..., :3]
            rows = (
                np.array_split(row, BLOCKS[1], axis=1) for row in np.array_split(new, BLOCKS[0])
            )
            new = np.array([[block.mean(axis=(0, 1)) for block in row] for row in rows])
            if old.shape and np.abs(new - old).max() < 1e-3:
                break
            old = new
            self.tab.wait_for_timeout(300)
        return new


def seen_before(name: str) -> np.ndarray:
    """The picture (*BLOCKS, 3) of a system that was looked at."""
    rows = [bytes.fromhex(row) for row in json.loads(PICTURES.read_text())[name]]
    return np.array([list(row) for row in rows]).reshape(*BLOCKS, 3) / 255.0


SHOWN = ("panda", "talos", "four_bar", "delta_uu", "car")


def systems(name: str) -> kempe.System:
    if name == "talos":
        if not DATA:
            pytest.skip("example-robot-data is not installed")
        # as text: beside its file the meshes would be found, and hide the arrows
        return kempe.load((DATA[0] / TALOS).read_text(), base="free")
    return kempe.load(name)


@pytest.mark.slow
@pytest.mark.parametrize("name", SHOWN)
def test_sliders_and_targets_move_the_robot_and_no_request_goes_outside(browser, name):
    """By the mouse: an arrow of the gizmo, along which the frame goes, then a slider of the panel.

    The picture is the one that was looked at, and another one after the slider.
    """
    system = systems(name)
    frame = "car" if name == "car" else None  # its front is under the panel
    with system.show(frame=frame, port=0, browser=False) as viewer:
        seen = Seen(browser, viewer, lit=True)
        assert seen.shows(lambda picture: np.abs(picture - seen_before(name)).max() < ALIKE)
        session = seen.page.session
        q = viewer.q
        X = session.pose.copy()
        size = 0.22 * seen.page.nodes.drawn.rigid.size
        ends = {
            k: [np.array(seen.at(X[:3, 3] + part * size * X[:3, k])) for part in (0.0, 0.85, 1.2)]
            for k in (0, 1)
        }
        axis = max(ends, key=lambda k: float(np.linalg.norm(ends[k][1] - ends[k][0])))
        seen.drag(*ends[axis][1:])
        assert seen.until(lambda: not np.allclose(session.pose, X, atol=1e-4))
        assert (
            judge_configurations(system, viewer.q)
            and (session.pose[:3, 3] - X[:3, 3]) @ X[:3, axis] > 0.0
        )
        q = viewer.q
        box = seen.tab.get_by_role("slider").nth(3 if name == "talos" else 0).bounding_box()
        middle = np.array([box["x"] + 0.5 * box["width"], box["y"] + 0.5 * box["height"]])
        seen.drag(middle, middle + [20.0, 0.0])
        assert seen.until(lambda: not np.allclose(viewer.q, q)) and judge_configurations(
            system, viewer.q
        )
        assert seen.until(lambda: np.abs(seen.picture() - seen_before(name)).max() > ALIKE)
        own = (viewer.url, viewer.url.replace("http", "ws"), "data:", "blob:")
        assert all(url.startswith(own) for url in seen.requests)
        seen.tab.close()


@pytest.mark.slow
@pytest.mark.parametrize("scale", [1e-3, 1e3])
def test_a_system_in_other_units_looks_the_same(browser, scale):
    """A linkage in millimetres, or as small as a grain: neither too near to be seen nor too far
    away.
    """
    bar = kempe.load("watt_six_bar")
    pictures = []
    lengths = {name: scale * x for name, x in bar.structure.parameters.items() if name != "bend"}
    for system in (bar, bar.with_parameters(**lengths)):
        with system.show(bar.assemble().q, port=0, browser=False) as viewer:
            seen = Seen(browser, viewer)
            assert seen.shows(
                lambda new: (
                    np.ptp(new) > 0.1 and (not pictures or np.abs(new - pictures[0]).max() < ALIKE)
                )
            )
            pictures.append(seen.picture())
            seen.tab.close()


@pytest.mark.slow
def test_the_camera_suits_the_size_of_the_page(browser):
    """The one that pages begin with is moved when the page is turned, or by "Reset View"; one that
    someone moved is left.
    """
    with kempe.load("panda").show(port=0, browser=False) as viewer:
        seen = Seen(browser, viewer, 420, 800)
        camera = seen.page.client.camera

        def far():
            return np.linalg.norm(np.subtract(camera.position, camera.look_at))

        upright = far()
        seen.tab.set_viewport_size({"width": 800, "height": 420})
        assert seen.until(lambda: far() < 0.9 * upright)
        begin = viewer.server.initial_camera

        def reset_view():  # as the button does; reports of the browser may still be on their way
            with seen.page.client.atomic():
                camera.look_at = begin.look_at
                camera.position = begin.position

        reset_view()
        seen.tab.set_viewport_size({"width": 420, "height": 800})
        assert seen.until(lambda: np.isclose(far(), upright, rtol=1e-3) or reset_view())
        direction = begin.position - begin.look_at

        def turned():
            away = camera.position - camera.look_at
            cosine = away @ direction / np.linalg.norm(away) / np.linalg.norm(direction)
            return cosine < np.cos(0.2)

        assert not turned()
        # the browser moves it when it has done what the server asked for, and then reports it
        assert seen.until(lambda: turned() or seen.drag((20.0, 100.0), (100.0, 140.0)))
        seen.tab.set_viewport_size({"width": 800, "height": 420})
        assert seen.until(lambda: camera.image_width > camera.image_height)
        seen.tab.wait_for_timeout(500)
        assert turned()
        seen.tab.close()


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "wide", "density"),
    [
        ("panda", 400, 1),
        ("four_bar", 400, 3),
        ("four_bar", 574, 1),
        ("panda", 600, 2),
        ("four_bar", 800, 1),
        ("panda", 1280, 2),
    ],
)
def test_the_panel_leaves_the_system_in_sight(browser, name, wide, density):
    """On pages of any width, with one or more pixels of the screen to one of the page, all origins
    of bodies lie where the picture is uncovered, and spread over a part of it.
    """
    system = kempe.load(name)
    with system.show(port=0, browser=False) as viewer:
        seen = Seen(browser, viewer, wide, 800, density)
        on_top = "([x, y]) => document.elementFromPoint(x, y)?.tagName"
        poses = system.fk(viewer.q)

        def places():
            origins = [X[:3, 3] for X in (*poses, seen.page.session.pose)]
            return np.stack(seen.at(origins), axis=-1)

        def uncovered():  # once the panel is where it stays
            return {seen.tab.evaluate(on_top, list(map(float, p))) for p in places()} == {"CANVAS"}

        assert seen.until(uncovered)
        points = places()
        assert np.ptp(points, axis=0).max() > 70
        seen.tab.close()


@pytest.mark.slow
def test_a_ghost_is_clicked(browser):
    """The other solutions of a UR5 are shown by a button; a click on one goes there, with the tool
    where it was.
    """
    system = kempe.load("ur5")
    with system.show([0.3, -1.2, 1.5, -0.6, -1.4, 0.2], port=0, browser=False) as viewer:
        seen = Seen(browser, viewer)
        session = seen.page.session
        q = viewer.q
        X = seen.page.session.pose.copy()
        seen.press("show", "other solutions")
        assert seen.until(lambda: len(session.solutions) == 7)
        solutions = session.solutions.copy()
        joints = system.fk(
            solutions, ["forearm", "wrist_1_link"] if "forearm" in system.body_names else None
        )

        def clicked():  # on each ghost, once they are drawn
            for points in np.asarray(joints)[..., :3, 3]:
                for a, b in zip(points[:-1], points[1:], strict=True):
                    if np.allclose(viewer.q, q) and seen.at(0.5 * (a + b))[0] < 600:
                        seen.tab.mouse.click(*seen.at(0.5 * (a + b)))
                        seen.tab.wait_for_timeout(150)
            return not np.allclose(viewer.q, q)

        assert seen.until(clicked), "no ghost was hit"
        assert np.abs(solutions - viewer.q).max(axis=1).min() < 1e-9 and np.allclose(
            session.pose, X, atol=1e-6
        )
        seen.tab.close()


@pytest.mark.slow
def test_another_assembly_mode_is_clicked_and_overlays_come_and_go(browser):
    """Of a four-bar: by a click on its ghost the loop closes the other way, with the crank where it
    was.
    """
    bar = kempe.load("four_bar")
    with bar.show(port=0, browser=False) as viewer:
        seen = Seen(browser, viewer)
        session = seen.page.session
        laid = seen.page.nodes.laid
        crank = viewer.q[0]
        for name in ("curve", "workspace"):
            seen.press(name)
            assert seen.until(lambda n=name: n in laid)
        seen.press("workspace")
        assert seen.until(lambda: "workspace" not in laid) and "curve" in laid
        seen.press("show", "assembly modes")
        assert seen.until(lambda: len(session.solutions) == 1)
        mode = session.solutions[0].copy()

        def clicked():  # once it is drawn
            if not np.array_equal(viewer.q, mode):
                seen.tab.mouse.click(*seen.at(bar.fk(mode, "coupler_point")[:3, 3]))
                seen.tab.wait_for_timeout(300)
            return np.array_equal(viewer.q, mode)

        assert seen.until(clicked) and judge_configurations(bar, viewer.q) and viewer.q[0] == crank
        seen.tab.close()


@pytest.mark.slow
def test_the_legend_says_what_is_laid_on_the_page(browser):
    """A row for each colour as long as it is shown, none over another one."""
    with kempe.load("two_link").show(port=0, browser=False) as viewer:
        seen = Seen(browser, viewer, high=800)

        def rows():
            return seen.tab.get_by_text("target of e").locator("xpath=..").locator("div").all()

        def texts():
            return seen.tab.evaluate(
                """() => {
                    const all = [...document.querySelectorAll("div")];
                    const first = all.findLast((one) => one.innerText?.startsWith("target of e"));
                    return first ? [...first.parentNode.children].map((one) => one.innerText) : [];
                }"""
            )

        assert seen.until(lambda: texts() == ["target of e: x, y, both"])
        seen.press("workspace")
        assert seen.until(lambda: texts()[1:] == ["reached in several ways", "boundary"])
        seen.press("singular configurations")
        assert seen.until(lambda: texts()[-1].startswith("singular: "))
        seen.press("show", "other solutions")
        assert seen.until(lambda: texts()[-1] == "pale: other solutions")
        boxes = [row.bounding_box() for row in rows()]
        for above, below in itertools.pairwise(boxes):
            assert above["y"] + above["height"] <= below["y"] + 0.5
        seen.press("workspace")
        assert seen.until(lambda: len(texts()) == 3)
        assert seen.page.nodes.laid["singular configurations"]
        seen.tab.close()


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "motion"),
    [
        ("four_bar", "whole motion"),
        ("panda", "frame at rest"),
        ("ball", "fall"),
        ("car", "manoeuvre"),
    ],
)
def test_motions_are_found_by_a_button_and_played(browser, name, motion):
    """All configurations that are passed are those of the motion, and hold what the system holds."""
    system = kempe.load(name)
    # it lies on the ground at first
    q = system.neutral + 0.5 * np.eye(system.nq)[2] if name == "ball" else None
    with system.show(q, port=0, browser=False) as viewer:
        seen = Seen(browser, viewer)
        if name == "car":
            seen.press("random")
            assert seen.until(lambda: not np.allclose(viewer.q, system.neutral))
        seen.press(motion)
        assert seen.until(lambda: seen.page.session.motion is not None)
        seen.press("play")
        passed = []
        assert seen.until(lambda: passed.append(viewer.q) or len(np.unique(passed, axis=0)) > 5)
        seen.press("stop")
        rows = seen.page.session.motion.q
        assert np.all(judge_configurations(system, np.array(passed)).holds)
        assert all(np.abs(rows - q).max(axis=1).min() < 1e-9 for q in passed[len(passed) // 2 :])
        seen.tab.close()


@pytest.mark.slow
def test_keys_go_to_configurations_and_play(browser):
    """By the keyboard only, but for the button that finds the motion, which keeps the focus."""
    bar = kempe.load("four_bar")
    with bar.show(port=0, browser=False) as viewer:
        seen = Seen(browser, viewer)
        assert seen.tab.title() == "four_bar"
        first = viewer.q
        seen.tab.keyboard.press("r")
        assert seen.until(lambda: not np.allclose(viewer.q, first))
        seen.tab.keyboard.press("h")
        assert seen.until(lambda: np.array_equal(viewer.q, first))
        seen.tab.keyboard.press("m")
        assert seen.until(lambda: not np.allclose(viewer.q, first))
        seen.press("whole motion")
        player = seen.page.player
        assert seen.until(lambda: player.motion is not None)
        for plays in (True, False):
            seen.tab.keyboard.press("Space")
            assert seen.until(lambda wanted=plays: player.playing == wanted)
        seen.press("play")
        assert seen.until(lambda: player.playing)
        seen.tab.keyboard.press("Space")
        assert seen.until(lambda: not player.playing)
        seen.tab.wait_for_timeout(300)
        assert not player.playing
        seen.tab.close()


@pytest.mark.slow
@pytest.mark.parametrize("name", ["ur5", "jansen", "stewart", "panda"])
def test_what_is_drawn_is_framed_and_stays_in_sight(browser, name):
    """It takes 25 to 80 % of the picture's width or height, and is in it after random jumps."""
    with kempe.load(name).show(port=0, browser=False) as viewer:
        seen = Seen(browser, viewer)

        def measure():  # corners of the box about what is drawn, in parts of the picture
            points = viewer.drawn.compute_extremes(viewer.q[None])
            at = np.stack(seen.at(points), axis=-1) / measure_picture(seen.tab)
            return at.min(axis=0), at.max(axis=0)

        assert seen.until(lambda: 0.25 < np.ptp(measure(), axis=0).max() < 0.8)
        for _ in range(3):
            q = viewer.q
            seen.tab.keyboard.press("r")
            assert seen.until(lambda old=q: not np.allclose(viewer.q, old))
            assert seen.until(lambda: measure()[0].min() > -0.01 and measure()[1].max() < 1.01)
        seen.tab.close()


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "parameter"), [("watt_six_bar", "b"), ("slider_crank", "l"), ("rssr", "coupler")]
)
def test_a_dimension_is_dragged_with_closed_loops(browser, name, parameter):
    """By the mouse: loops are closed to 1e-9 after each drag, the links are drawn in their new
    length, the curve follows, and all is undone by a button.
    """
    system = kempe.load(name)
    with system.show(port=0, browser=False) as viewer:
        seen = Seen(browser, viewer, high=800)
        page = seen.page
        seen.press("curve")
        assert seen.until(lambda: "curve" in page.nodes.laid)
        seen.press("dimensions")
        at = len(page.sliders) + list(page.dimensions).index(parameter)
        thumb = seen.tab.get_by_role("slider").nth(at)

        def at_rest():  # what the browser has sent last is answered
            shown = float(thumb.get_attribute("aria-valuenow"))
            now = viewer.system.structure.parameters[parameter]
            return (
                now == pytest.approx(shown, abs=1e-9) and page.nodes.drawn.system is viewer.system
            )

        values = []
        for by in (-15.0, 8.0):
            old = viewer.system
            curve = page.nodes.laid["curve"]
            thumb.scroll_into_view_if_needed()
            seen.tab.wait_for_timeout(500)
            box = thumb.bounding_box()
            middle = np.array([box["x"] + 0.5 * box["width"], box["y"] + 0.5 * box["height"]])
            seen.drag(middle, middle + [by, 0.0])
            assert seen.until(lambda old=old: viewer.system is not old)
            assert seen.until(lambda old=curve: page.nodes.laid["curve"] is not old)
            assert seen.until(at_rest)
            changed = viewer.system
            assert np.abs(closure_error(changed, viewer.q)).max() < 1e-9
            value = changed.structure.parameters[parameter]
            values.append(value)
            assert page.dimensions[parameter].value == pytest.approx(value, abs=1e-9)
            assert page.nodes.drawn.system is changed
            anew = Drawn(changed, viewer.q)
            here, there = (d.compute_extremes(viewer.q[None]) for d in (page.nodes.drawn, anew))
            r = anew.rigid.r
            assert np.allclose(here.min(axis=0), there.min(axis=0), atol=r)
            assert np.allclose(here.max(axis=0), there.max(axis=0), atol=r)
        assert len(values) == 2

        def steps_to(button, value):
            """By a button; a slow drag may be several steps."""
            for _ in range(20):
                before = viewer.system
                seen.press(button)
                assert seen.until(lambda old=before: viewer.system is not old)
                if viewer.system.structure.parameters[parameter] == value:
                    return True
            return False

        first = system.structure.parameters[parameter]
        assert steps_to("undo", values[0]) and steps_to("undo", first)
        assert steps_to("redo", values[0]) and steps_to("redo", values[1])
        seen.press("undo all")
        assert seen.until(lambda: viewer.system is system)
        assert judge_configurations(system, viewer.q)
        seen.tab.close()


@pytest.mark.slow
def test_a_changed_mechanism_is_saved_and_copied(browser, tmp_path):
    """By the mouse: the file that the browser saves, and the clipboard, hold the dimensions."""
    bar = kempe.load("four_bar")
    with bar.show(port=0, browser=False) as viewer:
        seen = Seen(browser, viewer, high=800)
        session = seen.page.session
        seen.tab.context.grant_permissions(["clipboard-read", "clipboard-write"])
        with session.lock:
            session.set_dimension("b", 0.45)
        seen.press("dimensions")
        with seen.tab.expect_download() as download:
            seen.press("save")
        download.value.save_as(tmp_path / "bar.toml")
        assert kempe.load(tmp_path / "bar.toml").structure.parameters["b"] == 0.45
        seen.press("copy as TOML")
        text = (tmp_path / "bar.toml").read_text()
        copied = "() => navigator.clipboard.readText()"
        assert seen.until(lambda: seen.tab.evaluate(copied) == text)
        seen.tab.close()


@pytest.mark.slow
def test_pages_share_a_configuration_on_request(browser):
    """And with neither page left, another one still opens."""
    with kempe.load("two_link").show(port=0, browser=False, share=True) as viewer:
        first = Seen(browser, viewer)
        q = viewer.q
        first.tab.get_by_text("random", exact=True).click()
        assert first.until(lambda: not np.allclose(viewer.q, q))
        q = viewer.q
        first.tab.close()
        assert first.gone()
        second = Seen(browser, viewer)
        assert np.allclose(second.page.session.q, q)
        second.tab.close()


@pytest.mark.slow
def test_a_saved_page_opens_from_disk_and_moves(browser, tmp_path):
    """Of a four-bar: one file, no request but for itself, and two pictures at different times
    differ.
    """
    bar = kempe.load("four_bar")
    file = tmp_path / "robot.html"
    bar.save_html(file, path=bar.trace("A"), labels=True, seconds=2.0)
    tab = browser.new_page(viewport={"width": 600, "height": 500})
    requests = []
    tab.on("request", lambda r: requests.append(r.url))
    tab.goto(Path(file).as_uri())
    note = tab.get_by_text("Sliders need the live page")
    bar = tab.locator(".mantine-Slider-root").first
    note.wait_for()
    bar.wait_for()
    assert "lengths in m; red: the curve of coupler_point" in note.inner_text()
    own = note.bounding_box()
    below = bar.bounding_box()
    assert own["y"] + own["height"] < below["y"], "above the player"
    pictures = set()
    for _ in range(200):  # as it is drawn, then as it moves
        pictures.add(tab.screenshot())
        if len(pictures) > 6:
            break
        tab.wait_for_timeout(200)
    assert len(pictures) > 6
    assert {u for u in requests if not u.startswith(("data:", "blob:"))} == {Path(file).as_uri()}
    tab.close()


if __name__ == "__main__":
    from chromium import CHROMIUM, SOFTWARE
    from playwright.sync_api import sync_playwright

    with sync_playwright() as play:
        chromium = play.chromium.launch(executable_path=CHROMIUM, args=SOFTWARE)
        pictures = {}
        for each in SHOWN:
            with systems(each).show(
                frame="car" if each == "car" else None, port=0, browser=False
            ) as shown:
                seen = Seen(chromium, shown, lit=True)
                pictures[each] = [
                    row.tobytes().hex() for row in np.round(255 * seen.picture()).astype(np.uint8)
                ]
                seen.tab.close()
        PICTURES.write_text(json.dumps(pictures, indent=1) + "\n")

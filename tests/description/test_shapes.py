"""Shapes of bodies: their kinds, what is refused, and that every way through the library keeps them.

The oracles are Pinocchio's and MuJoCo's own readers of URDF.
"""

from __future__ import annotations

import pickle
from pathlib import Path

import numpy as np
import pytest
from robots import good_urdf_files

import kempe
from kempe.description.mechanism import Mechanism
from kempe.description.parts import Body, Shape
from kempe.description.shapes import SHAPES, Box, Capsule, Geometry, Mesh, Sphere
from kempe.description.toml_reader import read_toml
from kempe.description.toml_writer import write_toml
from kempe.description.urdf_reader import read_urdf
from kempe.description.urdf_writer import write_urdf
from kempe.errors import DescriptionError, KempeError
from kempe.poses import place

SIZES = {
    "sphere": {"radius": 0.1},
    "box": {"size": (0.1, 0.2, 0.3)},
    "cylinder": {"radius": 0.1, "length": 0.5},
    "capsule": {"radius": 0.1, "length": 0.5},
    "ellipsoid": {"radii": (0.1, 0.2, 0.3)},
    "mesh": {"path": "meshes/a.stl", "scale": 0.001},
}
"""Sizes of one shape of each kind."""

PLACED = {"at": (1, 2, 3), "rpy": (0.1, 0.2, 0.3)}


def arm(*kinds: str) -> Mechanism:
    """A body 'b' on a hinge, with a shape of each of these kinds."""
    m = Mechanism("arm")
    m.revolute("q", m.ground, m.body("b"))
    for kind in kinds:
        m.shape("b", kind, **SIZES[kind], **PLACED, color=(1, 0, 0.5, 0.5), name=f"a {kind}")
    return m


def link(*inside: str, robot: str = "") -> str:
    """A URDF of one link."""
    return f'<robot name="r">{robot}<link name="a">{"".join(inside)}</link></robot>'


def visual(geometry: str, more: str = "") -> str:
    return f"<visual>{more}<geometry>{geometry}</geometry></visual>"


# ---- the builder


def test_each_kind_has_a_case():
    assert SIZES.keys() == SHAPES.keys()


@pytest.mark.parametrize("kind", SHAPES)
def test_a_shape_has_what_was_said(kind: str):
    m = arm(kind)
    (shape,) = m.bodies["b"].shapes
    assert isinstance(shape.geometry, SHAPES[kind]) and shape.kind == kind
    given = {name: np.asarray(x) for name, x in SIZES[kind].items()}
    for name, x in shape.geometry.sizes.items():
        assert np.all(np.asarray(x) == given[name])
    assert shape.X_BS == place(**PLACED) and shape.color == (1.0, 0.0, 0.5, 0.5)
    assert shape.visual and shape.collision and shape.name == f"a {kind}"
    again = m.shape("b", shape.geometry)
    assert again.geometry == shape.geometry and len(m.bodies["b"].shapes) == 2


def test_places_may_be_said_by_a_frame_by_angles_and_by_the_axis():
    m = arm()
    m.parameter("l", 0.4)
    m.frame("tip", "b", at=("l", 0, 0), rpy=(0.1, 0.2, 0.3))
    X = m.frames["tip"].X_BF.evaluate_pose(m.parameters)
    for shape in (
        m.shape("tip", "sphere", radius=1),
        m.shape("b", "sphere", radius=1, at="tip"),
        m.shape("b", "sphere", radius=1, at=("l", 0, 0), roll=0.1, pitch=0.2, yaw=0.3),
    ):
        np.testing.assert_allclose(shape.X_BS.evaluate_pose(m.parameters), X, rtol=0, atol=1e-15)
    along_x = m.shape("b", "cylinder", radius=1, length=2, axis="x").X_BS.evaluate_pose({})
    np.testing.assert_allclose(along_x[:3, 2], [1, 0, 0], rtol=0, atol=1e-15)
    further = m.shape("tip", "sphere", radius=1, at=(1, 0, 0)).X_BS.evaluate_pose(m.parameters)
    np.testing.assert_allclose(further[:3, 3], X[:3] @ [1, 0, 0, 1], rtol=0, atol=1e-15)


def test_sizes_may_be_expressions_in_parameters():
    m = arm()
    m.parameter("l", 0.4)
    shape = m.shape("b", "capsule", radius=0.04, length="l - 0.1", at=(0, 0, "l/2"))
    assert shape.geometry.evaluate_sizes(m.parameters) == Capsule(0.04, 0.4 - 0.1)
    assert read_toml(write_toml(m)) == m
    longer = m.build().with_parameters(l=1.1).mechanism
    (kept,) = longer.bodies["b"].shapes
    assert kept.geometry.evaluate_sizes(longer.parameters) == Capsule(0.04, 1.0)
    (written,) = (s for s in read_urdf(write_urdf(longer)).bodies["b"].shapes if s.visual)
    assert written.geometry == Capsule(0.04, 1.0)
    longer.parameters["l"] = 0.1
    with pytest.raises(DescriptionError, match="the length of a capsule is 0; it must be above"):
        write_urdf(longer)


@pytest.mark.parametrize(
    ("kind", "options", "said"),
    [
        ("capsul", {"radius": 1}, "no kind of shape 'capsul'; did you mean 'capsule'"),
        (3, {"radius": 1}, "no kind of shape 3; there are: 'sphere'"),
        (
            "capsule",
            {"radius": 1},
            "length of a capsule is missing; it must have radius and length",
        ),
        ("sphere", {"radius": 1, "length": 2}, "a sphere has no length; it must have radius"),
        (Sphere(1), {"radius": 1}, "radius is given beside a shape that has its sizes"),
        ("sphere", {"radius": 0}, "the radius of a sphere is 0; it must be above zero"),
        ("sphere", {"radius": float("nan")}, "the radius of a sphere is nan; it must be finite"),
        ("sphere", {"radius": "r"}, "no parameter 'r'"),
        ("box", {"size": (1, 2)}, "the size of a box has 2 numbers; it must have 3"),
        ("box", {"size": (1, 2, -3)}, "its three lengths must be above zero"),
        ("ellipsoid", {"radius": 1}, "an ellipsoid has no radius; it must have radii"),
        ("mesh", {"scale": 1}, "path of a mesh is missing; it must have path and may have scale"),
        ("mesh", {"path": ""}, "the path of a mesh is ''; it must be text, not empty"),
        ("mesh", {"path": "a.stl", "scale": (1, 0, 1)}, "its three factors must not be zero"),
        ("sphere", {"radius": 1, "color": "red"}, "color is 'red'; it must have 3 or 4 numbers"),
        ("sphere", {"radius": 1, "color": (0, 2, 0)}, "red, green, blue and opacity from 0 to 1"),
        ("sphere", {"radius": 1, "visual": False, "collision": False}, "neither visual nor"),
        ("sphere", {"radius": 1, "visual": 2}, "it must be True or False"),
        ("sphere", {"radius": 1, "rpy": (0, 0, 0), "yaw": 1}, "orientation given twice"),
        ("sphere", {"radius": 1, "at": "nowhere"}, "has no frame 'nowhere'"),
    ],
)
def test_wrong_shapes_are_refused_and_change_nothing(kind, options, said):
    m = arm("box")
    before = m.copy()
    with pytest.raises(KempeError, match=said):
        m.shape("b", kind, **options)
    assert m == before
    with pytest.raises(DescriptionError, match="no body 'c'"):
        m.shape("c", "sphere", radius=1)


def test_particles_have_no_shape():
    m = Mechanism("m")
    m.translation("p", m.ground, m.particle("p"))
    with pytest.raises(DescriptionError, match="'p' is a particle, which has no extent"):
        m.shape("p", "sphere", radius=1)


def test_sentences_name_the_shapes():
    m = arm("capsule", "mesh")
    m.shape("b", "box", size=(1, 2, 3), visual=False)
    assert m.bodies["b"].sentence == (
        "b: a rigid body; its shapes: capsule of radius 0.1 m and length 0.5 m, mesh meshes/a.stl "
        "scaled by 0.001 x 0.001 x 0.001, box of size 1 x 2 x 3 m (collision)"
    )
    assert m.bodies["b"].shapes[0].sentence.startswith("a capsule: capsule of radius 0.1 m")
    assert "placed by" in m.bodies["b"].shapes[0]._repr_html_()
    for _ in range(9):
        m.shape("b", "sphere", radius=1)
    assert m.bodies["b"].sentence.endswith("sphere of radius 1 m, ...")


# ---- every way through the library


def test_shapes_are_kept(tmp_path: Path):
    m = arm(*SHAPES)
    m.shape(m.ground, "box", size=(1, 1, 0.1), visual=False)
    m.revolute("r", "b", m.body("c"))
    shapes = m.bodies["b"].shapes
    assert pickle.loads(pickle.dumps(m)) == m and m.copy() == m
    assert read_toml(write_toml(m)) == m == kempe.read(m.save(tmp_path / "m.toml"))
    host = Mechanism("host").attach(m, prefix="x_")
    assert host.bodies["x_b"].shapes == shapes
    assert host.bodies["x_ground"].shapes == m.ground.shapes
    assert m.subchain("b", "c").bodies["b"].shapes == shapes
    looped = m.copy()
    looped.revolute("s", looped.ground, "c")
    assert looped.build().open_loops().mechanism.bodies["b"].shapes == shapes
    m.shape("b", "sphere", radius=2)
    assert len(host.bodies["x_b"].shapes) == len(shapes)


def test_a_text_without_shapes_has_the_older_format():
    assert "format = 1" in write_toml(arm()) and "format = 2" in write_toml(arm("box"))


def test_visuals_as_text_in_toml_are_read():
    """What TOML files had before [[shape]]."""
    text = (
        'format = 1\n[[body]]\nname = "a"\nvisuals = [\n\'\'\'\n<visual name="v"><origin '
        'xyz="1 0 0"/><geometry><box size="1 2 3"/></geometry><material name="m"><color '
        "rgba=\"1 0 0 1\"/></material></visual>''',\n"
        '"<visual/>"]\n[[joint]]\nname = "j"\ntype = "revolute"\nparent = "ground"\nchild = "a"\n'
    )
    m = read_toml(text)
    assert m.bodies["a"].shapes == (
        Shape(Box((1.0, 2.0, 3.0)), place((1.0, 0, 0)), True, False, (1.0, 0.0, 0.0, 1.0), "v"),
    )
    assert any("has no <geometry> with a shape" in note for note in m.notes)
    assert "visuals" not in write_toml(m) and read_toml(write_toml(m)).bodies == m.bodies
    for wrong, said in (("<visual>", "truncated"), ("<box/>", "it must be a <visual> element")):
        with pytest.raises(DescriptionError, match=said):
            read_toml(f'format = 1\n[[body]]\nname = "a"\nvisuals = ["{wrong}"]\n')


def test_urdf_keeps_all_but_the_name_of_a_material():
    m = arm("sphere", "box", "cylinder", "capsule", "mesh")
    m.shape("b", "box", size=(1, 2, 3), visual=False)
    m.shape("b", "box", size=(1, 2, 3), collision=False)
    again = read_urdf(write_urdf(m)).bodies["b"].shapes
    for use in ("visual", "collision"):
        ours = [s for s in m.bodies["b"].shapes if getattr(s, use)]
        theirs = [s for s in again if getattr(s, use)]
        assert [(s.geometry, s.X_BS, s.name) for s in theirs] == [
            (s.geometry, s.X_BS, s.name) for s in ours
        ]
        assert [s.color for s in theirs] == [s.color if use == "visual" else None for s in ours]


# ---- URDF


def test_materials_are_those_of_their_names():
    """The first definition counts, wherever it is; one without a name is of its visual alone."""
    red, blue = "1 0 0 1", "0 0 1 1"

    def of(name: str, rgba: str = "") -> str:
        color = f'<color rgba="{rgba}"/>' if rgba else ""
        return visual('<sphere radius="1"/>', f'<material name="{name}">{color}</material>')

    m = read_urdf(
        link(
            of("red"),
            of("later"),
            of("later", blue),
            of("", blue),
            of(""),
            of("lost"),
            of("red", blue),
            robot=f'<material name="red"><color rgba="{red}"/></material>',
        )
    )
    r, b = (1.0, 0.0, 0.0, 1.0), (0.0, 0.0, 1.0, 1.0)
    assert [s.color for s in m.ground.shapes] == [r, b, b, b, None, None, r]
    assert sum("material 'lost' is not defined" in n for n in m.notes) == 1
    assert sum("material 'red' has another colour" in n for n in m.notes) == 1


@pytest.mark.parametrize(
    ("inside", "note"),
    [
        ("<visual/>", "visual of link 'a': it has no <geometry> with a shape, and is left out"),
        (visual('<plane normal="0 0 1"/>'), "the shape <plane> is not read; URDF has box, sphere"),
        (visual('<sphere radius="0"/>'), "its sphere has no extent (0.0), and is left out"),
        (visual('<box size="1 0 1"/>'), "its box has no extent"),
    ],
)
def test_what_has_no_shape_is_noted(inside: str, note: str):
    m = read_urdf(link(inside))
    assert m.ground == Body("a") and any(note in n for n in m.notes)


def test_colours_that_are_none_and_textures_are_noted():
    material = '<material name=""><color rgba="{}"/><texture filename="a.png"/></material>'
    ball = '<sphere radius="1"/>'
    m = read_urdf(link(*(visual(ball, material.format(c)) for c in ("255 0 0 1", "1 0 0", ""))))
    assert [s.color for s in m.ground.shapes] == [None] * 3
    assert sum("which is not 4 numbers from 0 to 1; it is not used" in n for n in m.notes) == 3
    assert sum("3 textures not read" in n for n in m.notes) == 1


@pytest.mark.parametrize("tag", ["drake:ellipsoid", "drake:capsule"])
def test_shapes_of_drake_are_read(tag: str):
    sizes = 'a="1" b="2" c="3"' if tag == "drake:ellipsoid" else 'radius="1" length="2"'
    text = link(visual(f"<{tag} {sizes}/>")).replace("<robot", '<robot xmlns:drake="http://x.y"')
    (shape,) = read_urdf(text).ground.shapes
    assert str(shape.geometry) == (
        "ellipsoid of radii 1 x 2 x 3 m"
        if tag == "drake:ellipsoid"
        else "capsule of radius 1 m and length 2 m"
    )


# ---- other readers of URDF

Row = tuple[str, str, tuple[float | str, ...], np.ndarray, tuple[float, ...] | None]
"""A shape for comparison: link, kind, sizes, pose in the world, colour of a visual."""


def ours(system: kempe.System, use: str) -> list[Row]:
    out: list[Row] = []
    for body in system.mechanism.bodies.values():
        X = system.fk(system.neutral, body.name)
        for s in body.shapes:
            if getattr(s, use):
                g = s.geometry
                sizes = (Path(g.path).name, *g.scale) if isinstance(g, Mesh) else _sizes(g)
                color = s.color if use == "visual" else None
                out.append((body.name, s.kind, sizes, X @ s.X_BS.evaluate_pose({}), color))
    return sorted(out, key=_key)


def _sizes(geometry: Geometry) -> tuple[float, ...]:
    return tuple(np.concatenate([np.atleast_1d(x) for x in geometry.sizes.values()]).tolist())


def _key(row: Row) -> tuple[object, ...]:
    return row[0], row[1], [str(x) for x in row[2][:1]], np.round(row[3], 9).tolist()


def of_pinocchio(text: str, use: str, folders: list[str]) -> list[Row]:
    pin = pytest.importorskip("pinocchio")
    kind = {"visual": pin.GeometryType.VISUAL, "collision": pin.GeometryType.COLLISION}[use]
    model = pin.buildModelFromXML(text)
    geometries = pin.buildGeomFromUrdfString(model, text, kind, package_dirs=folders)
    data = geometries.createData()
    pin.updateGeometryPlacements(model, model.createData(), geometries, data, pin.neutral(model))
    sizes = {
        "Sphere": ("sphere", lambda g: (g.radius,)),
        "Box": ("box", lambda g: tuple(2.0 * g.halfSide)),
        "Cylinder": ("cylinder", lambda g: (g.radius, 2.0 * g.halfLength)),
        "Capsule": ("capsule", lambda g: (g.radius, 2.0 * g.halfLength)),
    }
    out: list[Row] = []
    for one, X in zip(geometries.geometryObjects, data.oMg, strict=True):
        name, read = sizes.get(type(one.geometry).__name__, ("mesh", None))
        mesh = (Path(one.meshPath).name, *one.meshScale)
        color = tuple(one.meshColor) if one.overrideMaterial else None
        size = read(one.geometry) if read else mesh
        out.append((model.frames[one.parentFrame].name, name, size, X.homogeneous, color))
    return sorted(out, key=_key)


def compare(mine: list[Row], theirs: list[Row]) -> None:
    assert [row[:2] for row in mine] == [row[:2] for row in theirs]
    for a, b in zip(mine, theirs, strict=True):
        if a[1] == "mesh":
            assert a[2] == b[2]
        else:
            np.testing.assert_allclose(a[2], b[2], rtol=0, atol=1e-15)  # type: ignore[arg-type]
        np.testing.assert_allclose(a[3], b[3], rtol=0, atol=1e-13)
        if a[4] is not None and b[4] is not None:  # theirs has 32 bits
            np.testing.assert_allclose(a[4], b[4], rtol=0, atol=1e-6)


QUICK = ("hyq_no", "panda_coll", "quadruped.", "allegro_left", "pr2")
APART = {"simple_humanoid.urdf": "collision", "romeo_laas_small.urdf": "visual"}
"""A cylinder that Pinocchio replaces by a capsule, as <collision_checking> asks; a mesh that it
cannot read."""


@pytest.mark.parametrize(
    ("path", "use"),
    [
        pytest.param(
            p,
            use,
            id=f"{name}-{use}",
            marks=() if any(q in name for q in QUICK) else pytest.mark.slow,
        )
        for name, p in good_urdf_files().items()
        for use in ("visual", "collision")
        if APART.get(p.name) != use
    ],
)
def test_shapes_are_those_that_pinocchio_reads(path: Path, use: str):
    folder = next(str(p) for p in path.parents if p.name == "share")
    text = path.read_text(errors="replace")
    compare(ours(kempe.load(path), use), of_pinocchio(text, use, [folder]))


@pytest.mark.parametrize("use", ["visual", "collision"])
def test_pinocchio_reads_what_is_written(use: str):
    m = arm("sphere", "box", "cylinder", "capsule")
    compare(ours(m.build(), use), of_pinocchio(write_urdf(m), use, []))


def test_mujoco_reads_what_is_written():
    mujoco = pytest.importorskip("mujoco")
    m = arm("sphere", "box", "cylinder", "capsule")
    model = mujoco.MjModel.from_xml_string(write_urdf(m))
    data = mujoco.MjData(model)
    mujoco.mj_kinematics(model, data)
    types = mujoco.mjtGeom
    sizes = {
        types.mjGEOM_SPHERE: ("sphere", lambda s: s[:1]),
        types.mjGEOM_BOX: ("box", lambda s: 2.0 * s),
        types.mjGEOM_CYLINDER: ("cylinder", lambda s: (s[0], 2.0 * s[1])),
        types.mjGEOM_CAPSULE: ("capsule", lambda s: (s[0], 2.0 * s[1])),
    }
    theirs: list[Row] = []
    for k in range(model.ngeom):
        kind, read = sizes[types(int(model.geom_type[k]))]
        X = np.eye(4)
        X[:3, :3] = data.geom_xmat[k].reshape(3, 3)
        X[:3, 3] = data.geom_xpos[k]
        body = mujoco.mj_id2name(model, mujoco.mjtObj.mjOBJ_BODY, model.geom_bodyid[k])
        theirs.append((body, kind, tuple(read(model.geom_size[k])), X, None))
    compare(ours(m.build(), "collision"), sorted(theirs, key=_key))


def test_one_number_scales_a_mesh_in_all_directions():
    """A drone of RobotLocomotion/models has it, and Drake reads it so."""
    mesh = '<visual><geometry><mesh filename="a.stl" scale=".00254"/></geometry></visual>'
    m = kempe.read(f'<robot name="r"><link name="a">{mesh}</link></robot>')
    assert m.bodies["a"].shapes[0].geometry.scale == (0.00254,) * 3
    assert "one number, '.00254'" in m.notes[0]

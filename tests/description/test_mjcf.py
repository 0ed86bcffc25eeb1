"""MJCF against MuJoCo: poses of all bodies and sites, the order of q, equalities and their
freedoms.
"""

from __future__ import annotations

import importlib.util
import json
import random
import struct
import warnings
from pathlib import Path

import numpy as np
import pytest

from kempe.description import mjcf_reader, mjcf_text, mjcf_worker
from kempe.description.read import read_mechanism
from kempe.description.shapes import Mesh
from kempe.errors import DescriptionError, KempeError, MissingExtraError
from kempe.system import System

mujoco = pytest.importorskip("mujoco")
mujoco.set_mju_user_warning(lambda message: None)  # else it writes a file of them


def mjcf(*bodies: str, more: str = "", compiler: str = "") -> str:
    """An MJCF text with these bodies in its world."""
    inside = "\n".join(bodies)
    return (
        f'<mujoco model="m">\n{compiler}\n<default><geom size="0.05"/></default>\n'
        f"<worldbody>\n{inside}\n</worldbody>\n{more}\n</mujoco>\n"
    )


def body(name: str, *inside: str, pos: str = "0.1 0.2 0.3", more: str = "") -> str:
    """A body with a geom and a site."""
    return (
        f'<body name="{name}" pos="{pos}" {more}><geom/>'
        f'<site name="{name} tip" pos="0.1 0 0.2" euler="10 20 30"/>{"".join(inside)}</body>'
    )


HINGE = '<joint name="{}" axis="{}" pos="{}" ref="{}"/>'


def hinge(name: str, axis: str = "0 0 1", pos: str = "0 0 0", ref: float = 0) -> str:
    """A hinge."""
    return f'<joint name="{name}" axis="{axis}" pos="{pos}" ref="{ref}"/>'


def slide(name: str, axis: str = "1 0 0", ref: float = 0) -> str:
    """A slide."""
    return f'<joint type="slide" name="{name}" axis="{axis}" ref="{ref}"/>'


BALL = '<joint type="ball" name="ball" pos="0.1 0 0"/>'

TREES = {
    "a chain": mjcf(
        body(
            "a",
            hinge("h", "1 2 3", "0.1 0 0"),
            body("b", slide("s", "0 1 1"), body("c", more='quat="1 2 3 4"'), more='euler="9 8 7"'),
        )
    ),
    "references": mjcf(
        body("a", hinge("h", "0 1 1", "0.1 0 0", 30), body("b", slide("s", "1 1 0", 0.2)))
    ),
    "radians and axes of the body": mjcf(
        body("a", hinge("h", "0 1 0", ref=0.5), more='euler="0.1 0.2 0.3"'),
        compiler='<compiler angle="radian" eulerseq="XYZ"/>',
    ),
    "a free base": mjcf(body("a", "<freejoint name='base'/>", body("b", hinge("h")))),
    "a ball": mjcf(body("a", BALL, body("b", hinge("h")), more='quat="1 2 3 4"')),
    "three hinges of one point": mjcf(
        body("a", hinge("z", "0 0 1"), hinge("y", "0 1 0"), hinge("x", "1 0 0"))
    ),
    "a left-handed triple": mjcf(
        body("a", hinge("x", "-1 0 0"), hinge("z", "0 0 -1"), hinge("y", "0 -1 0"))
    ),
    "axes that are oblique and do not meet": mjcf(
        body(
            "a",
            hinge("p", "0 1 0", "0 0 0.08"),
            hinge("q", "1 0 0.5", "0.1 0 0.04"),
            hinge("r", "1 -1 1", "0 0.2 0"),
        )
    ),
    "opposite axes": mjcf(body("a", hinge("p", "0 1 0"), hinge("q", "0 -1 0", "0.1 0 0"))),
    "an orthogonal pair along no axis": mjcf(
        body("a", hinge("p", "1 1 0"), hinge("q", "-1 1 0"), more='euler="9 8 7"')
    ),
    "references in the middle": mjcf(
        body(
            "a",
            slide("u", "0 1 0", 0.1),
            slide("v", "1 0 0", 0.2),
            hinge("w", "0 0 1", "0.1 0 0", 40),
            hinge("x", "1 0 0", "0 0.1 0", 50),
            hinge("y", "0 1 1", "0 0.1 0", 60),
        )
    ),
    "slides and a ball": mjcf(
        body("a", slide("u", "1 1 0"), slide("v", "0 0 1"), '<joint type="ball" name="b"/>')
    ),
    "a hinge with reference before a ball": mjcf(body("a", slide("u", "1 1 1", 0.3), BALL)),
    "frames, replicas and classes": mjcf(
        '<frame pos="1 0 0" euler="0 0 45"><replicate count="3" euler="0 0 30">'
        + body("a", '<joint class="up"/>')
        + "</replicate></frame>",
        more='<default><default class="up"><joint axis="0 1 0" pos="0 0 0.1"/></default></default>',
    ),
    "no names": mjcf(
        '<body pos="1 0 0"><geom/><joint/><body><geom/><joint/><joint axis="1 0 0"/>'
        "<site/></body></body><body><geom/></body>"
    ),
    "nothing moves": mjcf(body("a", body("b"))),
    "no mass": mjcf('<body name="a"><joint name="h"/><site name="s" pos="1 0 0"/></body>'),
}


@pytest.fixture
def at_once(monkeypatch):
    """MuJoCo compiles in this process, and not in one of its own, which takes 0.2 s."""

    def compiled(merged: mjcf_text.Merged):
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # of MuJoCo, on inertia
            return json.loads(json.dumps(mjcf_worker.compile_model(merged.text, merged.files)))

    monkeypatch.setattr(mjcf_reader, "compile_mjcf", compiled)


def model_of(text: str | Path) -> tuple[object, object]:
    """MuJoCo's model and data; bodies without mass get some."""
    spec = (
        mujoco.MjSpec.from_file(str(text))
        if isinstance(text, Path)
        else mujoco.MjSpec.from_string(text)
    )
    spec.compiler.boundmass = spec.compiler.boundinertia = 1e-6
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # on inertia
        model = spec.compile()
    return model, mujoco.MjData(model)


def poses_are_equal(system: System, text: str | Path, count: int = 3) -> None:
    """The bodies and sites, their order and their poses at random qpos are those of MuJoCo."""
    model, data = model_of(text)
    names = [*system.mechanism.bodies, *system.mechanism.frames]
    assert len(names) == model.nbody + model.nsite
    given = [model.body(i).name for i in range(model.nbody)]
    given += [model.site(i).name for i in range(model.nsite)]
    assert all(own.startswith(name) for name, own in zip(given, names, strict=True))
    assert system.nq == model.nq and system.nv == model.nv
    rng = np.random.default_rng(0)
    for _ in range(count):
        data.qpos[:] = rng.uniform(-2, 2, model.nq)
        mujoco.mj_normalizeQuat(model, data.qpos)
        mujoco.mj_kinematics(model, data)
        p = np.vstack([data.xpos, data.site_xpos])
        R = np.vstack([data.xmat, data.site_xmat]).reshape(-1, 3, 3)
        ours = np.array([system.fk(data.qpos, name) for name in names])
        np.testing.assert_allclose(ours[:, :3, 3], p, rtol=0, atol=1e-12)
        np.testing.assert_allclose(ours[:, :3, :3], R, rtol=0, atol=1e-12)


@pytest.mark.parametrize("text", TREES.values(), ids=list(TREES))
def test_poses_and_order_of_q(text: str, at_once):
    poses_are_equal(read_mechanism(text).build(), text)


def random_joints(rng: random.Random) -> str:
    """Up to six joints of one body about axes of it, opposite and oblique ones, with references."""
    joints: list[str] = []
    for _ in range(rng.randint(1, 6)):
        axis = rng.choice(
            ["1 0 0", "0 1 0", "0 0 1", "0 -1 0", "1 1 0", "-1 1 0", "1 2 3", "0 0 -1"]
        )
        pos = rng.choice(["0 0 0", "0 0 0", "0.1 0 0", "0.1 0.2 0.3"])
        ref = rng.choice([0, 0, 0.4])
        made = slide("", axis, ref) if rng.random() < 0.4 else hinge("", axis, pos, ref)
        joints.append(made.replace(' name=""', ""))
    if rng.random() < 0.2:
        joints = [*(j for j in joints[:3] if "slide" in j), BALL.replace(' name="ball"', "")]
    return "".join(joints)


@pytest.mark.parametrize("seed", range(3))
def test_products_of_random_joints(seed: int, at_once):
    rng = random.Random(seed)
    bodies = [body(f"b{k}", random_joints(rng), more='euler="9 8 7"') for k in range(40)]
    text = mjcf(*bodies, compiler='<compiler angle="radian"/>')
    m = read_mechanism(text)
    assert len(m.joints) == 40
    poses_are_equal(m.build(), text)


def test_shipped_file_and_all_that_it_holds_come_back_from_toml(tmp_path: Path):
    path = Path(mujoco.__file__).parent / "testdata" / "model.xml"
    mechanism = read_mechanism(path)
    poses_are_equal(mechanism.build(), path)
    assert read_mechanism(mechanism.save(tmp_path / "m.toml")) == mechanism


def test_joints_of_one_body_are_one_joint_in_their_order(at_once):
    m = read_mechanism(TREES["axes that are oblique and do not meet"])
    assert list(m.joints) == ["a"]
    system = m.build()
    assert len(system.coordinate_names) == 3 and system.mobility().dof == 3
    assert "p is a." in m.notes[0] and "q is a." in m.notes[0] and "r is a." in m.notes[0]


def test_natural_axes_have_natural_names(at_once):
    m = read_mechanism(TREES["three hinges of one point"])
    assert m.joints["a"].type.type_name == "R(z) R(y) R(x)" and not m.locks
    assert m.build().coordinate_names == ("a.rz", "a.ry", "a.rx")
    assert not read_mechanism(TREES["a left-handed triple"]).locks
    slides = mjcf(body("a", slide("u"), slide("v", "0 1 0", 0.3), hinge("w", "0 0 1", ref=20)))
    assert not read_mechanism(slides).locks


def test_ranges(at_once):
    text = mjcf(
        body("a", '<joint name="h" range="-30 40"/>', body("b", '<joint name="n"/>')),
        body("c", '<joint name="x" range="-10 20"/>', hinge("y", "0 1 0")),
        body("d", '<joint type="ball" name="ball" range="0 50"/>'),
    )
    m = read_mechanism(text)
    np.testing.assert_allclose(m.joints["h"].limits[""], np.radians((-30, 40)))
    assert not m.joints["n"].limits
    assert list(m.joints["c"].limits) == ["rz"]
    np.testing.assert_allclose(m.joints["c"].limits["rz"], np.radians((-10, 20)))
    (note,) = [n for n in m.notes if "'ball'" in n]
    assert note.startswith("<text>:7: joint 'ball': its range of 0.872665 rad")


def test_masses_are_those_of_mujoco(at_once):
    text = mjcf(
        '<body name="a"><joint/><geom type="box" size="0.1 0.2 0.3" pos="1 0 0"/>'
        '<geom type="capsule" size="0.1" fromto="0 0 0 1 1 1"/></body>',
        '<body name="b"><joint/><inertial mass="3" pos="1 2 3" diaginertia="1 1 1"/></body>',
        '<body name="c"><joint/></body>',
        '<body name="d"><joint/><geom type="mesh" mesh="box"/></body>',
        '<body name="e"><joint/><inertial mass="2" pos="0 0 1" diaginertia="1 1 1"/>'
        '<geom type="mesh" mesh="box"/></body>',
        more='<asset><mesh name="box" file="box.stl"/></asset>',
    )
    m = read_mechanism(text)
    model, _ = model_of(
        text.replace('<geom type="mesh" mesh="box"/>', "")
        .replace("<mesh", "<!--")
        .replace("</asset>", "--></asset>")
    )
    for name in ("a", "b", "e"):
        row = model.body(name)
        assert m.bodies[name].mass == pytest.approx(row.mass[0], rel=1e-15)
        np.testing.assert_allclose(m.bodies[name].center, row.ipos, rtol=0, atol=1e-15)
    assert m.bodies["c"].mass is m.bodies["d"].mass is m.bodies["d"].center is None
    assert "bodies 'd': their masses follow from meshes, which are not read" in m.notes[0]


# ---- equalities

ARM = body("a", hinge("p", "0 1 0"), body("b", hinge("q", "0 1 0"), body("c", hinge("r", "0 1 0"))))
FLOAT = '<body name="f" pos="0.5 0 0.7"><freejoint name="base"/><geom/><site name="on f"/></body>'

EQUALITIES = {
    "connect": (FLOAT + ARM, '<connect body1="c" body2="f" anchor="0.1 0.2 0.1"/>', "1 loop"),
    "connect to the world": (ARM, '<connect body1="c" anchor="0.1 0 0.1"/>', "1 loop"),
    "connect of sites": (FLOAT + ARM, '<connect site1="c tip" site2="on f"/>', "1 loop"),
    "weld": (FLOAT + ARM, '<weld body1="f" body2="c"/>', "1 loop"),
    "weld with a pose": (
        FLOAT + ARM,
        '<weld body1="f" body2="c" relpose="0.1 0 0 1 2 3 4" anchor="0.1 0.2 0"/>',
        "1 loop",
    ),
    "weld of points only": (
        FLOAT + ARM,
        '<weld body1="c" body2="f" anchor="0.1 0.2 0" torquescale="0"/>',
        "1 loop",
    ),
    "weld of sites": (FLOAT + ARM, '<weld site1="c tip" site2="on f"/>', "1 loop"),
    "two": (
        FLOAT + ARM,
        '<weld body1="f"/><connect body1="c" anchor="0.1 0 0.1"/>',
        "2 loops",
    ),
    "linear": (ARM, '<joint joint1="p" joint2="q" polycoef="0.1 2 0 0 0"/>', "serial chain"),
    "circle of linear ones": (
        ARM,
        '<joint joint1="p" joint2="q"/><joint joint1="q" joint2="r"/><joint joint1="r" joint2="p"/>',
        "serial chain",
    ),
    "two of one joint": (
        ARM,
        '<joint joint1="p" joint2="q"/><joint joint1="p" joint2="r" polycoef="0 2 0 0 0"/>',
        "serial chain",
    ),
    "held": (ARM, '<joint joint1="p" polycoef="0.2 0 0 0 0"/>', "serial chain"),
    "polynomial": (
        ARM,
        '<joint joint1="p" joint2="q" polycoef="0.1 1 0.2 -0.3 0.1"/>',
        "serial chain",
    ),
    "tendon": (ARM, '<tendon tendon1="t" polycoef="0.3 0 0 0 0"/>', "serial chain"),
    "two tendons": (
        ARM,
        '<tendon tendon1="t" tendon2="u" polycoef="0.1 1 0.2 0 0"/>',
        "serial chain",
    ),
}
TENDONS = (
    '<tendon><fixed name="t"><joint joint="p" coef="1"/><joint joint="q" coef="-2"/></fixed>'
    '<fixed name="u"><joint joint="r" coef="0.5"/></fixed></tendon>'
)


def values_of(system: System, q: np.ndarray) -> dict[str, float]:
    """All coordinates by name, those that follow others or are held, too."""
    m = system.mechanism
    out = {**dict(zip(system.coordinate_names, q.tolist(), strict=True)), **m.locks}
    for _ in m.couplings:
        for name, c in m.couplings.items():
            if all(s in out for s in c.sources):
                out[name] = sum(float(k) * out[s] for s, k in c.sources.items()) + float(c.offset)
    return out


def qpos_of(system: System, model, q: np.ndarray) -> np.ndarray:
    """MuJoCo's qpos, by the names of joints of which each body has one."""
    values = values_of(system, q)
    qpos = np.zeros(model.nq)
    for j in range(model.njnt):
        own = model.joint(j)
        names = system.mechanism.joints[own.name].type.list_coordinate_names()
        first = own.qposadr[0]
        for k, part in enumerate(names):
            qpos[first + k] = values[f"{own.name}.{part}" if part else own.name]
    return qpos


@pytest.mark.parametrize("reference", [0, 20])
@pytest.mark.parametrize(("bodies", "given", "kind"), EQUALITIES.values(), ids=list(EQUALITIES))
def test_equalities_are_closed_for_mujoco(
    bodies: str, given: str, kind: str, reference: int, at_once
):
    text = mjcf(
        bodies.replace('ref="0"', f'ref="{reference}"'),
        more=f"{TENDONS}<equality>{given}</equality><option jacobian='dense'/>",
    )
    system = read_mechanism(text).build()
    assert system.kind == kind
    model, data = model_of(text)
    answer = system.assemble(start=system.random(0))
    data.qpos[:] = qpos_of(system, model, answer.q)
    mujoco.mj_forward(model, data)
    rows = data.efc_type == mujoco.mjtConstraint.mjCNSTR_EQUALITY
    assert rows.any() and np.abs(data.efc_pos[rows]).max() <= 1e-9
    rank = np.linalg.matrix_rank(data.efc_J.reshape(-1, model.nv)[rows], tol=1e-7)
    assert system.mobility(answer.q).dof == model.nv - rank


def test_equalities_are_saved_as_text(tmp_path: Path, at_once):
    for name in ("polynomial", "two tendons", "weld of points only", "circle of linear ones"):
        bodies, given, _ = EQUALITIES[name]
        m = read_mechanism(mjcf(bodies, more=f"{TENDONS}<equality>{given}</equality>"))
        assert read_mechanism(m.save(tmp_path / "m.toml")) == m


def test_range_of_a_fixed_tendon_is_an_inequality(at_once):
    tendons = TENDONS.replace('name="t"', 'name="t" range="-0.1 0.2"')
    system = read_mechanism(mjcf(ARM, more=tendons)).build()
    held = system.mechanism.constraints["t"]
    assert held.kind == "inequality" and held.count_bounds(3) == 2
    answer = system.assemble(start=[1.0, 0.0, 0.0])
    p, q, _ = answer.q
    assert -0.1 - 1e-9 <= p - 2 * q <= 0.2 + 1e-9


def test_names_of_any_kind_stand_in_equations(at_once):
    text = mjcf(
        body("a", hinge("left/finger joint.1"), body("b", hinge("sin"))),
        more="<equality><joint joint1='sin' joint2='left/finger joint.1' polycoef='0 1 1 0 0'/>"
        "</equality>",
    )
    system = read_mechanism(text).build()
    values = system.assemble(start=system.random(0)).q
    by = dict(zip(system.coordinate_names, values, strict=True))
    x = by["left/finger joint.1"]
    assert by["sin"] == pytest.approx(x + x * x, abs=1e-9)


# ---- shapes


def test_geoms_are_shapes(at_once):
    text = mjcf(
        '<geom type="plane" size="1 1 1"/><geom name="s" size="0.1" material="red"/>'
        '<geom name="b" type="box" size="0.1 0.2 0.3" pos="1 2 3" euler="10 20 30" group="3"/>'
        '<geom name="c" type="capsule" size="0.1" fromto="0 0 0 0 1 1" rgba="0 1 0 0.5"/>'
        '<geom name="y" type="cylinder" size="0.1 0.2" contype="0" conaffinity="0"/>'
        '<geom name="e" type="ellipsoid" size="0.1 0.2 0.3"/>'
        '<geom name="m" type="mesh" mesh="box" pos="0 0 1" euler="0 0 90"/>'
        '<geom name="hidden" size="0.1" group="4" contype="0" conaffinity="0"/>'
        '<geom name="inline" type="mesh" mesh="inline"/><geom name="fit" type="box" mesh="box"/>',
        more='<asset><material name="red" rgba="1 0 0 1"/><mesh file="box.stl" scale="1 2 -3"/>'
        '<mesh name="inline" vertex="0 0 0 1 0 0 0 1 0 0 0 1"/></asset>',
        compiler='<compiler meshdir="meshes"/>',
    )
    m = read_mechanism(text)
    shapes = {shape.name: shape for shape in m.ground.shapes}
    assert {name: str(shape.geometry) for name, shape in shapes.items()} == {
        "s": "sphere of radius 0.1 m",
        "b": "box of size 0.2 x 0.4 x 0.6 m",
        "c": "capsule of radius 0.1 m and length 1.41421 m",
        "y": "cylinder of radius 0.1 m and length 0.4 m",
        "e": "ellipsoid of radii 0.1 x 0.2 x 0.3 m",
        "m": str(Mesh("meshes/box.stl", (1.0, 2.0, -3.0))),
    }
    uses = {name: (shape.visual, shape.collision) for name, shape in shapes.items()}
    assert uses == {n: (n != "b", n != "y") for n in shapes}
    assert shapes["s"].color == (1, 0, 0, 1) and shapes["c"].color == (0, 1, 0, 0.5)
    assert shapes["b"].color is None
    model, _ = model_of(
        text.replace('type="mesh" mesh="box"', "")
        .replace('type="box" mesh="box"', "")
        .replace("<mesh file", "<!--")
        .replace('scale="1 2 -3"/>', "-->")
        .replace("</mujoco>", "</mujoco>")
    )
    for name, shape in shapes.items():
        X = shape.X_BS.evaluate_pose({})
        np.testing.assert_allclose(X[:3, 3], model.geom(name).pos, rtol=0, atol=1e-15)
        R = np.zeros(9)
        mujoco.mju_quat2Mat(R, model.geom(name).quat)
        np.testing.assert_allclose(X[:3, :3].ravel(), R, rtol=0, atol=1e-14)
    for name, said in (
        ("a geom of body 'world'", "a plane is no shape of Kempe"),
        ("geom 'hidden'", "neither seen nor touched"),
        ("geom 'inline'", "its mesh 'inline' is no file"),
        ("geom 'fit'", "it is a box around the mesh 'box'"),
    ):
        assert any(name in note and said in note for note in m.notes), m.notes


# ---- postures and notes


def test_keyframes_are_postures(at_once):
    text = mjcf(
        FLOAT,
        ARM,
        more='<equality><joint joint1="q" joint2="p"/></equality>'
        '<keyframe><key name="home" qpos="1 2 3 0.6 0.8 0 0 0.1 0.1 0.3"/>'
        '<key qpos="0 0 0 1 0 0 0 0 0 0"/></keyframe>',
    )
    m = read_mechanism(text)
    assert list(m.postures) == ["qpos0", "home", "key1"]
    system = m.build()
    np.testing.assert_allclose(
        system.q("home") if callable(system.q) else (), [1, 2, 3, 0.6, 0.8, 0, 0, 0.1, 0.3]
    )
    np.testing.assert_allclose(system.q("qpos0")[:7], [0.5, 0, 0.7, 1, 0, 0, 0])


LEFT_OUT = {
    "mocap": (body("a", more='mocap="true"'), "", "body 'a': it is a mocap body"),
    "inactive": (
        ARM,
        '<equality><connect name="e" body1="c" anchor="0 0 0" active="false"/></equality>',
        "equality 'e': it is not active, and is left out",
    ),
    "switched off": (
        ARM,
        '<option><flag equality="disable"/></option>'
        '<equality><connect name="e" body1="c" anchor="0 0 0"/></equality>',
        "equality 'e': it is not active, and is left out",
    ),
    "tendon": (
        ARM,
        '<tendon><spatial name="rope" range="0 1"><site site="a tip"/><site site="c tip"/></spatial>'
        "</tendon>",
        "tendon 'rope': it runs in space",
    ),
    "equality of a tendon": (
        ARM,
        '<tendon><spatial name="rope"><site site="a tip"/><site site="c tip"/></spatial></tendon>'
        '<equality><tendon name="e" tendon1="rope"/></equality>',
        "equality 'e': it ties a tendon that runs in space",
    ),
    "actuators": (
        ARM,
        '<actuator><motor name="m" joint="p"/></actuator><sensor><jointpos joint="p"/></sensor>',
        "1 actuator of the simulator left out",
    ),
}


@pytest.mark.parametrize(("bodies", "more", "note"), LEFT_OUT.values(), ids=list(LEFT_OUT))
def test_what_is_left_out_is_noted_by_name(bodies: str, more: str, note: str, at_once):
    m = read_mechanism(mjcf(bodies, more=more))
    assert any(note in n for n in m.notes), m.notes
    assert not m.constraints and m.build()


# ---- files


TETRAHEDRON = (
    bytes(80)
    + struct.pack("<I", 4)
    + b"".join(
        struct.pack("<12fH", 0, 0, 0, *(float(k == x) for x in corners for k in range(3)), 0)
        for corners in ((3, 1, 0), (3, 0, 2), (3, 2, 1), (0, 1, 2))
    )
)
"""A mesh as an STL file."""


def written(folder: Path, **files: str) -> Path:
    """Files of these names (with .xml), of which the first is given back."""
    for name, text in files.items():
        path = folder / f"{name.replace('__', '/')}.xml"
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(text)
    return folder / f"{next(iter(files)).replace('__', '/')}.xml"


def test_includes_and_attached_models(tmp_path: Path):
    path = written(
        tmp_path / "robots" / "one",
        main='<?xml version="1.0"?>\n<!-- <include file="no.xml"/> -->\n<mujoco>\n'
        '<include file="parts/defaults.xml"/><asset><model name="sub" file="parts/sub.xml"/></asset>'
        '<worldbody><body name="a"><joint class="c"/><geom size="1"/>\n<include file="../common.xml"/>'
        '<attach model="sub" body="root" prefix="sub "/></body></worldbody></mujoco>',
        parts__defaults='<mujocoinclude><default><default class="c"><joint axis="0 1 0"/></default>'
        "</default></mujocoinclude>",
        parts__sub='<mujoco><compiler meshdir="m"/><asset><mesh name="x" file="../x.stl"/></asset>\n'
        '<include file="deep.xml"/></mujoco>',
        parts__deep='<mujocoinclude><worldbody><body name="root" pos="1 0 0">'
        '<joint name="j" pos="0.1 0 0"/><geom size="1"/><geom type="mesh" mesh="x"/></body>'
        "</worldbody></mujocoinclude>",
        **{"..__common": '<x><site name="tip" pos="1 2 3"/></x>'},
    )
    m = read_mechanism(path)
    (tmp_path / "robots" / "one" / "parts" / "x.stl").write_bytes(TETRAHEDRON)
    poses_are_equal(m.build(), path)
    assert m.bodies["sub root"].shapes[1].geometry == Mesh("parts/x.stl", (1.0, 1.0, 1.0))
    assert [b for b in m.bodies] == ["world", "a", "sub root"]
    assert str(m.joints["sub j"].where) == f"{path.parent / 'parts' / 'deep.xml'}:1"
    assert str(m.bodies["a"].where) == f"{path}:4"
    assert str(m.frames["tip"].where) == f"{tmp_path / 'robots' / 'common.xml'}:1"


def refused(path: Path | str) -> str:
    with pytest.raises(DescriptionError) as caught:
        read_mechanism(path)
    return str(caught.value)


@pytest.mark.parametrize(
    "changed", ['<compiler internal="1"/>', "<internal/>", '<option integrator="internal"/>']
)
def test_files_for_other_versions_name_the_installed_one(changed: str):
    said = refused(f"<mujoco>{changed}<worldbody/></mujoco>")
    assert "internal" in said
    assert f"for another version than MuJoCo {mujoco.__version__}, which is installed" in said


@pytest.mark.slow
def test_problems_of_included_files_have_their_file_and_line(tmp_path: Path):
    path = written(
        tmp_path,
        main='<mujoco>\n<worldbody><include file="part.xml"/>\n<body name="a"/></worldbody>\n</mujoco>',
        part='<x>\n\n<body name="b"><joint tipe="hinge"/></body>\n</x>',
    )
    assert refused(path).startswith(f"{tmp_path / 'part.xml'}:3: <joint> has no attribute 'tipe'")
    written(tmp_path, part='<x>\n\n<body name="a"></body>\n</x>')
    assert refused(path).startswith(f"{path}:3: there is another body of the name 'a'")
    written(tmp_path, part="<x>\n\n<body></x>")
    assert refused(path).startswith(f"{tmp_path / 'part.xml'}:3: '</x>' closes <body>")
    written(tmp_path, part="<x>\n<!-- a -- b -->\n<body></x>")
    assert refused(path).startswith(f"{tmp_path / 'part.xml'}:3: '</x>' closes <body>")
    written(tmp_path, part="<x/>")
    assert "there is nothing in it" in refused(path)
    written(tmp_path, part='<x><include file="part.xml"/></x>')
    assert "the file 'part.xml' is included twice" in refused(path)
    (tmp_path / "part.xml").unlink()
    assert refused(path).startswith(f"{path}:2: <include> names 'part.xml', and there is no such")


@pytest.mark.parametrize("tag", ["include", "asset><model", "worldbody><flexcomp name='f'"])
def test_no_file_outside_the_folders_is_read(tag: str, tmp_path: Path):
    secret = written(tmp_path / "secret", secret="<mujoco><worldbody/></mujoco>")
    close = "/>" + (f"</{tag.partition('>')[0]}>" if ">" in tag else "")
    inside = tmp_path / "a" / "b" / "robots"
    for name in (str(secret), "../../../secret/secret.xml"):
        path = written(inside, main=f'<mujoco><{tag} file="{name}"{close}</mujoco>')
        assert "lies outside the folders of the model; name its folder by package_dirs" in refused(
            path
        )
    (inside / "link.xml").symlink_to(secret)
    path = written(inside, main=f'<mujoco><{tag} file="link.xml"{close}</mujoco>')
    assert "lies outside the folders of the model" in refused(path)


def test_the_compiler_opens_no_file(tmp_path: Path):
    """Files that are not found before MuJoCo starts are out of its reach."""
    (tmp_path / "there.obj").write_text("v 0 0 0\nv 1 0 0\nv 0 1 0\nv 0 0 1\nf 1 2 3\n")
    name = str(tmp_path / "there.obj")
    merged = mjcf_text.Merged("<mujoco/>", "<text>")
    merged.text = (
        f'<mujoco><worldbody><flexcomp name="f" type="mesh" file="{name}"/></worldbody></mujoco>'
    )
    assert mujoco.MjModel.from_xml_string(merged.text.replace('"f"', '"f" radius="0.1"')).nflex == 1
    with pytest.raises(DescriptionError):
        mjcf_text.compile_mjcf(merged)


def test_assets_are_never_read(tmp_path: Path):
    """Meshes, textures and height fields that do not exist, or lie anywhere, change nothing."""
    text = mjcf(
        body("a", hinge("h"), '<geom type="mesh" mesh="m"/><geom type="hfield" hfield="f"/>'),
        '<light texture="t"/><geom type="box" mesh="m" material="t"/>',
        more='<asset><mesh name="m" file="/etc/passwd" scale="2 2 2"/>'
        '<hfield name="f" file="no.png" size="1 1 1 1"/>'
        '<texture name="t" type="2d" file="/etc/shadow"/><texture type="skybox" file="no.png"/>'
        '<material name="t" texture="t"/><skin name="s" file="no.skn"/></asset>',
    )
    assert read_mechanism(text).build().coordinate_names == ("h",)


@pytest.mark.slow
def test_endings_and_contents(tmp_path: Path):
    for name in ("m.xml", "m.mjcf", "m.urdf", "m"):
        (tmp_path / name).write_text(TREES["a chain"])
    assert all(
        list(read_mechanism(tmp_path / n).joints) == ["h", "s", "c_fixed"]
        for n in ("m.xml", "m.mjcf")
    )
    assert list(read_mechanism(tmp_path / "m").joints) == ["h", "s", "c_fixed"]
    assert list(read_mechanism(TREES["a chain"].encode("utf-16"), format="mjcf").joints)


def test_without_mujoco_the_extra_is_named(monkeypatch):
    found = importlib.util.find_spec

    def none(name: str, *args):
        return None if name == "mujoco" else found(name, *args)

    monkeypatch.setattr(importlib.util, "find_spec", none)
    with pytest.raises(MissingExtraError, match=r"'mujoco' \(extra kempe\[mjcf\]\)"):
        read_mechanism(TREES["a chain"])


def test_a_compiler_without_end_is_stopped(monkeypatch):
    monkeypatch.setattr(mjcf_text, "SECONDS", 1)
    text = mjcf(f'<replicate count="100000">{body("a", hinge("h"))}</replicate>')
    assert "did not finish in 1 s" in refused(text) or "memory" in refused(text)


@pytest.mark.slow
def test_damaged_files_never_crash():
    rng = random.Random(5)
    texts = [TREES["axes that are oblique and do not meet"], TREES["frames, replicas and classes"]]
    marks = [
        "<",
        ">",
        '"',
        "/",
        "1e999",
        "nan",
        "-",
        "<body/>",
        "<joint/>",
        "&x;",
        "\0",
        "99999999",
    ]
    loaded = 0
    for k in range(6):
        text = texts[k % 2]
        at = rng.randrange(len(text))
        text = text[:at] + rng.choice(marks) + text[at + rng.choice([0, 1, 3]) :]
        try:
            read_mechanism(text, format="mjcf").build()
            loaded += 1
        except KempeError as error:
            assert str(error)
    assert loaded < 6

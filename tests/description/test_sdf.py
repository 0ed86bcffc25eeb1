"""SDF: poses as Drake has them, by recorded numbers; what Drake does not read, by closed forms; and
what is refused.
"""

from __future__ import annotations

import json
import os
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from sdf_files import ARM, CONFIG, FILES, RECORD, TURNED, joint, link, model, sdf, world, write

import kempe
from kempe import spatial
from kempe.description.formats import SDF
from kempe.description.mechanism import Mechanism
from kempe.description.read import read_mechanism
from kempe.description.sdf_reader import read_sdf
from kempe.description.sdf_scopes import DEEPEST
from kempe.description.shapes import SHAPES
from kempe.errors import DescriptionError, InputError, UnknownNameError

DRAKE: dict[str, Any] = json.loads(RECORD.read_text(encoding="utf-8"))
EXACT: dict[str, Any] = {"rtol": 0, "atol": 1e-12}


def refused(text: str, **options: Any) -> str:
    """What is said of a text that is refused."""
    with pytest.raises(DescriptionError) as caught:
        read_sdf(text, **options)
    return str(caught.value)


# ---- as Drake has it


def own_name(name: str, known: Any, case: str) -> str:
    """The name in the mechanism of what Drake names with its model: a model's own names have no
    prefix.
    """
    if name in known:
        return name
    inner = name.partition("::")[2]
    return inner if inner in known else next(n for n in known if n.endswith(name.split("::")[-1]))


def coordinates(kind: str, name: str, values: list[float]) -> dict[str, float]:
    """Coordinates of a joint with the values that Drake gives it."""
    if kind == "universal":
        return dict(zip((f"{name}.rx", f"{name}.ry"), values, strict=True))
    if kind == "planar":
        return dict(zip((f"{name}.x", f"{name}.y", f"{name}.rz"), values, strict=True))
    if kind == "ball_rpy":
        quaternion = spatial.matrix_to_quat_wxyz(spatial.rpy_to_matrix(values)).tolist()
        return dict(zip((f"{name}.q{a}" for a in "wxyz"), quaternion, strict=True))
    return {name: values[0]}


@pytest.mark.parametrize("case", FILES)
def test_poses_are_those_of_drake(case: str, tmp_path: Path):
    found = DRAKE[case]
    path = write(FILES[case], tmp_path)
    m = read_mechanism(path)
    whole = m.copy()
    for name in found["loops"]:
        del m.joints[own_name(name, m.joints, case)]
    system = m.build()
    q: dict[str, float] = {}
    for name, (kind, values) in found["joints"].items():
        q |= coordinates(kind, own_name(name, m.joints, case), values)
    assert len(found["bodies"]) == len(m.bodies) - 1
    assert len(found["frames"]) == len(m.frames)
    assert system.nq == len(q)
    for name, X in {**found["bodies"], **found["frames"]}.items():
        own = own_name(name, {**m.bodies, **m.frames}, case)
        np.testing.assert_allclose(system.fk(system.q(q), own)[:3], X, **EXACT, err_msg=own)
    for name, (X_PF, X_CM, axis) in found["loops"].items():
        j = whole.joints[own_name(name, whole.joints, case)]
        for mine, X in ((j.X_PF.evaluate_pose({}), X_PF), (j.X_CM.evaluate_pose({}), X_CM)):
            np.testing.assert_allclose(mine[:3, 3], np.array(X)[:, 3], **EXACT)
            np.testing.assert_allclose(mine[:3, 2], np.array(X)[:, :3] @ axis, **EXACT)
    assert len(whole.build().structure.closures) == len(found["loops"])


# ---- what Drake does not read, and what is said in other ways


def test_a_model_that_floats_is_held_or_free_where_the_file_places_it():
    text = model(
        "<pose>1 2 3 0 0 0.5</pose>" + link("a", "0 0 1") + link("b") + joint("j", "a", "b")
    )
    text = text.replace("<pose>0 0 1</pose>", "<pose>0 0 1 0 0 0</pose>")
    held = read_sdf(text).build()
    free = read_sdf(text, base="free").build()
    assert list(held.mechanism.bodies) == ["world", "a", "b"]
    assert [j.type.type_name for j in held.mechanism.joints.values()] == ["revolute", "fixed"]
    assert (held.nq, free.nq) == (1, 8) and free.mechanism.joints["base"].child == "a"
    np.testing.assert_allclose(held.fk([0.0], "a")[:3, 3], [1, 2, 4], **EXACT)
    np.testing.assert_allclose(free.fk(free.neutral, "a"), held.fk([0.0], "a"), **EXACT)
    (note,) = held.mechanism.notes
    assert "nothing ties 'a' to the world" in note and "base='free'" in note
    assert free.mechanism.notes == []
    with pytest.raises(InputError, match="it must be None"):
        read_sdf(text, base="fixed")


def test_what_is_static_is_held_and_its_joints_do_not_move():
    text = world(
        '<model name="door"><static>true</static>'
        + link("frame")
        + '<model name="leaf">'
        + link("wood")
        + link("knob")
        + joint("turn", "wood", "knob")
        + "</model></model>"
        + f'<model name="cup">{link("cup")}</model>'
    )
    m = read_sdf(text, base="free")
    kinds = {j.child: j.type.type_name for j in m.joints.values()}
    assert kinds == {
        "door::frame": "fixed",
        "door::leaf::wood": "fixed",
        "door::leaf::knob": "fixed",
        "cup::cup": "free",
    }
    assert any("'door::leaf': the model is static: its joints do not move" in n for n in m.notes)


def test_the_link_that_is_held_is_the_one_that_others_hang_on():
    text = model(
        link("hand")
        + link("base")
        + link("arm")
        + joint("s", "base", "arm")
        + joint("e", "arm", "hand")
    )
    assert read_sdf(text).joints["base"].child == "base"
    loop = model(
        link("x") + link("y") + joint("s", "x", "y") + joint("t", "y", "x"),
        attributes=' canonical_link="y"',
    )
    m = read_sdf(loop)
    assert m.joints["base"].child == "y" and len(m.build().structure.closures) == 1


def test_one_model_of_a_world_is_read_where_it_stands():
    text = world(
        "<include><uri>model://missing</uri><name>gone</name></include>\n"
        f'<model name="a"><pose>1 0 0 0 0 0</pose>{link("x")}<model name="in">{link("y")}</model></model>'
        f'<model name="b">{link("z")}</model>'
    )
    m = read_sdf(text, model="a")
    assert list(m.bodies) == ["world", "x", "in::y"] and m.name == "a"
    np.testing.assert_allclose(m.build().fk([], "x")[:3, 3], [1, 0, 0], **EXACT)
    with pytest.raises(UnknownNameError, match="no model 'c'.*there are: 'a', 'b', 'gone'"):
        read_sdf(text, model="c")
    assert "'model://missing': there is no such model" in refused(text)
    two = sdf(f'<model name="a">{link("x")}</model><model name="b">{link("x")}</model>')
    assert "2 models; choose one by model=: 'a', 'b'" in refused(two)
    assert list(read_sdf(two, model="b").bodies) == ["world", "x"]


@pytest.mark.parametrize("kind", ["universal", "revolute2"])
@pytest.mark.parametrize("second", ["1 0 0", "1 0.5 2"])
def test_two_axes_turn_one_after_the_other(kind: str, second: str):
    inside = (
        f"{TURNED}<axis><xyz>0 0.6 0.8</xyz><limit><lower>-1</lower><upper>2</upper></limit></axis>"
        f"<axis2><xyz>{second}</xyz><limit><velocity>3</velocity></limit></axis2>"
    )
    text = model(
        link("a")
        + link("b", "0 0 1 0.3 0 0")
        + joint("j", "a", "b", inside, kind)
        + joint("base", "world", "a", "", "fixed")
    )
    system = read_sdf(text).build()
    a, b = 0.4, -0.7
    X_CJ = spatial.pose_from_xyz_rpy([0.1, 0.2, 0.3, 0.4, -0.5, 0.6])
    X_PJ = spatial.pose_from_xyz_rpy([0, 0, 1, 0.3, 0, 0]) @ X_CJ
    axes = spatial.unit([0, 0.6, 0.8]), spatial.unit([float(x) for x in second.split()])
    turn = spatial.pose(spatial.exp_so3(a * axes[0]) @ spatial.exp_so3(b * axes[1]))
    found = system.fk([a, b], "b")
    np.testing.assert_allclose(found, X_PJ @ turn @ spatial.inverse(X_CJ), **EXACT)
    assert (system.lower[0], system.upper[0]) == (-1.0, 2.0)
    assert np.isinf(system.upper[1])


def test_a_gearbox_couples_two_joints_and_connects_nothing():
    text = model(
        link("frame")
        + link("in")
        + link("out", "0 1 0 0 0 0")
        + joint("base", "world", "frame", "", "fixed")
        + joint("first", "frame", "in", "<axis><xyz>0 1 0</xyz></axis>")
        + joint("second", "out", "frame", "<axis><xyz>0 -1 0</xyz></axis>")
        + joint(
            "gears",
            "in",
            "out",
            "<gearbox_reference_body>frame</gearbox_reference_body>"
            "<gearbox_ratio>3</gearbox_ratio>"
            "<axis><xyz>0 1 0</xyz></axis><axis2><xyz>0 1 0</xyz></axis2>",
            "gearbox",
        )
    )
    system = read_sdf(text).build()
    assert system.coordinate_names == ("first",) and not system.structure.closures
    theta = spatial.log_so3(system.fk([0.2], "out")[:3, :3])
    np.testing.assert_allclose(theta, [0, -3 * 0.2, 0], **EXACT)
    lost = text.replace("<xyz>0 -1 0</xyz>", "<xyz>1 0 0</xyz>")
    assert "no revolute joint about its axis leads from 'frame' to 'out'" in refused(lost)


def test_followers():
    mimic = (
        '<axis><xyz>0 0 1</xyz><mimic joint="j" axis="axis2"><multiplier>2</multiplier>'
        "<offset>0.5</offset><reference>0.1</reference></mimic></axis>"
    )
    two = "<axis><xyz>1 0 0</xyz></axis><axis2><xyz>0 1 0</xyz></axis2>"
    text = model(
        link("a")
        + link("b")
        + link("c")
        + joint("j", "a", "b", two, "universal")
        + joint("k", "b", "c", mimic)
        + joint("base", "world", "a", "", "fixed")
    )
    coupling = read_sdf(text).couplings["k"]
    assert coupling.sources == {"j.ry": 2.0} and coupling.offset == pytest.approx(0.3)
    older = text.replace(
        mimic,
        '<axis><xyz>0 0 1</xyz></axis><drake:mimic joint="j" multiplier="-1" offset="2"/>',
    )
    assert str(read_sdf(older).couplings["k"].sentence) == "k = -j.rx + 2"
    assert "it mimics joint 'jj', which does not exist; did you mean 'j'" in refused(
        text.replace('mimic joint="j"', 'mimic joint="jj"')
    )


def test_constraints_of_drake():
    tie = (
        "<drake:ball_constraint><drake:ball_constraint_body_A>a</drake:ball_constraint_body_A>"
        "<drake:ball_constraint_p_AP>1 0 0</drake:ball_constraint_p_AP>"
        "<drake:ball_constraint_body_B>b</drake:ball_constraint_body_B>"
        "<drake:ball_constraint_p_BQ>0 1 0</drake:ball_constraint_p_BQ></drake:ball_constraint>"
    )
    text = model(link("a") + link("b") + tie + joint("base", "world", "a", "", "fixed"))
    made = read_sdf(text).joints["ball_constraint"]
    assert (made.parent, made.child, made.type.type_name) == ("a", "b", "spherical")
    assert made.X_PF.evaluate_pose({})[:3, 3].tolist() == [1, 0, 0]
    rod = tie.replace("ball_", "distance_").replace(
        "</drake:distance_constraint>",
        "<drake:distance_constraint_distance>2</drake:distance_constraint_distance>"
        "</drake:distance_constraint>",
    )
    m = read_sdf(text.replace(tie, rod), base="free")
    assert m.constraints["distance_constraint"].length({}) == 2.0
    spring = rod.replace("_distance>2<", "_distance>2<").replace(
        "<drake:distance_constraint_distance>",
        "<drake:distance_constraint_stiffness>9</drake:distance_constraint_stiffness>"
        "<drake:distance_constraint_distance>",
    )
    m = read_sdf(text.replace(tie, spring), base="free")
    assert not m.constraints and any("spring" in n for n in m.notes)
    curve = '<drake:joint name="c" type="curvilinear"/>'
    assert "curvilinear' is not read; planar ones are" in refused(text.replace(tie, curve))


def test_masses_limits_and_cuts():
    text = model(
        '<link name="a"><inertial><mass>2.5</mass><pose>1 2 3 0.4 0 0</pose></inertial></link>'
        '<link name="b"><inertial auto="true"/></link><link name="c"><inertial/></link>'
        + link("d")
        + joint(
            "j",
            "a",
            "b",
            "<axis><xyz>0 0 1</xyz><limit><lower>-inf</lower><upper>1e16</upper>"
            "<effort>-1</effort><velocity>3</velocity></limit></axis>",
        )
        + joint(
            "k",
            "b",
            "c",
            "<axis><xyz>0 0 1</xyz><limit><lower>-1</lower><effort>0</effort>"
            "</limit></axis><physics><simbody><must_be_loop_joint>true</must_be_loop_joint></simbody>"
            "</physics>",
            "prismatic",
        )
        + joint(
            "l",
            "c",
            "d",
            "<axis><xyz>0 0 1</xyz><limit><lower>1</lower><upper>-1</upper></limit></axis>",
            "continuous",
        ).replace("<lower>1</lower><upper>-1</upper>", "<upper>1</upper>")
    )
    m = read_sdf(text)
    a, b, c = (m.bodies[n] for n in "abc")
    assert (a.mass, a.center) == (2.5, (1.0, 2.0, 3.0))
    assert (b.mass, c.mass) == (None, 1.0)
    j, k, turn = (m.joints[n] for n in "jkl")
    assert (j.limits, j.velocity_limits, j.effort_limits) == ({}, {"": 3.0}, {})
    assert (k.limits, k.effort_limits, k.cut) == ({"": (-1.0, np.inf)}, {"": 0.0}, True)
    assert turn.limits == {} and any("turns without end" in n for n in m.notes)
    swapped = model(
        link("a")
        + link("b")
        + joint(
            "j",
            "a",
            "b",
            "<axis><xyz>0 0 1</xyz><limit><lower>1</lower><upper>-1</upper></limit></axis>",
        )
    )
    assert "its limits are swapped: lower 1, upper -1" in refused(swapped)
    assert read_sdf(swapped, lenient_limits=True).joints["j"].limits == {}


def test_flat_names_of_version_1_7_are_names():
    text = model(
        '<frame name="sub::__model__" attached_to="sub::a"><pose relative_to="__model__">1 0 0 0 0 0'
        "</pose></frame>"
        + link("sub::a", "0 0 1 0 0 0", "sub::__model__")
        + link("b", "0 0 2 0 0 0", "sub::a")
        + joint("sub::j", "sub::a", "b"),
        "1.7",
    )
    system = read_sdf(text).build()
    assert system.coordinate_names == ("sub::j",)
    np.testing.assert_allclose(system.fk([0.0], "b")[:3, 3], [1, 0, 3], **EXACT)
    assert "its name 'sub::a' holds '::'" in refused(text.replace("1.7", "1.8"))


def test_before_version_1_7_a_frame_may_have_the_name_of_a_link():
    text = model(link("a") + '<frame name="a"><pose>1 0 0 0 0 0</pose></frame>', "1.6")
    m = read_sdf(text)
    assert list(m.frames) == ["a_frame"] and any("a link has its name" in n for n in m.notes)
    assert "another link of this name" in refused(text.replace("1.6", "1.7"))


@pytest.mark.slow
def test_poses_over_a_long_chain_are_exact_and_fast():
    n = 3000
    links = link("l0") + "".join(link(f"l{i}", "0 0 1 0 0 0", f"l{i - 1}") for i in range(1, n))
    joints = "".join(joint(f"j{i}", f"l{i - 1}", f"l{i}") for i in range(1, n))
    m = read_sdf(model(links + joints))
    assert all(m.joints[f"j{i}"].X_PF.steps == (("z", (1.0,)),) for i in range(1, n))


# ---- shapes


def test_shapes(tmp_path: Path):
    shapes = (
        "<box><size>1 2 3</size></box>",
        "<sphere><radius>0.5</radius></sphere>",
        "<cylinder><radius>0.5</radius><length>2</length></cylinder>",
        "<capsule><radius>0.5</radius><length>2</length></capsule>",
        "<ellipsoid><radii>1 2 3</radii></ellipsoid>",
        "<mesh><uri>meshes/a.stl</uri><scale>2 2 2</scale></mesh>",
    )
    visuals = "".join(
        f'<visual name="v{i}"><pose>0 0 {i} 0 0 0</pose><geometry>{s}</geometry></visual>'
        for i, s in enumerate(shapes)
    )
    material = "<material><diffuse>1 0 0.5 1</diffuse></material>"
    link_ = (
        f'<link name="a"><pose>5 0 0 0 0 1</pose>{visuals}<visual name="red"><geometry>{shapes[0]}'
        f"</geometry>{material}</visual>"
        f'<collision name="c"><pose relative_to="f">1 0 0 0 0 0</pose><geometry>{shapes[1]}</geometry>'
        "</collision><collision name='ground'><geometry><plane><normal>0 0 1</normal></plane></geometry>"
        "</collision><visual name='flat'><geometry><box><size>1 1 0</size></box></geometry></visual>"
        "<visual name='far'><geometry><mesh><uri>model://robot/m.dae</uri></mesh></geometry></visual>"
        "</link>"
    )
    frame = '<frame name="f" attached_to="a"><pose>0 0 1 0 0 0</pose></frame>'
    m = read_sdf(model(link_ + frame))
    found = m.bodies["a"].shapes
    assert [s.kind for s in found[:6]] == [
        "box",
        "sphere",
        "cylinder",
        "capsule",
        "ellipsoid",
        "mesh",
    ] and {s.kind for s in found} <= set(SHAPES)
    assert [s.name for s in found] == ["v0", "v1", "v2", "v3", "v4", "v5", "red", "c", "far"]
    assert found[3].X_BS.evaluate_pose({})[2, 3] == 3.0
    assert found[6].color == (1.0, 0.0, 0.5, 1.0)
    assert found[7].X_BS.evaluate_pose({})[:3, 3].tolist() == [1, 0, 1]
    assert (found[7].visual, found[7].collision) == (False, True)
    geometry: Any = found[8].geometry
    assert geometry.path == "package://robot/m.dae"
    assert any("1 shape <plane> not read" in n for n in m.notes)
    assert any("its box has no extent" in n for n in m.notes)
    wrong = model(link_.replace("<size>1 2 3</size>", "<size>1 2</size>") + frame)
    assert "visual 'v0' of link 'a': size is '1 2': 2 numbers" in refused(wrong)


def test_meshes_of_included_models_are_found(tmp_path: Path):
    mesh = "<visual name='v'><geometry><mesh><uri>meshes/a.stl</uri></mesh></geometry></visual>"
    robot = model(f'<link name="x">{mesh}</link>', name="robot")
    files = {
        "world/main.sdf": world("<include><uri>model://robot</uri></include>"),
        "robot/model.config": CONFIG,
        "robot/model.sdf": robot,
    }
    write(files, tmp_path)
    m = read_mechanism(tmp_path / "world" / "main.sdf")
    geometry: Any = m.bodies["robot::x"].shapes[0].geometry
    assert (tmp_path / "world" / geometry.path).resolve() == tmp_path / "robot/meshes/a.stl"


# ---- included files


def test_included_files_are_found_in_folders_only(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    home = tmp_path / "a" / "home"
    other = tmp_path / "b" / "models"
    write({"main.sdf": world("<include><uri>model://arm</uri></include>")}, home)
    write({"arm/model.config": CONFIG, "arm/model.sdf": ARM, "arm/old.sdf": "<sdf/>"}, other)
    with pytest.raises(DescriptionError, match="'model://arm': there is no such model; looked in"):
        read_mechanism(home / "main.sdf")
    for given in (other, other / "arm"):
        assert "arm::tip" in read_mechanism(home / "main.sdf", package_dirs=[given]).bodies
    monkeypatch.setenv("GZ_SIM_RESOURCE_PATH", f"/no/folder{os.pathsep}{other}")
    assert "arm::tip" in read_mechanism(home / "main.sdf").bodies


@pytest.mark.parametrize(
    ("uri", "said"),
    [
        ("../../b/models/arm/model.sdf", "it leads out of the folders of the model"),
        ("model://../../b/models/arm", "leads out of the folders|no such model"),
        ("link/model.sdf", "it leads out of the folders of the model"),
        ("/etc/passwd", "it is absolute"),
        ("file:///etc/passwd", "it is absolute"),
        ("https://fuel.gazebosim.org/1.0/o/models/x", "it is not on this machine"),
        ("model://", "it names no file"),
        ("model://a\x01", "not well-formed"),
        ("empty", "there is no such model"),
        ("urdf/robot.urdf", "is no SDF: its outermost element is <robot>"),
        ("two.sdf", "has 2 models"),
        ("bad.sdf", "bad.sdf:1: the file ends inside"),
    ],
)
def test_what_includes_may_not_name(uri: str, said: str, tmp_path: Path):
    home = tmp_path / "a" / "home"
    files = {
        "main.sdf": world(f"<include><uri>{uri}</uri></include>"),
        "urdf/robot.urdf": "<robot/>",
        "two.sdf": sdf('<model name="a"/><model name="b"/>'),
        "bad.sdf": "<sdf>&",
        "empty/readme": "",
    }
    write(files, home)
    write({"arm/model.config": CONFIG, "arm/model.sdf": ARM}, tmp_path / "b" / "models")
    (home / "link").symlink_to(tmp_path / "b" / "models" / "arm")
    with pytest.raises(DescriptionError, match=said):
        read_mechanism(home / "main.sdf")


def test_includes_that_never_end(tmp_path: Path):
    again = "<include><uri>main.sdf</uri><name>{}</name></include>"
    path = write({"main.sdf": model(again.format("x") + again.format("y"))}, tmp_path)
    with pytest.raises(DescriptionError, match=f"nested more than {DEEPEST} deep"):
        read_mechanism(path)


@pytest.mark.slow
def test_includes_that_grow_without_bound(tmp_path: Path):
    files = {
        f"f{i}.sdf": model(
            "".join(
                f"<include><uri>f{i + 1}.sdf</uri><name>m{k}</name></include>" for k in range(8)
            )
        )
        for i in range(12)
    }
    files |= {"f12.sdf": model(link("a")), "main.sdf": files["f0.sdf"]}
    path = write(files, tmp_path)
    with pytest.raises(DescriptionError, match="more than 10000 models are included"):
        read_mechanism(path)


def test_lights_are_passed_over(tmp_path: Path):
    files = {
        "main.sdf": world(f'<include><uri>sun</uri></include><model name="m">{link("a")}</model>'),
        "sun/model.sdf": sdf('<light name="sun" type="directional"/>'),
    }
    assert list(read_mechanism(write(files, tmp_path)).bodies) == ["world", "m::a"]


# ---- the row of the table


def test_loaded_as_any_other_file(tmp_path: Path):
    path = write(FILES["frames"], tmp_path)
    system = kempe.load(path)
    assert system == kempe.load(path.read_text()) and system.nq == 2
    assert kempe.load(path, base="free").nq == 9
    where = system.mechanism.joints["j"].where
    assert SDF.read is not None and where is not None and where.file == str(path)
    again = kempe.load(Mechanism.save(system.mechanism, tmp_path / "again.toml"))
    q = [0.3, -0.2]
    for name in system.frame_names:
        np.testing.assert_allclose(again.fk(q, name), system.fk(q, name), **EXACT)

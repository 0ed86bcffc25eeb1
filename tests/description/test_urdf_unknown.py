"""What stands in URDF files beside what is read: names, prefixes, versions, and a hunt for what
vanishes silently.
"""

from __future__ import annotations

import re
import xml.etree.ElementTree as ET
from collections.abc import Iterator
from copy import deepcopy

import numpy as np
import pytest
from bad_file_cases import LIMIT, LINKS, joint, mimic, robot
from robots import good_urdf_files

from kempe.description.mechanism import Mechanism
from kempe.description.urdf_elements import MOTION, check_known_name
from kempe.description.urdf_reader import read_urdf
from kempe.errors import DescriptionError

REST = joint("rest", "", "fixed", "arm", "hand")
BALL = (
    '<drake:ball_constraint><drake:ball_constraint_body_A name="base"/><drake:ball_constraint_p_AP '
    'value="0 0 1"/><drake:ball_constraint_body_B name="hand"/></drake:ball_constraint>'
)


def with_namespace(text: str, prefix: str, uri: str) -> str:
    """The text with a namespace bound in its outermost element."""
    return text.replace("<robot", f'<robot xmlns:{prefix}="{uri}"', 1)


@pytest.mark.parametrize(
    "name",
    [
        "self_collision_checking",
        "collision_checking",
        "self_collide",
        "colision",
        "soft_visual",
        "gravity_scale",
    ],
)
def test_elements_without_a_part_in_the_motion_are_never_refused(name):
    links = LINKS.replace('base"/>', f'base"><{name}/></link>')
    assert read_urdf(robot(joint(), REST, links=links)).joints


def test_kukas_own_shapes_are_read_without_a_word():
    shape = (
        '<origin rpy="0 0 0" xyz="0 0 0"/><geometry><capsule length="0.25" '
        'radius="0.15"/></geometry>'
    )
    inside = f"<self_collision_checking>{shape}</self_collision_checking>"
    links = LINKS.replace('arm"/>', f'arm">{inside}</link>')
    assert read_urdf(robot(joint(), REST, links=links)).notes == []


@pytest.mark.parametrize("name", ["orgin", "limits", "Axis", "axis2", "mimick", "childs", "lmiit"])
def test_slips_of_what_decides_on_the_motion_are_refused(name):
    with pytest.raises(DescriptionError, match=f"unknown element '{name}'; did you mean"):
        read_urdf(robot(joint(inside=LIMIT + f"<{name}/>"), REST))


@pytest.mark.parametrize("name", ["joint_limit", "soft_limit", "axis_color", "max-limit"])
def test_a_name_that_holds_a_known_one_is_no_slip(name):
    notes = read_urdf(robot(joint(inside=LIMIT + f"<{name} lower='0'/>"), REST)).notes
    assert notes == [f"<text>:5: joint 'elbow': the element '{name}' is not read (lower='0')"]


@pytest.mark.parametrize(
    "name", ["max_velocity", "gear_velocity", "drake:acceleration", "effort_limit"]
)
def test_attributes_of_other_programs_are_noted(name):
    (note,) = read_urdf(robot(joint(inside=f'<limit lower="0" upper="1" {name}="2"/>'), REST)).notes
    assert note.endswith(f"the limit attribute '{name}' is not read")


@pytest.mark.parametrize("given", ["1.0", "1.1", "1.2", " 1.1 ", "1.00", "01.2", "1.01"])
def test_versions_of_urdf(given):
    assert not read_urdf(robot(joint(), REST).replace("<robot", f'<robot version="{given}"')).notes


@pytest.mark.parametrize(
    "given",
    [
        "2.0",
        "foo",
        "-1.0",
        "1.3",
        "1",
        "",
        "1.0.0",
        "1.10",
        "1.",
        ".1",
        "1.0a",
        "１.0",
        "1.-0",
        "1.+0",
        "1.3",
    ],
)
def test_other_versions_are_refused(given):
    with pytest.raises(
        DescriptionError, match=f"robot: the version is '{given}'; it is the version of URDF"
    ):
        read_urdf(robot(joint(), REST).replace("<robot", f'<robot version="{given}"'))


@pytest.mark.parametrize(
    "uri",
    [
        "http://www.ros.org",
        "http://www.ros.org/",
        "http://www.ros.org/wiki/urdf",
        "http://wiki.ros.org/urdf/XML",
    ],
)
def test_elements_in_the_namespace_of_urdf_are_read(uri):
    text = robot(joint(inside='<origin xyz="1 2 3"/>' + LIMIT), REST)
    prefixed = with_namespace(
        re.sub(r"<(/?)(\w)", r"<\1u:\2", text).replace("<u:robot", "<robot", 1), "u", uri
    )
    prefixed = prefixed.replace("</u:robot", "</robot")
    assert fingerprint(read_urdf(prefixed)) == fingerprint(read_urdf(text))
    whole = re.sub(r"<(/?)(\w)", r"<\1u:\2", text).replace(
        "<u:robot", f'<u:robot xmlns:u="{uri}"', 1
    )
    assert fingerprint(read_urdf(whole)) == fingerprint(read_urdf(text))


def test_the_namespace_of_the_outermost_element_is_its_own():
    text = robot(
        joint(), REST, joint("x", LIMIT, "ball", "base", "hand").replace("joint", "drake:joint")
    )
    text = text.replace("</joint>\n</robot>", "</drake:joint>\n</robot>").replace(
        "/drake:joint>", "/drake:joint>"
    )
    read = read_urdf(with_namespace(text, "drake", "http://drake.mit.edu"))
    assert read.joints["x"].type.type_name == "spherical"
    own = with_namespace(
        text.replace("<robot", '<robot xmlns="http://drake.mit.edu"'),
        "drake",
        "http://drake.mit.edu",
    )
    with pytest.raises(DescriptionError, match="unknown type 'ball'"):
        read_urdf(own)


@pytest.mark.parametrize("tag", sorted(MOTION))
@pytest.mark.parametrize("prefix", ["sdf:", "r:"])
def test_prefixes_hide_nothing(tag, prefix):
    inside = (
        '<link name="x"/>'
        if tag == "link"
        else f"<{tag} link='arm' joint='rest' xyz='1 0 0' lower='1'/>"
    )
    hidden = inside.replace(f"<{tag}", f"<{prefix}{tag}")
    for text in (robot(joint(inside=LIMIT + hidden), REST), robot(joint(), REST, hidden)):
        with pytest.raises(DescriptionError, match=rf"<{prefix}{tag}>"):
            read_urdf(text)


@pytest.mark.parametrize(
    "tag", ["x:ball_constraint", "loop_closure", "loop", "x:closure", "equality", "gear"]
)
def test_what_ties_links_is_refused_and_what_ties_none_is_noted(tag):
    tied = f'<{tag}><a name="base"/><b>hand</b></{tag}>'
    with pytest.raises(
        DescriptionError, match=f"<{tag}> is not read, and it ties 'base' and 'hand'"
    ):
        read_urdf(robot(joint(), REST, tied))
    (note,) = read_urdf(robot(joint(), REST, f'<{tag} of="nobody"/>')).notes
    assert f"the element '{tag}' is not read (of='nobody')" in note


def test_a_version_with_more_digits_decides_on_quaternions():
    text = robot(joint(inside='<origin quat_xyzw="0 0 0 1"/>' + LIMIT), REST)
    with pytest.raises(DescriptionError, match="this file is of version 1.0"):
        read_urdf(text.replace("<robot", '<robot version="1.00"'))
    assert read_urdf(text.replace("<robot", '<robot version="1.01"')).joints


@pytest.mark.parametrize(
    ("inside", "said"),
    [
        (
            '<equality><connect body1="base" body2="hand" anchor="0 0 1"/></equality>',
            "'base' and 'hand'",
        ),
        (
            '<equality><joint joint1="elbow" joint2="rest" polycoef="0 1 0 0 0"/></equality>',
            "'elbow' and 'rest'",
        ),
        ('<extension><equality><weld body1="arm"/></equality></extension>', "'arm'"),
        ('<tendon><fixed name="t"><joint joint="elbow" coef="1"/></fixed></tendon>', "'elbow'"),
    ],
)
@pytest.mark.parametrize("block", ["mujoco", "drake"])
def test_what_ties_links_for_one_simulator_is_noted(block, inside, said):
    notes = read_urdf(robot(joint(), REST, f"<{block}>{inside}</{block}>")).notes
    (note,) = [n for n in notes if "there it ties" in n]
    assert f"in a <{block}> block is not read" in note and note.endswith(f"there it ties {said}")


@pytest.mark.parametrize(
    "inside",
    [
        '<compiler discardvisual="true"/>',
        '<contact><exclude body1="base" body2="arm"/></contact>',
        "",
    ],
)
def test_what_ties_nothing_for_a_simulator_is_passed_over(inside):
    assert not read_urdf(robot(joint(), REST, f"<mujoco>{inside}</mujoco>")).notes


def test_blocks_of_simulators_are_noted():
    text = robot(
        joint(),
        REST,
        '<gazebo><link name="x"><visual/></link></gazebo>',
        '<gazebo><plugin><mimic joint="elbow"/></plugin></gazebo>',
        "<gazebo><plugin><joint>rest</joint><mimicJoint>elbow</mimicJoint></plugin></gazebo>",
        '<transmission name="t"><joint name="elbow"/><limit lower="0"/></transmission>',
        '<sensor name="s"><parent link="arm"/><origin xyz="0 0 1"/></sensor>',
        '<drake:collision_filter_group name="g"><drake:member '
        'link="arm"/></drake:collision_filter_group>',
    )
    notes = read_urdf(text).notes
    assert [note.split(":")[1] for note in notes] == ["8", "9", "10", "12"]


# ---- the hunt: a real file in which something that matters was renamed, hidden or moved


def fingerprint(mechanism: Mechanism) -> tuple:
    """All that decides on the motion."""
    joints = tuple(
        (
            j.name,
            j.type.type_name,
            j.parent,
            j.child,
            j.X_PF.evaluate_pose({}).tobytes(),
            j.X_CM.evaluate_pose({}).tobytes(),
            tuple(sorted(j.limits.items())),
        )
        for j in mechanism.joints.values()
    )
    return mechanism.ground.name, tuple(mechanism.bodies), joints, repr(mechanism.couplings)


def parts(root: ET.Element) -> Iterator[tuple[ET.Element, ET.Element]]:
    """Elements that decide on the motion, each with the one that holds it."""
    for element in root:
        if element.tag in ("link", "joint"):
            yield root, element
        if element.tag == "joint":
            yield from ((element, part) for part in element if part.tag in MOTION)


def words(rng: np.random.Generator, name: str) -> str:
    """A name with one slip, a related name, or another one."""
    k = int(rng.integers(len(name)))
    other = "abcdefghijklmnopqrstuvwxyz"[rng.integers(26)]
    slips = [
        name[:k] + name[k + 1 :],
        name[:k] + other + name[k:],
        name[:k] + other + name[k + 1 :],
        name.upper(),
    ]
    return str(rng.choice([*slips, name + "s", "my_" + name, name + "2", "pose", "element", "jnt"]))


def mutate(rng: np.random.Generator, root: ET.Element) -> str:
    """Change one thing of a robot; the name that a note must hold."""
    found = list(parts(root))
    holder, element = found[rng.integers(len(found))]
    tag = element.tag
    how = rng.integers(5)
    if how == 0:  # a prefix, bound to something else or to nothing
        element.tag = str(rng.choice(["drake_", "r_", "sdf_"])) + tag  # written as a prefix below
        return element.tag.replace("_", ":")
    if how == 1:
        element.tag = words(rng, tag)
        return element.tag
    if how == 2 and element.attrib:
        key = str(rng.choice(list(element.attrib)))
        value = element.attrib.pop(key)
        new = words(rng, key)
        element.set(new, value)
        return new
    holder.remove(element)
    places = [
        p
        for p in root.iter()
        if p is not holder and p.tag not in ("robot", "origin") and p is not element
    ]
    # inside another joint it is that one's
    if element.tag in (
        "origin",
        "parent",
        "child",
        "axis",
        "limit",
        "mimic",
    ):
        places = [p for p in places if p.tag != "joint"]
    if element.tag == "origin":  # a visual has an origin, too
        places = [p for p in places if p.tag not in ("visual", "collision", "inertial", "sensor")]
    if how == 3 or not places:
        wrapper = ET.SubElement(
            holder, str(rng.choice(["group", "drake", "extra", "mujoco", "transmission"]))
        )
        wrapper.append(element)
        return wrapper.tag
    places[rng.integers(len(places))].append(element)
    return tag


def base_files() -> list[tuple[str, str]]:
    """Small real robots, and one with a loop and a follower."""
    loop = robot(
        joint(),
        REST,
        joint("close", LIMIT, "revolute", "base", "hand"),
        joint("m", LIMIT + mimic("elbow"), "revolute", "hand", "tip"),
        links=LINKS + '<link name="tip"/>\n',
    )
    small = [
        (n, p.read_text(encoding="utf-8"))
        for n, p in good_urdf_files().items()
        if p.stat().st_size < 60_000
    ]
    return [("loop", loop), *small[:12]]


def hunted(rng: np.random.Generator, count: int) -> dict[str, int]:
    """Mutated files by what came of them; a silent difference fails."""
    files = [(n, t, read_urdf(t)) for n, t in base_files()]
    tally = dict.fromkeys(("same", "noted", "refused"), 0)
    for _ in range(count):
        name, text, whole = files[rng.integers(len(files))] if rng.random() < 0.6 else files[0]
        root = ET.fromstring(re.sub(r"(</?)\w+:", r"\1", re.sub(r"\s\w+:\w+=\"[^\"]*\"", "", text)))
        shown = mutate(rng, root := deepcopy(root))
        changed = re.sub(r"(</?)(drake|r|sdf)_", r"\1\2:", ET.tostring(root, encoding="unicode"))
        try:
            mine = read_urdf(changed)
        except DescriptionError:
            tally["refused"] += 1
            continue
        if fingerprint(mine) == fingerprint(whole):
            tally["same"] += 1
            continue
        fresh = [n for n in mine.notes if shown in n or shown.split(":")[-1] in n]
        assert fresh, f"{name}: {shown!r} changed the mechanism without a note:\n{changed[-3000:]}"
        tally["noted"] += 1
    return tally


def test_nothing_that_matters_vanishes_silently(hunt):
    assert min(hunted(hunt.rng(), hunt.cases(150)).values()) > 0


@pytest.mark.slow
def test_nothing_that_matters_vanishes_silently_in_many_files(hunt):
    assert min(hunted(hunt.rng(), hunt.cases(2000)).values()) > 0


def test_the_check_of_names_takes_long_names():
    from kempe.description.source import Findings
    from kempe.description.xml import parse_xml

    findings = Findings()
    check_known_name(
        "element", "x" * 5000, ("link",), findings, "", parse_xml(f"<{'x' * 5000}/>", "t")
    )
    assert len(findings.notes[0]) < 200

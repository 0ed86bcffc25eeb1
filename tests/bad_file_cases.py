"""Broken and unusual files: what each is, what is in it, and what Kempe must say (or that it must
load).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

from kempe.description.mechanism import Mechanism

LINKS = '<link name="base"/>\n<link name="arm"/>\n<link name="hand"/>\n'


@dataclass(frozen=True)
class Case:
    """`says`: pieces that the message must have, in any order; `line`: the first problem's line;
    None: it must load.

    `note` is what a loadable file must be remarked on with, `holds` what must be true of its
    mechanism m.
    """

    title: str
    text: str
    says: tuple[str, ...] | None = None
    line: int | None = None
    note: str = ""
    holds: Callable[[Mechanism], object] = lambda m: True
    encoding: str = "utf-8"
    suffix: str = ".urdf"
    any_encoding: bool = True


def robot(*lines: str, links: str = LINKS) -> str:
    """A URDF text; the given lines come after the opening tag and the three links, on lines 5, 6,
    ...
    """
    return f'<robot name="r">\n{links}' + "".join(f"{line}\n" for line in lines) + "</robot>\n"


def joint(
    name: str = "elbow",
    inside: str = '<limit lower="-1" upper="1" effort="9" velocity="2"/>',
    kind: str = "revolute",
    parent: str = "base",
    child: str = "arm",
) -> str:
    """A <joint> on one line."""
    ends = f'<parent link="{parent}"/><child link="{child}"/>'
    return f'<joint name="{name}" type="{kind}">{ends}{inside}</joint>'


SHOULDER = joint("shoulder")
WRIST = joint("wrist", parent="arm", child="hand")
LIMIT = '<limit lower="-1" upper="1" effort="9" velocity="2"/>'


def mimic(of: str) -> str:
    """A limit and a <mimic>."""
    return f'{LIMIT}<mimic joint="{of}"/>'


def shown(geometry: str) -> str:
    """The three links, on lines 2 to 4; the first is seen as this, on line 3."""
    return (
        f'<link name="base"><visual><geometry>\n{geometry}</geometry></visual></link>' + LINKS[20:]
    )


URDF_CASES = [
    Case(
        "an external entity in a DTD",
        '<!DOCTYPE robot [<!ENTITY x SYSTEM "file:///etc/passwd">]>\n' + robot(SHOULDER, WRIST),
        ("DTD", "remove it"),
        1,
    ),
    Case(
        "an external parameter entity in a DTD",
        '<?xml version="1.0"?>\n<!DOCTYPE robot [<!ENTITY % x SYSTEM "file:///etc/passwd"> %x;]>\n'
        + robot(SHOULDER, WRIST),
        ("DTD", "remove it"),
        2,
    ),
    Case(
        "entities that double ten times each (billion laughs)",
        '<!DOCTYPE robot [<!ENTITY a "ha"><!ENTITY b "&a;&a;&a;">]>\n'
        + robot('<link name="&b;"/>'),
        ("DTD", "remove it"),
        1,
    ),
    Case("an entity that nobody declared", robot('<link name="&x;"/>'), ("entity", "&amp;"), 5),
    Case(
        "a mesh path that leads out of the folders of the model",
        robot(
            SHOULDER,
            WRIST,
            links='<link name="base"><visual><geometry><mesh filename="../../../etc/passwd"/></geometry></visual>'
            "</link>\n"
            '<link name="arm"/>\n<link name="hand"/>\n',
        ),
        holds=lambda m: "../../../etc/passwd" in m.bodies["base"].shapes[0].geometry.path,
    ),
    Case(
        "a ball with a negative radius",
        robot(SHOULDER, WRIST, links=shown('<sphere radius="-1"/>')),
        ("visual of link 'base'", "radius of a sphere is -1", "above zero"),
        3,
    ),
    Case(
        "a box with a size that is no number",
        robot(SHOULDER, WRIST, links=shown('<box size="1 a 1"/>')),
        ("visual of link 'base'", "box size is '1 a 1'", "'a' is not a number"),
        3,
    ),
    Case(
        "a cylinder without its length",
        robot(SHOULDER, WRIST, links=shown('<cylinder radius="1"/>')),
        ("visual of link 'base'", "<cylinder> has no length", "it needs radius, length"),
        3,
    ),
    Case(
        "a mesh without a file",
        robot(SHOULDER, WRIST, links=shown("<mesh/>")),
        ("visual of link 'base'", "<mesh> has no filename"),
        3,
    ),
    Case(
        "a mesh scaled by infinity",
        robot(SHOULDER, WRIST, links=shown('<mesh filename="a.stl" scale="1 inf 1"/>')),
        ("visual of link 'base'", "mesh scale is '1 inf 1'", "'inf' is not finite"),
        3,
    ),
    Case(
        "two shapes in one visual",
        robot(SHOULDER, WRIST, links=shown('<sphere radius="1"/><sphere radius="2"/>')),
        ("visual of link 'base'", "it has 2 shapes", "one <visual> for each shape"),
        3,
    ),
    Case(
        "a shape that URDF does not have",
        robot(SHOULDER, WRIST, links=shown('<cone radius="1"/>')),
        note="the shape <cone> is not read",
        holds=lambda m: not m.bodies["base"].shapes,
    ),
    Case(
        "a ball without extent",
        robot(SHOULDER, WRIST, links=shown('<sphere radius="0"/>')),
        note="its sphere has no extent",
        holds=lambda m: not m.bodies["base"].shapes,
    ),
    Case(
        "not a number in an origin",
        robot(joint(inside='<origin xyz="nan 0 1"/>' + LIMIT), WRIST),
        ("joint 'elbow'", "origin xyz", "'nan' is not finite", "3 finite numbers"),
        5,
    ),
    Case(
        "an infinite number in an origin",
        robot(joint(inside='<origin rpy="0 1e999 1"/>' + LIMIT), WRIST),
        ("joint 'elbow'", "origin rpy", "'1e999' is not finite", "3 finite numbers"),
        5,
    ),
    Case(
        "an axis of zeros",
        robot(SHOULDER, joint("wrist", '<axis xyz="0 0 0"/>' + LIMIT, parent="arm", child="hand")),
        ("joint 'wrist'", "axis", "0 0 0", "must not be zero"),
        6,
    ),
    Case(
        "a circle of joints: no link is the root",
        robot(SHOULDER, WRIST, joint("back", parent="hand", child="base")),
        ("no link is the root", "'arm' -> 'hand' -> 'base' -> 'arm'", "root='arm'"),
        3,
    ),
    Case(
        "a circle that is detached from the root",
        robot(joint("a", parent="arm", child="hand"), joint("b", parent="hand", child="arm")),
        ("no joints lead from the root 'base'", "'arm' (line 3)", "'hand' (line 4)", "join them"),
        3,
    ),
    Case(
        "two joints that lead to one link (a loop)",
        robot(SHOULDER, WRIST, joint("second", parent="base", child="hand")),
        holds=lambda m: len(m.joints) == 3 and m.build().structure.closures,
    ),
    Case(
        "a chain of 3 000 links",
        robot(
            *(joint(f"j{i}", parent=f"l{i}", child=f"l{i + 1}") for i in range(2999)),
            links="".join(f'<link name="l{i}"/>\n' for i in range(3000)),
        ),
        holds=lambda m: len(m.joints) == 2999,
        any_encoding=False,
    ),
    Case(
        "a chain of 20 000 links",
        robot(
            *(joint(f"j{i}", parent=f"l{i}", child=f"l{i + 1}") for i in range(19999)),
            links="".join(f'<link name="l{i}"/>\n' for i in range(20000)),
        ),
        holds=lambda m: len(m.joints) == 19999,
        any_encoding=False,
    ),
    Case(
        "two links of one name",
        robot(SHOULDER, WRIST, '<link name="arm"/>'),
        ("link 'arm'", "another link of this name", "file.urdf:3", "unique"),
        7,
    ),
    Case(
        "two joints of one name",
        robot(joint("j"), joint("j", parent="arm", child="hand")),
        ("joint 'j'", "another joint of this name", "file.urdf:5", "unique"),
        6,
    ),
    Case(
        "Latin-1 bytes without a declaration",
        robot('<link name="Gelenkträger"/>', joint("j")),
        ("0xe4 is not UTF-8", "'ä'", "save the file as UTF-8"),
        5,
        encoding="latin-1",
        any_encoding=False,
    ),
    Case(
        "Latin-1 bytes, declared",
        '<?xml version="1.0" encoding="ISO-8859-1"?>\n'
        + robot(SHOULDER, WRIST, joint("g", parent="hand", child="ä"), '<link name="ä"/>'),
        holds=lambda m: "ä" in m.bodies,
        encoding="latin-1",
        any_encoding=False,
    ),
    Case(
        "a declared encoding that is not the file's",
        '<?xml version="1.0" encoding="UTF-16"?>\n' + robot(SHOULDER, WRIST),
        ("declares the encoding 'UTF-16'", "save it as UTF-8"),
        1,
        any_encoding=False,
    ),
    Case(
        "an encoding that is not read",
        '<?xml version="1.0" encoding="Shift_JIS"?>\n' + robot(SHOULDER, WRIST),
        ("declares the encoding 'Shift_JIS'", "save it as UTF-8"),
        1,
        any_encoding=False,
    ),
    Case(
        "UTF-16 with its byte order mark",
        robot(SHOULDER, joint("Ellbögen", parent="arm", child="hand")),
        holds=lambda m: "Ellbögen" in m.joints,
        encoding="utf-16",
        any_encoding=False,
    ),
    Case(
        "UTF-16 without its byte order mark",
        robot(SHOULDER, WRIST),
        ("UTF-16", "byte order mark", "UTF-8"),
        1,
        encoding="utf-16-le",
        any_encoding=False,
    ),
    Case(
        "binary data behind a few letters",
        "mesh\0\0\0\1",
        ("binary data",),
        1,
        any_encoding=False,
    ),
    Case(
        "UTF-8 names with accents",
        robot(joint("épaule"), WRIST),
        holds=lambda m: "épaule" in m.joints,
    ),
    Case(
        "a child link that does not exist",
        robot(SHOULDER, joint("wrist", parent="arm", child="hnad")),
        ("joint 'wrist'", "child link 'hnad' does not exist", "did you mean 'hand'"),
        6,
    ),
    Case(
        "joints that mimic each other",
        robot(
            joint("a", mimic("b")),
            joint("b", mimic("a"), parent="arm", child="hand"),
        ),
        ("mimics itself", "'a' mimics 'b' mimics 'a'", "must be free"),
        5,
    ),
    Case(
        "a joint that mimics a missing joint",
        robot(SHOULDER, joint("wrist", mimic("sholder"), parent="arm", child="hand")),
        ("joint 'wrist'", "joint 'sholder', which does not exist", "did you mean 'shoulder'"),
        6,
    ),
    Case(
        "a mimic of a mimic",
        robot(
            joint("a"),
            joint("b", mimic("a"), parent="arm", child="hand"),
            joint("c", mimic("b"), parent="hand", child="tip"),
            '<link name="tip"/>',
        ),
        holds=lambda m: m.build().nq == 1,
    ),
    Case(
        "an axis that is not of unit length",
        robot(joint(kind="prismatic", inside='<axis xyz="0 0 2"/>' + LIMIT), WRIST),
        note="axis 0 0 2 has length 2; it was normalised",
        holds=lambda m: abs(m.build().fk({"elbow": 0.5}, "arm")[2, 3] - 0.5) < 1e-15,
    ),
    Case(
        "two root links",
        robot(joint("a", child="hand"), joint("b", parent="arm", child="hand")),
        ("2 links are nobody's child", "'base' (line 2)", "'arm' (line 3)", "root='base'"),
        3,
    ),
    Case(
        "two separate robots",
        robot(SHOULDER),
        ("2 links are nobody's child", "'hand' (line 4)", "join them by joints"),
        4,
    ),
    Case(
        "a file that ends too soon",
        robot(SHOULDER, WRIST)[:-40],
        ("the file ends inside <joint> opened on line 6", "truncated"),
        6,
    ),
    Case(
        "a closing tag that does not fit",
        robot(SHOULDER, "<link name='x'></joint>"),
        ("closes <link> opened on line 6", "</link>"),
        6,
    ),
    Case(
        "a lower limit above the upper one",
        robot(joint(inside='<limit lower="1" upper="-1" effort="1" velocity="1"/>'), WRIST),
        ("joint 'elbow'", "swapped", "lower='1' upper='-1'", "lower must not be above upper"),
        5,
    ),
    Case(
        "a comma for the decimal point",
        robot(joint(inside='<origin xyz="0 0 1,5"/>' + LIMIT), WRIST),
        ("joint 'elbow'", "'1,5' is not a number", "1.5", "3 finite numbers"),
        5,
    ),
    Case(
        "commas between numbers",
        robot(joint(inside='<origin xyz="0,0,1"/>' + LIMIT), WRIST),
        ("joint 'elbow'", "'0,0,1' is not a number", "no commas", "3 finite numbers"),
        5,
    ),
    Case(
        "two numbers where three are needed",
        robot(joint(inside='<origin xyz="0 1"/>' + LIMIT), WRIST),
        ("joint 'elbow'", "origin xyz is '0 1': 2 numbers", "3 finite numbers"),
        5,
    ),
    Case(
        "a floating joint",
        robot(joint(kind="floating", inside=""), WRIST),
        holds=lambda m: m.joints["elbow"].type.type_name == "free",
    ),
    Case(
        "a planar joint",
        robot(joint(kind="planar", inside='<axis xyz="0 1 0"/>'), WRIST),
        holds=lambda m: m.joints["elbow"].type.type_name == "planar",
    ),
    Case(
        "an unknown joint type",
        robot(joint(kind="revolut"), WRIST),
        ("joint 'elbow'", "unknown type 'revolut'", "did you mean 'revolute'"),
        5,
    ),
    Case(
        "a joint without a type",
        robot('<joint name="elbow"><parent link="base"/><child link="arm"/></joint>', WRIST),
        ("joint 'elbow'", "it has no type", "revolute, continuous, prismatic"),
        5,
    ),
    Case(
        "a joint from a link to itself",
        robot(SHOULDER, joint("odd", parent="hand", child="hand"), WRIST),
        ("joint 'odd'", "connects link 'hand' to itself", "two links"),
        6,
    ),
    Case("an empty file", "", ("empty", "URDF, TOML"), any_encoding=False),
    Case("a file of blanks", " \n \n", ("nothing but blanks", "URDF, TOML")),
    Case("a file that is no XML", "Hello!\n", ("no XML element", "<robot"), 1),
    Case(
        "a robot without links",
        '<robot name="r">\n</robot>\n',
        ("no robot in this file", "without a <link>"),
        1,
    ),
    Case(
        "a link without a name",
        robot(SHOULDER, WRIST, "<link/>"),
        ("a link has no name", "needs a name"),
        7,
    ),
    Case(
        "a joint with an empty name",
        robot(joint(""), WRIST),
        ("a joint has an empty name", "needs a name"),
        5,
    ),
    Case(
        "a joint without a parent",
        robot('<joint name="elbow" type="fixed"><child link="arm"/></joint>', WRIST),
        ("joint 'elbow'", "no <parent link=...>"),
        5,
    ),
    Case(
        "a slip in the name of an element",
        robot(joint(inside='<orgin xyz="0 0 1"/>' + LIMIT), WRIST),
        ("joint 'elbow'", "unknown element 'orgin'", "did you mean 'origin'"),
        5,
    ),
    Case(
        "a slip in the name of an attribute",
        robot(joint(inside='<mimic joint="wrist" multplier="2"/>' + LIMIT), WRIST),
        ("joint 'elbow'", "unknown mimic attribute 'multplier'", "did you mean 'multiplier'"),
        5,
    ),
    Case(
        "an element of another program whose name holds a known one",
        robot(
            joint(),
            WRIST,
            links=LINKS.replace('"arm"/>', '"arm"><self_collision_checking/></link>'),
        ),
    ),
    Case(
        "an element that Kempe does not know",
        robot(joint(inside="<spring/>" + LIMIT), WRIST),
        note="the element 'spring' is not read",
    ),
    Case(
        "a prefix bound to the namespace of URDF",
        robot(joint().replace("joint", "u:joint", 1).replace("/joint", "/u:joint"), WRIST).replace(
            "<robot", '<robot xmlns:u="http://www.ros.org"'
        ),
        holds=lambda m: len(m.joints) == 2,
    ),
    Case(
        "a joint that a prefix hides",
        robot(
            joint(),
            WRIST,
            '<sdf:joint name="x" type="ball"><parent link="arm"/><child link="hand"/></sdf:joint>',
        ),
        (
            "the prefix of <sdf:joint> hides it",
            "parent link='arm', child link='hand'",
            "or remove it",
        ),
        7,
    ),
    Case(
        "a constraint of another program between links",
        robot(
            joint(),
            WRIST,
            '<drake:tendon_constraint><a name="elbow"/><b name="wrist"/></drake:tendon_constraint>',
        ),
        ("<drake:tendon_constraint> is not read, and it ties 'elbow' and", "another mechanism"),
        7,
    ),
    Case(
        "a constraint of Drake without its points, on a link that does not exist",
        robot(
            joint(),
            WRIST,
            '<drake:ball_constraint><drake:ball_constraint_body_A name="base"/>'
            '<drake:ball_constraint_body_B name="hnd"/></drake:ball_constraint>',
        ),
        (
            "constraint 'ball_constraint': its link 'hnd' does not exist; did you mean 'hand'?",
            "it has no <drake:ball_constraint_p_AP>; it needs one",
        ),
        7,
    ),
    Case(
        "a loop joint with one end and an unknown type",
        robot(joint(), WRIST, '<loop_joint name="l" type="ball"><link1 link="arm"/></loop_joint>'),
        (
            "loop_joint 'l': it has 1 end; a loop joint has two",
            "unknown type 'ball'; a <loop_joint>",
        ),
        7,
    ),
    Case(
        "a joint of Drake as one of URDF",
        robot(joint(), joint("wrist", "", "screw", "arm", "hand")),
        ("joint 'wrist': unknown type 'screw'; it is a type of Drake: write <drake:joint>",),
        6,
    ),
    Case(
        "a screw without a pitch",
        robot(joint(), joint("wrist", "", "screw", "arm", "hand").replace("joint", "drake:joint")),
        ("joint 'wrist': it has no <drake:screw_thread_pitch value=...>; a screw needs it",),
        6,
    ),
    Case(
        "a negative effort limit",
        robot(joint(inside='<limit lower="-1" upper="1" effort="-1" velocity="1"/>'), WRIST),
        (
            "effort limit is -1; it must not be negative (lenient_limits=True reads it as unlimited)",
        ),
        5,
    ),
    Case(
        "a declaration of XML after a comment",
        "<!-- licence\n-->\n\n<?xml version='1.0'?>\n" + robot(joint(), WRIST),
        note="file.urdf:4: the line <?xml ...?> is not at the very start of the file",
        holds=lambda m: m.joints["elbow"].where.line == 9,
    ),
    Case(
        "a limit that a prefix hides",
        robot(joint(inside='<d:limit lower="-1" upper="1"/>'), WRIST),
        ("joint 'elbow'", "the prefix of <d:limit> hides it (lower='-1', upper='1')"),
        5,
    ),
    Case(
        "an axis outside of its joint",
        robot(joint(), WRIST, '<axis xyz="0 0 1"/>'),
        ("<axis> is not read here (xyz='0 0 1')", "directly into a <joint>"),
        7,
    ),
    Case(
        "a joint inside another element",
        robot(joint(), WRIST, "<group>" + joint("x", parent="base", child="hand") + "</group>"),
        ("<joint> inside <group> is not read", "a <joint> stands directly in <robot>"),
        7,
    ),
    Case(
        "a version that URDF does not have",
        robot(joint(), WRIST).replace("<robot", '<robot version="2.0"'),
        ("the version is '2.0'", "it is the version of URDF, not of the robot", "1.0, 1.1, 1.2"),
        1,
    ),
    Case(
        "a quaternion in a file of version 1.0",
        robot(joint(inside='<origin quat_xyzw="0 0 1 0"/>' + LIMIT), WRIST),
        ("joint 'elbow'", "quat_xyzw is of URDF 1.1", "version='1.1'"),
        5,
    ),
    Case(
        "an element that is given twice, alike",
        robot(joint(inside='<origin xyz="0 0 1"/><origin xyz="0 0 1"/>' + LIMIT), WRIST),
        note="two <origin> elements, on line 5 and here, which say the same",
    ),
    Case(
        "an element that is given twice",
        robot(joint(inside='<origin xyz="0 0 1"/><origin xyz="0 0 2"/>' + LIMIT), WRIST),
        ("joint 'elbow'", "two <origin> elements", "one is allowed"),
        5,
    ),
    Case(
        "a xacro file that was not expanded",
        robot(joint(inside='<origin xyz="${l} 0 1"/>' + LIMIT), WRIST),
        ("xacro", "'${l} 0 1'", "xacro=True"),
        5,
    ),
    Case(
        "a revolute joint without limits",
        robot(joint(inside=""), WRIST),
        note="should have a <limit>; without one it is taken as unlimited",
        holds=lambda m: m.joints["elbow"].limits == {},
    ),
    Case(
        "a limit without numbers",
        robot(joint(inside='<limit effort="1" velocity="1"/>'), WRIST),
        note="by the rules of URDF both are 0 and the joint cannot move",
        holds=lambda m: m.joints["elbow"].limits == {"": (0.0, 0.0)},
    ),
    Case(
        "a transmission of a missing joint",
        robot(SHOULDER, WRIST, '<transmission name="t"><joint name="knee"/></transmission>'),
        note="a <transmission> speaks of joint 'knee', which does not exist",
    ),
    Case(
        "a negative speed limit",
        robot(joint(inside='<limit lower="-1" upper="1" effort="1" velocity="-2"/>'), WRIST),
        ("joint 'elbow'", "velocity limit is -2", "must not be negative"),
        5,
    ),
    Case(
        "elements nested 1 000 deep",
        robot("<a>" * 1000),
        ("nested more than 100 deep", "no robot"),
        5,
    ),
    Case(
        "30 problems at once",
        robot(SHOULDER, WRIST, *(joint(f"j{i}", parent="base", child=f"x{i}") for i in range(30))),
        ("joint 'j0'", "joint 'j19'", "and 10 more"),
        7,
    ),
]

TOML_HEAD = 'format = 1\nname = "m"\ndim = 2\n[[body]]\nname = "a"\n[[body]]\nname = "b"\n'
"""Seven lines."""


def toml(*lines: str) -> str:
    """A TOML text with the bodies a and b; the given lines follow on lines 8, 9, ..."""
    return TOML_HEAD + "".join(f"{line}\n" for line in lines)


def toml_joint(
    name: str, *more: str, kind: str = "revolute", parent: str = "ground", child: str = "a"
) -> str:
    """A [[joint]]: its header, then name, type, parent, child, and more, one a line."""
    return "\n".join(
        [
            "[[joint]]",
            f'name = "{name}"',
            f'type = "{kind}"',
            f'parent = "{parent}"',
            f'child = "{child}"',
            *more,
        ]
    )


A = toml_joint("A")
B = toml_joint("B", parent="a", child="b")
ROD = '[[constraint]]\nname = "R"\ntype = "distance"\nparent = "ground"\nchild = "b"'
SHAPE = '[[shape]]\nbody = "b"\ntype = "sphere"'

TOML_CASES = [
    Case("a file that is not TOML", toml("[[joint"), ("this is not TOML", "see the caret"), 8),
    Case("a text that ends too soon", toml('x = "ab')[:-1], ("this is not TOML", "truncated"), 8),
    Case(
        "a list that ends too soon",
        toml("notes = [1, 2")[:-1],
        ("this is not TOML", "truncated"),
        8,
    ),
    Case(
        "a comma for the decimal point",
        toml("[parameters]", "l1 = 1,5"),
        ("not TOML", "decimals take a point"),
        9,
    ),
    Case(
        "no line that says the format", 'name = "m"\n', ("no line 'format = 1'", "starts with it")
    ),
    Case("another format", "format = 7\n", ("format is 7", "reads format 1"), 1),
    Case(
        "an unknown table", toml("[[joints]]"), ("unknown key 'joints'", "did you mean 'joint'"), 8
    ),
    Case(
        "single brackets",
        'format = 1\n[body]\nname = "a"\n',
        ("'body' is not a list of tables", "[[body]]"),
        2,
    ),
    Case(
        "an unknown key",
        toml(A, "limts = [0, 1]", B),
        ("joint 'A'", "unknown key 'limts'", "did you mean 'limits'"),
        13,
    ),
    Case(
        "a missing key",
        toml("[[joint]]", 'name = "A"'),
        ("joint 'A'", "'type' is missing", "parent, child"),
        8,
    ),
    Case(
        "not a number in a placement",
        toml(toml_joint("A", "at = [nan, 0]"), B),
        ("joint 'A'", "at is nan", "finite"),
        13,
    ),
    Case(
        "a wrong count",
        toml(toml_joint("A", "at = [1]"), B),
        ("joint 'A'", "at has 1 number", "2 or 3"),
        13,
    ),
    Case(
        "an axis of zeros",
        toml(toml_joint("A", "axis = [0, 0, 0]"), B),
        ("joint 'A'", "axis is 0.0 0.0 0.0", "not zero"),
        13,
    ),
    Case(
        "swapped limits",
        toml(toml_joint("A", "limits = [1, -1]"), B),
        ("joint 'A'", "lower limit 1 is above"),
        13,
    ),
    Case(
        "two bodies of one name",
        toml("[[body]]", 'name = "a"'),
        ("body 'a'", "another body", "file.toml:4"),
        8,
    ),
    Case("two joints of one name", toml(A, A), ("joint 'A'", "another joint", "file.toml:8"), 13),
    Case(
        "a missing body",
        toml(toml_joint("A", child="aa")),
        ("joint 'A'", "child is 'aa', which is no body", "did you mean 'a'"),
        12,
    ),
    Case(
        "a joint from a body to itself",
        toml(toml_joint("A", parent="a")),
        ("joint 'A'", "connects body 'a' to itself", "two bodies"),
        8,
    ),
    Case(
        "an unknown joint type",
        toml(toml_joint("A", kind="revolut")),
        ("unknown joint type 'revolut'",),
        10,
    ),
    Case(
        "a joint that leaves the plane",
        toml(toml_joint("A", kind="spherical")),
        ("joint 'A'", "does not exist in the plane", "planar systems take"),
        8,
    ),
    Case(
        "an unknown parameter",
        toml(toml_joint("A", 'at = ["l1", 0]')),
        ("joint 'A'", "no parameter 'l1'"),
        13,
    ),
    Case(
        "an expression that calls something else",
        toml(toml_joint("A", "at = [\"__import__('os')\", 0]")),
        ("joint 'A'", "calls '__import__'", "sin, cos"),
        13,
    ),
    Case(
        "coordinates that follow each other",
        toml(
            A,
            B,
            "[[coupling]]",
            'of = "A"',
            "sources = {B = 1}",
            "[[coupling]]",
            'of = "B"',
            "sources = {A = 1}",
        ),
        ("it follows itself: A -> B -> A",),
        18,
    ),
    Case(
        "a coupling of a missing joint",
        toml(A, B, "[[coupling]]", 'of = "A"', "sources = {BB = 1}"),
        ("coupling 'A'", "'BB' is no coordinate", "did you mean 'B'"),
        20,
    ),
    Case("detached bodies", toml(A), ("no joints lead from 'ground' to 'b'", "free"), 6),
    Case(
        "a loop",
        toml(A, B, toml_joint("C", "at = [1, 0]", child="b")),
        holds=lambda m: len(m.build().structure.closures) == 1,
    ),
    Case(
        "a shape of a missing body",
        toml(A, B, SHAPE.replace('"b"', '"bb"'), "radius = 1"),
        ("shape 1", "body is 'bb', which is no body"),
        19,
    ),
    Case(
        "a shape of an unknown kind",
        toml(A, B, SHAPE.replace("sphere", "spere"), "radius = 1"),
        ("shape of 'b'", "no kind of shape 'spere'", "did you mean 'sphere'"),
        18,
    ),
    Case(
        "a shape without its size",
        toml(A, B, SHAPE),
        ("shape of 'b'", "the radius of a sphere is missing"),
        18,
    ),
    Case(
        "a shape with the size of another kind",
        toml(A, B, SHAPE, "radius = 1", "length = 1"),
        ("shape of 'b'", "a sphere has no length", "it must have radius"),
        21,
    ),
    Case(
        "a shape with an unknown key",
        toml(A, B, SHAPE, "radius = 1", "colour = [1, 0, 0]"),
        ("shape 1", "unknown key 'colour'", "did you mean 'color'"),
        22,
    ),
    Case(
        "a shape with a negative size",
        toml(A, B, SHAPE, "radius = -1"),
        ("shape of 'b'", "the radius of a sphere is -1", "above zero"),
        21,
    ),
    Case(
        "a rod", toml(A, B, ROD, "length = 1.5"), holds=lambda m: m.constraints["R"].of.value == 1.5
    ),
    Case(
        "a rod without a length",
        toml(A, B, ROD),
        ("constraint 'R'", "no length", "length of the rod"),
        18,
    ),
    Case(
        "a rod of length zero",
        toml(A, B, ROD, "length = 0"),
        ("constraint 'R'", "length is 0", "above zero"),
        23,
    ),
    Case(
        "a length that is negative",
        toml(A, B, ROD, "length = -1"),
        ("length is -1", "above zero"),
        23,
    ),
    Case(
        "a length that is not a number",
        toml(A, B, ROD, "length = nan"),
        ("length is nan", "finite"),
        23,
    ),
    Case(
        "a length that is a list",
        toml(A, B, ROD, "length = [1]"),
        ("length is [1]", "must be a number"),
        23,
    ),
    Case(
        "a length that comes out negative",
        toml("[parameters]", "l = 1", A, B, ROD, 'length = "l - 2"'),
        ("its length is -1 (length = l - 2)", "above zero"),
        25,
    ),
    Case(
        "a length in unknown parameters",
        toml(A, B, ROD, 'length = "l"'),
        ("length is l", "no parameter 'l'"),
        23,
    ),
    Case(
        "an unknown type of constraint",
        toml(A, B, ROD.replace("distance", "distanc")),
        ("constraint 'R'", "unknown type of constraint 'distanc'", "did you mean 'distance'"),
        20,
    ),
    Case(
        "a constraint of a missing body",
        toml(A, B, ROD.replace('"b"', '"bb"')),
        ("constraint 'R'", "child is 'bb', which is no body", "did you mean 'b'"),
        22,
    ),
    Case(
        "a constraint from a body to itself",
        toml(A, B, ROD.replace('"b"', '"ground"')),
        ("to itself", "two"),
        18,
    ),
    Case(
        "a constraint of a joint's name",
        toml(A, B, ROD.replace('"R"', '"A"')),
        ("another joint", "file.toml:8"),
        18,
    ),
    Case(
        "a plane in the plane",
        toml(A, B, ROD.replace("distance", "point_on_plane")),
        ("does not exist in the",),
        18,
    ),
    Case(
        "a line that leaves the plane",
        toml(A, B, ROD.replace("distance", "point_on_line")),
        ("constraint 'R'", "its line is z of the frame, out of the plane", "axis=(x, y)"),
        18,
    ),
    Case(
        "a line with a length",
        toml(A, B, ROD.replace("distance", "point_on_line"), "axis = [1, 0]", "length = 1"),
        ("constraint 'R'", "point_on_line takes no length"),
        24,
    ),
    Case(
        "an unknown key of a constraint",
        toml(A, B, ROD, "lenght = 1"),
        ("unknown key 'lenght'", "'length'"),
        23,
    ),
    Case(
        "bodies that only a rod holds",
        toml(A, ROD, "length = 1"),
        ("no joints lead from 'ground' to 'b'",),
        6,
    ),
    Case(
        "a posture of a missing joint",
        toml(A, B, "[postures]", "home = {AA = 1}"),
        ("'AA' is no coordinate",),
        19,
    ),
    Case(
        "an integer of 100 digits",
        toml("[parameters]", "l = 1" + "0" * 100),
        ("more than 64 bits",),
        9,
    ),
    Case("a date", toml("[parameters]", "l = 1979-05-27"), ("is a date", "quotes"), 9),
    Case(
        "brackets nested 5 000 deep",
        toml("notes = " + "[" * 5000 + "]" * 5000),
        ("nested too deep",),
    ),
    Case("an empty file", "", ("empty", "URDF, TOML"), any_encoding=False),
    Case(
        "Latin-1 bytes",
        toml('notes = ["ä"]'),
        ("0xe4 is not UTF-8", "'ä'", "save the file as UTF-8"),
        8,
        encoding="latin-1",
        any_encoding=False,
    ),
]
TOML_CASES = [replace(case, suffix=".toml") for case in TOML_CASES]


def mjcf(*lines: str) -> str:
    """An MJCF text; the given lines, in its <worldbody>, are 3, 4, ..."""
    return "<mujoco>\n<worldbody>\n" + "".join(f"{line}\n" for line in lines) + _MJCF_END


_MJCF_END = "</worldbody>\n</mujoco>\n"


def of_mujoco(*joints: str) -> str:
    """A <body> called arm with these joints, on one line."""
    return f'<body name="arm">{"".join(joints)}<geom size="0.1"/></body>'


MJCF_CASES = [
    Case(
        "an external entity in a DTD",
        '<!DOCTYPE mujoco [<!ENTITY x SYSTEM "file:///etc/passwd">]>\n' + mjcf(),
        ("DTD", "remove it"),
        1,
    ),
    Case(
        "an entity that nobody declared",
        mjcf('<body name="&x;"/>'),
        holds=lambda m: "&x;" in m.bodies,
    ),
    Case("a text that is cut off", mjcf(of_mujoco())[:-30], ("truncated", "get the whole file"), 3),
    Case("words", "a robot", ("the file holds no XML element", "MJCF starts with <mujoco>"), 1),
    Case(
        "URDF with the wrong ending",
        "<robot/>",
        ("the outermost element is <robot>", "it is a file in URDF", "<mujoco>"),
        1,
    ),
    Case(
        "a part that other files include",
        "<mujocoinclude/>",
        ("this is a part of models", "load the model that includes it"),
        1,
    ),
    Case(
        "an include of a file of the system",
        mjcf('<include file="/etc/passwd"/>'),
        ("<include> names '/etc/passwd'", "outside the folders of the model", "package_dirs"),
        3,
    ),
    Case(
        "an include of a file that does not exist",
        mjcf('<include file="parts/no.xml"/>'),
        ("<include> names 'parts/no.xml'", "there is no such file", "package_dirs"),
        3,
    ),
    Case(
        "a file that includes itself",
        mjcf('<include file="file.mjcf"/>'),
        ("'file.mjcf' is included twice", "include each file once"),
        3,
    ),
    Case(
        "a mesh and a texture that are files of the system",
        mjcf('<body><joint/><geom type="mesh" mesh="m"/></body>').replace(
            "<worldbody>",
            '<asset><mesh name="m" file="/etc/passwd"/><texture type="2d" name="t" '
            'file="/etc/shadow"/></asset><worldbody>',
        ),
        note="their masses follow from meshes, which are not read",
        holds=lambda m: "/etc/passwd" in str(m.bodies["body1"].shapes[0]),
    ),
    Case(
        "an unknown attribute",
        mjcf(of_mujoco('<joint axes="0 0 1"/>')),
        ("<joint> has no attribute 'axes'", "XML reference"),
        3,
    ),
    Case("an unknown element", mjcf("<bodi/>"), ("<bodi> is no element", "XML reference"), 3),
    Case(
        "an unknown type of joint",
        mjcf(of_mujoco('<joint type="hinje"/>')),
        ("'hinje' is no keyword that <joint> takes",),
        3,
    ),
    Case(
        "not a number in a position",
        mjcf('<body name="arm" pos="nan 0 0"/>'),
        ("pos holds 'nan'", "it must be finite numbers"),
        3,
    ),
    Case(
        "an infinite number in a position",
        mjcf('<body name="arm" pos="0 1e999 0"/>'),
        ("pos of <body>", "finite numbers"),
        3,
    ),
    Case(
        "a word for a number",
        mjcf('<body name="arm" pos="0 one 0"/>'),
        ("pos of <body>", "finite numbers"),
        3,
    ),
    Case(
        "too few numbers",
        mjcf('<body name="arm" pos="0 1"/>'),
        ("pos of <body>", "MuJoCo's XML reference"),
        3,
    ),
    Case(
        "an axis of zeros",
        mjcf(of_mujoco('<joint name="elbow" axis="0 0 0"/>')),
        ("'elbow': its axis is zero", "an axis has a direction"),
        3,
    ),
    Case(
        "two bodies of one name",
        mjcf(of_mujoco(), of_mujoco()),
        ("there is another body of the name 'arm'", "names must be unique"),
        4,
    ),
    Case(
        "an equality of a joint that does not exist",
        mjcf(of_mujoco('<joint name="a"/>')).replace(
            "</mujoco>", '<equality><joint joint1="a" joint2="b"/></equality>\n</mujoco>'
        ),
        ("there is nothing of the name 'b'", "MuJoCo's XML reference"),
        5,
    ),
    Case(
        "a body with too many joints",
        mjcf(of_mujoco("<freejoint/>", "<joint/>")),
        ("body 'arm' has more than 6 degrees of freedom",),
        3,
    ),
    Case(
        "a keyframe with too few numbers",
        mjcf(of_mujoco("<joint/>")).replace(
            "</mujoco>", '<keyframe><key name="home" qpos="1 2"/></keyframe></mujoco>'
        ),
        ("'home': its qpos has 2 numbers", "it must have 1"),
        5,
    ),
    Case(
        "a body without mass",
        mjcf('<body name="arm"><joint/></body>'),
        holds=lambda m: m.bodies["arm"].mass is None,
    ),
    Case(
        "elements nested 600 deep",
        mjcf("<body>" * 600 + "</body>" * 600),
        ("nested more than 100 deep",),
        3,
    ),
]
"""MuJoCo's compiler runs for each of them, so each is read in one encoding."""
MJCF_CASES = [replace(case, suffix=".mjcf", any_encoding=False) for case in MJCF_CASES]


def sdf(*lines: str, version: str = "1.9") -> str:
    """An SDF text with a model; the given lines come after its links, on lines 5, 6, ..."""
    links = '<link name="base"/><link name="arm"/>\n<link name="hand"/>\n'
    inside = links + "".join(f"{line}\n" for line in lines)
    return f'<sdf version="{version}">\n<model name="m">\n{inside}</model>\n</sdf>\n'


AXIS = "<axis><xyz>0 0 1</xyz></axis>"


def sdf_joint(
    name: str = "elbow",
    inside: str = AXIS,
    kind: str = "revolute",
    parent: str = "base",
    child: str = "arm",
) -> str:
    """A <joint> of SDF on one line."""
    ends = f"<parent>{parent}</parent><child>{child}</child>"
    return f'<joint name="{name}" type="{kind}">{ends}{inside}</joint>'


def sdf_axis(inside: str) -> str:
    """A joint with this axis."""
    return sdf_joint(inside=f"<axis>{inside}</axis>")


SDF_CASES = [
    Case(
        "an external entity in a DTD",
        '<!DOCTYPE sdf [<!ENTITY x SYSTEM "file:///etc/passwd">]>\n' + sdf(),
        ("DTD", "remove it"),
        1,
    ),
    Case("an entity that nobody declared", sdf('<link name="&x;"/>'), ("entity", "&amp;"), 5),
    Case("a file that ends too soon", sdf()[:-20], ("the file ends inside", "truncated"), 4),
    Case("a file that is no SDF", "<robot/>", ("<robot>: it is a file in URDF", "<sdf"), 1),
    Case("no version", "<sdf><model/></sdf>", ("it has no version", "from 1.2 to 1.12"), 1),
    Case("a version to come", sdf(version="1.13"), ("version is '1.13'", "from 1.2 to 1.12"), 1),
    Case("a version that is none", sdf(version="new"), ("version is 'new'", "must be one"), 1),
    Case("no model", "<sdf version='1.9'/>", ("no model in this file", "<model>"), 1),
    Case(
        "a model without links",
        '<sdf version="1.9"><model name="m"/></sdf>',
        ("no link in this file", "at least one <link"),
        1,
    ),
    Case(
        "two models",
        '<sdf version="1.9"><model name="a"/>\n<model name="b"/></sdf>',
        ("0 worlds and 2 models", "choose one by model=: 'a', 'b'"),
        2,
    ),
    Case(
        "a pose of five numbers",
        sdf('<frame name="f"><pose>1 2 3 4 5</pose></frame>'),
        ("frame 'f'", "pose is '1 2 3 4 5': 5 numbers", "6 finite numbers"),
        5,
    ),
    Case(
        "not a number in a pose",
        sdf('<frame name="f"><pose>nan 0 0 0 0 0</pose></frame>'),
        ("frame 'f'", "'nan' is not finite"),
        5,
    ),
    Case(
        "a comma for the decimal point",
        sdf('<frame name="f"><pose>0 0 1,5 0 0 0</pose></frame>'),
        ("decimals take a point: 1.5",),
        5,
    ),
    Case(
        "a quaternion of zeros",
        sdf('<frame name="f"><pose rotation_format="quat_xyzw">0 0 0 0 0 0 0</pose></frame>'),
        ("frame 'f'", "quaternion", "not zero"),
        5,
    ),
    Case(
        "an unknown format of a rotation",
        sdf('<frame name="f"><pose rotation_format="rpy">0 0 0 0 0 0</pose></frame>'),
        ("rotation_format is 'rpy'", "euler_rpy or quat_xyzw"),
        5,
    ),
    Case(
        "a switch that is neither true nor false",
        sdf('<frame name="f"><pose degrees="yes">0 0 0 0 0 0</pose></frame>'),
        ("degrees is 'yes'", "must be true or false"),
        5,
    ),
    Case(
        "a pose relative to a missing frame",
        sdf('<frame name="f"><pose relative_to="hnad">0 0 0 0 0 0</pose></frame>'),
        ("frame 'f'", "relative_to is 'hnad', which is no frame of model 'm'", "'hand'"),
        5,
    ),
    Case(
        "frames that sit on one another",
        sdf('<frame name="f" attached_to="g"/>', '<frame name="g" attached_to="f"/>'),
        ("is attached to itself", "the first one to a link"),
        5,
    ),
    Case(
        "poses that are relative to one another",
        sdf(
            '<link name="x"><pose relative_to="y"/></link>',
            '<link name="y"><pose relative_to="x"/></link>',
        ),
        ("relative to itself: 'x' -> 'y' -> 'x'", "the first one on the model"),
        5,
    ),
    Case(
        "two links of one name",
        sdf('<link name="arm"/>'),
        ("link 'arm'", "another link of this name", "file.sdf:3", "unique"),
        5,
    ),
    Case(
        "a frame with the name of a link",
        sdf('<frame name="arm"/>'),
        ("frame 'arm'", "another link of this name", "unique"),
        5,
    ),
    Case("a link without a name", sdf("<link/>"), ("a link has no name", "name of its own"), 5),
    Case("a reserved name", sdf('<link name="world"/>'), ("'world' is reserved", "rename it"), 5),
    Case(
        "a name with '::'",
        sdf('<link name="a::b"/>'),
        ("its name 'a::b' holds '::'", "rename it"),
        5,
    ),
    Case(
        "a joint to a missing link",
        sdf(sdf_joint(child="amr")),
        ("joint 'elbow'", "its child is 'amr'", "did you mean 'arm'"),
        5,
    ),
    Case(
        "a joint without an end",
        sdf('<joint name="j" type="fixed"><parent>base</parent></joint>'),
        ("joint 'j'", "it has no <child>", "names its parent and its child"),
        5,
    ),
    Case(
        "a joint to the world from a link",
        sdf(sdf_joint(child="world")),
        ("its child is the world", "only be the parent"),
        5,
    ),
    Case(
        "a joint from a link to itself",
        sdf(sdf_joint(child="base")),
        ("connects 'base' to itself", "two links"),
        5,
    ),
    Case(
        "an unknown type of a joint",
        sdf(sdf_joint(kind="revolut")),
        ("unknown type 'revolut'", "did you mean 'revolute'"),
        5,
    ),
    Case(
        "a joint without an axis",
        sdf(sdf_joint(inside="")),
        ("a revolute joint has no <axis>", "write <axis>"),
        5,
    ),
    Case(
        "an axis of zeros",
        sdf(sdf_axis("<xyz>0 0 0</xyz>")),
        ("its axis is '0 0 0'", "must not be zero"),
        5,
    ),
    Case(
        "an axis expressed in a missing frame",
        sdf(sdf_axis("<xyz expressed_in='f'>0 0 1</xyz>")),
        ("expressed_in is 'f', which is no frame",),
        5,
    ),
    Case(
        "swapped limits",
        sdf(sdf_axis("<xyz>0 0 1</xyz><limit><lower>1</lower><upper>-1</upper></limit>")),
        ("limits are swapped: lower 1, upper -1", "must not be above", "lenient_limits=True"),
        5,
    ),
    Case(
        "a slip in the name of an element",
        sdf(sdf_joint(inside="<axs><xyz>0 0 1</xyz></axs>", kind="ball")),
        ("unknown element 'axs'; did you mean 'axis'",),
        5,
    ),
    Case(
        "a slip in the name of an attribute",
        sdf('<frame name="f" atached_to="arm"/>'),
        ("unknown attribute 'atached_to'; did you mean 'attached_to'",),
        5,
    ),
    Case(
        "two axes of one joint",
        sdf(sdf_joint(inside=AXIS + "<axis><xyz>1 0 0</xyz></axis>")),
        ("two <axis> elements", "one is allowed"),
        5,
    ),
    Case(
        "a mimic of a missing joint",
        sdf(
            sdf_joint(),
            sdf_joint("wrist", AXIS[:-7] + "<mimic joint='elbw'/></axis>", child="hand"),
        ),
        ("joint 'wrist'", "mimics joint 'elbw', which does not exist", "'elbow'"),
        6,
    ),
    Case(
        "a negative mass",
        sdf('<link name="x"><inertial><mass>-1</mass></inertial></link>'),
        ("mass is -1", "must not be negative"),
        5,
    ),
    Case(
        "an included model of the internet",
        sdf("<include><uri>https://fuel.gazebosim.org/x</uri></include>"),
        ("it is not on this machine", "download the model"),
        5,
    ),
    Case(
        "an include without a uri",
        sdf("<include/>"),
        ("it has no <uri>", "write <include>"),
        5,
    ),
    Case(
        "two joints that lead to one link (a loop)",
        sdf(sdf_joint(), sdf_joint("a", child="hand"), sdf_joint("b", parent="arm", child="hand")),
        holds=lambda m: len(m.build().structure.closures) == 1,
    ),
    Case(
        "elements of a simulator",
        sdf("<plugin name='p' filename='f'/>", "<gripper name='g'/>", "<x:y/>"),
        note="the element 'gripper' is not read",
        holds=lambda m: any("the element 'x:y' is not read" in n for n in m.notes),
    ),
    Case(
        "a model that nothing ties to the world",
        sdf(sdf_joint()),
        note="nothing ties 'base', 'hand' to the world",
    ),
    Case(
        "a comment with two dashes",
        "<!-- gz sim --headless -->\n" + sdf(),
        note="a comment holds '--'",
    ),
    Case(
        "an axis that is not of unit length",
        sdf(sdf_axis("<xyz>0 0 2</xyz>")),
        note="its axis 0 0 2 has length 2; it was normalised",
    ),
    Case(
        "text with references and comments",
        sdf(sdf_joint(child="a<!-- x -->&#114;m")),
        holds=lambda m: m.joints["elbow"].child == "arm",
    ),
    Case(
        "a model of 3 000 links",
        sdf(*(f'<link name="l{i}"/>' for i in range(3000))),
        holds=lambda m: len(m.bodies) == 3004,
        any_encoding=False,
    ),
    Case(
        "models nested 60 deep",
        sdf(*(f'<model name="m{i}">' for i in range(60)), "</model>" * 60),
        ("nested more than 50 deep", "no robot's file"),
        any_encoding=False,
    ),
    Case("an empty file", "", ("empty", "URDF, TOML"), any_encoding=False),
]
SDF_CASES = [replace(case, suffix=".sdf") for case in SDF_CASES]

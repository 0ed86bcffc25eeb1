"""Robot files of other people, read as their owners read them: Pinocchio, and the file's text by
plain numpy.

The files are those of the package example-robot-data, and all below the folder in
``KEMPE_URDF_FOLDER``, which holds a folder for each package. This file, run as a program with such
a folder, prints the page `docs/collected.md`:
``python tests/description/test_collected.py FOLDER > docs/collected.md``.
"""

from __future__ import annotations

import math
import os
import re
import sys
import xml.etree.ElementTree as ET
from collections import Counter
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pytest
from hunts import some

sys.path.insert(0, str(Path(__file__).parent.parent))

from robots import DATA

import kempe
from kempe.description.read import read_mechanism
from kempe.errors import DescriptionError
from kempe.spatial import quat_wxyz_to_matrix

pin = pytest.importorskip("pinocchio")

FOLDER = os.environ.get("KEMPE_URDF_FOLDER", "")

TYPES = {
    "revolute": "revolute",
    "continuous": "revolute",
    "prismatic": "prismatic",
    "fixed": "fixed",
    "floating": "free",
    "planar": "planar",
    "spherical": "spherical",
}

DIRT = {
    "swapped limits": "its limits are swapped",
    "unexpanded xacro": "xacro",
    "no robot in it": "there is no robot in this file",
    "no XML": "no XML element|this is not XML|truncated|closes <",
    "text before the XML declaration": "not at the very start",
    "several roots": "are nobody's child|no joints lead",
    "a joint of a missing link": "link .* does not exist",
    "a mimic of a missing joint": "it mimics joint .* does not exist",
    "two elements of one name": "there is another",
    "a joint type that URDF lacks": "unknown type",
    "a number that is none": "is not a number|is not finite|numbers? *;|: \\d+ numbers?",
    "an axis of zeros": "it must not be zero",
    "an attribute given twice": "is given twice",
    "a joint from a link to itself": "to itself",
    "a mimic of a joint with several coordinates": "but .* has several coordinates",
}
"""What is wrong with files that are refused, and the words that say so."""


def files(folder: str | Path = FOLDER) -> dict[str, Path]:
    """Files to read, by name: those of example-robot-data, and those below a folder."""
    found = (
        {f"example-robot-data/{p.relative_to(DATA[0])}": p for p in sorted(DATA[0].rglob("*.urdf"))}
        if DATA
        else {}
    )
    if folder:
        root = Path(folder)
        found |= {str(p.relative_to(root)): p for p in sorted(root.rglob("*.urdf"))}
    return found


# ---- the file by plain numpy, from its text alone


class Joint(NamedTuple):
    """A joint as it is written: type, links, placement (4, 4), unit axis, limits, and what it
    follows.
    """

    kind: str
    parent: str
    child: str
    X: np.ndarray
    axis: np.ndarray
    limits: tuple[float, float]
    mimic: tuple[str, float, float] | None


def floats(text: str) -> np.ndarray:
    """The numbers of an attribute."""
    return np.array([float(x) for x in text.split()])


def rotation(axis: np.ndarray, angle: float) -> np.ndarray:
    """Turn about a unit axis (Rodrigues, 1840)."""
    x, y, z = axis
    K = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    return np.eye(3) + math.sin(angle) * K + (1.0 - math.cos(angle)) * K @ K


def written(path: Path) -> dict[str, Joint]:
    """The joints of a file, read without regard to what else is in it."""
    text = re.sub(
        rb"(</?|\s)([A-Za-z_][\w.-]*):(?=[A-Za-z_][\w.-]*[\s=/>])", rb"\1\2_", path.read_bytes()
    )
    out = {}
    for element in ET.fromstring(text.lstrip()).findall("joint"):
        X = np.eye(4)
        origin = element.find("origin")
        axis = np.array([1.0, 0.0, 0.0])
        if origin is not None:
            X[:3, 3] = floats(origin.get("xyz", "0 0 0"))
            roll, pitch, yaw = floats(origin.get("rpy", "0 0 0"))
            ex, ey, ez = np.eye(3)
            X[:3, :3] = rotation(ez, yaw) @ rotation(ey, pitch) @ rotation(ex, roll)
        if element.find("axis") is not None:
            axis = floats(element.find("axis").get("xyz"))
        kind = element.get("type")
        limit = element.find("limit")
        mimic = element.find("mimic")
        bounds = (-math.inf, math.inf)
        if kind in ("revolute", "prismatic") and limit is not None:
            bounds = float(limit.get("lower", 0)), float(limit.get("upper", 0))
        follows = None
        if mimic is not None and kind != "fixed":
            follows = (
                mimic.get("joint"),
                float(mimic.get("multiplier", 1)),
                float(mimic.get("offset", 0)),
            )
        length = np.linalg.norm(axis)
        out[element.get("name")] = Joint(
            kind,
            element.find("parent").get("link"),
            element.find("child").get("link"),
            X,
            axis / length if length else axis,
            bounds,
            follows,
        )
    return out


def values_of(
    joints: dict[str, Joint], system: kempe.System, q: np.ndarray
) -> dict[str, np.ndarray]:
    """Coordinates of each joint that moves, those that follow others by the file's own numbers."""
    named = system.q_dict(q)
    own = {
        n: np.array([named[c] for c in system.structure.coordinates_of_joint(n) if c in named])
        for n, j in joints.items()
        if j.kind != "fixed" and j.mimic is None
    }
    waiting = {n: j.mimic for n, j in joints.items() if j.mimic}
    while waiting:
        ready = [n for n, (source, _, _) in waiting.items() if source in own]
        assert ready, f"no order for {list(waiting)}"
        for n in ready:
            source, factor, offset = waiting.pop(n)
            own[n] = factor * own[source] + offset
    return own


def motion(joint: Joint, x: np.ndarray) -> np.ndarray:
    """Pose (4, 4) of the joint's child frame in its parent frame at its coordinates."""
    M = np.eye(4)
    if joint.kind in ("revolute", "continuous"):
        M[:3, :3] = rotation(joint.axis, x[0])
    elif joint.kind == "prismatic":
        M[:3, 3] = joint.axis * x[0]
    elif joint.kind == "floating":
        M[:3, 3] = x[:3]
        M[:3, :3] = quat_wxyz_to_matrix(x[3:])
    elif joint.kind == "spherical":
        M[:3, :3] = quat_wxyz_to_matrix(x)
    return M


def plain_poses(
    joints: dict[str, Joint], root: str, values: dict[str, np.ndarray]
) -> dict[str, np.ndarray]:
    """Poses of all links that joints lead to from the root; planar joints and what hangs on them
    are left out.
    """
    by_parent: dict[str, list[str]] = {}
    for name, joint in joints.items():
        by_parent.setdefault(joint.parent, []).append(name)
    poses = {root: np.eye(4)}
    waiting = [root]
    while waiting:
        link = waiting.pop()
        for name in by_parent.get(link, ()):
            joint = joints[name]
            if joint.kind != "planar" and joint.child not in poses:
                poses[joint.child] = (
                    poses[link] @ joint.X @ motion(joint, values.get(name, np.zeros(0)))
                )
                waiting.append(joint.child)
    return poses


# ---- Pinocchio


def pinocchio_model(path: Path):
    """The model as Pinocchio reads it, or the reason why it does not."""
    for options in ({"mimic": True}, {}):
        try:
            return pin.buildModelFromUrdf(str(path), **options)
        except (ValueError, RuntimeError, IndexError) as error:
            reason = str(error).splitlines()[0][:100] if str(error) else type(error).__name__
    return reason


def pinocchio_poses(model, values: dict[str, np.ndarray]) -> dict[str, np.ndarray]:
    """Poses of all links by Pinocchio, at coordinates by joint name."""
    q = pin.neutral(model)
    for name, joint in zip(list(model.names)[1:], list(model.joints)[1:], strict=True):
        if joint.shortname() == "JointModelMimic":
            continue
        x = values[name]
        if joint.shortname() == "JointModelFreeFlyer":
            x = np.concatenate([x[:3], x[4:], x[3:4]])  # it puts the scalar part last
        elif len(x) == 1 and joint.nq == 2:
            x = np.array([math.cos(x[0]), math.sin(x[0])])
        elif joint.shortname() == "JointModelPlanar":
            x = np.array([x[0], x[1], math.cos(x[2]), math.sin(x[2])])
        q[joint.idx_q : joint.idx_q + joint.nq] = x
    data = model.createData()
    pin.framesForwardKinematics(model, data, q)
    names = [f.name for f in model.frames if f.type == pin.FrameType.BODY and f.name != "universe"]
    return {n: data.oMf[model.getFrameId(n, pin.FrameType.BODY)].homogeneous for n in names}


# ---- the comparison


class Answer(NamedTuple):
    """What came of a file: "equal" or "refused", by what it was judged, and the reason of a
    refusal.
    """

    kind: str
    judge: str
    reason: str = ""


def judge(path: Path, rng: np.random.Generator) -> Answer:
    """Compare names, types, limits, followers and poses of a file with both judges; differences
    fail.
    """
    try:
        mechanism = read_mechanism(path)
    except DescriptionError as error:
        return Answer("refused", "", str(error.problems[0]).removeprefix(f"{path.parent}/"))
    system = mechanism.build()
    joints = written(path)
    assert {n: j.type.type_name for n, j in mechanism.joints.items()} == {
        n: TYPES[j.kind] for n, j in joints.items()
    }
    assert {n: (j.parent, j.child) for n, j in mechanism.joints.items()} == {
        n: (j.parent, j.child) for n, j in joints.items()
    }
    for name, joint in joints.items():
        if joint.kind in ("revolute", "continuous", "prismatic"):
            mine = next(iter(mechanism.joints[name].limits.values()), (-math.inf, math.inf))
            assert mine == joint.limits, f"limits of {name}"
    loops = len({j.child for j in joints.values()}) < len(joints)
    model = "a loop" if loops else pinocchio_model(path)
    for _ in range(3):
        q = system.random(rng)
        values = values_of(joints, system, q)
        mine = dict(zip(system.body_names, system.fk(q), strict=True))
        others = [plain_poses(joints, system.body_names[0], values)] if not loops else []
        if not isinstance(model, str):
            others.append(pinocchio_poses(model, values))
            assert set(others[-1]) == set(mine)
        scale = max(1.0, *(float(np.abs(X[:3, 3]).max()) for X in mine.values()))
        for poses in others:
            for link, X in poses.items():
                np.testing.assert_allclose(mine[link], X, rtol=0, atol=1e-12 * scale, err_msg=link)
    return Answer("equal", "numpy" if isinstance(model, str) else "Pinocchio")


@pytest.mark.parametrize("path", some(files().values(), 4), ids=list(files()))
def test_files_are_read_as_their_owners_read_them(path, hunt):
    answer = judge(path, hunt.rng())
    if answer.kind == "refused":
        assert any(re.search(words, answer.reason) for words in DIRT.values()), answer.reason


# ---- the page


COLUMNS = ("files", "moving", "equal", "numpy", "refused")

HEAD = """\
# Robot files of other people

The URDF files of the packages below were read by Kempe and by two judges that share no code with it: Pinocchio
{version} and some plain numpy in the test. Equal means: joints of the same types between the same links, with the same
limits and followers, and links in the same places to 1e-12 (of the largest coordinate, at least 1 m) at three random
configurations. The files belong to others and are not part of Kempe; `tests/description/test_collected.py` reads those
of a folder and writes this page. What it reads is equal or refused for a reason that is listed, for every file of
example-robot-data and of such a folder.

| package | files | with joints | equal | of these by numpy alone | refused |
|---|---|---|---|---|---|
"""

REFUSED = """
Files by numpy alone are refused by Pinocchio, since their limits lack the effort or velocity that it asks for.

What Kempe refuses, and why:

| file | what Kempe says | Pinocchio |
|---|---|---|
"""


def page(folder: str | Path) -> str:
    """The text of `docs/collected.md` for a folder with a folder for each package."""
    tally: dict[str, Counter[str]] = {}
    refused = []
    for name, path in files(folder).items():
        row = tally.setdefault(name.split("/")[0], Counter())
        answer = judge(path, np.random.default_rng(len(name)))
        row["files"] += 1
        row[answer.kind] += 1
        row["moving"] += b"<joint" in path.read_bytes()
        row["numpy"] += answer.judge == "numpy"
        if answer.kind == "refused":
            other = "refuses it" if isinstance(pinocchio_model(path), str) else "reads it"
            refused.append(
                f"| {name.split('/')[0]}: {path.name} | `` {answer.reason} `` | {other} |"
            )
    total = Counter[str]()
    for row in tally.values():
        total.update(row)
    lines = [
        f"| {name.replace('_', '-')} | {' | '.join(str(row[k]) for k in COLUMNS)} |"
        for name, row in [*sorted(tally.items()), ("**all**", total)]
    ]
    head = HEAD.format(version=pin.__version__)
    return head + "\n".join(lines) + "\n" + REFUSED + "\n".join(dict.fromkeys(refused)) + "\n"


if __name__ == "__main__":
    print(page(sys.argv[1]), end="")

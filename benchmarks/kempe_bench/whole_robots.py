"""Humanoids with a floating base for the inverse model of whole bodies, the same file for all
libraries.
"""

from __future__ import annotations

import xml.etree.ElementTree as ElementTree
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

import kempe
from kempe import spatial
from kempe.spatial import Array
from kempe_bench import peers

if TYPE_CHECKING:
    from kempe.system import System

GROUND = "world"
FLOATING = "floating_base"
"""Names of the fixed link and of the joint of six freedoms that the files are given: MuJoCo asks
for this link's."""
BASE = 7
"""Coordinates of the base: position, then quaternion, w first."""
MOVED = 0.2
TURNED = 0.3
"""How far the base is from the origin along each axis [m], and about each axis [rad], at most."""
PART = 0.25
"""Part of its range by which a joint is at most away from its place in a posture near standing."""


@dataclass(frozen=True)
class Humanoid:
    """A robot of the package example-robot-data, its feet and its hands."""

    title: str
    file: str
    feet: tuple[str, str]
    hands: tuple[str, str]

    def body(self, folder: Path) -> Body | None:
        """The robot, written to `folder`, or None where its description is not installed."""
        path = peers.robot_file(self.file)
        if path is None:
            return None
        out = folder / f"floating_{self.file}"
        out.write_text(floating(path), encoding="utf-8")
        return Body(out, (*self.feet, *self.hands))


HUMANOIDS = (
    Humanoid(
        "G1",
        "g1_29dof_rev_1_0.urdf",
        ("left_ankle_roll_link", "right_ankle_roll_link"),
        ("left_rubber_hand", "right_rubber_hand"),
    ),
    Humanoid(
        "Talos",
        "talos_reduced.urdf",
        ("left_sole_link", "right_sole_link"),
        ("gripper_left_base_link", "gripper_right_base_link"),
    ),
)
"""The robots."""


@dataclass(frozen=True)
class Body:
    """A robot with a floating base, as its file says; `frames` are held.

    Configurations (..., 7 + joints) are the base's position and quaternion (w first), then the
    joints `names`.
    """

    file: Path
    frames: tuple[str, ...]

    @cached_property
    def system(self) -> System:
        """Kempe's system."""
        return kempe.load(self.file)

    @property
    def names(self) -> tuple[str, ...]:
        """The joints."""
        return tuple(self.system.coordinate_names[BASE:])

    @property
    def limits(self) -> Array:
        """Bounds (joints, 2)."""
        return self.system.structure.limits[-len(self.names) :]

    @property
    def start(self) -> Array:
        """Where all libraries start: the base at the origin, joints at zero or at the limit next to
        it.
        """
        return np.concatenate([[0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0], np.clip(0.0, *self.limits.T)])

    def anywhere(self, n: int, random: np.random.Generator) -> Array:
        """Configurations (n, 7 + joints): joints uniform inside the limits, the base near the
        origin.
        """
        return self._drawn(n, random, *self.limits.T)

    def standing(self, n: int, random: np.random.Generator) -> Array:
        """The same with each joint at most `PART` of its range away from where it is at `start`."""
        lower, upper = self.limits.T
        reach = PART * (upper - lower)
        middle = self.start[BASE:]
        return self._drawn(
            n, random, np.maximum(middle - reach, lower), np.minimum(middle + reach, upper)
        )

    def _drawn(self, n: int, random: np.random.Generator, lower: Array, upper: Array) -> Array:
        p = random.uniform(-MOVED, MOVED, (n, 3))
        w = random.uniform(-TURNED, TURNED, (n, 3))
        quat_wxyz = spatial.matrix_to_quat_wxyz(spatial.exp_so3(w))
        return np.concatenate([p, quat_wxyz, random.uniform(lower, upper, (n, len(lower)))], axis=1)


def floating(path: Path) -> str:
    """URDF text of a robot on a floating base: its links' masses and its joints, nothing to draw,
    nothing coupled.
    """
    root = ElementTree.parse(path).getroot()
    for part in list(root):
        if part.tag not in ("link", "joint"):
            root.remove(part)
    for link in root.iter("link"):
        for part in link.findall("*"):
            if part.tag != "inertial":
                link.remove(part)
    for joint in root.iter("joint"):
        for part in joint.findall("*"):
            if part.tag not in ("parent", "child", "origin", "axis", "limit"):
                joint.remove(part)
    carried = {child.get("link") for child in root.iterfind("joint/child")}
    first = next(
        link.attrib["name"] for link in root.iter("link") if link.get("name") not in carried
    )
    ElementTree.SubElement(root, "link", name=GROUND)
    base = ElementTree.Element("joint", name=FLOATING, type="floating")
    root.insert(0, base)  # so that its coordinates come first
    ElementTree.SubElement(base, "parent", link=GROUND)
    ElementTree.SubElement(base, "child", link=first)
    return ElementTree.tostring(root, encoding="unicode")


# ---- the same robot in the coordinates of other libraries


def pinocchio_body(body: Body) -> tuple[Any, np.ndarray]:
    """Pinocchio's model, and where each of our coordinates is in its own."""
    model = peers.module("pinocchio").buildModelFromUrdf(str(body.file))
    at = model.joints[model.getJointId(FLOATING)].idx_q
    joints = [model.joints[model.getJointId(name)].idx_q for name in body.names]
    return model, np.array([at, at + 1, at + 2, at + 6, at + 3, at + 4, at + 5, *joints])


def mujoco_body(body: Body) -> tuple[Any, np.ndarray]:
    """MuJoCo's model, all links kept, and where each of our coordinates is in its own."""
    root = ElementTree.parse(body.file).getroot()
    settings = ElementTree.SubElement(root, "mujoco")
    ElementTree.SubElement(
        settings, "compiler", fusestatic="false", discardvisual="true", balanceinertia="true"
    )
    model = peers.module("mujoco").MjModel.from_xml_string(
        ElementTree.tostring(root, encoding="unicode")
    )
    at = int(model.joint(FLOATING).qposadr[0])
    return model, np.array(
        [*range(at, at + BASE), *(int(model.joint(name).qposadr[0]) for name in body.names)]
    )


def poses(body: Body, q: Array) -> tuple[Array, Array]:
    """Poses (n, frames, 4, 4) of the frames and centres of mass (n, 3) at q (n, 7 + joints), by
    Pinocchio.
    """
    pin = peers.module("pinocchio")
    model, place = pinocchio_body(body)
    data = model.createData()
    numbers = [model.getFrameId(name) for name in body.frames]
    X = np.empty((len(q), len(numbers), 4, 4))
    centre = np.empty((len(q), 3))
    own = np.empty(model.nq)
    for row, frames, c in zip(q, X, centre, strict=True):
        own[place] = row
        c[:] = pin.centerOfMass(model, data, own)
        for i, number in enumerate(numbers):
            frames[i] = pin.updateFramePlacement(model, data, number).homogeneous
    return X, centre

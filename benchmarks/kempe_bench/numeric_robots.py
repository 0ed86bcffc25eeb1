"""Chains for the numerical inverse model, each written as a URDF file without anything beside it,
the same for all.
"""

from __future__ import annotations

import xml.etree.ElementTree as ElementTree
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path

import numpy as np

import kempe
from kempe import spatial
from kempe.description.urdf_writer import write_urdf
from kempe_bench import peers
from kempe_bench.peers import Link

BASE = "base"
TIP = "tip"
"""Names of the first and the last body of each chain."""
BEND = 2.0
"""Limit of a snake's joints, either way [rad]."""


@dataclass(frozen=True)
class Robot:
    """A chain of the benchmark: where its description comes from, the frame, and how many joints of
    the trunk to drop.

    `file` is a URDF file of the package example-robot-data; without one, `model` is a model of the
    library. A snake is `joints` parallel turns.
    """

    title: str
    file: str = ""
    frame: str = ""
    dropped: int = 0
    model: str = ""
    joints: int = 0

    def arm(self, folder: Path) -> peers.Arm | None:
        """The chain, written to `folder`, or None where its description is not installed."""
        if self.joints:
            return written(self.title, *snake(self.joints), folder)
        path = peers.robot_file(self.file) if self.file else None
        if path is None:
            if not self.model:
                return None
            path = folder / f"{self.model}.urdf"
            path.write_text(write_urdf(kempe.read(self.model)), encoding="utf-8")
        system = kempe.load(path)
        known = (*system.structure.frames, *system.body_names)
        whole = peers.arm_of(system, next(f for f in (self.frame, "tool") if f in known), path)
        return written(self.title, whole.links[self.dropped :], whole.tool, folder)


ROBOTS = (
    Robot("Panda", "panda.urdf", "panda_hand_tcp", model="panda"),
    Robot("UR5", "ur5_robot.urdf", "tool0", model="ur5"),
    Robot("UR10", "ur10_robot.urdf", "tool0"),
    Robot("iiwa 14", model="iiwa14"),
    Robot("Talos torso + arm", "talos_full_v2.urdf", "gripper_left_base_link"),
    Robot("iCub arm", "icub.urdf", "l_hand", dropped=3),
    Robot("TIAGo lift + arm", "tiago.urdf", "arm_tool_link"),
    Robot("Romeo arm", "romeo.urdf", "l_gripper", dropped=1),
    Robot("G1 arm", "g1_29dof_rev_1_0.urdf", "left_rubber_hand", dropped=3),
    Robot("SO-101", "so101.urdf", "gripper_frame_link", model="so101"),
    Robot("planar 10R", joints=10),
    Robot("planar 20R", joints=20),
    Robot("planar 40R", joints=40),
)
"""The chains."""


def snake(n: int) -> tuple[tuple[Link, ...], spatial.Array]:
    """Links and tool of n parallel turns, one metre long in all."""
    step = spatial.pose(None, [1.0 / n, 0.0, 0.0])
    return tuple(
        Link(f"q{i + 1}", step if i else np.eye(4), False, (-BEND, BEND)) for i in range(n)
    ), step


def written(title: str, links: Iterable[Link], tool: spatial.Array, folder: Path) -> peers.Arm:
    """The chain as a URDF file of its own, read again: its joints are called q1, q2 and so on, its
    frame `TIP`.
    """
    slug = "".join(c if c.isalnum() else "_" for c in title.lower())
    path = folder / f"{slug}_chain.urdf"
    path.write_text(urdf(slug, links, tool), encoding="utf-8")
    return peers.arm_of(kempe.load(path), TIP, path)


def urdf(name: str, links: Iterable[Link], tool: spatial.Array) -> str:
    """URDF text of a chain: numbers with all their digits, each body a ball of one kilogram, fast
    motors.
    """
    root = ElementTree.Element("robot", name=name)
    parent = BASE
    ElementTree.SubElement(root, "link", name=BASE)
    for i, link in enumerate(links, start=1):
        child = _body(root, f"body{i}")
        joint = _joint(
            root, f"q{i}", "prismatic" if link.slides else "revolute", parent, child, link.X
        )
        ElementTree.SubElement(joint, "axis", xyz="0 0 1")
        lower, upper = (repr(float(x)) for x in link.limits)
        ElementTree.SubElement(
            joint, "limit", lower=lower, upper=upper, effort="1000", velocity="1000"
        )
        parent = child
    _joint(root, "tool", "fixed", parent, _body(root, TIP), tool)
    return ElementTree.tostring(root, encoding="unicode")


def _body(root: ElementTree.Element, name: str) -> str:
    inertial = ElementTree.SubElement(ElementTree.SubElement(root, "link", name=name), "inertial")
    ElementTree.SubElement(inertial, "mass", value="1")
    ElementTree.SubElement(
        inertial, "inertia", ixx="1", ixy="0", ixz="0", iyy="1", iyz="0", izz="1"
    )
    return name


def _joint(
    root: ElementTree.Element, name: str, kind: str, parent: str, child: str, X: spatial.Array
) -> ElementTree.Element:
    joint = ElementTree.SubElement(root, "joint", name=name, type=kind)
    ElementTree.SubElement(joint, "parent", link=parent)
    ElementTree.SubElement(joint, "child", link=child)
    xyz = X[:3, 3]
    rpy = spatial.matrix_to_rpy(X[:3, :3])
    ElementTree.SubElement(joint, "origin", xyz=_numbers(xyz), rpy=_numbers(rpy))
    return joint


def _numbers(values: Iterable[float]) -> str:
    return " ".join(repr(float(x)) for x in values)

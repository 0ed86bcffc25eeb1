"""Real robots: the files of the package example-robot-data, as other libraries read them."""

from __future__ import annotations

import sys
import xml.etree.ElementTree as ET
from pathlib import Path

DATA = sorted(
    Path(sys.prefix).glob("lib/python*/site-packages/cmeel.prefix/share/example-robot-data/robots")
)

BROKEN = {"ur3.urdf", "alex_psyonic_hands.urdf"}
"""Files without links, or that mimic a joint which does not exist."""


def urdf_files() -> dict[str, Path]:
    """All URDF files by their path inside the package; empty where it is not installed."""
    return {str(p.relative_to(DATA[0])): p for p in sorted(DATA[0].rglob("*.urdf"))} if DATA else {}


def good_urdf_files() -> dict[str, Path]:
    """Those that describe a robot."""
    return {name: path for name, path in urdf_files().items() if path.name not in BROKEN}


def mimics(path: Path) -> dict[str, tuple[str, float, float]]:
    """Joints that follow another, as written: source, multiplier, offset."""
    found = {}
    for joint in ET.parse(path).getroot().findall("joint"):
        mimic = joint.find("mimic")
        if mimic is not None and joint.get("type") != "fixed":
            source = mimic.get("joint")
            factor = mimic.get("multiplier", "1")
            offset = mimic.get("offset", "0")
            found[joint.get("name")] = (source, float(factor), float(offset))
    return found


def mujoco_text(path: Path) -> str:
    """The file as MuJoCo can read it: links with some inertia, joints, nothing to draw."""
    root = ET.parse(path).getroot()
    for element in list(root):
        if element.tag not in ("link", "joint"):
            root.remove(element)
    for link in root.iter("link"):
        for part in list(link):
            link.remove(part)
        inertial = ET.SubElement(link, "inertial")
        ET.SubElement(inertial, "mass", value="1")
        ET.SubElement(inertial, "inertia", ixx="1", iyy="1", izz="1", ixy="0", ixz="0", iyz="0")
    for joint in root.iter("joint"):
        for tag in ("limit", "mimic", "dynamics", "calibration", "safety_controller"):
            for part in joint.findall(tag):
                joint.remove(part)
        if joint.get("type") == "revolute":
            joint.set("type", "continuous")
        if joint.get("type") == "prismatic":
            ET.SubElement(joint, "limit", lower="-1e6", upper="1e6", effort="1", velocity="1")
    ET.SubElement(
        ET.SubElement(root, "mujoco"), "compiler", fusestatic="false", discardvisual="true"
    )
    return ET.tostring(root, encoding="unicode")

"""The other libraries, where they are installed, and the robots on which all of them are compared."""

from __future__ import annotations

import importlib
import importlib.metadata
import importlib.util
import os
import platform
import xml.etree.ElementTree as ElementTree
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from kempe import spatial
from kempe.errors import UnknownNameError

if TYPE_CHECKING:
    from kempe.system import System

PEERS = {
    "pin": "pinocchio",
    "mujoco": "mujoco",
    "roboticstoolbox-python": "roboticstoolbox",
    "ikpy": "ikpy",
    "pytorch-kinematics": "pytorch_kinematics",
    "exudyn": "exudyn",
    "drake": "pydrake",
    "pylinkage": "pylinkage",
    "EAIK": "eaik",
    "ik-geo": "ik_geo",
    "ssik": "ssik",
    "py-opw-kinematics": "py_opw_kinematics",
    "optik-py": "optik",
    "pytracik": "pytracik",
    "roboplan": "roboplan",
    "klampt": "klampt",
    "mink": "mink",
    "pin-pink": "pink",
    "placo": "placo",
    "ompl": "ompl",
}
"""Package name and module name of each peer."""


def installed(wanted: list[str] | None = None) -> dict[str, str]:
    """Versions of the peers that are installed (of those `wanted`, if given). Errors:
    `UnknownNameError`.
    """
    for name in wanted or ():
        if name not in PEERS:
            raise UnknownNameError("peer", name, PEERS)
    names = PEERS if wanted is None else wanted
    return {
        n: importlib.metadata.version(n)
        for n in names
        if importlib.util.find_spec(PEERS[n]) is not None
    }


def robot_file(name: str) -> Path | None:
    """Path of a URDF file of the package example-robot-data, or None where it is not installed."""
    try:
        files = importlib.metadata.files("example-robot-data") or []
    except importlib.metadata.PackageNotFoundError:
        return None
    found = [Path(str(f.locate())) for f in files if Path(str(f)).name == name]
    return next((path for path in found if path.is_file()), None)


def machine() -> str:
    """Processor, number of usable processors, versions and variant of the kernels of the machine
    that measures.
    """
    from kempe.kernels.compiled import VARIANT
    from kempe.numerics.pool import count_processors

    model = platform.processor() or platform.machine()
    cpuinfo = Path("/proc/cpuinfo")
    if cpuinfo.exists():
        lines = [x for x in cpuinfo.read_text().splitlines() if x.startswith("model name")]
        model = lines[0].split(":", 1)[1].strip() if lines else model
    system = f"{platform.system()} {platform.machine()}, Python {platform.python_version()}"
    return f"{model}, {count_processors()} processors; {system}, numpy {np.__version__}, kernels {VARIANT}"


def load() -> float:
    """Processes that wanted to run in the last minute, on average: above 1 or 2, figures are of a
    busy machine.
    """
    return os.getloadavg()[0] if hasattr(os, "getloadavg") else float("nan")


def module(name: str) -> Any:
    """A peer's module, imported when it is needed."""
    return importlib.import_module(name)


# ---- the same arm for everybody


@dataclass(frozen=True)
class Link:
    """A moving joint of a serial chain: the placement before it, whether it slides along z, its
    limits.
    """

    name: str
    X: spatial.Array
    slides: bool
    limits: tuple[float, float]


@dataclass(frozen=True)
class Arm:
    """A serial chain written out: the moving joints from the ground to a frame, then the placement
    `tool`.
    """

    system: System
    frame: str
    links: tuple[Link, ...]
    tool: spatial.Array
    file: Path

    def pose(self, q: spatial.Array) -> spatial.Array:
        """Pose (n, 4, 4) of the frame for q (n, number of joints) by plain products: an independent
        check.
        """
        out = np.broadcast_to(np.eye(4), (len(q), 4, 4))
        for i, link in enumerate(self.links):
            motion = spatial.pose(None if link.slides else spatial.rot_z(q[:, i]))
            if link.slides:
                motion = np.broadcast_to(motion, (len(q), 4, 4)).copy()
                motion[:, 2, 3] = q[:, i]
            out = out @ link.X @ motion
        return out @ self.tool

    @property
    def limits(self) -> spatial.Array:
        """Bounds (number of joints, 2)."""
        return np.array([link.limits for link in self.links])

    def random(self, n: int) -> spatial.Array:
        """Configurations (n, number of joints), uniform inside the limits, the same ones each time."""
        return self.system.random(1, n)


def arm_of(system: System, frame: str, file: Path) -> Arm:
    """The chain to a frame, everything beside it locked, written out for libraries that take chains
    only.
    """
    body = system.structure.frames[frame].body if frame in system.structure.frames else frame
    path = []
    number = system.body_names.index(body)
    while number:
        path.append(system.structure.joints[system.structure.parent_joints[number - 1]])
        number = system.parent[number - 1]
    path.reverse()
    beside = set(system.coordinate_names) - {j.name for j in path}
    limits = dict(zip(system.coordinate_names, system.structure.limits.tolist(), strict=True))
    system = system.mechanism.lock({n: float(np.clip(0.0, *limits[n])) for n in beside}).build()
    links = []
    X = np.eye(4)
    for joint in path:
        X = X @ joint.X_PF.evaluate_pose(system.structure.parameters)
        if joint.type.type_name != "fixed":
            low, high = limits[joint.name]
            links.append(Link(joint.name, X, joint.type.type_name == "prismatic", (low, high)))
            X = np.eye(4)
        X = X @ spatial.inverse(joint.X_CM.evaluate_pose(system.structure.parameters))
    tool = (
        system.structure.frames[frame].X_BF.evaluate_pose(system.structure.parameters)
        if frame in system.structure.frames
        else np.eye(4)
    )
    return Arm(system, frame, tuple(links), X @ tool, file)


def pinocchio_arm(arm: Arm) -> tuple[Any, Any, int]:
    """Pinocchio's model, data and frame number of the arm, with everything beside it locked."""
    pin = module("pinocchio")

    model = pin.buildModelFromUrdf(str(arm.file))
    keep = {link.name for link in arm.links}
    lock = [model.getJointId(n) for n in list(model.names)[1:] if n not in keep]
    model = pin.buildReducedModel(model, lock, pin.neutral(model))
    return model, model.createData(), model.getFrameId(arm.frame)


def mujoco_model(file: Path) -> tuple[Any, Any]:
    """MuJoCo's model and data of a URDF file: without shapes, with inertias, with all links kept."""
    mujoco = module("mujoco")

    root = ElementTree.parse(file).getroot()
    for link in root.iter("link"):
        for tag in ("visual", "collision", "inertial"):
            for child in link.findall(tag):
                link.remove(child)
        inertial = ElementTree.SubElement(link, "inertial")
        ElementTree.SubElement(inertial, "mass", value="1")
        ElementTree.SubElement(
            inertial, "inertia", ixx="1", ixy="0", ixz="0", iyy="1", iyz="0", izz="1"
        )
    settings = ElementTree.SubElement(root, "mujoco")
    ElementTree.SubElement(settings, "compiler", fusestatic="false", discardvisual="true")
    model = mujoco.MjModel.from_xml_string(ElementTree.tostring(root, encoding="unicode"))
    return model, mujoco.MjData(model)


def toolbox_arm(arm: Arm) -> Any:
    """The arm as an elementary transform sequence of roboticstoolbox."""
    toolbox = module("roboticstoolbox")
    ET = toolbox.ET
    ETS = toolbox.ETS

    out = []
    for i, link in enumerate(arm.links):
        joint = ET.tz if link.slides else ET.Rz
        out += [ET.SE3(link.X), joint(jindex=i, qlim=np.array(link.limits))]
    return ETS([*out, ET.SE3(arm.tool)])


def ikpy_arm(arm: Arm) -> Any:
    """The arm as a chain of ikpy."""
    link_type = module("ikpy.link").URDFLink
    links: list[Any] = [module("ikpy.link").OriginLink()]
    for link in arm.links:
        axis = {"translation": [0, 0, 1]} if link.slides else {"rotation": [0, 0, 1]}
        kind = "prismatic" if link.slides else "revolute"
        at = link.X[:3, 3], spatial.matrix_to_rpy(link.X[:3, :3])
        links.append(link_type(link.name, *at, **axis, bounds=link.limits, joint_type=kind))
    links.append(
        link_type(
            "tool", arm.tool[:3, 3], spatial.matrix_to_rpy(arm.tool[:3, :3]), joint_type="fixed"
        )
    )
    return module("ikpy.chain").Chain(
        links, active_links_mask=[False, *(True for _ in arm.links), False]
    )


def torch_arm(arm: Arm) -> Any:
    """The arm as a serial chain of pytorch-kinematics."""
    return module("pytorch_kinematics").build_serial_chain_from_urdf(
        arm.file.read_bytes(), arm.frame
    )

"""Robots with many closed loops as exporters of CAD programs write them: SDF files with link frames
anywhere and every number rounded to so many decimals.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field

import numpy as np

from kempe.spatial import rot_x, rot_y, rot_z, xyz_rpy_from_pose

X, Y, Z = np.eye(3)


@dataclass
class CadFile:
    """An SDF file of links and joints that are placed in the axes of the model, closed at zero."""

    name: str
    digits: int = 6
    links: dict[str, np.ndarray] = field(default_factory=dict[str, np.ndarray])
    joints: list[str] = field(default_factory=list[str])
    rng: np.random.Generator = field(default_factory=lambda: np.random.default_rng(0))

    def link(self, name: str, at: np.ndarray) -> str:
        """Add a link with its frame near a point (3,), turned at random."""
        pose = np.eye(4)
        turn = self.rng.uniform(-1.5, 1.5, 3)
        pose[:3, :3] = rot_z(turn[0]) @ rot_y(turn[1]) @ rot_x(turn[2])
        pose[:3, 3] = at + self.rng.uniform(-0.02, 0.02, 3)
        numbers = np.round(xyz_rpy_from_pose(pose), self.digits)
        pose[:3, :3] = rot_z(numbers[5]) @ rot_y(numbers[4]) @ rot_x(numbers[3])
        pose[:3, 3] = numbers[:3]
        self.links[name] = pose
        return name

    def joint(
        self, name: str, kind: str, parent: str, child: str, at: np.ndarray, *axes: np.ndarray,
        more: str = "",
    ) -> None:  # fmt: skip
        """Add a joint at a point (3,) with its axes, all of them written in the child's frame."""
        inverse = np.linalg.inv(self.links[child])
        place = self._round(inverse[:3, :3] @ at + inverse[:3, 3])
        said = "".join(
            f"<axis{k}><xyz>{self._round(inverse[:3, :3] @ axis)}</xyz></axis{k}>"
            for k, axis in zip(("", "2"), axes, strict=False)
        )
        self.joints.append(
            f'<joint name="{name}" type="{kind}"><pose>{place} 0 0 0</pose>'
            f"<parent>{parent}</parent><child>{child}</child>{said}{more}</joint>"
        )

    def _round(self, numbers: np.ndarray) -> str:
        return " ".join(f"{x:.{self.digits}f}" for x in numbers)

    @property
    def text(self) -> str:
        """The text of the file."""
        links = [
            f'<link name="{name}"><pose>{self._round(xyz_rpy_from_pose(pose))}</pose></link>'
            for name, pose in self.links.items()
        ]
        return "\n".join(
            ['<sdf version="1.7">', f'<model name="{self.name}">', *links, *self.joints,
             "</model>", "</sdf>"]
        )  # fmt: skip


def _add_parallelogram(
    file: CadFile, name: str, base: str, at: np.ndarray, arm: np.ndarray, off: np.ndarray,
    axis: np.ndarray,
) -> tuple[str, str]:  # fmt: skip
    """Add two parallel bars from a base, `off` apart, and what they carry; one loop, one freedom.

    Return the names of the first bar and of what they carry.
    """
    bars = [file.link(f"{name}_{k}", at + i * off + arm / 2) for i, k in enumerate("ab")]
    tip = file.link(f"{name}_tip", at + arm)
    for i, bar in enumerate(bars):
        file.joint(f"{bar}_root", "revolute", base, bar, at + i * off, axis)
        file.joint(f"{bar}_end", "revolute", bar, tip, at + i * off + arm, axis)
    return bars[0], tip


def gripper(fingers: int = 4, digits: int = 5, file: CadFile | None = None, palm: str = "palm",
            at: np.ndarray = 0.0 * X) -> CadFile:  # fmt: skip
    """A gripper whose slider moves all fingers by rods; two loops a finger; one freedom."""
    if file is None:
        file = CadFile(f"gripper with {fingers} fingers", digits)
        file.link(palm, at)
    slider = file.link(f"{palm}_slider", at + 0.021 * Z)
    file.joint(f"{palm}_slide", "prismatic", palm, slider, at + 0.021 * Z, Z)
    for k in range(fingers):
        turn = 2.0 * math.pi * k / fingers + 0.3
        out = math.cos(turn) * X + math.sin(turn) * Y
        axis = np.cross(Z, out)
        name = f"{palm}_finger{k}"
        root = at + 0.0314 * out + 0.0123 * Z
        arm = 0.0411 * out + 0.0523 * Z
        bar, _ = _add_parallelogram(file, name, palm, root, arm, 0.0179 * out - 0.0041 * Z, axis)
        pin = root + 0.37 * arm + 0.0087 * Z - 0.0031 * out
        eye = at + 0.0153 * out + 0.0291 * Z
        rod = file.link(f"{name}_rod", (pin + eye) / 2)
        file.joint(f"{rod}_eye", "revolute", slider, rod, eye, axis)
        file.joint(f"{rod}_pin", "revolute", rod, bar, pin, axis)
    return file


def humanoid(digits: int = 6) -> CadFile:
    """A humanoid with 12 loops: rods at both ankles, the waist and the neck, four-bars at knees
    and elbows; 24 freedoms.
    """
    file = CadFile("humanoid with rods", digits)
    pelvis = file.link("pelvis", 0.0 * X)

    def add_pair_of_rods(
        name: str, base: str, moved: str, at: np.ndarray, from_: float, side: np.ndarray
    ) -> None:
        """A universal joint that two cranks turn by rods: two loops, two freedoms."""
        file.joint(name, "universal", base, moved, at, Y, X)
        for k, s in (("l", 1.0), ("r", -1.0)):
            pivot = at + from_ * Z + s * 0.0373 * side
            knob = pivot + 0.0417 * X + 0.0023 * Z
            eye = at + 0.0391 * X + s * 0.0337 * side + 0.0112 * Z
            crank = file.link(f"{name}_{k}_crank", pivot)
            rod = file.link(f"{name}_{k}_rod", (knob + eye) / 2)
            file.joint(f"{crank}_turn", "revolute", base, crank, pivot, Y)
            file.joint(f"{rod}_knob", "universal", crank, rod, knob, Y, X)
            file.joint(f"{rod}_eye", "ball", rod, moved, eye)

    def add_driven_hinge(name: str, base: str, moved: str, at: np.ndarray) -> None:
        """A hinge that a crank turns by a link, all axes parallel: one loop, one freedom."""
        file.joint(name, "revolute", base, moved, at, Y)
        pivot = at + 0.1431 * Z + 0.0117 * X
        knob = pivot + 0.0353 * X - 0.0071 * Z
        eye = at + 0.0419 * X + 0.0123 * Z
        crank = file.link(f"{name}_crank", pivot)
        rod = file.link(f"{name}_rod", (knob + eye) / 2)
        file.joint(f"{crank}_turn", "revolute", base, crank, pivot, Y)
        file.joint(f"{rod}_knob", "revolute", crank, rod, knob, Y)
        file.joint(f"{rod}_eye", "revolute", rod, moved, eye, Y)

    for side, s in (("left", 1.0), ("right", -1.0)):
        hip = s * 0.0871 * Y - 0.0412 * Z
        file.link(f"{side}_hip", hip)
        file.link(f"{side}_thigh", hip - 0.15 * Z)
        file.link(f"{side}_shin", hip - 0.48 * Z)
        file.link(f"{side}_foot", hip - 0.73 * Z)
        file.joint(f"{side}_hip_yaw", "revolute", pelvis, f"{side}_hip", hip, Z)
        file.joint(f"{side}_hip_joint", "universal", f"{side}_hip", f"{side}_thigh", hip, X, Y)
        add_driven_hinge(f"{side}_knee", f"{side}_thigh", f"{side}_shin", hip - 0.3317 * Z)
        ankle = hip - 0.6623 * Z
        add_pair_of_rods(f"{side}_ankle", f"{side}_shin", f"{side}_foot", ankle, 0.1913, Y)
    torso = file.link("torso", 0.2 * Z)
    add_pair_of_rods("waist", pelvis, torso, 0.0813 * Z, -0.0719, Y)
    head = file.link("head", 0.55 * Z)
    add_pair_of_rods("neck", torso, head, 0.4917 * Z, -0.1133, 0.7 * Y)
    for side, s in (("left", 1.0), ("right", -1.0)):
        shoulder = s * 0.1923 * Y + 0.4121 * Z
        file.link(f"{side}_shoulder", shoulder)
        file.link(f"{side}_upper_arm", shoulder - 0.1 * Z)
        file.link(f"{side}_forearm", shoulder - 0.35 * Z)
        file.joint(f"{side}_shoulder_pitch", "revolute", torso, f"{side}_shoulder", shoulder, Y)
        file.joint(
            f"{side}_shoulder_joint", "universal", f"{side}_shoulder", f"{side}_upper_arm",
            shoulder, X, Z,
        )  # fmt: skip
        elbow = shoulder - 0.2411 * Z
        add_driven_hinge(f"{side}_elbow", f"{side}_upper_arm", f"{side}_forearm", elbow)
    return file


def mobile_robot(digits: int = 6) -> CadFile:
    """A robot with 11 loops, as PR2 has them: a torso on a screw, two grippers of five loops; 29
    freedoms.
    """
    file = CadFile("mobile robot with two grippers", digits)
    base = file.link("base", 0.0 * X)
    for k, (x, y) in enumerate(((1, 1), (1, -1), (-1, 1), (-1, -1))):
        at = 0.2246 * (x * X + y * Y) + 0.0282 * Z
        caster = file.link(f"caster{k}", at)
        file.joint(f"caster{k}_turn", "revolute", base, caster, at, Z)
        for side, s in (("l", 1.0), ("r", -1.0)):
            wheel = file.link(f"caster{k}_{side}", at)
            file.joint(f"caster{k}_{side}_roll", "revolute", caster, wheel, at + s * 0.049 * Y, Y)
    torso = file.link("torso", 0.74 * Z - 0.05 * X)
    screw = file.link("torso_screw", 0.5 * Z - 0.15 * X)
    file.joint("torso_lift", "prismatic", base, torso, 0.7397 * Z - 0.05 * X, Z)
    file.joint("torso_motor", "revolute", base, screw, 0.5 * Z - 0.15 * X, Z)
    pitch = "<screw_thread_pitch>-0.002</screw_thread_pitch>"
    file.joint("torso_nut", "screw", screw, torso, 0.5 * Z - 0.15 * X, Z, more=pitch)
    for side, s in (("left", 1.0), ("right", -1.0)):
        link = torso
        at = s * 0.188 * Y + 0.74 * Z
        for k, (axis, step) in enumerate(
            ((Z, 0.1 * X), (Y, 0.0 * X), (X, 0.4 * X), (Y, 0.0 * X), (X, 0.321 * X), (Y, 0.0 * X),
             (X, 0.05 * X))
        ):  # fmt: skip
            at = at + step
            below = link
            link = file.link(f"{side}_arm{k}", at)
            file.joint(f"{side}_arm{k}_turn", "revolute", below, link, at, axis)
        gripper(2, digits, file, link, at)
        motor = file.link(f"{side}_motor", at)
        nut = "<screw_thread_pitch>0.0032</screw_thread_pitch>"
        file.joint(f"{side}_motor_turn", "revolute", link, motor, at - 0.01 * Z, Z)
        file.joint(f"{side}_nut", "screw", motor, f"{link}_slider", at - 0.01 * Z, Z, more=nut)
    return file

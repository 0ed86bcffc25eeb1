"""Conversion of several joints of one body to one joint: a product of rotations and translations.

Where axes are oblique or do not meet, the product has turns and slides between them that are held.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np

from kempe.joints import make_joint_type
from kempe.poses import Placement, place
from kempe.spatial import Array, matrix_to_rpy, pose

EXACT = 1e-14
"""Differences of directions up to here are rounding."""


class Product(NamedTuple):
    """Product of elementary motions, with its frames: `first` on the parent, `last` on the body.

    `names` are its coordinates, `of_joint` the (first) coordinate of each joint, `held` the values
    of those that are constant.
    """

    words: str
    first: Placement
    last: Placement
    names: tuple[str, ...]
    of_joint: list[int]
    held: dict[int, float]


class _Factors:
    """Factors of a product of elementary motions, and the pose that they have reached."""

    def __init__(self, R: Array, p: Array):
        self.R = R
        self.p = p
        self.words: list[str] = []
        self.count = 0
        self.held: dict[int, float] = {}

    def add_factor(self, word: str, value: float | None = None) -> int:
        """Append a factor and return the index of its coordinate.

        A factor with a `value` is constant.
        """
        at = self.count
        self.words.append(word)
        self.count += 4 if word == "S" else 1
        if value is not None:
            self.held[at] = value
        return at

    def go_to_joint(self, joint: dict[str, Any]) -> int:
        """Append constant motions up to a frame of a joint; return the joint's axis (0, 1, 2)."""
        local = self.R.T @ np.array(joint["axis"])
        if joint["kind"] != "slide":
            d = self.R.T @ (np.array(joint["pos"]) - self.p)
            if joint["kind"] == "hinge":  # any point of the axis will do
                d -= (d @ local) * local
            for letter, x in zip("xyz", d.tolist(), strict=True):
                if abs(x) > EXACT:
                    self.add_factor(f"P({letter})", x)
            self.p = self.p + self.R @ d
        if joint["kind"] == "ball":
            # a ball's quaternion is read in the axes of the body
            roll, pitch, yaw = matrix_to_rpy(self.R.T).tolist()
            self.add_turn(2, yaw)
            self.add_turn(1, pitch)
            self.add_turn(0, roll)
            return 2
        for letter in range(3):
            if np.abs(local - np.eye(3)[letter]).max() <= EXACT:
                return letter
        letter = int(np.abs(local).argmax())
        m, n = (letter + 1) % 3, (letter + 2) % 3
        self.add_turn(n, math.atan2(local[m], local[letter]))
        self.add_turn(m, math.atan2(-local[n], math.hypot(local[letter], local[m])))
        return letter

    def add_turn(self, letter: int, angle: float) -> None:
        """Append a constant rotation by `angle` [rad] about axis `letter` (0, 1, 2 for x, y, z)."""
        if abs(angle) > EXACT:
            self.add_factor(f"R({'xyz'[letter]})", angle)
            self.R = self.R @ _make_rotation(letter, angle)


def make_product(joints: Sequence[dict[str, Any]], qpos0: Sequence[float]) -> Product:
    """Return the product of the joints of one body: hinges, slides, and perhaps a ball at the end.

    A joint moves the body by N E(q - ref) N^-1, where N is a frame on its axis and E its turn or
    slide: from one N to the next lead constant slides and turns, of which `make_axes_frame` needs few.
    """
    axes = [np.array(j["axis"]) for j in joints if j["kind"] != "ball"]
    turning = [np.array(j["pos"]) for j in joints if j["kind"] != "slide"]
    has_ball = len(axes) < len(joints)
    f = _Factors(
        np.eye(3) if has_ball else make_axes_frame(axes), turning[0] if turning else np.zeros(3)
    )
    first = place(pose(f.R, f.p))
    of_joint: list[int] = []
    back = Placement()
    for k, joint in enumerate(joints):
        letter = f.go_to_joint(joint)
        if joint["kind"] == "ball":
            of_joint.append(f.add_factor("S"))
            back = Placement()
            continue
        kind = "P" if joint["kind"] == "slide" else "R"
        ref = float(qpos0[int(joint["address"])])
        name = "xyz"[letter]
        # slides that no turn precedes can change places
        ahead = kind == "P" and all(word.startswith("P") for word in f.words)
        if ref and (ahead or not f.words):
            first = first @ _make_step(kind, name, -ref)
            ref = 0.0
        of_joint.append(f.add_factor(f"{kind}({name})"))
        back = _make_step(kind, name, ref)
        if ref and k < len(joints) - 1:
            f.add_factor(f"{kind}({name})", -ref)
    words = " ".join(f.words)
    last = place(pose(f.R, f.p)) @ back
    return Product(
        words, first, last, make_joint_type(words).list_coordinate_names(), of_joint, f.held
    )


def _make_step(kind: str, letter: str, x: float) -> Placement:
    """Return a constant rotation [rad] or translation [m] along an axis as a placement."""
    return Placement(((letter if kind == "P" else f"r{letter}", (x,)),)) if x else Placement()


def make_axes_frame(axes: Sequence[Array]) -> Array:
    """Return a rotation (3, 3) whose columns are as many of the axes as possible.

    An axis goes to the column of its largest component where that is free.
    """
    columns: dict[int, Array] = {}
    for a in axes:
        if len(columns) < 3 and all(abs(a @ c) <= EXACT for c in columns.values()):
            own = int(np.abs(a).argmax())
            letter = own if own not in columns else min({0, 1, 2} - set(columns))
            columns[letter] = a
    if len(columns) == 1:
        (letter,) = columns
        a = columns[letter]
        free = (letter + 1) % 3
        other = np.eye(3)[free]
        other = other - (other @ a) * a if abs(other @ a) < 0.9 else np.eye(3)[letter]
        other = other - (other @ a) * a
        columns[free] = other / np.linalg.norm(other)
    if len(columns) == 2:
        (missing,) = {0, 1, 2} - set(columns)
        columns[missing] = np.cross(columns[(missing + 1) % 3], columns[(missing + 2) % 3])
    R = np.column_stack([columns[k] for k in range(3)])
    if np.linalg.det(R) < 0.0:
        R[:, [1, 2]] = R[:, [2, 1]]
    return R


def _make_rotation(letter: int, angle: float) -> Array:
    """Return the rotation (3, 3) by an angle [rad] about axis `letter` (0, 1, 2 for x, y, z)."""
    c, s = math.cos(angle), math.sin(angle)
    R = np.eye(3)
    m, n = (letter + 1) % 3, (letter + 2) % 3
    R[m, m] = R[n, n] = c
    R[n, m] = s
    R[m, n] = -s
    return R

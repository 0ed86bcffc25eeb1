"""Serial arms of every class, each as a `kempe.System` and as lines in numpy
(`analytic_oracle.Model`).

`ARMS` is the table for any test: published robots, random ones, calibrated ones, all joint types.
`COUNTS` holds how many solutions random poses have, by the oracle.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field, replace
from functools import cache, cached_property

import analytic_oracle as oracle
import numpy as np
import reference

import kempe
from kempe.description.dh import from_dh
from kempe.poses import make_placement_from_pose

PI = math.pi
H = math.pi / 2
NEG = -H
FREE = (-math.inf, math.inf)


@dataclass(frozen=True)
class Joint:
    """A joint placed as in URDF. `follow` = (multiplier, offset) lets it follow a motor beside the
    chain.
    """

    kind: str = "revolute"
    at: tuple[float, ...] = (0.0, 0.0, 0.0)
    rpy: tuple[float, ...] = (0.0, 0.0, 0.0)
    axis: tuple[float, ...] = (0.0, 0.0, 1.0)
    limits: object = None
    follow: tuple[float, float] | None = None
    options: dict = field(default_factory=dict)


@dataclass(frozen=True, eq=False)
class Arm:
    """A chain from the ground to `frame`.

    `task` is what a target of it asks for by default, `axis` the tool's for tasks that ask for a
    direction; `classes` are words by which tests pick arms; `bound` is the largest number of
    isolated solutions known for its class (16 for six turns: Lee and Liang, 1988; 8 for a spherical
    wrist or three parallel axes: Pieper, 1968). `held` names coordinates to hold where the chain is
    redundant.
    """

    name: str
    mechanism: Callable[[], kempe.Mechanism]
    steps: tuple
    classes: tuple[str, ...]
    bound: int
    frame: str = "tool"
    task: str = "pose"
    held: tuple[str, ...] = ()
    axis: tuple[float, float, float] = (0.0, 0.0, 1.0)

    def __str__(self) -> str:
        return self.name

    @cached_property
    def system(self) -> kempe.System:
        return self.mechanism().build()

    @cached_property
    def model(self) -> oracle.Model:
        return oracle.from_steps(self.steps, self.system.coordinate_names)

    def random(self, seed, number: int) -> np.ndarray:
        """Configurations (number, nq) anywhere, lengths within half a metre, joint limits ignored."""
        rng = np.random.default_rng(seed)
        q = rng.uniform(-PI, PI, (number, self.system.nq))
        slides = np.zeros(self.system.nq, dtype=bool)
        slides[self.model.index[self.model.kinds == oracle.SLIDE]] = True
        return np.where(slides, q * (0.5 / PI), q)

    def inside(self, seed, number: int) -> np.ndarray:
        """Configurations (number, nq) inside the limits."""
        return self.system.random(np.random.default_rng(seed), number)


# ---------------------------------------------------------------- makers


def table(
    name: str, rows, classes: str, bound: int, convention="standard", base=None, tool=None, **more
) -> Arm:
    """Arm of a Denavit-Hartenberg table; rows are (a, alpha, d, theta[, type[, limits]])."""
    keys = ("a", "alpha", "d", "theta", "type", "limits")
    dicts = [dict(zip(keys, r, strict=False)) for r in rows]
    steps = oracle.dh_steps(
        ({k: v for k, v in r.items() if k != "limits"} for r in dicts), convention, base, tool
    )
    return Arm(
        name,
        lambda: from_dh(dicts, convention, name, _floats(base), _floats(tool)),
        tuple(steps),
        tuple(classes.split()),
        bound,
        **more,
    )


def _floats(X):
    return None if X is None else np.asarray(X, dtype=float)


def joints(
    name: str,
    rows: list[Joint],
    classes: str,
    bound: int,
    tool=((0, 0, 0), (0, 0, 0)),
    dim=3,
    **more,
) -> Arm:
    """Arm of joints placed as in URDF, named j1, j2, ..."""

    def build() -> kempe.Mechanism:
        m = kempe.Mechanism(name, dim=dim)
        last = m.ground
        for i, r in enumerate(rows, 1):
            body = m.body(f"b{i}")
            turn = {"angle": r.rpy[2]} if dim == 2 else {"rpy": r.rpy}
            axis = {} if r.axis == (0.0, 0.0, 1.0) else {"axis": r.axis}
            m.joint(
                f"j{i}",
                r.kind,
                last,
                body,
                at=r.at[:dim],
                limits=r.limits,
                **turn,
                **axis,
                **r.options,
            )
            if r.follow:
                m.joint(
                    f"motor{i}", "revolute", m.ground, m.body(f"rotor{i}"), at=(1.0, 0.1 * i, 0.0)
                )
                m.couple(f"j{i}", {f"motor{i}": r.follow[0]}, r.follow[1])
            last = body
        m.frame(
            "tool",
            last,
            at=tool[0][:dim],
            **({"angle": tool[1][2]} if dim == 2 else {"rpy": tool[1]}),
        )
        return m

    steps: list = []
    for i, r in enumerate(rows, 1):
        name_of = f"motor{i}" if r.follow else f"j{i}"
        steps += oracle.joint_steps(r.kind, name_of, r.at, r.rpy, r.axis, *(r.follow or (1.0, 0.0)))
    steps.append(("X", reference.placement(*tool)))
    return Arm(name, build, tuple(steps), tuple(classes.split()), bound, **more)


def shipped(name: str, frame: str, classes: str, bound: int, **more) -> Arm:
    """An arm of the library."""
    return Arm(
        name,
        lambda: kempe.read(name),
        tuple(oracle.library_steps(name, frame)),
        tuple(classes.split()),
        bound,
        frame=frame,
        **more,
    )


def placed(name: str, frames, kinds, tool, classes: str, bound: int, order=None, **more) -> Arm:
    """Arm of joints about z of `frames` (n, 4, 4), each seen from the one before, and a tool (4,
    4).

    `order` is that in which the joints are declared.
    """
    kinds = ["revolute" if k == oracle.TURN else "prismatic" for k in kinds]

    def build() -> kempe.Mechanism:
        m = kempe.Mechanism(name)
        count = len(kinds)
        bodies = {i: m.body(f"b{i + 1}") for i in reversed(range(count))} if order else {}
        bodies = {-1: m.ground} | {i: bodies.get(i) or m.body(f"b{i + 1}") for i in range(count)}
        for i in order or range(count):
            m.joint(
                f"j{i + 1}",
                kinds[i],
                bodies[i - 1],
                bodies[i],
                at=make_placement_from_pose(frames[i]),
            )
        m.frame("tool", bodies[count - 1], at=make_placement_from_pose(tool))
        return m

    steps: list = []
    for i, (X, kind) in enumerate(zip(frames, kinds, strict=True), 1):
        steps += [("X", X), ("R" if kind == "revolute" else "P", "z", f"j{i}", 1.0, 0.0)]
    return Arm(name, build, (*steps, ("X", tool)), tuple(classes.split()), bound, **more)


def frames_of(model: oracle.Model) -> tuple[np.ndarray, np.ndarray]:
    """Frames (n, 4, 4) with z along the lines of a model, each seen from the one before, and the
    tool.
    """
    out = []
    before = np.eye(4)
    for h, o in zip(model.axes, model.points, strict=True):
        X = np.eye(4)
        x = np.linalg.svd(h[None])[2][1]
        X[:3, :3] = np.stack([x, np.cross(h, x), h], axis=1)
        X[:3, 3] = o
        out.append(np.linalg.inv(before) @ X)
        before = X
    return np.array(out), np.linalg.inv(before) @ model.home


def regauged(arm: Arm, seed: int) -> tuple[Arm, np.ndarray, np.ndarray, np.ndarray]:
    """The same lines described in another way, and what that changes: arm, base (4, 4), tool (4,
    4), signs (n,).

    Frames are shifted along and turned about their joint's axis, some axes are turned over, the arm
    stands elsewhere and holds a tool, joints are declared in another order under other names. With
    theta of the arm, the new one has signs * theta at base @ X @ tool.
    """
    rng = np.random.default_rng([seed, 55])
    m = arm.model
    frames, tip = frames_of(m)
    signs = rng.choice([-1.0, 1.0], m.n)
    base, tool = (
        reference.placement(rng.uniform(-1, 1, 3), rng.uniform(-PI, PI, 3)).astype(float)
        for _ in range(2)
    )
    before = base
    out = []
    for X, sign in zip(frames, signs, strict=True):
        own = reference.placement(
            (0, 0, rng.uniform(-1, 1)), (0 if sign > 0 else PI, 0, rng.uniform(-PI, PI))
        )
        out.append(before @ X @ own.astype(float))
        before = np.linalg.inv(own.astype(float))
    order = [int(i) for i in rng.permutation(m.n)]
    new = placed(
        f"regauged_{arm}",
        out,
        m.kinds,
        before @ tip @ tool,
        " ".join(arm.classes),
        arm.bound,
        order=order,
    )
    return new, base, tool, signs


def mirrored(arm: Arm, name: str) -> Arm:
    """The chain walked from its tip to its base: what was a wrist becomes a shoulder."""
    m = arm.model
    home = np.linalg.inv(m.home)
    back = replace(
        m,
        kinds=m.kinds[::-1],
        axes=-(m.axes @ home[:3, :3].T)[::-1],
        home=home,
        points=(m.points @ home[:3, :3].T + home[:3, 3])[::-1],
    )
    return placed(name, *_swap(frames_of(back), back.kinds), "mirrored 6R", arm.bound)


def _swap(pair, kinds):
    return pair[0], kinds, pair[1]


def random_arm(
    seed: int, kinds: str = "RRRRRR", name: str | None = None, classes: str = "", **more
) -> Arm:
    """Joints at random placements of some decimetres; `kinds` has a letter for each, R or P."""
    rng = np.random.default_rng([seed, len(kinds)])
    rows = [
        Joint(
            "revolute" if k == "R" else "prismatic",
            tuple(rng.uniform(-0.4, 0.4, 3)),
            tuple(rng.uniform(-PI, PI, 3)),
        )
        for k in kinds
    ]
    tool = (tuple(rng.uniform(-0.3, 0.3, 3)), tuple(rng.uniform(-PI, PI, 3)))
    return joints(name or f"random{kinds}_{seed}", rows, classes, 16, tool, **more)


def with_geometry(name: str, parallel=(), intersecting=(), seed: int = 0, bound: int = 16) -> Arm:
    """A random standard table of six turns; some consecutive axes (counted from 1) are parallel or
    concurrent.
    """
    rng = np.random.default_rng([seed, 77])
    rows = []
    for _ in range(6):
        a = rng.uniform(0.1, 0.4)
        alpha = rng.uniform(0.5, 2.6) * rng.choice([-1, 1])
        rows.append([a, alpha, rng.uniform(-0.4, 0.4), rng.uniform(-PI, PI)])
    for i in parallel[:-1]:
        rows[i - 1][1] = 0.0
    for i in intersecting[:-1]:
        rows[i - 1][0] = 0.0
    for i in intersecting[1:-1]:
        rows[i - 1][2] = 0.0
    return table(name, rows, "geometry 6R", bound)


def calibrated(name: str, rows, size: float, seed: int) -> Arm:
    """A table with all its numbers perturbed by `size`."""
    rng = np.random.default_rng([seed, round(-math.log10(size))])
    out = [tuple(x + size * rng.uniform(-1, 1) for x in r[:4]) for r in rows]
    return table(name, out, "calibrated 6R", 16)


def hollow(name: str, angle: float, offsets: bool) -> Arm:
    """Spherical wrist whose consecutive axes meet at `angle`: a hollow wrist, as on painting
    robots.
    """
    a1, a3, d3 = (0.25, 0.1, 0.05) if offsets else (0.0, 0.0, 0.0)
    rows = [
        (a1, -H, 0.5, 0),
        (0.7, 0, 0, 0),
        (a3, -H, d3, 0),
        (0, angle, 0.8, 0),
        (0, -angle, 0, 0),
        (0, 0, 0.15, 0),
    ]
    return table(name, rows, "spherical 6R hollow", 8)


# ---------------------------------------------------------------- figures

PUMA = [
    (0, H, 0, 0),
    (0.4318, 0, 0, 0),
    (0.0203, NEG, 0.15005, 0),
    (0, H, 0.4318, 0),
    (0, NEG, 0, 0),
    (0, 0, 0, 0),
]
UR10E = [(0, H, 0.1807, 0), (-0.6127, 0, 0, 0), (-0.57155, 0, 0, 0), (0, H, 0.17415, 0), (0, NEG, 0.11985, 0),
         (0, 0, 0.11655, 0)]  # fmt: skip
S3 = 0.0741 / math.sqrt(3)
JACO = [(0, H, 0.2755, 0), (0.41, PI, 0, 0), (0, H, -0.0098, 0), (0, PI / 3, -0.2073 - S3, 0), (0, PI / 3, -2 * S3, 0),
        (0, PI, -0.16 - S3, 0)]  # fmt: skip
TM5 = [(0, NEG, 0.1451, 0), (0.429, 0, 0, NEG), (0.4115, 0, 0, 0), (0, H, -0.1222, H), (0, H, 0.106, 0),
       (0, 0, 0.1144, 0)]  # fmt: skip
"""Techman TM5-900: the maker's table."""
ONE = math.radians(1.0)
MANSEUR = [
    (0.3, H, 0, 0),
    (1.0, ONE, 0, 0),
    (0, H, 0.2, 0),
    (1.5, ONE, 0, 0),
    (0, H, 0, 0),
    (0, ONE, 0, 0),
]
"""R. Manseur and K. L. Doty, "A robot manipulator with 16 real inverse kinematic solution sets",
IJRR 8(5), 1989."""
PIPER = [
    Joint(at=(0, 0, 0.123)), Joint(rpy=(H, -0.10095, -PI)), Joint(at=(0.28503, 0, 0), rpy=(0, 0, -1.759)),
    Joint(at=(-0.021984, -0.25075, 0), rpy=(H, 0, 0)), Joint(rpy=(NEG, 0, 0)),
    Joint(at=(8.8259e-05, -0.091, 0), rpy=(H, 0, 0)),
]  # fmt: skip
"""AgileX PiPER: the maker's ROS package, 1.5708 and 3.1416 read as right and straight angles."""
M1013 = [
    Joint(at=(0, 0, 0.1525)), Joint(at=(0, 0.0345, 0), rpy=(0, NEG, NEG)), Joint(at=(0.62, 0, 0), rpy=(0, 0, H)),
    Joint(at=(0, -0.559, 0), rpy=(H, 0, 0)), Joint(rpy=(NEG, 0, 0)), Joint(at=(0, -0.124, 0), rpy=(H, 0, 0)),
]  # fmt: skip
"""Doosan M1013: the maker's ROS package, 1.571 read as a right angle."""
XARM7 = [
    Joint(at=(0, 0, 0.267)), Joint(rpy=(NEG, 0, 0)), Joint(at=(0, -0.293, 0), rpy=(H, 0, 0)),
    Joint(at=(0.0525, 0, 0), rpy=(H, 0, 0)), Joint(at=(0.0775, -0.3425, 0), rpy=(H, 0, 0)), Joint(rpy=(H, 0, 0)),
    Joint(at=(0.076, 0.097, 0), rpy=(NEG, 0, 0)),
]  # fmt: skip
"""UFACTORY xArm 7: the maker's ROS package, 1.5708 read as a right angle."""
XARM5 = [Joint(at=(0, 0, 0.267)), Joint(rpy=(NEG, 0, 0)), Joint(at=(0.0535, -0.2845, 0)), Joint(at=(0.0775, 0.3425, 0)),
         Joint(at=(0.076, 0.097, 0), rpy=(NEG, 0, 0))]  # fmt: skip
STANFORD = [(0, NEG, 0.412, 0), (0, H, 0.154, 0), (0, 0, 0, 0, "prismatic"), (0, NEG, 0, 0), (0, H, 0, 0),
            (0, 0, 0.263, 0)]  # fmt: skip
Z = (0.0, 0.0, 1.0)
X_AXIS = (1.0, 0.0, 0.0)
Y_AXIS = (0.0, 1.0, 0.0)
GANTRY = [
    Joint("prismatic", axis=X_AXIS),
    Joint("prismatic", axis=Y_AXIS),
    Joint("prismatic", axis=Z),
]
ROLL = [Joint(at=(0, 0, -0.2)), Joint(rpy=(H, 0, 0)), Joint(at=(0, 0, 0), rpy=(NEG, 0, 0))]


def makers() -> Iterator[Arm]:
    """All arms."""
    yield from _spherical()
    yield from _parallel()
    yield from _general()
    yield from _prismatic()
    yield from _few()
    yield from _seven()
    yield from _unusual()


def _spherical() -> Iterator[Arm]:
    yield shipped("puma560", "tool", "spherical 6R", 8)
    yield shipped("irb6640", "tool0", "spherical 6R", 8)
    plain = [
        (0, H, 0.3, 0),
        (0.5, 0, 0, 0),
        (0, H, 0, H),
        (0, NEG, 0.4, 0),
        (0, H, 0, 0),
        (0, 0, 0.1, 0),
    ]
    yield table("anthropomorphic6", plain, "spherical 6R", 8)
    lateral = reference.placement((0.11, -0.07, 0.2), (0.4, -0.9, 1.3))
    yield table("puma_lateral_tool", PUMA, "spherical 6R", 8, tool=lateral)
    yield hollow("hollow60", PI / 3, False)
    yield hollow("hollow60_offsets", PI / 3, True)
    yield with_geometry("random_spherical_wrist", intersecting=(4, 5, 6), seed=3)
    yield mirrored(table("puma", PUMA, "", 8), "spherical_shoulder")
    yield with_geometry("random_spherical_shoulder", intersecting=(1, 2, 3), seed=4)


def _parallel() -> Iterator[Arm]:
    yield shipped("ur5", "tool", "ur parallel 6R", 8)
    yield shipped("ur10e", "tool", "ur parallel 6R", 8)
    yield table("tm5_900", TM5, "ur parallel 6R", 8)
    for i in (1, 2, 3, 4):
        yield with_geometry(f"parallel{i}{i + 1}{i + 2}", parallel=(i, i + 1, i + 2), seed=i)
    for i in (2, 3):
        yield with_geometry(
            f"concurrent{i}{i + 1}{i + 2}", intersecting=(i, i + 1, i + 2), seed=10 + i
        )


def _general() -> Iterator[Arm]:
    for name in ("jaco2", "gen3_lite", "xarm6"):
        yield shipped(name, "tool", "offset 6R", 16)
    for name in ("crx10ia", "hc10"):
        yield shipped(name, "tool0", "offset 6R", 16)
    yield joints("m1013", M1013, "offset 6R", 16, tool=((0, 0, 0.0), (0, 0, 0)))
    yield joints("piper", PIPER, "offset 6R", 16)
    for seed in range(10):
        yield random_arm(seed, classes="random 6R")
    for name, rows in (("ur10e", UR10E), ("puma", PUMA), ("jaco2", JACO)):
        for digits in (3, 5, 7):
            yield calibrated(f"{name}_1e-{digits}", rows, 10.0**-digits, 1)
    yield table("manseur_doty", MANSEUR, "general 6R", 16)


def _prismatic() -> Iterator[Arm]:
    yield shipped("cobra600", "tool", "scara prismatic 4", 2)
    arms = [(0.4, 0, 0.3, 0), (0.35, 0, 0, 0)]
    yield table(
        "scara_rrrp", [*arms, (0, 0, 0, 0), (0, 0, 0.1, 0, "prismatic")], "scara prismatic 4", 2
    )
    yield table(
        "scara_prrr", [(0, 0, 0.1, 0, "prismatic"), *arms, (0, PI, 0.05, 0)], "scara prismatic 4", 2
    )
    yield table("stanford", STANFORD, "prismatic spherical 6", 8)
    yield joints(
        "gantry6", [*GANTRY, *ROLL], "prismatic spherical 6", 2, tool=((0.05, 0, -0.1), (0, 0, 0.3))
    )
    column = [Joint(), Joint("prismatic", at=(0, 0, 0.4)), Joint("prismatic", axis=X_AXIS), *ROLL]
    yield joints(
        "cylindrical6", column, "prismatic spherical 6", 4, tool=((0.05, 0.02, -0.1), (0, 0, 0.3))
    )
    yield joints(
        "cartesian",
        GANTRY,
        "prismatic few",
        1,
        tool=((0.1, 0.2, 0.3), (0.1, 0.2, 0.3)),
        task="position",
    )
    yield joints(
        "cartesian_pose", GANTRY, "prismatic few", 1, tool=((0.1, 0.2, 0.3), (0.1, 0.2, 0.3))
    )
    rail = [Joint("prismatic", axis=X_AXIS), *(Joint(at=j.at, rpy=j.rpy) for j in XARM5)]
    yield joints("rail_xarm5", rail, "prismatic 6", 16)
    for k in range(6):
        yield random_arm(k, "R" * k + "P" + "R" * (5 - k), classes="prismatic random 6")
    yield random_arm(1, "RPRRPR", classes="prismatic random 6")
    yield random_arm(2, "PRRPRP", classes="prismatic random 6")


def _few() -> Iterator[Arm]:
    flat2 = [Joint(), Joint(at=(0.5, 0, 0))]
    flat3 = [*flat2, Joint(at=(0.4, 0, 0))]
    yield joints(
        "planar2", flat2, "few planar", 2, tool=((0.4, 0, 0), (0, 0, 0)), dim=2, task="position"
    )
    yield joints("planar3", flat3, "few planar", 2, tool=((0.2, 0, 0), (0, 0, 0.3)), dim=2)
    yield joints("flat2", flat2, "few", 2, tool=((0.4, 0, 0), (0, 0, 0)), task="position")
    yield joints("flat3", flat3, "few", 2, tool=((0.2, 0, 0), (0, 0, 0.3)))
    elbow = [(0, H, 0.3, 0), (0.5, 0, 0, 0), (0.4, 0, 0, 0)]
    yield table("anthropomorphic3", elbow, "few three", 4, task="position")
    cuspidal = [(1.0, NEG, 0, 0), (2.0, H, 1.0, 0), (1.5, 0, 0, 0)]
    yield table("orthogonal3_cuspidal", cuspidal, "few three", 4, task="position")
    yield table(
        "orthogonal3",
        [(1.0, NEG, 0, 0), (0.7, H, 0.2, 0), (1.2, 0, 0, 0)],
        "few three",
        4,
        task="position",
    )
    yield random_arm(5, "RRR", task="position", classes="few three")
    yield random_arm(6, "RPR", task="position", classes="few three")
    yield joints(
        "wrist3",
        [Joint(), Joint(rpy=(H, 0, 0)), Joint(rpy=(NEG, 0, 0))],
        "few wrist",
        2,
        task="orientation",
    )
    yield table("palletiser4", [*elbow, (0.1, 0, 0, 0)], "few", 2)
    yield random_arm(7, "RRRR", classes="few")
    yield shipped("youbot", "tool", "five", 4)
    yield replace(
        shipped("youbot", "tool", "five axis", 8, task="position_axis", axis=X_AXIS),
        name="youbot_axis",
    )
    yield shipped("so101", "tool", "five", 4)
    yield replace(
        shipped("so101", "tool", "five axis", 8, task="position_axis", axis=X_AXIS),
        name="so101_axis",
    )
    yield joints("xarm5", XARM5, "five", 4)
    yield random_arm(8, "RRRRR", classes="five")
    yield random_arm(9, "RRRRR", name="random5_axis", task="position_axis", classes="five axis")


def _seven() -> Iterator[Arm]:
    yield shipped("iiwa14", "tool", "seven srs", 8, held=("q3",))
    yield shipped("panda", "tool", "seven", 16, held=("panda_joint7",))
    yield shipped("gen3", "tool", "seven", 16, held=("joint_3",))
    yield joints("xarm7", XARM7, "seven", 16, held=("j7",))
    yield random_arm(11, "RRRRRRR", classes="seven random", held=("j4",))


def _unusual() -> Iterator[Arm]:
    several = [
        Joint("universal", at=(0, 0, 0.3)), Joint(at=(0.2, 0.1, 0.4), axis=(0, 1, 0)),
        Joint("universal", at=(0.1, 0, 0.4), rpy=(0.3, 0.2, 0.1)), Joint(at=(0, 0, 0.1), rpy=(0.2, H, 0)),
    ]  # fmt: skip
    yield joints("universals", several, "types 6R", 16, tool=((0, 0.05, 0.1), (0, 0, 0.5)))
    sleeve = [Joint("cylindrical", at=(0, 0, 0.2)), Joint(at=(0.3, 0, 0), rpy=(H, 0, 0)),
              Joint(at=(0.25, 0, 0), rpy=(0.3, 0, 0)), Joint("universal", at=(0.2, 0, 0.1))]  # fmt: skip
    yield joints("sleeve", sleeve, "types prismatic 6", 16, tool=((0, 0.05, 0.1), (0, 0, 0.5)))
    table_ = [Joint("planar"), Joint(at=(0, 0, 0.3), rpy=(H, 0, 0)), Joint(at=(0.3, 0, 0), rpy=(0.8, 0, 0)),
              Joint(at=(0.25, 0, 0.1), rpy=(H, 0.3, 0))]  # fmt: skip
    yield joints("mobile_base", table_, "types prismatic 6", 16, tool=((0.1, 0.0, 0.1), (0, 0, 0)))
    ball = [
        Joint(),
        Joint(at=(0, 0, 0.3), rpy=(H, 0, 0)),
        Joint(at=(0.4, 0, 0)),
        Joint("spherical", at=(0.35, 0, 0), options={"angles": True}),
    ]
    yield joints("ball_wrist", ball, "types spherical 6R", 8, tool=((0.1, 0, 0.05), (0, 0, 0)))
    geared = [
        Joint(at=r.at, rpy=r.rpy, axis=r.axis, follow=f)
        for r, f in zip(
            PIPER, [None, (2.0, 0.3), (-0.5, 0.1), None, (-1.0, 0.0), (3.0, -1.0)], strict=True
        )
    ]
    yield joints("geared_piper", geared, "mimic 6R", 16)
    turned = [
        Joint(at=r.at, rpy=r.rpy, axis=(0, 0, -1.0 if i % 2 else 1.0)) for i, r in enumerate(M1013)
    ]
    yield joints("negative_axes", turned, "offset 6R", 16, tool=((0.03, 0, 0.05), (0, 0, 0)))
    wide = [(-5 * PI, 5 * PI), (-1.0, 7.0), (-4 * PI, -2 * PI), FREE, (0.5, 0.8), (-PI, PI)]
    rows = [(*r, "revolute", w) for r, w in zip(PUMA, wide, strict=True)]
    yield table("puma_wide_limits", rows, "spherical 6R limits", 8)


@cache
def arms() -> dict[str, Arm]:
    """All arms by name."""
    out: dict[str, Arm] = {}
    for arm in makers():
        assert arm.name not in out, arm.name
        out[arm.name] = arm
    return out


def names(*words: str, without: tuple[str, ...] = ()) -> list[str]:
    """Names of the arms whose classes have one of the words (all arms where none is given), and
    none of `without`.
    """
    return [
        n
        for n, a in arms().items()
        if (not words or set(words) & set(a.classes)) and not set(without) & set(a.classes)
    ]


SEED = 2026

COUNTS: dict[str, tuple[tuple[int, int], ...]] = {
    "puma560": ((0, 8), (1, 8), (2, 8), (3, 8), (4, 8)),
    "irb6640": ((0, 4), (1, 8), (2, 8), (3, 8), (4, 8)),
    "anthropomorphic6": ((0, 8), (1, 8), (2, 8), (3, 8), (4, 8)),
    "puma_lateral_tool": ((0, 8), (1, 8), (2, 8), (3, 8), (4, 8)),
    "hollow60": ((0, 8), (1, 8), (2, 8), (3, 4), (4, 8)),
    "hollow60_offsets": ((0, 8), (1, 2), (2, 6), (3, 6), (4, 4)),
    "random_spherical_wrist": ((0, 4), (1, 8), (2, 8), (3, 4), (4, 8)),
    "spherical_shoulder": ((0, 8), (1, 8), (2, 8), (4, 8), (5, 8)),
    "random_spherical_shoulder": ((0, 4), (1, 4), (2, 2), (3, 4), (4, 8)),
    "ur5": ((0, 4), (1, 4), (3, 4), (5, 8), (6, 8)),
    "ur10e": ((0, 4), (1, 4), (3, 4), (4, 8), (5, 8)),
    "tm5_900": ((0, 2), (1, 4), (2, 8), (3, 2), (4, 8)),
    "parallel123": ((0, 4), (1, 4), (2, 4), (3, 4), (4, 4)),
    "parallel234": ((0, 4), (1, 4), (2, 4), (3, 4), (4, 2)),
    "parallel345": ((0, 2), (1, 2), (2, 2), (3, 2), (4, 4)),
    "parallel456": ((0, 2), (1, 2), (2, 2), (3, 4), (5, 2)),
    "concurrent234": ((0, 8), (1, 4), (2, 8), (3, 8), (4, 4)),
    "concurrent345": ((0, 2), (1, 4), (2, 2), (3, 2), (4, 2)),
    "jaco2": ((0, 10), (1, 8), (2, 10), (3, 10), (4, 8)),
    "gen3_lite": ((0, 4), (1, 8), (3, 8), (4, 8), (5, 8)),
    "crx10ia": ((0, 8), (1, 8), (2, 8), (3, 8), (4, 4)),
    "xarm6": ((0, 8), (1, 8), (2, 6), (3, 8), (4, 8)),
    "hc10": ((0, 8), (1, 8), (2, 8), (3, 8), (4, 8)),
    "m1013": ((0, 8), (1, 8), (2, 8), (3, 8), (4, 8)),
    "piper": ((0, 8), (1, 8), (2, 8), (3, 8), (4, 8)),
    "randomRRRRRR_0": ((0, 8), (1, 2), (2, 6), (3, 4), (4, 4)),
    "randomRRRRRR_1": ((0, 8), (1, 4), (2, 8), (3, 6), (4, 6)),
    "randomRRRRRR_2": ((0, 6), (1, 4), (2, 4), (3, 8), (4, 4)),
    "randomRRRRRR_3": ((0, 4), (1, 6), (2, 4), (3, 4), (4, 4)),
    "randomRRRRRR_4": ((0, 4), (1, 6), (2, 2), (3, 2), (4, 4)),
    "randomRRRRRR_5": ((0, 2), (1, 2), (2, 2), (3, 4), (4, 4)),
    "randomRRRRRR_6": ((0, 4), (1, 2), (2, 8), (3, 8), (4, 6)),
    "randomRRRRRR_7": ((1, 4), (2, 2), (3, 6), (4, 4), (5, 8)),
    "randomRRRRRR_8": ((0, 4), (1, 4), (2, 4), (3, 8), (4, 4)),
    "randomRRRRRR_9": ((0, 4), (1, 4), (2, 4), (3, 4), (4, 4)),
    "ur10e_1e-3": ((0, 4), (1, 4), (3, 4), (4, 8), (5, 8)),
    "ur10e_1e-5": ((0, 4), (1, 4), (3, 4), (4, 8), (5, 8)),
    "ur10e_1e-7": ((0, 4), (1, 4), (3, 4), (4, 8), (5, 8)),
    "puma_1e-3": ((0, 8), (1, 8), (2, 8), (3, 8), (4, 8)),
    "puma_1e-5": ((0, 8), (1, 8), (2, 8), (3, 8), (4, 8)),
    "puma_1e-7": ((0, 8), (1, 8), (2, 8), (3, 8), (4, 8)),
    "jaco2_1e-3": ((0, 8), (1, 4), (2, 4), (3, 8), (4, 8)),
    "jaco2_1e-5": ((0, 8), (1, 4), (2, 4), (3, 8), (4, 8)),
    "jaco2_1e-7": ((0, 8), (1, 4), (2, 4), (3, 8), (4, 8)),
    "manseur_doty": ((0, 4), (1, 8), (2, 12), (3, 8), (4, 8)),
    "cobra600": ((0, 2), (1, 2), (2, 2), (3, 2), (4, 2)),
    "scara_rrrp": ((0, 2), (1, 2), (2, 2), (3, 2), (4, 2)),
    "scara_prrr": ((0, 2), (1, 2), (2, 2), (3, 2), (4, 2)),
    "stanford": ((0, 8), (1, 8), (2, 8), (3, 8), (4, 8)),
    "gantry6": ((0, 2), (1, 2), (2, 2), (3, 2), (4, 2)),
    "cylindrical6": ((0, 4), (1, 4), (2, 4), (3, 4), (4, 4)),
    "cartesian": ((0, 1), (1, 1), (2, 1), (3, 1), (4, 1)),
    "cartesian_pose": ((0, 1), (1, 1), (2, 1), (3, 1), (4, 1)),
    "rail_xarm5": ((0, 4), (1, 4), (2, 4), (3, 4), (4, 4)),
    "randomPRRRRR_0": ((0, 4), (1, 2), (2, 2), (3, 4), (4, 4)),
    "randomRPRRRR_1": ((0, 4), (1, 2), (2, 4), (3, 6), (4, 4)),
    "randomRRPRRR_2": ((0, 2), (1, 8), (2, 8), (3, 6), (4, 8)),
    "randomRRRPRR_3": ((0, 4), (1, 8), (2, 4), (3, 6), (4, 6)),
    "randomRRRRPR_4": ((0, 4), (1, 2), (2, 4), (3, 4), (4, 2)),
    "randomRRRRRP_5": ((0, 4), (1, 2), (2, 4), (3, 2), (4, 2)),
    "randomRPRRPR_1": ((0, 2), (1, 4), (4, 6), (5, 2), (6, 4)),
    "randomPRRPRP_2": ((1, 2), (2, 2), (3, 2), (4, 2), (5, 2)),
    "planar2": ((0, 2), (1, 2), (2, 2), (3, 2), (4, 2)),
    "planar3": ((0, 2), (1, 2), (2, 2), (3, 2), (4, 2)),
    "flat2": ((0, 2), (1, 2), (2, 2), (3, 2), (4, 2)),
    "flat3": ((0, 2), (1, 2), (2, 2), (3, 2), (4, 2)),
    "anthropomorphic3": ((0, 4), (1, 4), (2, 4), (3, 4), (4, 4)),
    "orthogonal3_cuspidal": ((0, 2), (1, 2), (2, 2), (3, 4), (4, 2)),
    "orthogonal3": ((0, 2), (1, 2), (2, 2), (3, 4), (4, 2)),
    "randomRRR_5": ((0, 2), (1, 2), (2, 2), (3, 2), (4, 2)),
    "randomRPR_6": ((0, 2), (1, 2), (2, 2), (3, 2), (4, 2)),
    "wrist3": ((0, 2), (1, 2), (2, 2), (3, 2), (4, 2)),
    "palletiser4": ((0, 2), (1, 2), (2, 2), (3, 2), (4, 2)),
    "randomRRRR_7": ((0, 1), (1, 1), (2, 1), (3, 1), (4, 1)),
    "youbot": ((0, 4), (1, 2), (2, 4), (3, 4), (4, 4)),
    "youbot_axis": ((0, 4), (1, 2), (2, 8), (3, 8), (4, 4)),
    "so101": ((0, 2), (1, 2), (2, 2), (3, 2), (4, 2)),
    "so101_axis": ((0, 2), (1, 2), (2, 8), (3, 2), (4, 4)),
    "xarm5": ((0, 4), (1, 2), (2, 4), (3, 4), (4, 4)),
    "randomRRRRR_8": ((0, 1), (1, 1), (2, 1), (3, 1), (4, 1)),
    "random5_axis": ((0, 2), (1, 4), (2, 4), (3, 2), (4, 6)),
    "iiwa14": ((0, 8), (1, 8), (2, 8), (3, 8), (4, 8)),
    "panda": ((0, 4), (1, 8), (2, 4), (3, 8), (4, 8)),
    "gen3": ((0, 8), (1, 8), (2, 8), (3, 8), (4, 8)),
    "xarm7": ((0, 8), (1, 8), (2, 8), (3, 4), (4, 4)),
    "randomRRRRRRR_11": ((0, 6), (1, 2), (2, 2), (3, 2), (4, 2)),
    "universals": ((0, 4), (1, 8), (2, 6), (3, 2), (4, 4)),
    "sleeve": ((0, 2), (1, 2), (2, 4), (3, 2), (4, 4)),
    "mobile_base": ((0, 2), (1, 4), (2, 2), (3, 4), (4, 2)),
    "ball_wrist": ((0, 8), (1, 8), (2, 8), (3, 8), (4, 8)),
    "geared_piper": ((0, 8), (1, 8), (2, 8), (3, 8), (4, 8)),
    "negative_axes": ((0, 8), (1, 8), (2, 8), (3, 8), (4, 8)),
    "puma_wide_limits": ((0, 8), (1, 8), (2, 8), (3, 8), (4, 8)),
}
"""Of configurations `arm.random(SEED, 40)`: (number of the row, how many isolated solutions its
pose has), with the `held` coordinates held; rows whose solutions are near a singularity or near
each other are left out."""

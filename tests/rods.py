"""Random mechanisms with rods, legs and links whose idle spins are known by construction, closed at
neutral.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np
from world_mechanisms import World, unit

FORMS = ("S", "A", "RRR", "UR", "RU", "RRfR")
"""A ball as one joint (with a quaternion, with angles), as three hinges that meet, as a universal
joint and a hinge, with a fixed link in between."""


@dataclass
class Rods:
    """A world that grows unit by unit; `idle` are the groups that spin, as sets of bodies."""

    rng: np.random.Generator
    world: World = field(default_factory=lambda: World("rods"))
    idle: list[frozenset[str]] = field(default_factory=list)
    count: int = 0

    def name(self, what: str) -> str:
        self.count += 1
        return f"{what}{self.count}"

    def point(self, size: float = 1.0) -> np.ndarray:
        return size * self.rng.uniform(-1, 1, 3)

    def axis(self) -> np.ndarray:
        return unit(self.rng.normal(size=3))

    def axes(self) -> list[np.ndarray]:
        """Three directions that are far from one plane."""
        while True:
            axes = [self.axis() for _ in range(3)]
            if abs(np.linalg.det(axes)) > 0.4:
                return axes

    def ball(self, a: str, b: str, at: np.ndarray, form: str | None = None) -> None:
        w = self.world
        (x, y, z) = self.axes()
        form = form or str(self.rng.choice(FORMS))
        here, there, far = (
            at + d * axis for d, axis in zip(self.rng.uniform(-0.3, 0.3, 3), (x, y, z), strict=True)
        )
        if form in ("S", "A"):
            w.ball(a, b, at, **({"angles": True} if form == "A" else {}))
        elif form == "UR":
            link = self.name("link")
            w.cross(a, link, at, x, np.cross(x, y))
            w.turn(link, b, far, z)
        elif form == "RU":
            link = self.name("link")
            w.turn(a, link, here, x)
            w.cross(link, b, at, y, np.cross(y, z))
        else:
            one = self.name("link")
            two = self.name("link")
            w.turn(a, one, here, x)
            w.turn(one, two, there, y)
            if form == "RRfR":
                w.joint("fixed", two, two := self.name("link"), at + self.point(0.1), self.axis())
            w.turn(two, b, far, z)

    def universal(self, a: str, b: str, at: np.ndarray) -> None:
        x, y, _ = self.axes()
        if self.rng.random() < 0.5:
            self.world.cross(a, b, at, x, np.cross(x, y))
        else:
            link = self.name("link")
            self.world.turn(a, link, at, x)
            self.world.turn(link, b, at, y)

    def arm(self, ground: str, **options) -> str:
        """A link on a hinge."""
        body = self.name("arm")
        self.world.turn(ground, body, self.point(), self.axis(), **options)
        return body


def rssr(r: Rods, ground: str) -> None:
    """A rod between two arms, of one body or of two that are fixed, perhaps with something fixed to
    it.
    """
    a = r.arm(ground)
    b = r.arm(ground)
    rod = r.name("rod")
    p = r.point()
    q = r.point()
    group = {rod}
    far = rod
    if r.rng.random() < 0.3:
        far = r.name("rod")
        r.world.joint("fixed", rod, far, r.point(), r.axis())
        group.add(far)
    if r.rng.random() < 0.3:
        group.add(cover := r.name("cover"))
        r.world.joint("fixed", far, cover, r.point(), r.axis())
    r.ball(a, rod, p)
    r.ball(far, b, q)
    r.idle.append(frozenset(group))


def rusr(r: Rods, ground: str) -> None:
    """A rod that a universal joint keeps from spinning."""
    a = r.arm(ground)
    b = r.arm(ground)
    rod = r.name("rod")
    r.universal(a, rod, r.point())
    r.ball(rod, b, r.point())


def leg(r: Rods, ground: str) -> None:
    """A leg whose hip goes through the ball of a rod beside it: the rod spins, the leg swings."""
    hip = r.point()
    axis = r.axis()
    x = r.rng.uniform(0.1, 0.5)
    thigh = r.name("thigh")
    shin = r.name("shin")
    rod = r.name("rod")
    marked = {"actuated": True} if r.rng.random() < 0.3 else {}
    r.world.turn(ground, thigh, hip, axis, **marked)
    r.world.turn(thigh, shin, r.point(), r.axis())
    r.ball(ground, rod, hip + x * axis)
    r.ball(rod, shin, r.point())
    r.idle.append(frozenset({rod}))


def strut(r: Rods, ground: str) -> None:
    """A telescopic leg, driven or not, between an arm and the ground: both halves spin together."""
    a = r.arm(ground)
    low = r.name("cylinder")
    high = r.name("piston")
    p = r.point()
    q = r.point()
    marked = {"actuated": True} if r.rng.random() < 0.5 else {}
    r.ball(ground, low, p)
    r.world.slide(low, high, q - p if r.rng.random() < 0.7 else r.axis(), p, **marked)
    r.ball(high, a, q)
    r.idle.append(frozenset({low, high}))


def carrier(r: Rods, ground: str) -> None:
    """A rod that carries a pendulum."""
    a = r.arm(ground)
    b = r.arm(ground)
    rod = r.name("rod")
    r.ball(a, rod, r.point())
    r.ball(rod, b, r.point())
    r.world.turn(rod, r.name("pendulum"), r.point(), r.axis())


def motor(r: Rods, ground: str) -> None:
    """A rod that is turned: one hinge of its balls has a motor."""
    a = r.arm(ground)
    b = r.arm(ground)
    rod = r.name("rod")
    p = r.point()
    one = r.name("link")
    two = r.name("link")
    joints = list(zip((a, one, two), (one, two, rod), r.axes(), strict=True))
    driven = int(r.rng.integers(3))
    for k, (i, k_, z) in enumerate(joints):
        r.world.turn(i, k_, p, z, **({"actuated": True} if k == driven else {}))
    r.ball(rod, b, r.point())


def tied(r: Rods, ground: str) -> None:
    """A rod that a second rod holds off its axis: only the second spins."""
    a = r.arm(ground)
    b = r.arm(ground)
    rod = r.name("rod")
    second = r.name("rod")
    r.ball(a, rod, r.point())
    r.ball(rod, b, r.point())
    r.ball(rod, second, r.point())
    r.ball(second, ground, r.point())
    r.idle.append(frozenset({second}))


def engine(r: Rods, ground: str) -> None:
    """A piston that can turn in its bore, on a rod: both spin."""
    crank = r.arm(ground)
    rod = r.name("rod")
    piston = r.name("piston")
    p = r.point()
    axis = r.axis()
    form = r.rng.integers(3)
    if form == 0:
        r.world.joint("cylindrical", ground, piston, p, axis)
    else:
        slider = r.name("slider")
        r.world.joint("revolute" if form == 1 else "prismatic", ground, slider, p, axis)
        r.world.joint("prismatic" if form == 1 else "revolute", slider, piston, p, axis)
    r.ball(piston, rod, p + r.rng.uniform(0.1, 0.5) * axis)
    r.ball(rod, crank, r.point())
    r.idle += [frozenset({rod}), frozenset({piston, slider} if form == 1 else {piston})]


def dome(r: Rods, ground: str) -> None:
    """A spherical linkage of five bars, or a row of five hinges that meet in a longer loop: nothing
    is a ball.
    """
    centers = [r.point()] * 5
    if r.rng.random() < 0.5:
        centers = [*centers, *(r.point() for _ in range(3))][:: int(r.rng.choice([-1, 1]))]
    bodies = [ground, *(r.name("bar") for _ in centers[1:]), ground]
    for a, b, center in zip(bodies[:-1], bodies[1:], centers, strict=True):
        r.world.turn(a, b, center, r.axis())


def hinges(r: Rods, ground: str) -> None:
    """A loop of seven or eight hinges, some of which meet their neighbours, but not enough of them
    for two balls.
    """
    runs = [9, 9]
    while sum(n >= 3 for n in runs) > 1 or len(runs) < 3:
        runs = [int(n) for n in r.rng.integers(1, 4, size=5)]
    points = [p for n in runs for p in [r.point()] * n]
    bodies = [ground, *(r.name("bar") for _ in points[1:]), ground]
    for a, b, p in zip(bodies[:-1], bodies[1:], points, strict=True):
        r.world.turn(a, b, p, r.axis())


def beam(r: Rods, ground: str) -> None:
    """A bar on three balls or more in one line, held by several arms, perhaps telescopic; or bent:
    then none spins.
    """
    p = r.point()
    d = r.axis()
    n = int(r.rng.integers(3, 6))
    bent = r.rng.random() < 0.3
    bar = [r.name("bar")]
    if r.rng.random() < 0.3 and not bent:
        bar.append(r.name("bar"))
        r.world.slide(bar[0], bar[1], d, p)
    arms = [
        r.arm(ground),
        *(ground if r.rng.random() < 0.3 else r.arm(ground) for _ in range(n - 1)),
    ]
    where = 0.5 * np.arange(n) + r.rng.uniform(0, 0.2, n)
    for k in range(n):
        r.ball(
            arms[k],
            bar[min(k % 2, len(bar) - 1)],
            p + where[k] * d + (r.point(0.3) if bent and k < 2 else 0.0),
        )
    r.idle += [] if bent else [frozenset(bar)]


def spindle(r: Rods, ground: str) -> None:
    """A shaft in bearings on one axis, and a ball on it, held by different arms; perhaps driven, or
    with a wheel.
    """
    p = r.point()
    d = r.axis()
    shaft = r.name("shaft")
    kind = int(r.rng.integers(3))
    marked = {}
    if kind == 1:
        marked = {"actuated": True}
    r.world.turn(ground, shaft, p, d, **marked)
    r.world.joint("cylindrical", r.arm(ground), shaft, p + 0.3 * d, d)
    r.world.ball(r.arm(ground), shaft, p + 0.7 * d)
    if kind == 2:
        r.world.turn(shaft, r.name("wheel"), r.point(), r.axis())
    r.idle += [frozenset({shaft})] if kind == 0 else []


def floating(r: Rods, ground: str) -> None:
    """A bar that is held by nothing but massless rods at points of a line; or a plate."""
    bar = r.name("bar")
    p = r.point()
    d = r.axis()
    plate = r.rng.random() < 0.3
    r.world.joint(
        "free",
        ground,
        bar,
        r.point(),
        r.axis(),
        **({"angles": True} if r.rng.random() < 0.5 else {}),
    )
    for k in range(int(r.rng.integers(3, 6))):
        holder = ground if r.rng.random() < 0.5 else r.arm(ground)
        r.world.rod(holder, bar, r.point(), p + k * 0.3 * d + (r.point(0.3) if plate else 0.0))
    r.idle += [] if plate else [frozenset({bar})]


def tethered(r: Rods, ground: str) -> None:
    """A bar on a ball, whose other end a massless rod, a line or a plane holds; the line and the
    plane may be on it.
    """
    arm = r.arm(ground)
    bar = r.name("bar")
    p = r.point()
    q = r.point()
    r.ball(arm, bar, p)
    kind = int(r.rng.integers(4))
    if kind == 0:
        r.world.rod(
            *((ground, bar, r.point(), q) if r.rng.random() < 0.5 else (bar, ground, q, r.point()))
        )
    elif kind == 1:
        r.world.line(ground, bar, q, r.axis())
    else:
        r.world.plane(*((ground, bar) if kind == 2 else (bar, ground)), q, r.axis())
    r.idle += [frozenset({bar})] if kind < 3 else []


def door(r: Rods, ground: str) -> None:
    """A body between two balls of one part."""
    body = r.name("door")
    r.ball(ground, body, r.point())
    r.ball(body, ground, r.point())


UNITS: tuple[Callable[[Rods, str], None], ...] = (
    rssr,
    rusr,
    leg,
    strut,
    carrier,
    motor,
    tied,
    engine,
    dome,
    hinges,
    door,
    beam,
    spindle,
    floating,
    tethered,
)


def mechanism(rng: np.random.Generator) -> Rods:
    """One to three units, each on the ground or on a carriage that slides."""
    r = Rods(rng)
    for _ in range(int(rng.integers(1, 4))):
        ground = "ground"
        if rng.random() < 0.3:
            ground = r.name("carriage")
            r.world.slide("ground", ground, r.axis())
        UNITS[int(rng.integers(len(UNITS)))](r, ground)
    return r

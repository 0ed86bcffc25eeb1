"""Mechanisms of the literature on nonholonomic constraints, with their growth vectors at random
configurations.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from kempe import Mechanism
from kempe.constraints import Constraint, NoSideslip, Op, Row, kind
from kempe.constraints.base import KINDS, Frame, Number
from kempe.constraints.tape import POSE, TWIST
from kempe.constraints.text import parse_tape
from kempe.system import System

ON_BALL = parse_tape(["sqrt(x^2 + y^2 + z^2) - a - b"], (*POSE, "a", "b"), {})
SLIPS = parse_tape(
    [
        "vx - (wy*z - wz*y)*b/(a + b)",
        "vy - (wz*x - wx*z)*b/(a + b)",
        "vz - (wx*y - wy*x)*b/(a + b)",
        "wx*x + wy*y + wz*z",
    ],
    (*POSE, *TWIST, "a", "b"),
    {},
)


@kind("rolls_on_ball", "wheel", "{frame} rolls on a ball about {other}")
class RollsOnBall(Constraint):
    """A ball of radius b rolls on one of radius a, without slipping and without spin."""

    frame: Frame
    other: Frame | None = None
    a: Number = 1.0
    b: Number = 1.0

    def list_rows(self, dim: int) -> tuple[Row, ...]:
        """The distance, three velocities of the point that touches, of which two are independent,
        and the spin.
        """
        units = ["m/s", "m/s", "m/s", "rad/s"]
        return (
            Row(Op.TAPE, (ON_BALL, 0), "gap", "m"),
            *(Row(Op.VELOCITY, (SLIPS, k), f"slip {k}", unit) for k, unit in enumerate(units)),
        )


del KINDS["rolls_on_ball"]  # of this module alone


def trailers(n: int, second: bool = False) -> System:
    """A car, whose rear axle does not slip, with n trailers of length 1; `second`: each axle has
    two wheels.
    """
    m = Mechanism("car", dim=2)
    last = m.body("car")
    m.joint("car", "planar", m.ground, last)
    m.no_sideslip("rear", last)
    for i in range(n):
        new = m.body(f"trailer {i}")
        m.joint(f"H{i}", "revolute", last, new, at=(-1.0 if i else 0.0, 0.0))
        m.frame(f"axle {i}", new, at=(-1.0, 0.0))
        m.no_sideslip(f"wheel {i}", f"axle {i}")
        if second:
            m.frame(f"left {i}", new, at=(-1.0, 0.5))
            m.no_sideslip(f"left wheel {i}", f"left {i}")
        last = new
    return System(m)


def steered_car(linkage: bool = False) -> System:
    """A car with a front wheel that is steered, by hand or by a parallelogram of links, which is a
    closed loop.
    """
    m = Mechanism("steered car", dim=2)
    car = m.body("car")
    wheel = m.body("wheel")
    m.joint("car", "planar", m.ground, car)
    m.joint("steering", "revolute", car, wheel, at=(2.5, 0.0))
    if linkage:
        lever = m.body("lever")
        rod = m.body("rod")
        m.joint("A", "revolute", car, lever, at=(1.0, 0.0))
        m.joint("B", "revolute", lever, rod, at=(0.2, 0.4))
        m.joint("C", "revolute", rod, wheel, at=(1.5, 0.1), child_at=(0.2, 0.5))
    m.no_sideslip("rear", car)
    m.no_sideslip("front", wheel)
    return System(m)


def on_plane(shape: str = "ball", **options: object) -> System:
    """A ball or disc, free in space, that rolls on the ground."""
    m = Mechanism(shape)
    body = m.body("B")
    m.joint("F", "free", m.ground, body)
    m.rolls("rolling", body, 0.4, shape=shape, **options)  # type: ignore[arg-type]
    return System(m)


def upright_disc() -> System:
    """A disc on two slides and two hinges, which keep it upright and on the ground."""
    m = Mechanism("upright disc")
    fork = m.body("fork")
    disc = m.body("disc")
    m.joint("place", "planar", m.ground, fork, at=(0.0, 0.0, 0.4))
    m.joint("axle", "revolute", fork, disc, axis=(0.0, 1.0, 0.0))
    m.frame("hub", fork)
    m.rolls("rolling", disc, 0.4, shape="disc")
    return System(m)


def two_balls(a: float, b: float) -> System:
    """A ball of radius b that rolls without spin on one of radius a, which stands."""
    m = Mechanism("balls")
    body = m.body("B")
    m.joint("F", "free", m.ground, body)
    m.constrain(RollsOnBall("B", None, a, b), "rolling")
    return System(m)


def blade_in_space() -> System:
    """A body free in space with one blade."""
    m = Mechanism("blade")
    body = m.body("B")
    m.joint("F", "free", m.ground, body)
    m.no_sideslip("blade", body)
    return System(m)


def two_axles() -> System:
    """A rigid body with two parallel axles one behind the other: it goes straight ahead."""
    m = Mechanism("cart", dim=2)
    body = m.body("B")
    m.joint("P", "planar", m.ground, body)
    m.frame("front", body, at=(1.0, 0.0))
    m.no_sideslip("rear", body)
    m.constrain(NoSideslip("front"), "front")
    return System(m)


KNOWN: dict[str, tuple[Callable[[], System], tuple[int, ...], int]] = {
    "knife edge": (lambda: trailers(0), (2, 3), 3),
    "one trailer": (lambda: trailers(1), (2, 3, 4), 4),
    "two trailers": (lambda: trailers(2), (2, 3, 4, 5), 5),
    "three trailers": (lambda: trailers(3), (2, 3, 4, 5, 6), 6),
    "four trailers": (lambda: trailers(4), (2, 3, 4, 5, 6, 7), 7),
    "five trailers": (lambda: trailers(5), (2, 3, 4, 5, 6, 7, 8), 8),
    "two trailers, two wheels on each axle": (lambda: trailers(2, True), (2, 3, 4, 5), 5),
    "steered car": (steered_car, (2, 3, 4), 4),
    "steered car, with a linkage": (lambda: steered_car(True), (2, 3, 4), 4),
    "upright disc": (upright_disc, (2, 3, 4), 4),
    "tilting disc": (lambda: on_plane("disc"), (3, 4, 5), 5),
    "ball": (on_plane, (3, 5), 5),
    "ball without spin": (lambda: on_plane(spin=False), (2, 3, 5), 5),
    "ball that may jump": (lambda: on_plane(one_sided=True), (3, 5), 5),
    "two balls, 1 : 2": (lambda: two_balls(1.0, 2.0), (2, 3, 5), 5),
    "two balls, 1 : 3": (lambda: two_balls(1.0, 3.0), (2, 3, 5), 5),
    "two equal balls": (lambda: two_balls(0.7, 0.7), (2, 2), 5),
    "blade in space": (blade_in_space, (5, 6), 6),
    "two axles": (two_axles, (1, 1), 3),
}
"""Growth vector at random configurations, and the freedoms of position. Ball on plane and disc:
Murray, Li, Sastry (1994), *A Mathematical Introduction to Robotic Manipulation*, chapter 7, and
Bloch (2003), *Nonholonomic Mechanics and Control*; trailers: Jean (1996); two balls without spin:
Agrachev, Sachkov (2004), *Control Theory from the Geometric Viewpoint*, chapter 24, Bor, Montgomery
(2009), *G2 and the rolling distribution*: (2, 3, 5) unless they are equal."""


def close_by(system: System, rng: np.random.Generator) -> np.ndarray:
    """A configuration at random, near enough to zero for loops to be closed from there."""
    return system.configuration_space.integrate(system.neutral, 0.4 * rng.normal(size=system.nv))

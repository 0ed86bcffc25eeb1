"""Arms of two or three joints in a plane as formulas: the triangle that joints and target make,
solved step by step.
"""

from __future__ import annotations

from itertools import pairwise
from typing import Any, NamedTuple

from kempe.errors import UnsupportedError
from kempe.kinematics.formulas.derivation import FormulaStep
from kempe.kinematics.formulas.plane_steps import (
    Names,
    Vector,
    line_and_circle,
    minus,
    plus,
    polar,
    turned,
    turning_slide,
    two_circles,
    two_lines,
)

ELBOW = "-1 is elbow up, +1 elbow down"


class PlaneJoint(NamedTuple):
    """A joint at q = 0: a point of its axis, whether it turns, its sense about z or its direction."""

    name: str
    at: Vector
    turns: bool
    sense: int
    along: Vector

    @classmethod
    def of(cls, joint: Any) -> PlaneJoint:
        """The joint as it lies in the plane."""
        sense = int(joint.along[2]) if joint.turns else 1
        return cls(
            joint.coordinate,
            (joint.point[0], joint.point[1]),
            joint.turns,
            sense,
            (joint.along[0], joint.along[1]),
        )


def in_plane(
    n: Names,
    arm: list[PlaneJoint],
    to: Vector,
    end: Vector,
    angle: Any,
    names: list[Any],
    elbow: str = ELBOW,
) -> tuple[list[FormulaStep], list[Any]]:
    """Steps and coordinates as `solved`; of a pose from the place of a last joint that turns,
    called `names`.
    """
    steps = list[FormulaStep]()
    if angle is not None and arm[-1].turns:
        place = minus(to, turned(minus(end, arm[-1].at), angle))
        if place != to:
            steps = [
                FormulaStep(s, x, "the target, less the last link")
                for s, x in zip(names, place, strict=True)
            ]
            to = (steps[0].symbol, steps[1].symbol)
        end = arm[-1].at
    more, found = solved(n, arm, to, end, angle, elbow)
    return steps + more, found


def solved(
    n: Names, arm: list[PlaneJoint], to: Vector, end: Vector, angle: Any, elbow: str
) -> tuple[list[FormulaStep], list[Any]]:
    """Steps and coordinates: of joints that bring the point `end` to `to`, the last body turned by
    `angle`.

    `elbow` says what the sign of two turns is.
    """
    kinds = "".join("RP"[not j.turns] for j in arm)
    one = arm[0]
    two = arm[1]
    if any(
        one.turns and two.turns and set(minus(two.at, one.at)) == {0} for one, two in pairwise(arm)
    ):
        raise UnsupportedError(
            "two turns are about one axis, which leaves a joint to spare; ik_all gives families"
        )
    if kinds in ("RR", "RRR"):
        (l1, at1) = polar(minus(two.at, one.at))
        (l2, at2) = polar(minus(end, two.at))
        steps, first, bend = two_circles(n, minus(to, one.at), l1, l2, elbow, one.sense)
        turns = [first - at1, bend - (at2 - at1)]
        return steps, _turns(arm, turns, angle)
    if kinds in ("RP", "RPR"):
        gap = minus(end, one.at)
        (_, at) = polar(two.along)
        ahead, aside = _parts(gap, two.along)
        steps, u, rail = turning_slide(n, minus(to, one.at), aside)
        turn = rail - at
        return steps, [
            one.sense * turn,
            u - ahead,
            *([arm[2].sense * (angle - turn)] if kinds == "RPR" else []),
        ]
    if kinds in ("PR", "PRR"):
        length, at = polar(minus(end, two.at))
        steps, u, bar = line_and_circle(n, minus(to, two.at), one.along, length)
        turn = bar - at
        return steps, [
            u,
            two.sense * turn,
            *([arm[2].sense * (angle - turn)] if kinds == "PRR" else []),
        ]
    if kinds == "RRP":  # the orientation is that of the second body
        length, at = polar(minus(two.at, one.at))
        rest = minus(minus(to, one.at), turned(minus(end, two.at), angle))
        steps, u, bar = line_and_circle(n, rest, turned(arm[2].along, angle), length)
        turn = bar - at
        return steps, [one.sense * turn, two.sense * (angle - turn), u]
    if kinds in ("PP", "PPR"):
        steps, u1, u2 = two_lines(n, minus(to, end), one.along, two.along)
        return steps, [u1, u2, *([arm[2].sense * angle] if kinds == "PPR" else [])]
    if kinds == "RPP":
        rest = minus(turned(minus(to, one.at), -angle), minus(end, one.at))
        steps, u2, u3 = two_lines(n, rest, two.along, arm[2].along)
        return steps, [one.sense * angle, u2, u3]
    if kinds == "PRP":
        rest = minus(to, plus(two.at, turned(minus(end, two.at), angle)))
        steps, u1, u3 = two_lines(n, rest, one.along, turned(arm[2].along, angle))
        return steps, [u1, two.sense * angle, u3]
    raise UnsupportedError(
        "formulas need a joint that turns where an angle is wanted; ik_all gives numbers"
    )


def _turns(arm: list[PlaneJoint], turns: list[Any], angle: Any) -> list[Any]:
    """Coordinates of joints that turn: by these, the last one by what is left of the angle."""
    last = [] if angle is None else [angle - sum(turns)]
    return [j.sense * x for j, x in zip(arm, [*turns, *last], strict=True)]


def _parts(v: Vector, along: Vector) -> tuple[Any, Any]:
    """Parts of a vector along a direction and to the left of it."""
    return v[0] * along[0] + v[1] * along[1], along[0] * v[1] - along[1] * v[0]

"""Planar mechanisms of the library with their published freedoms, and their motions through
singular postures.

`PLANAR` and `SINGULAR` are tables for any test; `branches` gives motions in closed form.
"""

from __future__ import annotations

from cmath import phase, rect
from collections.abc import Callable
from dataclasses import dataclass
from math import asin, atan, atan2, cos, pi, sin, sqrt, tan


@dataclass(frozen=True)
class Case:
    """What is known about one posture of a mechanism.

    `count`: 3 n_b - 2 n_j, the lecture's count in the plane; `rank`: all coordinates minus the rank
    of the Jacobian of the loops; `true`: the largest dimension of a motion through the posture;
    `branches`: the dimensions of all motions that meet there, where it is a singular point of the
    configuration space.
    """

    name: str
    count: int
    true: int
    note: str
    rank: int = -1
    posture: str = "closed"
    branches: tuple[int, ...] = ()

    def __post_init__(self) -> None:
        if self.rank < 0:
            object.__setattr__(self, "rank", self.true)

    def __str__(self) -> str:
        return f"{self.name}-{self.posture}"


WUNDERLICH = (2,) * 5 + (1,) * 8

PLANAR: tuple[Case, ...] = (
    Case("four_bar", 1, 1, "crank-rocker, Grashof 1883"),
    Case("slider_crank", 1, 1, "textbook"),
    Case("slider_crank_equal", 1, 1, "textbook; rod as long as the crank"),
    Case("ladder", 1, 1, "trammel of Archimedes"),
    Case("five_bar", 2, 2, "textbook"),
    Case("parallelogram", 1, 1, "textbook; 1-3-1-3"),
    Case("antiparallelogram", 1, 1, "textbook; 1-3-1-3 crossed"),
    Case("kite", 1, 1, "textbook"),
    Case("chebyshev", 1, 1, "Chebyshev; 4 : 5 : 2 : 5"),
    Case("hoeken", 1, 1, "Hoecken 1926; 2 : 1 : 2.5 : 2.5"),
    Case("evans", 1, 1, "Evans about 1805"),
    Case("watt_straight", 1, 1, "Watt 1784"),
    Case("watt_six_bar", 1, 1, "Watt II; textbook"),
    Case("stephenson_six_bar", 1, 1, "Stephenson III; textbook"),
    Case("double_parallelogram", 0, 1, "textbook; one redundant constraint in the plane"),
    Case("row_of_four_bars", 1, 1, "Gonzalez and others 2006, N = 3"),
    Case("scissor", 1, 1, "textbook; two cells"),
    Case("peaucellier", 1, 1, "Peaucellier 1864, Lipkin 1871"),
    Case("jansen", 1, 1, "Jansen 2007"),
    Case("klann", 1, 1, "Klann 2001, US patent 6260862"),
    Case("andrews_squeezer", 1, 1, "Schiehlen 1990, Hairer and Wanner"),
    Case("three_rrr", 3, 3, "Gosselin and Angeles 1988"),
    Case("three_rpr", 3, 3, "Hunt 1983"),
    Case("shaky_3r", 0, 0, "rigid of the second order", rank=1),
    Case("pendulum_dead_centre", 1, 1, "shaky in every configuration", rank=2, branches=(1,)),
    Case("double_watt", 1, 1, "Connelly and Servatius 1994; a cusp", rank=2, branches=(1,)),
    Case("wunderlich", 1, 2, "Wunderlich 1954; kinematotropic", rank=6, branches=WUNDERLICH),
)
"""One record for each planar mechanism with loops, at its posture `closed`."""

SINGULAR: tuple[Case, ...] = (
    Case("parallelogram", 1, 1, "change point", 2, "flat", (1, 1)),
    Case("antiparallelogram", 1, 1, "change point", 2, "flat", (1, 1)),
    Case("kite", 1, 1, "change point", 2, "change_point", (1, 1)),
    Case("slider_crank_equal", 1, 1, "change point", 2, "change_point", (1, 1)),
    Case(
        "double_parallelogram",
        0,
        1,
        "flat, but no antiparallelogram serves both loops",
        2,
        "flat",
        (1,),
    ),
    Case(
        "row_of_four_bars",
        1,
        1,
        "flat: each crank can be the first that turns",
        4,
        "flat",
        (1, 1, 1, 1),
    ),
    Case(
        "three_rpr",
        3,
        3,
        "regular, but the lines of the actuators meet in a point",
        3,
        "concurrent",
    ),
    Case("wunderlich", 1, 2, "regular point of a motion of dimension 2", 2, "parallel"),
    Case("wunderlich", 1, 1, "regular point of a motion of dimension 1", 1, "antiparallel"),
)
"""Further postures: change points, a singularity of the actuators, and points of Wunderlich's two
kinds of motions."""

Motion = Callable[..., dict[str, float]]


def branches(name: str) -> list[tuple[int, Motion]]:
    """Motions through the singular posture of a mechanism, each with its dimension: coordinates, by
    name, as a function of as many numbers, zeros at the posture. All of the motions that meet
    there; none for other mechanisms, and none for `double_watt`, whose cusp has no smooth parameter
    in closed form.
    """
    return {
        "parallelogram": _parallelogram,
        "antiparallelogram": _parallelogram,
        "kite": _kite,
        "slider_crank_equal": _slider_crank_equal,
        "double_parallelogram": _double_parallelogram,
        "row_of_four_bars": _row_of_four_bars,
        "pendulum_dead_centre": _pendulum,
        "wunderlich": _wunderlich,
    }.get(name, list)()


def _four_bar(crank: float, coupler: float, rocker: float) -> dict[str, float]:
    """Joint coordinates of a four-bar from the directions of its links."""
    return {"A": crank, "B": coupler - crank, "C": rocker - coupler, "D": rocker}


def antiparallelogram_rocker(crank: float, a: float = 0.1, d: float = 0.3) -> float:
    """Angle of the rocker of an antiparallelogram for a crank angle below half a turn."""
    return 2 * atan((a + d) / (a - d) * tan(crank / 2))


def _parallelogram() -> list[tuple[int, Motion]]:
    def crossed(t: float) -> dict[str, float]:
        rocker = antiparallelogram_rocker(t)
        return _four_bar(t, t + rocker, rocker)

    return [(1, lambda t: _four_bar(t, 0.0, t)), (1, crossed)]


def _kite(a: float = 0.2, b: float = 0.3) -> list[tuple[int, Motion]]:
    def symmetric(t: float) -> dict[str, float]:
        along = a * cos(t / 2) + sqrt(b * b - (a * sin(t / 2)) ** 2)
        x = along * cos(t / 2)
        y = along * sin(t / 2)
        return _four_bar(t, atan2(y - a * sin(t), x - a * cos(t)), atan2(y, x - a))

    return [(1, symmetric), (1, lambda t: _four_bar(0.0, t, t))]


def _slider_crank_equal(r: float = 0.2) -> list[tuple[int, Motion]]:
    return [
        (1, lambda t: {"A": pi / 2 + t, "B": pi - 2 * t, "C": pi / 2 + t, "S": -2 * r * sin(t)}),
        (1, lambda t: {"A": pi / 2 + t, "B": pi, "C": pi / 2 - t, "S": 0.0}),
    ]


def _double_parallelogram() -> list[tuple[int, Motion]]:
    return [
        (
            1,
            lambda t: {
                f"{joint}{i}": sign * t for joint, sign in (("A", 1), ("B", -1)) for i in (1, 2, 3)
            },
        )
    ]


def _row_of_four_bars(n: int = 3) -> list[tuple[int, Motion]]:
    def motion(first: int) -> Motion:
        def coordinates(t: float) -> dict[str, float]:
            crank = [t if i >= first else 0.0 for i in range(n + 1)]
            coupler = [0.0] + [t if i == first else 0.0 for i in range(1, n + 1)]
            q = {f"A{i}": crank[i] for i in range(n + 1)}
            for i in range(1, n + 1):
                q |= {f"B{i}": coupler[i] - crank[i - 1], f"C{i}": crank[i] - coupler[i]}
            return q

        return coordinates

    return [(1, motion(first)) for first in range(n + 1)]


def _pendulum() -> list[tuple[int, Motion]]:
    return [(1, lambda t: {"A": 0.0, "B": 0.0, "C": 0.0, "P": t - pi / 3})]


# ------------------------------------------------------------------ Wunderlich's box

CORNERS = [(i, j, k) for i in (0, 1) for j in (0, 1) for k in (0, 1)]
Angles = Callable[[int, int], float]


def _box(a: Angles, b: Angles, c: Angles) -> dict[str, float]:
    """Joint coordinates from the directions of the bars a_jk, b_ik, c_ij; the ground is a_00."""
    q = {f"B{i}{j}{k}": b(i, k) - a(j, k) for i, j, k in CORNERS}
    return q | {f"C{i}{j}{k}": c(i, j) - a(j, k) for i, j, k in CORNERS}


def _crossed_faces(pair: str, lengths: dict[str, float]) -> Motion:
    """Two opposite faces are antiparallelograms, the other four parallelograms; s and the third
    direction are free.
    """
    one, two = pair
    third = next(x for x in "abc" if x not in pair)
    # direction of the bar, then the two places in its name
    axes = {
        "a": "ijk",
        "b": "jik",
        "c": "kij",
    }

    def coordinates(s: float, t: float) -> dict[str, float]:
        def direction(bar: str) -> Angles:
            def angle(x: int, y: int) -> float:
                if bar == third:
                    return t
                other = axes[two if bar == one else one][0]
                place = (x, y)[axes[bar].index(other) - 1]
                return asin(s / lengths[bar]) * (1 if place == 0 else -1)

            return angle

        a, b, c = (direction(bar) for bar in "abc")
        turn = a(0, 0)
        return _box(
            lambda x, y: a(x, y) - turn, lambda x, y: b(x, y) - turn, lambda x, y: c(x, y) - turn
        )

    return coordinates


def _all_crossed(lengths: dict[str, float]) -> Motion:
    """All six faces are antiparallelograms: the directions of the three bars at a pin are free.

    A fourth corner is the mirror image of the first one in the bisector of the two others. That the
    last corner comes out the same from three faces is the consistency of cross-ratios (Bobenko and
    Suris, 2002).
    """

    def mirrored(z: complex, z1: complex, z2: complex) -> complex:
        along = (z2 - z1) / abs(z2 - z1)
        return z + 2 * along * (((z1 + z2) / 2 - z) * along.conjugate()).real

    def coordinates(s: float, t: float) -> dict[str, float]:
        z = {
            (0, 0, 0): 0j,
            (1, 0, 0): complex(lengths["a"]),
            (0, 1, 0): rect(lengths["b"], s),
            (0, 0, 1): rect(lengths["c"], t),
        }
        z[1, 1, 0] = mirrored(z[0, 0, 0], z[1, 0, 0], z[0, 1, 0])
        z[1, 0, 1] = mirrored(z[0, 0, 0], z[1, 0, 0], z[0, 0, 1])
        z[0, 1, 1] = mirrored(z[0, 0, 0], z[0, 1, 0], z[0, 0, 1])
        z[1, 1, 1] = mirrored(z[1, 0, 0], z[1, 1, 0], z[1, 0, 1])
        return _box(
            lambda j, k: phase(z[1, j, k] - z[0, j, k]),
            lambda i, k: phase(z[i, 1, k] - z[i, 0, k]),
            lambda i, j: phase(z[i, j, 1] - z[i, j, 0]),
        )

    return coordinates


def _crossed_pin(pin: tuple[int, int, int], lengths: dict[str, float]) -> Motion:
    """The three faces around a pin are antiparallelograms, the other three parallelograms; s is
    free.
    """

    def coordinates(s: float) -> dict[str, float]:
        def direction(bar: int) -> Angles:
            here = tuple(x for place, x in enumerate(pin) if place != bar)
            size = asin(s / lengths["abc"[bar]]) * (1 if pin[bar] else -1)
            return lambda x, y: -size if (x, y) == here else size

        a, b, c = (direction(bar) for bar in range(3))
        turn = a(0, 0)
        return _box(
            lambda x, y: a(x, y) - turn, lambda x, y: b(x, y) - turn, lambda x, y: c(x, y) - turn
        )

    return coordinates


def _wunderlich() -> list[tuple[int, Motion]]:
    lengths = {"a": 0.9, "b": 0.6, "c": 0.3}
    motions: list[tuple[int, Motion]] = [
        (2, lambda s, t: _box(lambda x, y: 0.0, lambda x, y: s, lambda x, y: t))
    ]
    motions += [(2, _crossed_faces(pair, lengths)) for pair in ("ab", "ac", "bc")] + [
        (2, _all_crossed(lengths))
    ]
    return motions + [(1, _crossed_pin(pin, lengths)) for pin in CORNERS]

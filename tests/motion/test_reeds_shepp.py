"""Ways of a car with a turning radius: they lead to the goal, and none that is shorter was found."""

from __future__ import annotations

import math

import numpy as np
import pytest

from kempe.motion.reeds_shepp import compute_length, list_ways


def follow(way) -> np.ndarray:
    """The pose at the end of a way, by complex numbers: independent of the formula under test."""
    z = 0j
    h = 0.0
    for curvature, length in way:
        if curvature:
            centre = z + 1j * curvature * np.exp(1j * h)
            h += curvature * length
            z = centre - 1j * curvature * np.exp(1j * h)
        else:
            z += length * np.exp(1j * h)
    return np.array([z.real, z.imag, h])


def cusps_of(way) -> int:
    """How often a way changes between forwards and reverse."""
    signs = [length > 0.0 for _, length in way if length]
    return sum(a != b for a, b in zip(signs, signs[1:], strict=False))


def goals(rng: np.random.Generator, n: int) -> np.ndarray:
    """Goals near and far, many of them with parallel or opposite headings."""
    size = rng.choice([0.01, 0.3, 1.0, 5.0, 100.0], n)
    heading = np.where(
        rng.random(n) < 0.2, rng.choice([0.0, math.pi, math.pi / 2], n), rng.uniform(-4, 4, n)
    )
    return np.column_stack([size * rng.uniform(-1, 1, n), size * rng.uniform(-1, 1, n), heading])


def test_every_way_leads_to_the_goal(hunt):
    for x, y, h in goals(hunt.rng(), hunt.cases(300)):
        found = list_ways(x, y, h)
        assert found
        for way in found:
            off = follow(way) - [x, y, h]
            off[2] = math.remainder(off[2], 2 * math.pi)
            assert np.abs(off).max() < 1e-12 * (1 + math.hypot(x, y))
        assert [compute_length(w) for w in found] == sorted(compute_length(w) for w in found)


# Turning round in place takes three arcs of 60 degrees (Reeds and Shepp, 1990, section 1).
@pytest.mark.parametrize(
    ("goal", "length", "cusps"),
    [
        ((0.0, 0.0, 0.0), 0.0, 0),
        ((3.0, 0.0, 0.0), 3.0, 0),
        ((-3.0, 0.0, 0.0), 3.0, 0),
        ((1.0, 1.0, math.pi / 2), math.pi / 2, 0),
        ((0.0, 2.0, math.pi), math.pi, 0),
        ((0.0, 0.0, math.pi), math.pi, 2),
    ],
)
def test_known_lengths(goal, length, cusps):
    best = list_ways(*goal)[0] if any(goal) else ()
    assert compute_length(best) == pytest.approx(length, abs=1e-12)
    assert cusps_of(best) == cusps


@pytest.mark.parametrize("sign", [(-1, 1, -1), (1, -1, -1)])
def test_lengths_are_those_of_mirror_images(hunt, sign):
    for goal in goals(hunt.rng(), hunt.cases(100)):
        mirrored = goal * sign
        assert compute_length(list_ways(*goal)[0]) == pytest.approx(
            compute_length(list_ways(*mirrored)[0]), abs=1e-9
        )


def polished(way: np.ndarray, goal: np.ndarray) -> np.ndarray | None:
    """Lengths near those of a word (curvatures, lengths) that end at the goal: Newton with
    differences.
    """
    k, x = way
    for _ in range(30):
        off = goal - follow(zip(k, x, strict=True))
        off[2] = math.remainder(off[2], 2 * math.pi)
        if np.abs(off).max() < 1e-11:
            return x
        J = np.empty((3, len(x)))
        for i in range(len(x)):
            moved = x.copy()
            moved[i] += 1e-7
            J[:, i] = (follow(zip(k, moved, strict=True)) - follow(zip(k, x, strict=True))) / 1e-7
        step = np.linalg.lstsq(J, off, rcond=1e-8)[0]
        x = x + step / max(1.0, np.abs(step).max())
    return None


@pytest.mark.parametrize("starts", [6, pytest.param(150, marks=pytest.mark.slow)])
def test_no_shorter_way_of_up_to_five_pieces_was_found(hunt, starts):
    """Random sequences of arcs and lines, led to the goal: an upper bound that shares nothing with
    the formulas.
    """
    rng = hunt.rng()
    near = 0
    for goal in goals(rng, hunt.cases(12)):
        if np.abs(goal).max() > 20:
            continue
        best = compute_length(list_ways(*goal)[0])
        for _ in range(starts):
            n = int(rng.integers(3, 6))
            k = rng.choice([-1.0, 0.0, 1.0], n)
            x = polished((k, rng.uniform(-1, 1, n) * max(0.3, best / 2)), goal)
            if x is not None:
                assert np.abs(x).sum() > best - 1e-8
                near += np.abs(x).sum() < 1.5 * best + 1e-3
    assert near

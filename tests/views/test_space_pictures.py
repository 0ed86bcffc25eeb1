"""Pictures of both spaces: numbers, lines and distances are those of closed forms; pixels are not compared."""

from __future__ import annotations

import numpy as np
import pytest
from drawn import artists

import kempe
from kempe.errors import InputError, UnknownNameError, UnsupportedError

pytest.importorskip("matplotlib")
from kempe.views.space_pictures import nearest, preimages

ARM = kempe.load("two_link")
LIMITED = ARM.with_limits({"q1": (-0.5, 2.0), "q2": (-1.0, 2.5)})
L1, L2 = 0.5, 0.4


def by_hand(p: np.ndarray, limits: list[tuple[float, float]]) -> int:
    """How many of the two closed-form solutions (the lecture's) lie within limits."""
    c2 = (p @ p - L1**2 - L2**2) / (2.0 * L1 * L2)
    if abs(c2) > 1.0:
        return 0
    count = 0
    for sign in (1.0, -1.0):
        s2 = sign * np.sqrt(1.0 - c2**2)
        q = np.array([np.arctan2(p[1], p[0]) - np.arctan2(L2 * s2, L1 + L2 * c2), np.arctan2(s2, c2)])
        inside = [
            any(a <= x + k <= b for k in (-2.0 * np.pi, 0.0, 2.0 * np.pi)) for x, (a, b) in zip(q, limits, strict=True)
        ]
        count += all(inside)
    return count


@pytest.mark.parametrize(("system", "limits"), [
    (ARM, [(-9.0, 9.0)] * 2), (LIMITED, [(-0.5, 2.0), (-1.0, 2.5)]),
])  # fmt: skip
def test_numbers_of_configurations_are_those_of_the_closed_form(system, limits):
    p = np.random.default_rng(3).uniform(-1.0, 1.0, (300, 2))
    expected = [by_hand(x, limits) for x in p]
    assert preimages(system, "e", p).tolist() == expected and set(expected) == {0, 1, 2} - (
        {1} if system is ARM else set()
    )


def test_shades_show_these_numbers():
    left, right = LIMITED.plot_spaces("e", resolution=40)
    for ax, at in ((right, lambda x: x), (left, lambda q: LIMITED.fk(q, "e")[:2, 3])):
        mesh = artists(ax)["preimages"][0]
        x, y = (np.asarray(mesh.get_coordinates())[..., i] for i in range(2))
        middles = np.stack([0.25 * (z[1:, 1:] + z[:-1, 1:] + z[1:, :-1] + z[:-1, :-1]) for z in (x, y)], axis=-1)
        shown = np.asarray(mesh.get_array()).reshape(middles.shape[:2])
        rng = np.random.default_rng(0)
        for _ in range(60):
            i, j = rng.integers(1, 39, 2)
            assert shown[i, j] == by_hand(at(middles[i, j]), [(-0.5, 2.0), (-1.0, 2.5)]) or ax is left and j in (0, 39)


def test_singular_lines_and_their_images():
    """The arm is singular where q2 is 0 or pi: circles of radius l1 + l2 and l1 - l2."""
    left, right = ARM.plot_spaces("e", resolution=61)
    lines = [c for c in left.collections if c.get_gid() is None and len(c.get_paths())]
    q2 = np.concatenate([path.vertices[:, 1] for c in lines for path in c.get_paths()])
    assert np.abs(np.sin(q2)).max() < 1e-6 and np.abs(q2).min() < 1e-6
    radii = [np.hypot(*line.get_data()) for k, (line,) in artists(right).items() if k.startswith("singular")]
    assert {round(float(r.mean()), 6) for r in radii} == {0.9, 0.1} and max(float(np.ptp(r)) for r in radii) < 1e-6


def test_points_have_their_solutions_or_their_distance():
    left, right = ARM.plot_spaces("e", points=[(0.6, 0.3), (1.2, 0.5)], resolution=30)
    solutions = [np.ravel(a.get_data()) for k, (a, *_) in artists(left).items() if k.startswith("solution:0")]
    expected = [ARM.q("elbow_up"), ARM.q("elbow_down")]
    assert len(solutions) == 2
    assert all(min(np.abs(q - x).max() for x in solutions) < 1e-9 for q in expected)
    for k in range(2):
        ends = np.array(artists(right)[f"arm:0:{k}"][0].get_data())
        assert ends[:, 0] == pytest.approx([0.6, 0.3]) and ends[:, -1] == pytest.approx([0.0, 0.0])
    line = np.array(artists(right)["distance:1"][0].get_data())
    assert np.linalg.norm(line[:, 1] - line[:, 0]) == pytest.approx(1.3 - 0.9, abs=1e-6)
    assert artists(right)["distance:1:text"][0].get_text() == "0.4 m away"


def test_the_nearest_place_within_limits_is_that_of_a_fine_grid():
    grid = np.stack(np.meshgrid(np.linspace(-0.5, 2.0, 700), np.linspace(-1.0, 2.5, 700), indexing="ij"), axis=-1)
    p = LIMITED.fk(grid, "e")[..., :2, 3]
    for target in ([-0.5, -0.3], [1.0, 0.4], [0.0, 0.0]):
        far = nearest(LIMITED, "e", np.array(target), grid[::20, ::20], p[::20, ::20])[2]
        assert far == pytest.approx(float(np.linalg.norm(p - target, axis=-1).min()), abs=5e-3)


def test_limits_are_a_rectangle_and_its_image():
    left, right = LIMITED.plot_spaces("e", resolution=20)
    assert {k for k in artists(left) if k.startswith("limit")} == {f"limit:q{i}:{k}" for i in (1, 2) for k in (0, 1)}
    x, y = artists(right)["limit:q2:1"][0].get_data()
    assert np.hypot(x, y) == pytest.approx(np.sqrt(L1**2 + L2**2 + 2.0 * L1 * L2 * np.cos(2.5)))


def test_what_cannot_be_drawn_is_said():
    with pytest.raises(UnsupportedError, match="two coordinates.*puma560 has 6"):
        kempe.load("puma560").plot_spaces("tool")
    with pytest.raises(UnsupportedError, match="and loops"):
        kempe.load("four_bar").plot_spaces("coupler_point")
    with pytest.raises(UnknownNameError):
        ARM.plot_spaces("nowhere")
    for points in ([1.0, 2.0, 3.0], [[np.nan, 0.0]]):
        with pytest.raises(InputError, match="points"):
            ARM.plot_spaces("e", points=points)
    with pytest.raises(InputError, match="resolution"):
        ARM.plot_spaces("e", resolution=1)
    with pytest.raises(InputError, match="2 matplotlib axes"):
        ARM.plot_spaces("e", ax=3)
    m = kempe.Mechanism("polar", dim=2)
    m.revolute("t", m.ground, m.body("a"))
    m.prismatic("s", "a", m.body("b"), axis=(1, 0))
    with pytest.raises(InputError, match=r"'s' has no limits.*with_limits"):
        m.build().plot_spaces("b")

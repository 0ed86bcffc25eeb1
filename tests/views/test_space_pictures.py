"""Pictures of both spaces: numbers, lines and distances are those of closed forms; pixels are not
compared.
"""

from __future__ import annotations

import numpy as np
import pytest
from drawn import artists
from two_freedoms_in_space import (
    between,
    directions,
    lengths_of_pointer,
    pointer,
    slider_pair,
    spherical_five_bar,
)

import kempe
from kempe import Budget
from kempe.arguments import call_until_interrupt
from kempe.errors import InputError, TimeLimitError, UnknownNameError, UnsupportedError

pytest.importorskip("matplotlib")
from kempe.constraints.flat_tasks import FlatTask
from kempe.spaces import two_freedoms as spaces
from kempe.views.space_pictures import find_nearest

ARM = kempe.load("two_link")
LIMITED = ARM.with_limits({"q1": (-0.5, 2.0), "q2": (-1.0, 2.5)})
L1 = 0.5
L2 = 0.4
FIVE = kempe.load("five_bar").with_parameters(d=0.3)
CRANK = 0.2
ROD = 0.3
BASE = 0.3
"""Its lengths; its pivots are at (0, 0) and (BASE, 0)."""
ARCS = (1.0, 1.2, 1.1, 0.9, 1.3)
"""Of a spherical five-bar: crank, rod, rod, crank, base."""


PLANE = FlatTask("xy", 2)


def two_freedoms(system, frame, task=PLANE):
    return spaces.make_two_freedoms(system, frame, task)


def by_hand(p: np.ndarray, limits: list[tuple[float, float]]) -> int:
    """How many of the two closed-form solutions (the lecture's) lie within limits."""
    c2 = (p @ p - L1**2 - L2**2) / (2.0 * L1 * L2)
    if abs(c2) > 1.0:
        return 0
    count = 0
    for sign in (1.0, -1.0):
        s2 = sign * np.sqrt(1.0 - c2**2)
        q = np.array(
            [np.arctan2(p[1], p[0]) - np.arctan2(L2 * s2, L1 + L2 * c2), np.arctan2(s2, c2)]
        )
        inside = [
            any(a <= x + k <= b for k in (-2.0 * np.pi, 0.0, 2.0 * np.pi))
            for x, (a, b) in zip(q, limits, strict=True)
        ]
        count += all(inside)
    return count


@pytest.mark.parametrize(
    ("system", "limits"),
    [
        (ARM, [(-9.0, 9.0)] * 2),
        (LIMITED, [(-0.5, 2.0), (-1.0, 2.5)]),
    ],
)
def test_numbers_of_configurations_are_those_of_the_closed_form(system, limits):
    p = np.random.default_rng(3).uniform(-1.0, 1.0, (300, 2))
    expected = [by_hand(x, limits) for x in p]
    found = two_freedoms(system, "e").solve_places(p)[1].sum(axis=1)
    assert found.tolist() == expected and set(expected) == {0, 1, 2} - (
        {1} if system is ARM else set()
    )


def test_shades_show_these_numbers():
    left, right = LIMITED.plot_spaces("e", resolution=40)
    for ax, at in ((right, lambda x: x), (left, lambda q: LIMITED.fk(q, "e")[:2, 3])):
        mesh = artists(ax)["preimages"][0]
        x, y = (np.asarray(mesh.get_coordinates())[..., i] for i in range(2))
        middles = np.stack(
            [0.25 * (z[1:, 1:] + z[:-1, 1:] + z[1:, :-1] + z[:-1, :-1]) for z in (x, y)], axis=-1
        )
        shown = np.asarray(mesh.get_array()).reshape(middles.shape[:2])
        rng = np.random.default_rng(0)
        for _ in range(60):
            i, j = rng.integers(1, 39, 2)
            assert (
                shown[i, j] == by_hand(at(middles[i, j]), [(-0.5, 2.0), (-1.0, 2.5)])
                or ax is left
                and j in (0, 39)
            )


def test_singular_lines_and_their_images():
    """The arm is singular where q2 is 0 or pi: circles of radius l1 + l2 and l1 - l2."""
    left, right = ARM.plot_spaces("e", resolution=61)
    lines = [line for k, (line,) in artists(left).items() if k.startswith("singular")]
    q2 = np.concatenate([line.get_ydata() for line in lines])
    q2 = q2[np.isfinite(q2)]
    assert np.abs(np.sin(q2)).max() < 1e-6 and np.abs(q2).min() < 1e-6
    radii = [
        np.hypot(*line.get_data())
        for k, (line,) in artists(right).items()
        if k.startswith("singular")
    ]
    assert {round(float(r.mean()), 6) for r in radii} == {0.9, 0.1} and max(
        float(np.ptp(r)) for r in radii
    ) < 1e-6


def test_points_have_their_solutions_or_their_distance():
    left, right = ARM.plot_spaces("e", points=[(0.6, 0.3), (1.2, 0.5)], resolution=30)
    solutions = [
        np.ravel(a.get_data()) for k, (a, *_) in artists(left).items() if k.startswith("solution:0")
    ]
    expected = [ARM.q("elbow_up"), ARM.q("elbow_down")]
    assert len(solutions) == 2
    assert all(min(np.abs(q - x).max() for x in solutions) < 1e-9 for q in expected)
    for k in range(2):
        bars = {name: v for name, v in artists(right).items() if name.startswith(f"arm:0:{k}")}
        lower, upper = (np.array(line.get_data()) for (line,) in bars.values())
        assert lower[:, 0] == pytest.approx([0.0, 0.0]) and upper[:, -1] == pytest.approx(
            [0.6, 0.3]
        )
        assert lower[:, -1] == pytest.approx(upper[:, 0])
    line = np.array(artists(right)["distance:1"][0].get_data())
    assert np.linalg.norm(line[:, 1] - line[:, 0]) == pytest.approx(1.3 - 0.9, abs=1e-6)
    assert artists(right)["distance:1:text"][0].get_text() == "0.4 m away"


@pytest.mark.slow
@pytest.mark.parametrize("small", [False, True])
def test_texts_do_not_cover_each_other(small):
    """Numbers of points and distances, and what stands at the axes, also of systems of millimetres."""
    m = kempe.Mechanism("arm", dim=2)
    if small:
        m.revolute("q1", m.ground, m.body("a"), limits=(0.0, 0.05))
        m.revolute("q2", "a", m.body("b"), at=(6e-4, 1e-4), limits=(1.0, 1.04))
        m.frame("e", "b", at=(4e-4, 0))
        places = [[8e-4, 4e-4]]
    else:
        m.revolute("q1", m.ground, m.body("a"), limits=(-1.0, 1.0))
        m.revolute("q2", "a", m.body("b"), at=(0.6, 0.1), limits=(-1.0, 1.0))
        m.frame("e", "b", at=(0.4, 0))
        places = [[0.8, 0.1], [2.0, 2.0]]
    left, right = m.build().plot_spaces("e", points=places)
    right.figure.canvas.draw()
    for ax in (left, right):
        texts = [t for t in (*ax.texts, *ax.get_xticklabels()) if t.get_text()]
        boxes = [t.get_window_extent() for t in texts]
        for i, a in enumerate(boxes):
            for t, b in zip(texts[:i], boxes[:i], strict=True):
                assert not a.overlaps(b), f"{texts[i].get_text()!r} covers {t.get_text()!r}"
    assert sum("away" in t.get_text() for t in right.texts) == len(places)


def test_the_nearest_place_within_limits_is_that_of_a_fine_grid():
    grid = np.stack(
        np.meshgrid(np.linspace(-0.5, 2.0, 700), np.linspace(-1.0, 2.5, 700), indexing="ij"),
        axis=-1,
    )
    p = LIMITED.fk(grid, "e")[..., :2, 3]
    for target in ([-0.5, -0.3], [1.0, 0.4], [0.0, 0.0]):
        far = find_nearest(LIMITED, "e", PLANE, np.array(target), grid[::20, ::20], p[::20, ::20])[
            2
        ]
        assert far == pytest.approx(float(np.linalg.norm(p - target, axis=-1).min()), abs=5e-3)


def test_limits_are_a_rectangle_and_its_image():
    left, right = LIMITED.plot_spaces("e", resolution=20)
    assert {k for k in artists(left) if k.startswith("limit")} == {
        f"limit:q{i}:{k}" for i in (1, 2) for k in (0, 1)
    }
    x, y = artists(right)["limit:q2:1"][0].get_data()
    assert np.hypot(x, y) == pytest.approx(np.sqrt(L1**2 + L2**2 + 2.0 * L1 * L2 * np.cos(2.5)))


@pytest.mark.slow
def test_what_cannot_be_drawn_is_said():
    with pytest.raises(UnsupportedError, match="two degrees of freedom.*puma560 has 6 coordinates"):
        kempe.load("puma560").plot_spaces("tool")
    for name, frame, words in [
        ("four_bar", "coupler_point", "four_bar has 1 freedom and loops"),
        ("three_rrr", "tool", "has 3 freedoms and loops"),
        ("five_bar", "arm2", "'arm2' of five_bar moves on"),
        ("rssr", "coupler", "rssr has 1 freedom and loops, 1 idle spin left out"),
    ]:
        with pytest.raises(UnsupportedError, match=words):
            kempe.load(name).plot_spaces(frame)
    with pytest.raises(InputError, match="'ground' of five_bar does not move"):
        FIVE.plot_spaces("ground")
    with pytest.raises(UnsupportedError, match="no configuration was found inside the limits"):
        FIVE.with_limits({"A": (3.1, 3.13), "D": (0.0, 0.02), "P": (1.0, 1.1)}).plot_spaces("tip")
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


def test_configurations_paths_and_self_motions_are_drawn_in_both_spaces():
    """On the right is the image by the forward model: of a self-motion the line that it keeps to."""
    targets = np.linspace([0.75, 0.1], [0.2, 0.6], 20)
    way = LIMITED.ik_path(targets, "e", start=[-0.3, 0.8])
    start = np.array([0.3, 0.9])
    x = float(LIMITED.fk(start, "e")[0, 3])
    kept = LIMITED.inverse.self_motion(
        start, kempe.constraints.OnLine("e", (x, 0.0), (0.0, 1.0, 0.0))
    )
    line = np.linspace([1.0, 0.5], [1.5, 2.0], 7)
    sides = LIMITED.plot_spaces("e", q=[{"q1": 1.0, "q2": 2.0}, way, kept, line], resolution=20)
    left, right = (artists(ax) for ax in sides)
    for k, q in enumerate((way.q, kept.q, line)):
        assert np.transpose(left[f"path:{k}"][0].get_data()) == pytest.approx(q)
        image = np.transpose(right[f"path:{k}"][0].get_data())
        assert image == pytest.approx(LIMITED.fk(q, "e")[:, :2, 3])
        assert np.ravel(left[f"begin:{k}"][0].get_data()) == pytest.approx(q[0])
    assert len(kept) > 5 and np.ptp(right["path:1"][0].get_xdata()) < 1e-8
    assert np.transpose(right["path:0"][0].get_data()) == pytest.approx(targets, abs=1e-5)
    assert np.ravel(left["configuration:0"][0].get_data()) == pytest.approx([1.0, 2.0])
    assert any(k.startswith("configuration:0:arm") for k in right)
    for wrong in (3.0, [np.zeros((2, 3))], np.zeros((1, 2, 2)), [np.nan, 0.0]):
        with pytest.raises(InputError):
            LIMITED.plot_spaces("e", resolution=20, q=wrong)


# ---- with closed loops


@pytest.fixture(scope="module")
def five():
    return FIVE.plot_spaces("tip", points=[(0.1, 0.35), (0.6, 0.3)], resolution=40)


def shades(ax):
    """Middles (n, n, 2) of the cells of a picture, and the numbers (n, n) shown there."""
    mesh = artists(ax)["preimages"][0]
    x, y = (np.asarray(mesh.get_coordinates())[..., i] for i in range(2))
    middles = np.stack(
        [0.25 * (z[1:, 1:] + z[:-1, 1:] + z[1:, :-1] + z[:-1, :-1]) for z in (x, y)], axis=-1
    )
    return middles, np.asarray(mesh.get_array()).reshape(middles.shape[:2])


@pytest.mark.slow
def test_ways_of_a_five_bar_are_those_of_its_legs(five):
    """Each leg reaches a place in two ways where the distance from its pivot is between b - a and a
    + b.
    """
    p, shown = shades(five[1])
    legs = [np.linalg.norm(p - x, axis=-1) for x in ([0.0, 0.0], [BASE, 0.0])]
    ways = [2 * ((r < CRANK + ROD) & (r > ROD - CRANK)) for r in legs]
    assert np.array_equal(shown, ways[0] * ways[1]) and set(shown.ravel()) == {0, 4}


@pytest.mark.slow
def test_modes_of_a_five_bar_are_two_where_the_rods_are_long_enough(five):
    q, shown = shades(five[0])
    ends = [
        x + CRANK * np.stack([np.cos(a), np.sin(a)], axis=-1)
        for x, a in zip(([0.0, 0.0], [BASE, 0.0]), np.moveaxis(q, -1, 0), strict=True)
    ]
    far = np.linalg.norm(ends[1] - ends[0], axis=-1)
    assert np.array_equal(shown, 2 * (far < 2.0 * ROD)) and set(shown.ravel()) == {0, 2}


def test_modes_and_ways_of_five_bars_are_those_of_triangles(hunt):
    """Each leg closes a triangle in two ways or in none, and so do the rods."""
    rng = hunt.rng()
    for _ in range(hunt.cases(40)):
        a1, b1, b2, a2, d = rng.uniform(0.1, 1.0, 5)
        m = kempe.Mechanism("five bars", dim=2)
        for name, parent, child, at, of in [
            ("A", "ground", "crank1", 0.0, 0.0),
            ("B", "crank1", "rod1", a1, 0.0),
            ("P", "rod1", "rod2", b1, b2),
            ("C", "crank2", "rod2", a2, 0.0),
            ("D", "ground", "crank2", d, 0.0),
        ]:
            for body in (parent, child):
                body in m.bodies or m.body(body)
            m.revolute(name, parent, child, at=(at, 0), child_at=(of, 0), actuated=name in "AD")
        m.frame("tip", "rod1", at=(b1, 0))
        space = two_freedoms(m.build(), "tip")
        values = rng.uniform(-np.pi, np.pi, (500, 2))
        p = rng.uniform(-1.5, 1.5, (500, 2))
        ends = [
            x + a * np.stack([np.cos(q), np.sin(q)], axis=1)
            for x, a, q in (([0.0, 0.0], a1, values[:, 0]), ([d, 0.0], a2, values[:, 1]))
        ]
        far = np.linalg.norm(ends[1] - ends[0], axis=1)
        legs = [np.linalg.norm(p - [x, 0.0], axis=1) for x in (0.0, d)]
        modes = space.solve_values(values)[1].sum(axis=1)
        ways = space.solve_places(p)[1].sum(axis=1)
        assert space.names == ("A", "D")
        assert np.array_equal(modes, 2 * _closes(far, b1, b2))
        assert np.array_equal(ways, 4 * (_closes(legs[0], a1, b1) & _closes(legs[1], a2, b2)))


def _closes(far, a, b):
    assert np.abs(far - abs(a - b)).min() > 1e-9 and np.abs(far - a - b).min() > 1e-9
    return (far < a + b) & (far > abs(a - b))


def test_singular_lines_are_where_modes_and_ways_meet(five):
    """Of type 1 circles about the pivots; of type 2, on the left, where the rods are in line or
    fold.
    """
    lines = {k: v[0] for k, v in artists(five[1]).items() if k.startswith("singular")}
    radii = {
        k: [np.hypot(x.get_xdata() - b, x.get_ydata()) for b in (0.0, BASE)]
        for k, x in lines.items()
    }
    kind = {
        k: any(min(abs(r - ROD - CRANK).max(), abs(r - ROD + CRANK).max()) < 1e-6 for r in v)
        for k, v in radii.items()
    }
    assert {lines[k].get_linestyle() for k in lines if kind[k]} == {"-"} and 4 <= sum(
        kind.values()
    ) < len(kind)
    assert {lines[k].get_linestyle() for k in lines if not kind[k]} == {"--"}
    for k in (k for k in lines if not kind[k]):
        a, d = np.array(artists(five[0])[k][0].get_data())
        far = np.hypot(BASE + CRANK * (np.cos(d) - np.cos(a)), CRANK * (np.sin(d) - np.sin(a)))
        far = far[np.isfinite(far)]
        assert min(np.abs(far - 2.0 * ROD).max(), far.max()) < 1e-6
    words = [t.get_text() for t in five[1].get_legend().get_texts()]
    assert words == [
        "none",
        "2 modes, or 2 ways",
        "4 modes, or 4 ways",
        "singular, type 1",
        "singular, type 2",
    ]


def test_points_of_a_five_bar_have_four_solutions_or_a_distance(five):
    solutions = [k for k in artists(five[0]) if k.startswith("solution:0")]
    bars = {
        k: np.array(v[0].get_data()) for k, v in artists(five[1]).items() if k.startswith("arm:0")
    }
    assert len(solutions) == 4 and len(bars) == 16
    assert all(
        np.linalg.norm(x[:, 1] - x[:, 0]) == pytest.approx(CRANK if "crank" in k else ROD)
        for k, x in bars.items()
    )
    (text,) = artists(five[1])["distance:1:text"]
    assert text.get_text() == f"{np.hypot(0.6, 0.3) - CRANK - ROD:.3g} m away"


@pytest.mark.slow
def test_limits_of_other_coordinates_are_lines():
    system = FIVE.with_limits({"A": (0.0, 2.8), "P": (0.3, 2.5)})
    left, right = system.plot_spaces("tip", resolution=80, grid=True)
    drawn = artists(left)
    assert {k.split(":")[1] for k in drawn if k.startswith("limit")} == {"A", "D", "P"}
    for k, lines in drawn.items():
        for line in lines if k.startswith("limit:P") else ():
            values = np.transpose(line.get_data())
            values = values[np.isfinite(values).all(axis=1)]
            P = FIVE.loops.closed_form(["A", "D"]).all(values)[0][..., 2]
            assert np.abs(P[..., None] - [0.3, 2.5]).min(axis=(1, 2)).max() < 0.03
    assert "limits" in [t.get_text() for t in right.get_legend().get_texts()]
    count = shades(left)[1]
    assert set(count.ravel()) == {0, 1}  # one of two modes has P > 0


@pytest.mark.parametrize("limits", [{}, {"A": (0.0, 2.8), "P": (0.3, 2.5)}])
def test_places_with_a_configuration_are_the_image_of_a_grid(limits):
    space = two_freedoms(FIVE.with_limits(limits), "tip")
    p = space.compute_places(*space.solve_grid(300)).reshape(-1, 2)
    x = np.linspace(-0.31, 0.61, 24)
    y = np.linspace(-0.51, 0.52, 27)
    beside = np.histogram2d(*p[np.isfinite(p).all(axis=1)].T, bins=[_edges(x), _edges(y)])[0] > 0
    reached = space.count_reaching_grid(x, y) > 0
    assert not (reached & ~beside).any()  # a cell whose middle is reached holds some of the image
    assert (
        reached == beside
    ).mean() > 0.88 and 0.1 < reached.mean() < 0.9  # but beside the borders


def _edges(x):
    step = x[1] - x[0]
    return np.append(x, x[-1] + step) - 0.5 * step


def linkage() -> kempe.System:
    """A mechanism with seven bars and two freedoms, whose actuated joints leave no dyads."""
    m = kempe.Mechanism("seven", dim=2)
    for b in ("c1", "l1", "c2", "tern", "l2", "l3"):
        m.body(b)
    m.revolute("A", m.ground, "c1", actuated=True)
    m.revolute("B", "c1", "l1", at=(0.2, 0))
    m.revolute("P", "l1", "tern", at=(0.35, 0))
    m.revolute("C", "tern", "c2", at=(0.3, 0), child_at=(0.25, 0))
    m.revolute("D", m.ground, "c2", at=(0.4, 0))
    m.revolute("E", "tern", "l2", at=(0.15, 0.1))
    m.revolute("F", "l2", "l3", at=(0.35, 0))
    m.revolute("G", m.ground, "l3", at=(0.7, 0), child_at=(0.2, 0), actuated=True)
    m.frame("tip", "tern", at=(0.15, 0.2))
    m.frame("mid", "l1", at=(0.1, 0.05))
    return m.build()


def test_another_pair_of_coordinates_takes_over_where_actuated_ones_leave_no_dyads():
    space = two_freedoms(linkage(), "tip")
    assert space.names != ("A", "G") and space.complete
    rng = np.random.default_rng(1)
    q, mask = space.solve_values(rng.uniform(-3.0, 3.0, (200, 2)))
    assert np.abs(space.system.loops.closure_error(q[mask])).max() < 1e-9
    p = space.compute_places(q, mask)[mask]
    back, ok = space.solve_places(p)
    assert ok.any(axis=1).all() and space.compute_places(back, ok)[ok] == pytest.approx(
        np.repeat(p, ok.sum(axis=1), axis=0)
    )
    off = np.abs(np.sin(0.5 * (back - q[mask][:, None]))).max(axis=-1)
    # the one that it came from is among them
    assert np.where(ok, off, 1.0).min(axis=1).max() < 1e-6


@pytest.mark.slow
def test_slides_as_drives_are_the_axes():
    m = kempe.Mechanism("RPRPR", dim=2)
    for k, x in ((1, 0.0), (2, 0.8)):
        m.revolute(f"A{k}", m.ground, m.body(f"leg{k}"), at=(x, 0))
        m.prismatic(
            f"s{k}", f"leg{k}", m.body(f"rod{k}"), axis=(1, 0), limits=(0.3, 1.0), actuated=True
        )
    m.revolute("P", "rod1", "rod2")
    left, right = m.build().plot_spaces("rod1", points=[(0.4, 1.2)], resolution=50)
    assert left.get_xlabel() == "s1 [m]" and left.get_ylabel() == "s2 [m]"
    s, modes = shades(left)
    clear = np.abs(s.sum(axis=-1) - 0.8) > 1e-9
    # the triangle with the base of 0.8 m closes
    assert np.array_equal(modes[clear], 2 * (s.sum(axis=-1) > 0.8)[clear])
    p, ways = shades(right)
    legs = np.stack([np.linalg.norm(p - x, axis=-1) for x in ([0.0, 0.0], [0.8, 0.0])])
    assert np.array_equal(ways, ((legs > 0.3) & (legs < 1.0)).all(axis=0))
    assert (
        artists(right)["distance:0:text"][0].get_text() == f"{1.2 - np.sqrt(1.0 - 0.16):.3g} m away"
    )
    m.joints["s2"].limits.clear()
    with pytest.raises(InputError, match=r"'s2' has no limits.*with_limits"):
        m.build().plot_spaces("rod1")


# ---- in space


@pytest.fixture(scope="module")
def pointing():
    points = [(0.3, 0.5), (1.5, 0.6)]
    return spherical_five_bar(*ARCS).plot_spaces(
        "tip", task="direction", points=points, grid=True, resolution=24
    )


@pytest.mark.slow
def test_a_direction_has_its_solutions_or_an_angle(pointing):
    left, right = (artists(ax) for ax in pointing)
    assert len([k for k in left if k.startswith("solution:0")]) == 4 and not any(
        k.startswith("arm") for k in right
    )
    z = directions(np.array(1.5), np.array(0.6))
    legs = [
        between(z, x)
        for x in (directions(0.0, np.pi / 2), directions(-np.pi / 2, np.pi / 2 - ARCS[4]))
    ]
    least = max(
        abs(ARCS[0] - ARCS[1]) - legs[0],
        legs[0] - ARCS[0] - ARCS[1],
        abs(ARCS[2] - ARCS[3]) - legs[1],
        legs[1] - ARCS[2] - ARCS[3],
    )
    (text,) = right["distance:1:text"]
    assert least > 0.1 and text.get_text() == f"{np.degrees(least):.3g}° away"


@pytest.mark.slow
def test_singular_directions_of_a_spherical_five_bar_lie_on_circles_about_its_pivots(pointing):
    """Of type 1 a leg is in line or folded: sums or differences of its arcs from the pivot, unlike
    those of type 2.
    """
    lines = {k: v[0] for k, v in artists(pointing[1]).items() if k.startswith("singular")}
    seen = {"-": set[float](), "--": set[float]()}
    for line in lines.values():
        p = np.transpose(line.get_data())
        z = directions(*p[np.isfinite(p).all(axis=1)].T)
        for far, a, b in (
            (between(z, directions(0.0, np.pi / 2)), *ARCS[:2]),
            (between(z, directions(-np.pi / 2, np.pi / 2 - ARCS[4])), ARCS[3], ARCS[2]),
        ):
            seen[line.get_linestyle()] |= {
                x for x in (a + b, abs(a - b)) if np.abs(far - x).max() < 1e-6
            }
    sums = {ARCS[0] + ARCS[1], abs(ARCS[0] - ARCS[1]), ARCS[2] + ARCS[3], abs(ARCS[2] - ARCS[3])}
    assert seen["-"] == sums and not seen["--"]


@pytest.mark.slow
def test_images_of_lines_in_space_are_those_of_the_forward_model(pointing):
    """Of a line on which the first crank stands: the tip is as far from the end of the crank as the
    rod is long.
    """
    system = spherical_five_bar(*ARCS)
    lines = {k: v for k, v in artists(pointing[1]).items() if k.startswith("grid:A")}
    assert len(lines) == 11
    for k, line in lines.items():
        (a,) = {round(float(x), 9) for x in artists(pointing[0])[k][0].get_xdata()}
        B = system.fk(system.q({"A": a}), "rod1")[:3, 2]
        for part in line:
            p = np.transpose(part.get_data())
            assert between(directions(*p[np.isfinite(p).all(axis=1)].T), B) == pytest.approx(
                ARCS[1], abs=1e-6
            )


@pytest.mark.slow
def test_a_task_that_sees_a_curve_only_is_refused():
    m = spherical_five_bar(*ARCS).mechanism.copy()
    m.frame("crank1 end", "crank1", rpy=(ARCS[0], 0, 0))
    system = m.build()
    with pytest.raises(UnsupportedError, match="moves on a curve; task may be .*direction"):
        system.plot_spaces("crank1 end", task="direction", resolution=10)
    with pytest.raises(InputError, match="does not move"):
        system.plot_spaces("tip", task="xy", resolution=10)
    with pytest.raises(InputError, match="azimuths and elevations"):
        system.plot_spaces("tip", task="direction", points=[1.0, 2.0, 3.0])
    pan = kempe.Mechanism("pan")
    pan.revolute("p", pan.ground, pan.body("a"), axis="z")
    pan.prismatic("s", "a", pan.body("b"), axis="x", limits=(0.1, 0.5))
    with pytest.raises(InputError, match="does not move"):
        pan.build().plot_spaces("b", task="direction", resolution=10)


@pytest.mark.slow
def test_a_linkage_that_spins_idly_is_drawn():
    """Each direction has two pairs of angles of the universal joint; legs may be too long or too
    short for them.
    """
    system = pointer("spherical", "spherical", (0.45, 0.7))
    left, right = system.plot_spaces("camera", task="direction", resolution=14)
    assert (left.get_xlabel(), left.get_ylabel()) == ("s0 [m]", "s1 [m]") and set(
        shades(left)[1].ravel()
    ) >= {2, 4}
    p, ways = shades(right)
    z = directions(*np.moveaxis(p, -1, 0))
    expected = np.zeros(ways.shape)
    a = np.arctan2(-z[..., 1], z[..., 2])
    b = np.arcsin(z[..., 0])
    for U in ((a, b), (a + np.pi, np.pi - b)):
        s = lengths_of_pointer(np.stack(U, axis=-1))
        expected += ((s > 0.45) & (s < 0.7)).all(axis=-1)
    assert np.array_equal(ways, expected) and set(ways.ravel()) == {0, 1, 2}


@pytest.mark.slow
def test_a_picture_shows_what_was_done_until_an_interrupt_and_says_so():
    seen = list[int]()

    def progress(done: int, total: int) -> None:
        seen.append(done)
        assert 0 <= done <= total == 24**2
        if len(seen) == 4:
            raise KeyboardInterrupt

    system = spherical_five_bar(*ARCS)
    budget = Budget(progress=progress)
    left, _ = call_until_interrupt(
        system.plot_spaces, "tip", task="direction", resolution=24, budget=budget
    )
    modes = shades(left)[1]
    assert "interrupted: this is the part that was done" in artists(left)["partial"][0].get_text()
    assert seen[:4] == sorted(seen[:4]) and 0 < (modes > 0).sum()
    with pytest.raises(
        TimeLimitError, match="plot_spaces: the time limit of 0.0001 s was over before anything"
    ):
        system.plot_spaces("tip", task="direction", resolution=24, budget=Budget(time_limit=1e-4))


@pytest.mark.slow
def test_lines_in_millimetres_are_not_torn():
    """Of type 1 a bar is upright: the slides are as far apart as the other bar reaches along x."""
    left, _ = slider_pair(2).plot_spaces("tip", resolution=12)
    lines = [
        np.transpose(v[0].get_data()) for k, v in artists(left).items() if k.startswith("singular")
    ]
    upright = np.sqrt(300.0**2 - 250.0**2)
    apart = [x[:, 1] - x[:, 0] for x in lines if np.ptp(x[:, 1] - x[:, 0]) < 1e-6 and len(x) > 10]
    assert all(np.isfinite(x).all() for x in lines)
    assert any(np.abs(x - upright).max() < 1e-6 for x in apart)

"""Curves of singular configurations against circles, coupler curves and the conic of the
literature.
"""

from __future__ import annotations

import numpy as np
import pytest
from two_freedoms_in_space import lengths_of_pointer, pointer

import kempe
from kempe import Budget, Status
from kempe.arguments import call_until_interrupt
from kempe.errors import InputError, UnknownNameError

FIVE = kempe.load("five_bar")


def away(p: np.ndarray, curves) -> np.ndarray:
    """Distances (n,) of places p (n, 2) from the nearest points of curves."""
    points = np.concatenate([c.p[:, :2] for c in curves])
    return np.linalg.norm(p[:, None] - points, axis=-1).min(axis=1)


def arm_of(lengths) -> kempe.System:
    m = kempe.Mechanism("arm", dim=2)
    at = 0.0
    body = m.ground
    for k, length in enumerate(lengths):
        m.revolute(f"q{k}", body, m.body(f"b{k}"), at=(at, 0))
        at = length
        body = f"b{k}"
    m.frame("tip", body, at=(at, 0))
    return m.build()


@pytest.mark.slow
@pytest.mark.parametrize("lengths", [(0.5, 0.4), (0.5, 0.4, 0.25), (0.9, 0.3, 0.2, 0.1)])
def test_an_arm_of_turns_is_singular_on_circles(lengths):
    """In line, each link ahead or back: radii are sums of the lengths with signs, the first +."""
    found = arm_of(lengths).singularities("tip", "position", budget=Budget(starts=256)).curves()
    assert (
        found
        and all(c.closed for c in found)
        and all(np.ptp(np.hypot(*c.p.T[:2])) < 1e-9 for c in found)
    )
    signs = np.array(np.meshgrid(*[(1, -1)] * (len(lengths) - 1))).reshape(len(lengths) - 1, -1)
    expected = {round(abs(lengths[0] + float(np.dot(lengths[1:], s))), 6) for s in signs.T}
    assert {round(float(np.hypot(*c.p[0, :2])), 6) for c in found} == expected


@pytest.fixture(scope="module")
def five():
    return FIVE.singularities("tip", "position", budget=Budget(starts=24)).curves()


@pytest.mark.slow
def test_type_1_of_a_five_bar_lies_on_circles_about_its_pivots(five):
    """Radii a + b and b - a about (0, 0) and (d, 0), wherever the other leg reaches, and nowhere
    else.
    """
    curves = [c for c in five if c.kinds == ("type 1",)]
    a = 0.2
    b = 0.3
    pivots = np.array([[0.0, 0.0], [0.2, 0.0]])
    turn = np.linspace(0.0, 2.0 * np.pi, 721)
    for c in curves:
        radii = np.linalg.norm(c.p[:, None, :2] - pivots, axis=-1)
        off = np.minimum(np.abs(radii - (a + b)), np.abs(radii - (b - a)))
        assert (
            off.min(axis=1).max() < 1e-9
            and radii.max() < a + b + 1e-9
            and radii.min() > b - a - 1e-9
        )
    for k in range(2):
        for r in (a + b, b - a):
            p = pivots[k] + r * np.column_stack([np.cos(turn), np.sin(turn)])
            other = np.linalg.norm(p - pivots[1 - k], axis=1)
            reached = (other < a + b) & (other > b - a)
            assert reached.any() and away(p[reached], curves).max() < 0.02


@pytest.mark.slow
def test_type_2_of_a_five_bar_is_a_coupler_curve():
    """The distal links are in line: a point of the coupler of a four-bar, whose length is their sum
    or difference.
    """
    ours = FIVE.with_parameters(d=0.3)
    curves = [
        c
        for c in ours.singularities("tip", "position", budget=Budget(starts=24)).curves()
        if c.kinds == ("type 2",)
    ]
    a = 0.2
    b = 0.3
    d = 0.3
    for c in curves:
        B = ours.fk(c.q, "arm1")[:, :2, 3]
        C = ours.fk(c.q, "crank2") @ np.array([a, 0.0, 0.0, 1.0])
        u = c.p[:, :2] - B
        v = c.p[:, :2] - C[:, :2]
        assert np.abs(u[:, 0] * v[:, 1] - u[:, 1] * v[:, 0]).max() < 1e-9
    # of the first crank; the other crank's end is on two circles
    angle = np.linspace(-np.pi, np.pi, 400)
    B = a * np.column_stack([np.cos(angle), np.sin(angle)])
    to = np.array([d, 0.0]) - B
    far = np.linalg.norm(to, axis=1)
    coupler = 2.0 * b
    along = (far**2 + coupler**2 - a**2) / (2.0 * far)
    ok = coupler**2 > along**2
    for sign in (1.0, -1.0):
        up = sign * np.sqrt(coupler**2 - along[ok] ** 2)
        unit = to[ok] / far[ok, None]
        C = B[ok] + along[ok, None] * unit + up[:, None] * unit[:, ::-1] * [-1.0, 1.0]
        assert ok.sum() > 100 and away(0.5 * (B[ok] + C), curves).max() < 0.02


BASE = np.array([[0.0, 0.0], [1.0, 0.1], [0.3, 0.9]])
PLATFORM = np.array([[0.0, 0.0], [0.35, -0.05], [0.1, 0.3]])


def three_rpr(limits=(0.15, 1.6)) -> kempe.System:
    """A platform on three legs between pins whose lengths are driven; nothing of it is symmetric."""
    m = kempe.Mechanism("3-RPR", dim=2)
    platform = m.body("platform")
    for k, (a, b) in enumerate(zip(BASE, PLATFORM, strict=True)):
        m.revolute(f"A{k}", m.ground, m.body(f"leg{k}"), at=tuple(a))
        m.prismatic(
            f"s{k}", f"leg{k}", m.body(f"rod{k}"), axis=(1, 0), limits=limits, actuated=True
        )
        m.revolute(f"B{k}", f"rod{k}", platform, child_at=tuple(b))
    m.frame("tool", platform)
    return m.build()


def determinant(p: np.ndarray, angle: float) -> np.ndarray:
    """Of the lines of the legs at places p (n, 2) of the platform, by their directions and their
    moments about it.

    Sefrioui and Gosselin, "On the quadratic nature of the singularity curves of planar
    three-degree-of-freedom parallel manipulators", Mechanism and Machine Theory 30 (1995): a
    polynomial of degree two in x and y.
    """
    c = np.cos(angle)
    s = np.sin(angle)
    arm = PLATFORM @ np.array([[c, s], [-s, c]])
    u = p[:, None] + arm - BASE
    return np.linalg.det(np.dstack([u, arm[:, 0] * u[..., 1] - arm[:, 1] * u[..., 0]]))


@pytest.mark.parametrize(
    ("angle", "starts"),
    [
        (0.4, 8),
        pytest.param(0.4, 64, marks=pytest.mark.slow),
        pytest.param(-1.1, 64, marks=pytest.mark.slow),
    ],
)
def test_type_2_of_a_3_rpr_at_one_orientation_is_a_conic(angle, starts):
    """Every place found is on it; from many starts, every point of it that all legs reach is found."""
    robot = three_rpr()
    found = robot.singularities(
        "tool", inputs=["s0", "s1", "s2"], budget=Budget(starts=starts)
    ).curves(orientation=angle)
    curves = [c for c in found if "type 2" in c.kinds]
    assert found.held == ("orientation",) and curves
    trial = np.random.default_rng(0).uniform(-1.0, 1.0, (6, 2))

    def terms(p: np.ndarray) -> np.ndarray:
        x, y = p.T
        return np.stack([x * x, x * y, y * y, x, y, 1.0 + 0.0 * x], axis=1)

    conic = np.linalg.solve(terms(trial), determinant(trial, angle))
    for c in curves:
        X = robot.fk(c.q, "tool")
        assert np.abs(np.arctan2(X[:, 1, 0], X[:, 0, 0]) - angle).max() < 1e-9
        assert np.abs(terms(c.p[:, :2]) @ conic).max() < 1e-9 * np.abs(conic).max()
    x, y = np.meshgrid(np.linspace(-2.0, 2.0, 401), np.linspace(-2.0, 2.0, 401), indexing="ij")
    p = np.stack([x, y], axis=-1).reshape(-1, 2)
    value = (terms(p) @ conic).reshape(401, 401)
    cross = np.sign(value[1:]) != np.sign(value[:-1])
    points = 0.5 * (p.reshape(401, 401, 2)[1:] + p.reshape(401, 401, 2)[:-1])[cross]
    c = np.cos(angle)
    s = np.sin(angle)
    legs = np.linalg.norm(points[:, None] + PLATFORM @ np.array([[c, s], [-s, c]]) - BASE, axis=-1)
    reached = ((legs > 0.16) & (legs < 1.59)).all(axis=1)
    assert reached.sum() > 50 and (starts < 64 or away(points[reached], curves).max() < 0.05)


@pytest.mark.slow
def test_type_1_of_a_3_rrr_at_one_orientation_lies_on_circles():
    """A leg is stretched or folded: the platform goes round on a circle whose radius is a + b or b
    - a.
    """
    found = (
        kempe.load("three_rrr")
        .singularities("tool", budget=Budget(starts=24))
        .curves(orientation=0.1)
    )
    curves = [c.p[:, :2] for c in found if c.kinds == ("type 1",)]
    assert curves
    for p in curves:
        fit = np.linalg.lstsq(
            np.column_stack([2.0 * p, np.ones(len(p))]), (p**2).sum(axis=1), rcond=None
        )[0]
        radius = np.sqrt(fit[2] + fit[0] ** 2 + fit[1] ** 2)
        assert np.linalg.norm(p - fit[:2], axis=1) == pytest.approx(
            np.full(len(p), radius), abs=1e-9
        )
        assert min(abs(radius - 0.55), abs(radius - 0.05)) < 1e-9


@pytest.mark.slow
def test_curves_end_at_limits():
    arm = kempe.load("two_link").with_limits({"q1": (-0.5, 2.0)})
    found = arm.singularities("e").curves()
    assert len(found) == 2 and not any(c.closed for c in found)
    assert all(np.sort(c.q[[0, -1], 0]) == pytest.approx([-0.5, 2.0], abs=1e-5) for c in found)
    free = arm.singularities("e", limits=False).curves()
    assert len(free) == 2 and all(c.closed for c in free)


def test_coordinates_that_are_held_cut_larger_sets_down():
    """Of the Puma the elbow is a set of dimension 5: with the others held the tool goes round on a
    circle about z.
    """
    puma = kempe.load("puma560")
    found = puma.singularities("tool", budget=Budget(starts=32))
    with pytest.raises(InputError, match="have dimension 5.*4 further coordinates are held"):
        found.curves()
    held = {"q2": 0.3, "q4": 0.2, "q5": 0.7, "q6": 0.1}
    elbow = [c for c in found.curves(hold=held) if c.name == "elbow"]
    assert elbow
    for c in elbow:
        assert all(np.abs(c.q[:, k] - held[f"q{k + 1}"]).max() < 1e-9 for k in (1, 3, 4, 5))
        assert (
            np.ptp(np.hypot(*c.p.T[:2])) < 1e-6
            and np.ptp(c.p[:, 2]) < 1e-6
            and np.ptp(c.q[:, 0]) > 3.0
        )


def test_what_has_no_curves_says_so():
    m = kempe.Mechanism("gantry", dim=2)
    m.prismatic("x", m.ground, m.body("a"), axis=(1, 0), limits=(0, 1))
    m.prismatic("y", "a", m.body("b"), axis=(0, 1), limits=(0, 1))
    found = m.build().singularities("b").curves()
    assert (
        not found
        and found.code is Status.NOT_FOUND
        and len(found) == 0
        and "no curve" in found.status
    )


def test_wrong_calls_are_explained():
    found = FIVE.singularities("tip", "position", budget=Budget(starts=8))
    for arguments, error, words in [
        ({"hold": {"Z": 1.0}}, UnknownNameError, "Z"),
        ({"hold": {"A": np.nan}}, InputError, "'A'.*finite"),
        ({"hold": 3.0}, InputError, "hold is 3.0"),
        ({"orientation": [0.1, 0.2]}, InputError, "orientation.*one"),
        ({"orientation": np.nan}, InputError, "finite"),
        ({"budget": Budget(starts=3)}, InputError, "does not read"),
    ]:
        with pytest.raises(error, match=words):
            found.curves(**arguments)
    with pytest.raises(InputError, match="planar"):
        kempe.load("puma560").singularities("tool", budget=Budget(starts=8)).curves(orientation=0.1)


def test_what_was_done_before_the_end_is_kept():
    found = arm_of((0.5, 0.4, 0.25)).singularities("tip", "position", budget=Budget(starts=32))
    late = found.curves(budget=Budget(time_limit=1e-9))
    assert late.code is Status.OUT_OF_TIME and not len(late)

    def enough(done: int, of: int) -> None:
        if done == 3:
            raise KeyboardInterrupt

    some = call_until_interrupt(found.curves, budget=Budget(progress=enough))
    assert some.code is Status.INTERRUPTED and 0 < len(some) < 4 and "interrupted" in some.status
    assert len(some.data()["curves"][0]["q"]) == len(some.curves[0])


class _Ends:
    """Progress that interrupts when so many configurations are done."""

    def __init__(self, after: int):
        self.after = after

    def __call__(self, done: int, total: int) -> None:
        assert 0 < done <= total
        if done >= self.after:
            raise KeyboardInterrupt


@pytest.mark.parametrize("after", [1, 3])
def test_what_is_traced_stays_where_curves_are_broken_off(after):
    """Those that are there lie on the circles on which all of them lie, and the picture says that
    they are a part.
    """
    found = arm_of((0.5, 0.4)).singularities("tip", "position", budget=Budget(starts=8))
    curves = call_until_interrupt(found.curves, budget=Budget(progress=_Ends(after)))
    assert curves.code is Status.INTERRUPTED and "this is the part that was done" in curves.status
    radii = {round(float(np.hypot(*c.p[0, :2])), 6) for c in curves}
    assert radii and radii <= {0.9, 0.1}
    pytest.importorskip("matplotlib")
    last = call_until_interrupt(found.plot, budget=Budget(progress=_Ends(after)))[-1]
    assert "interrupted:\nthis is the part that was done" in last.get_title() and last.get_lines()


def test_a_curve_that_is_broken_off_is_kept_as_far_as_it_was_followed(monkeypatch):
    from kempe.budget import TimeUp
    from kempe.numerics.clock import TimeLimit

    count = [0]

    def check(self):
        count[0] += 1
        if count[0] > 60:
            raise TimeUp

    found = arm_of((0.5, 0.4)).singularities("tip", "position", budget=Budget(starts=8))
    monkeypatch.setattr(TimeLimit, "check_time", check)
    (curve,) = curves = found.curves(budget=Budget(time_limit=100.0))
    assert curves.code is Status.OUT_OF_TIME and not curve.closed
    assert 3 <= len(curve) and np.ptp(np.hypot(*curve.p.T[:2])) < 1e-9


def test_the_time_limit_of_a_picture_is_that_of_its_curves():
    found = arm_of((0.5, 0.4)).singularities("tip", "position", budget=Budget(starts=8))
    pytest.importorskip("matplotlib")
    last = found.plot(budget=Budget(time_limit=1e-6))[-1]
    assert "stopped by the time limit" in last.get_title() and not last.get_lines()


@pytest.mark.slow
@pytest.mark.parametrize("lower", ["spherical", "universal"])
def test_curves_of_a_pointer_whose_legs_spin_idly_are_whole_turns(lower):
    """The direction is lost where the second angle of the universal joint is a quarter turn,
    whatever the first is.
    """
    robot = pointer(lower, "spherical")
    found = robot.singularities(
        "camera", "direction", inputs=["s0", "s1"], budget=Budget(starts=16)
    )
    assert {s.dimension for s in found.sets} == {1}
    at = [robot.coordinate_names.index(n) for n in ("U.rx", "U.ry", "s0", "s1")]
    curves = [c for c in found.curves() if c.kinds == ("type 1",)]
    for c in curves:
        U = c.q[:, at[:2]]
        assert c.closed and np.abs(np.cos(U[:, 1])).max() < 1e-6
        assert (
            abs(U[-1, 0] - U[0, 0]) == pytest.approx(2.0 * np.pi)
            and np.abs(np.diff(U[:, 0])).max() < 0.25
        )
        assert lengths_of_pointer(U) == pytest.approx(c.q[:, at[2:]], abs=1e-8)
    assert curves


def test_the_far_side_of_a_turn_is_not_beside_a_place():
    from kempe.spaces.singular_curves import _is_beside

    assert _is_beside(np.array([[-0.1, 0.0]]), np.array([[0.1, 0.0]])).all()
    assert not _is_beside(np.array([[-3.1, 0.2]]), np.array([[3.1, 0.2]])).any()

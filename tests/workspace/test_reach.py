"""Reach studies, capability maps and places of the base, against brute force and geometry."""

from __future__ import annotations

import numpy as np
import pytest

import kempe
from kempe import Budget, spatial
from kempe.arguments import call_until_interrupt
from kempe.errors import InputError, UnknownNameError
from kempe.status import Status
from kempe.workspace import reach

PUMA = kempe.load("puma560")
UR = kempe.load("ur5")
TWO = kempe.load("two_link")
RNG = np.random.default_rng(3)
Q = PUMA.random(RNG, 12)
X = PUMA.fk(Q, "tool")
FAR = X.copy()
FAR[:, 0, 3] += 9.0


def test_poses_that_are_reached_and_that_are_not():
    """Against `ik_all`, pose by pose: the number of solutions inside the limits, the best margin
    and manipulability.
    """
    study = PUMA.reach.poses(np.concatenate([X, FAR[:3]]), "tool")
    assert (
        study.reached.tolist() == [True] * 12 + [False] * 3
        and study.code is Status.PARTLY
        and not study
    )
    for i in range(12):
        a = PUMA.ik_all(X[i], "tool")
        q = a.q[a.inside]
        assert study.solutions[i] == len(q) > 0
        lo = PUMA.lower
        hi = PUMA.upper
        margins = (np.minimum(q - lo, hi - q) / (0.5 * (hi - lo))).min(axis=1)
        assert study.margin[i] == pytest.approx(margins.max(), abs=1e-9)
        dets = np.abs(np.linalg.det(PUMA.jacobian(q, "tool")))
        assert study.manipulability[i] == pytest.approx(
            dets.max() / study_length(PUMA) ** 3, rel=1e-6
        )
        assert np.abs(PUMA.fk(study.q[i], "tool") - X[i]).max() < 1e-5
    assert set(study.reasons) == {12, 13, 14} and all(
        "outside the workspace" in s for s in study.reasons.values()
    )
    assert (study.solutions[12:] == 0).all() and np.isnan(study.margin[12:]).all()
    assert "12 of 15 poses reached" in study.status and "pose 12: outside" in str(study)


def study_length(system) -> float:
    from kempe.model.characteristic_length import compute_characteristic_length

    return float(compute_characteristic_length(system))


def test_limits_that_block_are_named():
    tight = PUMA.with_limits({"q1": (2.0, 2.1)})
    study = tight.reach.poses(X[:4], "tool")
    assert not study.reached.any() and (study.solutions == 0).all()
    assert all("'q1'" in s for s in study.reasons.values())


def test_a_redundant_arm_has_infinitely_many_solutions():
    arm = kempe.load("panda")
    study = arm.reach.poses(arm.fk(arm.random(0, 4), "tool"), "tool")
    assert study.reached.all() and (study.solutions == -1).all() and (study.margin > 0.0).all()


def test_positions_of_a_planar_arm():
    study = TWO.reach.poses([[0.6, 0.3], [5.0, 0.0]], "e")
    assert study.reached.tolist() == [True, False] and study.solutions.tolist() == [2, 0]


def test_a_frame_that_moves_with_loops():
    """The five-bar reaches what its two legs reach: 0.5 m from A, and from D, 0.2 m beside it."""
    arm = kempe.load("five_bar")
    study = arm.reach.poses([[0.1, 0.4], [0.55, 0.1], [-0.45, 0.05]], "tip")
    assert study.reached.tolist() == [True, False, False] and (study.manipulability[:1] > 0.0).all()


# ---- places of the base


def test_the_base_of_a_planar_arm():
    """A point is reached from where it is between the radii: an annulus about it."""
    point = spatial.pose(p=np.array([0.4, -0.2, 0.0]))
    w = TWO.reach.planar("e")
    outer, inner = (f(p.radius for p in w.boundary) for f in (max, min))
    found = TWO.reach.place(
        point[None], "e", {"x": (-1.5, 1.5), "y": (-1.5, 1.5)}, 15, task="position"
    )
    x, y = np.meshgrid(*found.axes.values(), indexing="ij")
    far = np.hypot(x - 0.4, y + 0.2)
    clear = (np.abs(far - outer) > 1e-6) & (np.abs(far - inner) > 1e-6)
    expected = (far < outer) & (far > inner) if w.voids else far < outer
    assert np.array_equal(found.fraction[clear] == 1.0, expected[clear])


def test_the_best_place_of_the_base_reaches_all():
    """A workpiece that was reached from a base elsewhere, and a map that has this place among its
    cells.
    """
    base = spatial.pose_from_xyz_rpy(np.array([0.5, -0.25, 0.0, 0.0, 0.0, 0.0]))
    pieces = base @ UR.fk(UR.q("up") + np.random.default_rng(0).uniform(-0.6, 0.6, (6, 6)), "tool")
    found = UR.reach.place(
        pieces, "tool", {"x": (-1.0, 1.0), "y": (-1.0, 1.0), "z": 0.0}, {"x": 9, "y": 9}
    )
    assert found.fraction.shape == (9, 9) and found.fraction[6, 3] == 1.0 and found
    place = found.place()
    assert place["z"] == 0.0 and found.fraction.max() == 1.0
    again = UR.reach.poses(spatial.inverse(found.best) @ pieces, "tool", budget=Budget(starts=64))
    assert again.reached.all() and again.margin.min() == pytest.approx(
        np.nanmax(found.margin), abs=1e-9
    )
    for i, j in ((0, 0), (4, 4), (8, 1)):
        shift = spatial.pose(p=np.array([found.axes["x"][i], found.axes["y"][j], 0.0]))
        each = [UR.ik(spatial.inverse(shift) @ piece, "tool").success for piece in pieces]
        assert found.fraction[i, j] == pytest.approx(np.mean(each))
    assert "6 of 6 poses reached from the best place" in found.status


# ---- capability maps


def test_a_capability_map_is_what_ik_says():
    """Each pose of a subset by itself, with the default effort of `ik`."""
    found = UR.reach.capability("tool", [[-1.0, -1.0, -0.2], [1.0, 1.0, 1.0]], 4, 12)
    assert found.fraction.shape == (4, 4, 4) and found.reached.shape == (4, 4, 4, 12, 1)
    assert (
        0.0 < found.fraction.mean() < 1.0 and np.isnan(found.solutions[found.fraction > 0.0]).all()
    )
    for i, j, k in np.random.default_rng(0).integers(0, 4, (8, 3)):
        p = np.array([found.axes[0][i], found.axes[1][j], found.axes[2][k]])
        wanted = np.column_stack([np.tile(p, (12, 1)), found.directions])
        each = UR.ik(wanted, "tool", task="position_axis").success
        assert np.array_equal(found.reached[i, j, k, :, 0], each)
        assert found.fraction[i, j, k] == each.mean()


def test_a_capability_map_with_rolls_counts_solutions():
    found = PUMA.reach.capability(
        "tool", [[-0.6, -0.6, -0.3], [0.6, 0.6, 0.3]], (3, 2, 2), 5, rolls=3
    )
    assert found.reached.shape == (3, 2, 2, 5, 3)
    for i, j, k in np.ndindex(3, 2, 2):
        p = [found.axes[0][i], found.axes[1][j], found.axes[2][k]]
        counts = []
        for d in found.directions:
            z = d
            x = np.cross([0.0, 0.0, 1.0] if abs(d[2]) < 0.8 else [1.0, 0.0, 0.0], z)
            x /= np.linalg.norm(x)
            for roll in found.rolls:
                u = np.cos(roll) * x + np.sin(roll) * np.cross(z, x)
                target = spatial.pose(np.column_stack([u, np.cross(z, u), z]), np.array(p))
                counts.append(int(PUMA.ik_all(target, "tool").inside.sum()))
        assert found.solutions[i, j, k] == pytest.approx(np.mean(counts))


def test_a_planar_capability_map_is_inside_the_exact_workspace():
    """Of the arm of three turns: a cell is reached in all directions if the wrist gets to a circle
    about it.
    """
    m = kempe.Mechanism("three", dim=2)
    a = m.body("a")
    b = m.body("b")
    c = m.body("c")
    m.revolute("q1", m.ground, a)
    m.revolute("q2", a, b, at=(0.5, 0.0))
    m.revolute("q3", b, c, at=(0.4, 0.0))
    m.frame("tool", c, at=(0.2, 0.0))
    arm = m.build()
    found = arm.reach.capability("tool", [[-1.2, -1.2], [1.2, 1.2]], 12, 16)
    x, y = np.meshgrid(*found.axes, indexing="ij")
    wrist = np.stack([x, y], axis=-1)[..., None, :] - 0.2 * found.directions[:, :2]
    far = np.linalg.norm(wrist, axis=-1)
    assert np.array_equal(found.reached[..., 0], (far < 0.9) & (far > 0.1))
    inside = arm.reach.planar("tool").contains(np.stack([x, y], axis=-1))
    assert inside[found.fraction > 0.0].all()


def test_progress_and_effort():
    seen = []
    budget = Budget(starts=4, progress=lambda done, total: seen.append((done, total)))
    PUMA.reach.capability("tool", [[-1, -1, -1], [1, 1, 1]], 2, 4, budget=budget)
    assert seen == [(32, 32)]


def interrupted(done: int, total: int) -> None:
    """What happens where Ctrl-C comes after the first slice."""
    raise KeyboardInterrupt


@pytest.mark.parametrize(
    ("budget", "code", "slices"),
    [
        (Budget(starts=4, progress=interrupted), Status.INTERRUPTED, 1),
        (Budget(starts=4, time_limit=1e-9), Status.OUT_OF_TIME, 0),
    ],
)
def test_what_was_done_stays_where_a_map_is_broken_off(budget, code, slices, monkeypatch):
    monkeypatch.setattr(reach, "SLICE", 8)
    box = [[-1.0, -1.0, -1.0], [1.0, 1.0, 1.0]]
    part, whole = (
        call_until_interrupt(PUMA.reach.capability, "tool", box, 2, 4, budget=b)
        for b in (budget, Budget(starts=4))
    )
    assert (
        part.code == code
        and "this is the part that was done" in part.status
        and whole.broken is None
    )
    done = np.isfinite(part.fraction).ravel()
    first = 2 * slices
    assert done.tolist() == [True] * first + [False] * (8 - first)
    np.testing.assert_array_equal(part.fraction.ravel()[:first], whole.fraction.ravel()[:first])
    ranges = {"x": (-4.0, 0.0), "y": (-0.1, 0.1)}
    part, whole = (
        call_until_interrupt(
            UR.reach.place, UR.fk(UR.mid, "tool")[None], "tool", ranges, 4, budget=b
        )
        for b in (budget, Budget(starts=4))
    )
    first = 8 * slices
    assert np.isfinite(part.fraction).sum() == first and part.broken == code
    np.testing.assert_array_equal(part.fraction.ravel()[:first], whole.fraction.ravel()[:first])
    assert not slices or part.place()["x"] in part.axes["x"][:2]
    poses = UR.fk(UR.random(0, 12), "tool")
    part, whole = (
        call_until_interrupt(UR.reach.poses, poses, "tool", budget=b)
        for b in (budget, Budget(starts=4))
    )
    assert (
        part.code == code
        and part.tried.tolist() == [True] * first + [False] * (12 - first)
        and whole.tried.all()
    )
    np.testing.assert_array_equal(part.solutions, [*whole.solutions[:first], *[-1] * (12 - first)])
    assert f"of {first} poses reached (" in part.status
    assert not part.reached[first:].any() and (part.codes[first:] == code).all()
    assert not {*part.reasons} & {*range(first, 12)}, "poses that were not tried are not blocked"


def test_a_search_can_be_broken_off_before_many_poses_are_tried():
    """A slice is short work, also where most poses are searched for in vain, or loops have to
    close.
    """
    for name, frame, most in (("puma560", "tool", 2048), ("five_bar", "tip", 128)):
        system = kempe.load(name)
        targets = np.tile([2.0, 2.0, 0.0][: system.dim], (3000, 1))
        said = list[int]()

        def stop(done, of, said=said):
            said.append(done)
            raise KeyboardInterrupt

        study = call_until_interrupt(
            system.reach.poses,
            targets,
            frame,
            task="position",
            budget=Budget(starts=1, progress=stop),
        )
        assert said == [most] and study.code == Status.INTERRUPTED and study.tried.sum() == most


def scara():
    m = kempe.Mechanism("scara")
    m.revolute("q1", m.ground, m.body("a"), axis="z")
    m.revolute("q2", "a", m.body("b"), at=(0.3, 0, 0), axis="z")
    m.prismatic("q3", "b", m.body("c"), at=(0.2, 0, 0), axis="z", limits=(-0.2, 0))
    m.revolute("q4", "c", m.body("d"), axis="z")
    m.frame("tool", "d")
    return m.build()


def test_a_capability_map_says_why_no_direction_is_reached():
    box = [[0.1, 0.1, -0.1], [0.3, 0.3, 0.0]]
    none, some = (scara().reach.capability("tool", box, 2, d) for d in (8, [[0, 0, 1]]))
    assert not none.fraction.any() and some.fraction.any()
    assert (
        "a position and a direction have 5 equations, but this frame has only 3 freedoms"
        in none.status
    )
    assert "only" not in some.status
    turned = scara().reach.capability("tool", box, 2, 8, rolls=2)
    assert "a pose has 6 equations, but this frame has only 4 freedoms" in turned.status
    far = PUMA.reach.capability("tool", [[8, 8, 8], [9, 9, 9]], 2, 8)
    assert not far.fraction.any() and "only" not in far.status


def test_where_nothing_is_reached_there_is_no_best_place():
    pytest.importorskip("matplotlib")
    found = UR.reach.place(FAR, "tool", {"x": (-1, 1), "y": (-1, 1)}, 3, budget=Budget(starts=1))
    assert (
        "none of 12 poses reached from any of 9 places" in found.status
        and "best" not in found.status
    )
    assert found.plot().get_legend() is None


def test_the_map_over_one_coordinate_is_a_curve():
    pytest.importorskip("matplotlib")
    found = UR.reach.place(
        UR.fk(UR.mid, "tool")[None], "tool", {"x": (-2.0, 2.0)}, 9, budget=Budget(starts=8)
    )
    ax = found.plot()
    np.testing.assert_allclose(
        ax.lines[0].get_xydata(), np.column_stack([found.axes["x"], found.fraction])
    )
    assert (
        ax.lines[1].get_xydata().tolist() == [[found.place()["x"], 1.0]]
        and ax.get_xlabel() == "x [m]"
    )


# ---- wrong calls


@pytest.mark.parametrize(
    ("how", "why"),
    [
        ("scaled", "last row"),
        ("stretched", "orthonormal"),
        ("mirrored", "orthonormal"),
        ("far", "below"),
    ],
)
def test_what_is_no_pose_is_refused_and_named(how, why):
    bad = X.copy()
    if how == "scaled":
        bad[3] *= 2.0
    elif how == "far":
        bad[3, 0, 3] = 1e200
    else:
        bad[3, :3, 0] *= 2.0 if how == "stretched" else -1.0
    for ask in (
        lambda: PUMA.reach.poses(bad, "tool"),
        lambda: PUMA.reach.place(bad, "tool", {"x": (0, 1)}, 2),
    ):
        with pytest.raises(InputError, match=rf"targets\[3\] is not a pose: .*{why}"):
            ask()


def test_what_cannot_be_done_is_said():
    with pytest.raises(UnknownNameError, match="hand"):
        PUMA.reach.poses(X, "hand")
    bad = X.copy()
    bad[4] = np.nan
    with pytest.raises(InputError, match=r"targets\[4\] is not a pose: .*it must be finite"):
        PUMA.reach.poses(bad, "tool")
    with pytest.raises(InputError, match="box"):
        PUMA.reach.capability("tool", "everywhere")
    with pytest.raises(InputError, match="index is 99"):
        PUMA.reach.poses(X[:1], "tool").reason(99)
    with pytest.raises(UnknownNameError, match="pitch"):
        PUMA.reach.place(X, "tool", {"pitch": (0, 1)})
    with pytest.raises(InputError, match="a pair"):
        PUMA.reach.place(X, "tool", {"x": (1, 0)})
    with pytest.raises(InputError, match="no range"):
        PUMA.reach.place(X, "tool", {"x": 1})
    with pytest.raises(InputError, match="at least one"):
        PUMA.reach.place(np.zeros((0, 4, 4)), "tool", {"x": (0, 1)})
    with pytest.raises(InputError, match="take fewer cells"):
        PUMA.reach.place(X, "tool", {"x": (0, 1), "y": (0, 1)}, 10**6)
    with pytest.raises(InputError, match="two corners"):
        PUMA.reach.capability("tool", [[0, 0], [1, 1]])
    with pytest.raises(InputError, match="rolls"):
        PUMA.reach.capability("tool", [[0, 0, 0], [1, 1, 1]], rolls=0)
    with pytest.raises(InputError, match="directions"):
        PUMA.reach.capability("tool", [[0, 0, 0], [1, 1, 1]], 2, np.zeros((3, 3)))


def test_pictures():
    """What is drawn is the map: as many cells, and a curve for each piece of a boundary."""
    figure = pytest.importorskip("matplotlib.figure")
    box = {"x": (-1.0, 1.0), "y": (-1.0, 1.0), "yaw": (0.0, 1.0)}
    placed = TWO.reach.place(
        TWO.fk(TWO.random(0, 2), "e"), "e", box, {"x": 5, "y": 4, "yaw": 2}, task="position"
    )
    assert placed.plot(figure.Figure().subplots()).collections[0].get_array().size == 20
    found = PUMA.reach.capability("tool", [[-1, -1, -1], [1, 1, 1]], (3, 2, 2), 2)
    ax = found.plot(figure.Figure().subplots(), height=0.4)
    assert np.array_equal(ax.collections[0].get_array().ravel(), found.fraction[..., 1].T.ravel())
    ring = TWO.reach.planar("e")
    ax = ring.plot(figure.Figure().subplots())
    assert len(ax.lines) == len(ring.boundary) == 2 and len(ax.patches) == len(ring.regions)

"""Tasks at their edges: opposite axes, what is refused, proofs by lengths, names, caches, ends of
self-motions.
"""

from __future__ import annotations

import math

import numpy as np
import pytest

import kempe
from kempe import Mechanism, System, spatial, tasks
from kempe.errors import InputError
from kempe.inverse.tasks.search import pack_tasks
from kempe.status import Status

HAND = "panda_link7"
NAN = math.nan
INF = math.inf


def ball(kind: str = "spherical") -> System:
    m = Mechanism("ball")
    m.joint("j", kind, m.ground, m.body("b"))
    return m.build()


def flat_arm(n: int = 3) -> System:
    """An arm in the plane of links of length 1, with the frame 'tip'."""
    m = Mechanism("flat", dim=2)
    before = "ground"
    at = 0.0
    for k in range(n):
        m.revolute(f"j{k}", before, m.body(f"b{k}", 1.0, (0.5, 0.0)), at=(at, 0))
        before = f"b{k}"
        at = 1.0
    m.frame("tip", before, at=(1.0, 0))
    return m.build()


# ---- opposite axes


def turned(angle: float) -> np.ndarray:
    return np.array([0.6 * math.sin(angle), 0.8 * math.sin(angle), math.cos(angle)])


@pytest.mark.parametrize("back", [0.0, 1e-15, 1e-12, 1e-9, 1e-7, 1e-6, 1e-5, 1e-4])
@pytest.mark.parametrize("task", [tasks.Pointing, tasks.LookAt])
def test_axes_that_are_nearly_opposite_are_turned(task, back):
    s = ball()
    wanted = task("b", turned(math.pi - back))
    assert np.linalg.norm(tasks.error(s, wanted, s.neutral)) == pytest.approx(2.0, abs=1e-8)
    answer = s.ik(wanted)
    assert answer.success and answer.errors[wanted.label][1] < 1e-6
    soft = s.ik(task("b", turned(math.pi - back), weight=1.0))
    assert np.max(list(soft.errors.values())) < 1e-6


@pytest.mark.parametrize("angle", [0.0, 1e-3, 1.5, 3.0, math.pi - 1e-3, math.pi - 1e-5])
@pytest.mark.parametrize("task", [tasks.Pointing, tasks.LookAt])
def test_tilts_have_the_length_and_the_rates_that_they_should(task, angle):
    s = ball("free")
    t = task("b", turned(angle))
    q = s.neutral
    h = 1e-6 if angle < 3.1 else 1e-3 * (math.pi - angle)
    ends = [
        [tasks.error(s, t, s.configuration_space.integrate(q, sign * h * e)) for sign in (1, -1)]
        for e in np.eye(6)
    ]
    J = np.stack([(a - b) / (2.0 * h) for a, b in ends], axis=-1)
    assert np.linalg.norm(tasks.error(s, t, q)) == pytest.approx(
        2.0 * math.sin(angle / 2.0), abs=1e-12
    )
    np.testing.assert_allclose(tasks.jacobian(s, t, q), J, atol=2e-6 * np.abs(J).max())


@pytest.mark.parametrize("name", ["panda", "ur5", "puma560"])
def test_an_arm_that_points_the_other_way(name):
    s = kempe.load(name)
    frame = s.body_names[-1]
    for q in (s.mid, s.random(3)):
        z = s.fk(q, frame)[:3, 2]
        answer = s.ik(tasks.Pointing(frame, -z), start=q)
        assert answer.success and s.fk(answer.q, frame)[:3, 2] @ z == pytest.approx(-1.0, abs=1e-9)


def test_two_opposite_directions_contradict_each_other():
    """That is proven: they turn axes of one body."""
    up, down = (tasks.Pointing("b", [0, 0, z], name=n) for z, n in ((1.0, "up"), (-1.0, "down")))
    answer = ball().ik([up, down], budget=kempe.Budget(starts=3))
    assert not answer.success and answer.proven and answer.starts == 3
    assert "contradictory: 'up' and 'down'" in answer.status


def test_nothing_looks_at_its_own_origin():
    s = ball()
    answer = s.ik(tasks.LookAt("b", [0.0, 0.0, 0.0]))
    assert (
        not answer.success
        and answer.starts > 1
        and answer.orientation_error == pytest.approx(math.pi)
    )


# ---- the plane


def test_axes_of_the_plane():
    s = flat_arm()
    q = np.array([0.3, 0.4, 0.5])
    for task in (tasks.Pointing("tip", [-1.0, 0.5]), tasks.LookAt("tip", [1.0, 0.2])):
        answer = s.ik(task, start=q)
        X = s.fk(answer.q, "tip")
        to = [-1.0, 0.5] if isinstance(task, tasks.Pointing) else [1.0, 0.2] - X[:2, 3]
        assert answer.success and X[:2, 0] @ to / np.linalg.norm(to) == pytest.approx(1.0, abs=1e-9)
        assert (tasks.count(s, task), tasks.error(s, task, q).shape) == (1, (1,))
        assert tasks.jacobian(s, task, q).shape == (1, 3)
        assert (answer.m, answer.rank, answer.self_motion.shape) == (1, 1, (3, 2))
        ends = [
            (tasks.error(s, task, q + h) - tasks.error(s, task, q - h)) / 2e-6
            for h in 1e-6 * np.eye(3)
        ]
        np.testing.assert_allclose(tasks.jacobian(s, task, q), np.stack(ends, axis=-1), atol=1e-8)
    back = tasks.LookAt("tip", [0.0, 0.0])
    assert (
        abs(tasks.error(s, back, np.zeros(3)).item()) == pytest.approx(2.0)
        and s.ik(back, start=np.zeros(3)).success
    )


TILTED = spatial.pose(spatial.rot_x(0.5))


@pytest.mark.parametrize(
    "task",
    [
        tasks.LookAt("tip", [1.0, 0.0], axis=[0, 0, 1]),
        tasks.Pointing("tip", [1.0, 0.0], axis=[1, 0, 1]),
        tasks.Pointing("tip", [0, 0, 1.0]),
        tasks.Position("tip", [1, 1, 5.0]),
        tasks.Pose("tip", TILTED),
        tasks.Pose("tip", spatial.pose(p=[1.0, 0.0, 1.0])),
        tasks.Orientation("tip", np.diag([1.0, -1.0, -1.0])),
        tasks.OnLine("tip", [1, 0, 3.0], [1, 0]),
        tasks.OnLine("tip", [1, 0], [1, 0, 1.0]),
        tasks.OnPlane("tip", [1, 0], [0, 0, 1.0]),
        tasks.HalfSpace("tip", [1, 0, 3.0], [1, 0]),
        tasks.OnSphere("tip", [1, 0, 2.0], 1.0),
        tasks.InBox("tip", [0, 0, 1.0], [2, 2, 2.0]),
        tasks.InBox("tip", [0, 0], [1, 1], pose=TILTED),
        tasks.RelativePosition("tip", "b0", [0.5, 0.5, 1.0]),
        tasks.Position("tip", [1.0, 1.0], point=[0, 0, 1.0]),
        tasks.CentreOfMass([0.5, 0.5, 2.0]),
        tasks.CentreOfMass([0.5, 0.5], axes="z"),
    ],
    ids=lambda t: t.label,
)
def test_what_leaves_the_plane_is_refused(task):
    with pytest.raises(InputError, match=r"plane|z, |axes|corner"):
        flat_arm().ik(task)


def test_a_box_through_the_plane_is_a_box_in_it():
    assert flat_arm().ik(tasks.InBox("tip", [1.0, 1.0, -1.0], [1.5, 1.5, 1.0])).success


# ---- what is refused


P = [0.4, 0.1, 0.5]


@pytest.mark.parametrize(
    "make, match",
    [
        (lambda: tasks.Position(HAND, P, point=[NAN, 0, 0]), "point"),
        (lambda: tasks.Position(HAND, P, point=np.zeros((2, 3))), "point"),
        (lambda: tasks.Pointing(HAND, P, axis=[0, INF, 0]), "axis"),
        (lambda: tasks.Pointing(HAND, P, [0, NAN, 0]), "axis"),
        (lambda: tasks.Position(HAND, [1e300, 0, 0]), "goal of .* its size must be below"),
        (lambda: tasks.HalfSpace(HAND, P, P, margin=NAN), "HalfSpace"),
        (lambda: tasks.HalfSpace(HAND, P, P, margin="x"), "margin"),
        (lambda: tasks.HalfSpace(HAND, P, P, margin=None), "margin"),
        (lambda: tasks.InBox(HAND, [NAN, 0, 0], [1, 1, 1]), "InBox"),
        (lambda: tasks.InBox(HAND, [INF, 0, 0], [INF, 1, 1]), "InBox"),
        (lambda: tasks.InBox(HAND, [0, 0], [1, 1]), "InBox"),
        (lambda: tasks.Distance(HAND, "panda_link0", at_least=INF), "Distance"),
        (lambda: tasks.Distance(HAND, "panda_link0", at_most=NAN), "Distance"),
        (lambda: tasks.Distance(HAND, "panda_link0", at_most="a"), "Distance"),
        (lambda: tasks.Distance(HAND, "panda_link0", at_least=-0.1), "at_least|bound"),
        (lambda: tasks.CentreOfPoints([HAND], P, within=-1.0), "within"),
        (lambda: tasks.CentreOfPoints([HAND], P, within=NAN), "within"),
        (lambda: tasks.CentreOfPoints([HAND], P, within=[0.1, 0.2]), "within"),
        (lambda: tasks.CentreOfPoints([HAND], P, within=[0.1, -0.2, 0.1]), "within"),
        (lambda: tasks.CentreOfPoints({HAND: NAN}, P), "weight"),
        (lambda: tasks.CentreOfPoints(3, P), "a list of names of frames"),
        (lambda: tasks.CentreOfPoints(HAND, P), "a list of names of frames"),
        (lambda: tasks.CentreOfPoints({HAND: "a"}, P), "weight"),
        (lambda: tasks.CentreOfMass(P, axes=["x"]), "axes"),
        (lambda: tasks.Function(3), "function of q"),
        (lambda: tasks.Function(lambda q: np.zeros(0)), "no numbers"),
        (lambda: tasks.Function(lambda q: q[0], low=NAN, high=1.0), "bounds"),
        (lambda: tasks.Function(lambda q: q[0], low=INF, high=INF), "bounds"),
        (
            lambda: tasks.Function(lambda q: q[: 1 + int(abs(np.real(q[0])) * 10) % 3] - 0.1),
            "gave 1 before|numbers",
        ),
        (lambda: tasks.Position(HAND, P, weight="1"), "weight"),
        (lambda: tasks.Position(HAND, P, weight=np.ones(3)), "weight"),  # type: ignore[arg-type]
        (lambda: tasks.Position(HAND, P, tolerance=[1e-3, 1e-3, 1e-3]), "tolerance"),  # type: ignore[arg-type]
        (lambda: tasks.Position(HAND, P, name=3), "name"),  # type: ignore[arg-type]
    ],
)
def test_bad_input_is_named(panda, make, match):
    with pytest.raises(InputError, match=match):
        panda.ik(make())


def test_a_task_by_name_belongs_to_one_frame(panda):
    with pytest.raises(InputError, match="task is 'pose'"):
        panda.ik([tasks.Position(HAND, P)], task="pose")


@pytest.mark.parametrize(
    "tolerance", [[1e-3, 1e-3], np.array([1e-3, 1e-3]), (1e-3, 1e-3), 1e-3], ids=str
)
def test_tolerances_may_be_lists(tolerance, panda):
    goal = panda.fk(panda.random(0), HAND)[:3, 3]
    assert panda.ik(tasks.Position(HAND, goal, tolerance=tolerance)).success  # type: ignore[arg-type]


def test_a_function_that_writes_into_its_argument_changes_nothing(panda):
    def writes(q):
        out = q[1] - 0.2
        q[:] = 0.25
        return out

    answer = panda.ik(tasks.Function(writes), start=panda.mid)
    assert answer.success and answer.q[1] == pytest.approx(0.2, abs=1e-6)
    np.testing.assert_array_equal(answer.q[2:], panda.mid[2:])


def test_every_task_has_a_key_of_its_own(panda):
    x = panda.fk(panda.mid, HAND)[:3, 3]
    answer = panda.ik(
        [tasks.Position(HAND, x, name=n) for n in ("x", "x (2)", "x", "x")], start=panda.mid
    )
    assert list(answer.errors) == ["x", "x (2)", "x (3)", "x (4)"]


@pytest.mark.slow
def test_caches_are_bounded():
    s = flat_arm()
    for k in range(200):
        s.ik(
            [
                tasks.Position("tip", [1.0, 1.0], point=[1e-3 * k, 0]),
                tasks.Posture(np.zeros(3), weight=1.0 + k),
            ]
        )
    same = tasks.Position("tip", [1.0, 1.0])
    for k in range(200):
        s.ik([same, tasks.Posture(np.zeros(3), weight=1.0 + k)])
    kept = list(s._kept[pack_tasks].values())
    assert len(kept) <= 64 and max(len(p.stages) for p in kept) <= 64


# ---- out of reach


def test_lengths_prove_what_is_out_of_reach_as_for_one_frame(panda):
    rng = np.random.default_rng(0)
    for d in spatial.unit(rng.normal(size=(4, 3))):
        answer = panda.ik(tasks.Position(HAND, 3.0 * d), budget=kempe.Budget(starts=4))
        single = panda.ik(3.0 * d, HAND)
        beyond = single.status.split("at least ")[1].split(",")[0]
        assert answer.code == single.code == Status.OUT_OF_REACH
        assert (
            f"is outside the workspace by at least {beyond}, by the lengths of the links"
            in answer.status
        )
        assert float(beyond.split()[0]) <= answer.position_error
    X = spatial.pose(spatial.rot_x(math.pi), [0.0, 0.0, 1.25])
    answer = panda.ik(tasks.Pose(HAND, X), budget=kempe.Budget(starts=4))
    single = panda.ik(X, HAND)
    assert answer.code == single.code == Status.OUT_OF_REACH
    assert single.status.split("outside")[1].split(";")[0] in answer.status


def test_lengths_prove_nothing_wrong(panda):
    """What a configuration reaches is never called out of reach, whatever is required of it."""
    point = [0.1, 0.0, 0.2]
    for q in panda.random(1, 30):
        X = panda.fk(q, HAND)
        p = (X @ [*point, 1.0])[:3]
        d = np.array([0.3, 0.5, -0.2])
        at = [
            tasks.Pose(HAND, X),
            tasks.Position(HAND, p, point),
            tasks.OnLine(HAND, p + d, d, point),
            tasks.OnPlane(HAND, p, d, point),
            tasks.RelativePose(HAND, "panda_link0", X),
        ]
        for task in at:
            assert panda.ik(task, budget=kempe.Budget(starts=1)).code in (
                Status.SOLVED,
                Status.NOT_FOUND,
            )


def test_tasks_that_are_out_of_reach_are_the_ones_named(panda):
    far = tasks.OnPlane(HAND, [0.0, 0.0, 4.0], [0.0, 0.0, 1.0], name="far")
    line = tasks.OnLine(HAND, [5.0, 0.0, 0.0], [0.0, 0.0, 1.0], name="line")
    near = tasks.Position("panda_link4", panda.fk(panda.mid, "panda_link4")[:3, 3], name="near")
    answer = panda.ik([far, near], budget=kempe.Budget(starts=3))
    assert (
        answer.code == Status.OUT_OF_REACH
        and "; 'far' is outside the workspace by at least" in answer.status
    )
    assert "'near' is outside" not in answer.status
    assert panda.ik([line], budget=kempe.Budget(starts=3)).code == Status.OUT_OF_REACH
    side = tasks.HalfSpace(HAND, [0.0, 0.0, -4.0], [0.0, 0.0, 1.0])
    assert panda.ik([side, near], start=panda.mid).success
    targets = np.array([[0.4, 0.1, 0.5], [3.0, 0.0, 0.0], [NAN, 0.0, 0.0]])
    assert panda.ik(tasks.Position(HAND, targets), budget=kempe.Budget(starts=5)).code.tolist() == [
        0,
        3,
        2,
    ]


def test_lengths_prove_with_loops_too():
    s = kempe.load("five_bar")
    frame = s.body_names[-1]
    q = s.assemble().q
    answer = s.ik(tasks.Position(frame, [9.0, 0.0]), start=q, budget=kempe.Budget(starts=3))
    assert answer.code == Status.OUT_OF_REACH and "by the lengths of the links" in answer.status
    beyond = float(answer.status.split("at least ")[1].split(" m")[0])
    assert 0.0 < beyond <= answer.position_error
    assert s.ik(tasks.Position(frame, s.fk(q, frame)[:2, 3])).success


def test_a_slide_that_is_too_short_is_blocked_by_its_limit():
    m = Mechanism("slide", dim=2)
    m.prismatic("s", m.ground, m.body("a"), axis=(1.0, 0.0), limits=(0.0, 1.0))
    m.revolute("j", "a", m.body("b"))
    m.frame("tip", "b", at=(1.0, 0.0))
    answer = m.build().ik(tasks.Position("tip", [3.0, 0.5]), budget=kempe.Budget(starts=3))
    assert answer.code == Status.OUT_OF_REACH and answer.proven
    assert (
        "outside the workspace" in answer.status
        and "blocked by the limit of 's' (" in answer.status
        and "); without limits it is reachable" in answer.status
    )


# ---- self-motions


@pytest.mark.parametrize("i", range(0, 15, 3))
def test_the_limit_at_which_a_self_motion_ends_is_named(panda, i):
    q = panda.random(i)
    m = panda.inverse.self_motion(q, "panda_hand_tcp", budget=kempe.Budget(points=2000))
    for end, why in zip((m.q[0], m.q[-1]), m.ends, strict=True):
        assert why.startswith("the limit of ")
        k = panda.coordinate_names.index(why.split("'")[1])
        assert min(end[k] - panda.lower[k], panda.upper[k] - end[k]) < 1e-4


def test_the_half_space_at_which_a_self_motion_ends_is_named():
    s = flat_arm()
    q = np.array([0.4, 1.0, 0.7])
    elbow = s.fk(q, "b2")[:2, 3]
    wall = tasks.HalfSpace("b2", elbow + [0.1, 0.0], [-1.0, 0.0], name="wall")
    m = s.inverse.self_motion(
        q, [tasks.Position("tip", s.fk(q, "tip")[:2, 3]), wall], budget=kempe.Budget(points=300)
    )
    assert not m.closed and "the bound of 'wall'" in m.ends
    end = m.q[0] if m.ends[0].startswith("the bound") else m.q[-1]
    assert s.fk(end, "b2")[0, 3] == pytest.approx(elbow[0] + 0.1, abs=1e-4)


def test_what_self_motions_are_given(panda):
    q = panda.random(4)
    assert len(panda.inverse.self_motion(q, HAND, budget=kempe.Budget(points=np.int64(3)))) == 7
    for more, match in (({"points": 2.0}, "points"), ({"step": "a"}, "step")):
        with pytest.raises(InputError, match=match):
            panda.inverse.self_motion(q, HAND, budget=kempe.Budget(**more))
    with pytest.raises(InputError, match="direction"):
        panda.inverse.self_motion(q, HAND, direction=["a"])
    with pytest.raises(InputError, match="leading shape"):
        panda.inverse.self_motion(q, tasks.Position(HAND, np.zeros((2, 3))))

"""What a search may take, steps and time, and how exact its answers are: counted, with Pinocchio as
a judge.
"""

from __future__ import annotations

import itertools
import pickle
import threading
from types import SimpleNamespace

import numpy as np
import pytest
from robots import urdf_files
from test_tasks import inside, two_arms

import kempe
from kempe import Mechanism, arguments, spatial, tasks
from kempe.assemble import modes
from kempe.budget import watched_by
from kempe.errors import InputError, NoSolutionError
from kempe.inverse import explain_tasks, multi_start, solve_all
from kempe.inverse.chain import problem
from kempe.inverse.closed_forms import problem as chain_problem
from kempe.inverse.closed_forms import solve, start_search
from kempe.inverse.tasks import search as effort
from kempe.inverse.tasks import search as ik_tasks
from kempe.kernels.compiled import fallback
from kempe.numerics import clock, newton
from kempe.numerics.newton import solve_many_least_squares
from kempe.status import Status
from kempe.workspace import workers

ROUNDING = 1e-12
HAND = "panda_link7"


# ---- answers end at rounding


@pytest.mark.skipif(not urdf_files(), reason="the package example-robot-data is not installed")
def test_a_whole_body_is_exact_to_rounding_for_pinocchio():
    """Feet and hands of a Unitree G1 at targets that Pinocchio makes, whatever the tolerance,
    judged by Pinocchio.
    """
    pinocchio = pytest.importorskip("pinocchio")
    path = next(p for n, p in urdf_files().items() if n.endswith("g1_29dof_rev_1_0.urdf"))
    s = kempe.load(path, base="free")
    model = pinocchio.buildModelFromUrdf(str(path), pinocchio.JointModelFreeFlyer())
    data = model.createData()
    frames = [
        "left_ankle_roll_link",
        "right_ankle_roll_link",
        "left_rubber_hand",
        "right_rubber_hand",
    ]
    order = [model.joints[model.getJointId(n)].idx_q for n in s.coordinate_names[7:]]

    def poses(q: np.ndarray) -> list[np.ndarray]:
        theirs = np.empty(model.nq)
        theirs[:3] = q[:3]
        theirs[3:6] = q[4:7]
        theirs[6] = q[3]
        theirs[order] = q[7:]
        pinocchio.framesForwardKinematics(model, data, theirs)
        return [data.oMf[model.getFrameId(f)].homogeneous.copy() for f in frames]

    worst = []
    for q in s.random(1, 20):
        targets = poses(q)
        answer = s.ik(
            [tasks.Pose(f, X) for f, X in zip(frames, targets, strict=True)], tolerance=(1e-4, 1e-3)
        )
        assert answer.success and inside(s, answer.q)
        worst.append(np.abs(np.array(poses(answer.q)) - targets).max())
    assert np.median(worst) < 1e-14 and np.mean(np.array(worst) < ROUNDING) >= 0.9


def test_rounding_costs_two_steps_at_most():
    """Against the same starts with a tolerance so small that the search itself must get there."""
    s = two_arms()
    for q in s.random(7, 20):
        wanted = [
            tasks.Pose("left", s.fk(q, "left")),
            tasks.Position("right", s.fk(q, "right")[:3, 3]),
        ]
        loose = s.ik(wanted, tolerance=1e-6)
        tight = s.ik(wanted, tolerance=1e-11)
        assert loose.success and tight.success and loose.starts <= tight.starts
        if loose.starts == tight.starts:
            assert loose.iterations <= tight.iterations + 2
            assert max(loose.position_error, loose.orientation_error) < ROUNDING


def test_rounding_keeps_limits_one_sided_rows_and_levels():
    s = two_arms()
    rng = np.random.default_rng(11)
    for q in s.random(rng, 8):
        at = rng.random(14) < 0.3
        q[7:][at] = np.where(rng.random(14) < 0.5, s.lower[6:], s.upper[6:])[at]
        L = s.fk(q, "left")
        R = s.fk(q, "right")
        wall = tasks.HalfSpace("right", R[:3, 3], [0.0, 0.0, 1.0], priority=1, name="wall")
        pose = tasks.Pose("left", L)
        answer = s.ik([pose, wall, tasks.Posture(s.random(rng), priority=2)])
        assert answer.success and inside(s, answer.q)
        assert (answer.errors[pose.label] < ROUNDING).all() and answer.errors["wall"][0] < ROUNDING
    contradictory = s.ik(
        [tasks.Position("left", L[:3, 3]), tasks.Position("left", R[:3, 3], priority=1, name="too")]
    )
    assert not contradictory.success and contradictory.errors["Position of 'left'"][0] < ROUNDING


# ---- steps


def test_iterations_are_the_steps_of_a_start():
    s = two_arms()
    q = s.random(3)
    wanted = [tasks.Pose("left", s.fk(q, "left")), tasks.Pose("right", s.fk(q, "right"))]
    few = s.ik(wanted, budget=kempe.Budget(iterations=7))
    assert few.success and few.iterations <= 7 * few.starts and s.ik(wanted).iterations > 7
    assert not s.ik(wanted, budget=kempe.Budget(starts=1, iterations=1))
    panda = kempe.load("panda")
    X = panda.fk(panda.random(0), HAND)
    few = panda.ik(X, HAND, budget=kempe.Budget(iterations=8))
    assert few.iterations <= 8 * few.starts
    assert not panda.ik(X, HAND, budget=kempe.Budget(starts=1, iterations=1)).success


@pytest.mark.parametrize("iterations", [1, 2, 5, 13, 40])
@pytest.mark.parametrize("starts", [1, 3, 30])
@pytest.mark.parametrize("name", ["panda", "so101", "cobra600", "ball"])
@pytest.mark.parametrize("tolerance", [1e-6, (1e-3, 1e-2)], ids=str)
def test_iterations_bound_the_work_of_one_frame(tolerance, name, starts, iterations, hunt):
    """The steps of each start, and five times as many those of up to 16 descents to the nearest,
    where all fail.
    """
    s = kempe.load(name)
    frame = s.frame_names[-1]
    X = np.array(s.fk(s.random(hunt.rng(), hunt.cases(40)), frame))
    X[::4, :3, 3] *= 1.6
    answer = s.ik(
        X, frame, tolerance=tolerance, budget=kempe.Budget(starts=starts, iterations=iterations)
    )
    assert (answer.iterations <= iterations * (answer.starts + 5 * min(starts, 16))).all()
    found = answer.success & (answer.starts < starts)
    assert (answer.iterations <= iterations * answer.starts)[found].all()


@pytest.mark.parametrize("iterations", [1, 3, 10, 60])
@pytest.mark.parametrize("starts", [1, 4])
def test_iterations_bound_the_work_of_tasks(starts, iterations, hunt):
    """The steps of each start, and four times as many those of each level that is then lowered."""
    s = kempe.load("panda")
    rng = hunt.rng()
    for _ in range(hunt.cases(12)):
        X = s.fk(s.random(rng), HAND)
        wanted = [
            tasks.Position(HAND, X[:3, 3] * rng.choice([1.0, 1.5])),
            tasks.Pointing(HAND, X[:3, 0], priority=1, weight=1.0),
            tasks.Posture(s.random(rng), priority=2, weight=1.0),
        ]
        answer = s.ik(wanted, budget=kempe.Budget(iterations=iterations, starts=starts))
        assert answer.iterations <= iterations * (answer.starts + 3 * 4)


@pytest.mark.parametrize(
    "more",
    [
        {"iterations": 0},
        {"iterations": 2.5},
        {"time_limit": 0.0},
        {"time_limit": "1"},
    ],
    ids=str,
)
def test_bad_budgets_are_refused(more):
    s = kempe.load("panda")
    X = s.fk(s.random(0), HAND)
    budget = kempe.Budget(**more)
    for call in (
        lambda b=budget: s.ik(X, HAND, budget=b),
        lambda b=budget: s.ik(tasks.Pose(HAND, X), budget=b),
    ):
        with pytest.raises(InputError, match=next(iter(more))):
            call()


# ---- time


def test_a_limit_that_does_not_bite_changes_nothing():
    s = kempe.load("panda")
    arms = two_arms()
    q = s.random(0, 100)
    X = s.fk(q, HAND)
    free = s.ik(X, HAND)
    limited = s.ik(X, HAND, budget=kempe.Budget(time_limit=1e6))
    same = free.starts <= problem.ROUND
    assert limited.success.all() and same.mean() > 0.9
    np.testing.assert_array_equal(limited.q[same], free.q[same])
    np.testing.assert_array_equal(
        s.ik(X, HAND, budget=kempe.Budget(time_limit=1e6, threads=3)).q, limited.q
    )
    L = arms.fk(arms.random(1, 5), "left")
    wanted = [tasks.Pose("left", L), tasks.Posture(arms.neutral)]
    free = arms.ik(wanted)
    limited = arms.ik(wanted, budget=kempe.Budget(time_limit=1e6))
    np.testing.assert_array_equal(limited.q, free.q)
    assert not limited.late.any() and list(limited.status) == list(free.status)


def test_tasks_stop_when_the_time_is_up(looks):
    """The clock is looked at before each start: at look n, n starts have been tried."""
    s = kempe.load("panda")
    far = tasks.Position(HAND, [3.0, 0.0, 0.0])
    for n in (0, 1, 5):
        looks(n)
        answer = s.ik(far, budget=kempe.Budget(time_limit=2.0))
        assert (answer.code, answer.starts, answer.late, answer.success) == (
            Status.OUT_OF_TIME,
            n,
            True,
            False,
        )
        assert (
            f"not reached within the time limit of 2 s, after {n} of 1470 starts" in answer.status
        )
        missed = np.linalg.norm(s.fk(answer.q, HAND)[:3, 3] - [3.0, 0.0, 0.0])
        assert inside(s, answer.q) and answer.position_error == pytest.approx(missed, abs=1e-12)
    looks(10**9)
    assert s.ik(far, budget=kempe.Budget(time_limit=2.0)).code == Status.OUT_OF_REACH
    looks(3)
    with pytest.raises(NoSolutionError, match="time limit"):
        s.ik(far, budget=kempe.Budget(time_limit=2.0)).expect()


def test_a_batch_shares_the_time(looks):
    s = kempe.load("panda")
    p = np.tile([3.0, 0.0, 0.0], (4, 1))
    p[0] = s.fk(s.mid, HAND)[:3, 3]
    looks(11)
    answer = s.ik(tasks.Position(HAND, p), budget=kempe.Budget(starts=5, time_limit=1.0, threads=1))
    assert (
        answer.starts.tolist()[0] == 1
        and answer.starts.tolist()[3] == 0
        and np.isfinite(answer.q).all()
    )
    assert answer.code[0] == 0 and answer.code[3] == Status.OUT_OF_TIME


def test_what_is_lowered_is_said_to_be_cut_short(looks):
    s = kempe.load("panda")
    X = s.fk(s.random(2), HAND)
    posture = tasks.Posture(s.random(1))
    whole = s.ik([tasks.Pose(HAND, X), posture])
    looks(whole.starts + 2)
    cut = s.ik([tasks.Pose(HAND, X), posture], budget=kempe.Budget(time_limit=1.0))
    assert (
        cut.success
        and cut.late
        and "time limit of 1 s ended the search before all errors were minimal" in cut.status
    )
    missed = [
        np.sum(s.configuration_space.difference(posture.q, answer.q) ** 2)
        for answer in (cut, whole)
    ]
    assert missed[0] >= missed[1] and cut.iterations < whole.iterations
    assert cut.position_error < ROUNDING and not whole.late


def stiff_arm() -> kempe.System:
    """Six joints of 0.3 rad to either side: most of what its lengths allow is out of reach."""
    m = Mechanism("stiff")
    before: object = m.ground
    for k in range(6):
        m.revolute(
            f"j{k}",
            before,
            m.body(f"b{k}"),
            at=(0.0, 0.05, 0.3),
            rpy=(np.pi / 2 * (-1) ** k, 0.0, 0.0),
            limits=(-0.3, 0.3),
        )
        before = f"b{k}"
    m.frame("tip", "b5", at=(0.0, 0.0, 0.2))
    return m.build()


@pytest.mark.parametrize("task", ["pose", "position", "direction", "position_axis", "orientation"])
def test_single_targets_stop_when_the_time_is_up(looks, task):
    """Rounds of starts, then what is nearest so far, with its errors: looked at before each round."""
    s = stiff_arm()
    axis = np.array([0.6, 0.0, 0.8])
    home = s.fk(s.neutral, "tip")
    X = spatial.pose(home[:3, :3] @ spatial.rot_x(2.5), 0.4 * home[:3, 3])
    pointed = task in ("direction", "position_axis")
    for n in (0, 2):
        looks(n)
        answer = s.ik(X, "tip", task=(task, axis), budget=kempe.Budget(time_limit=3.0))
        assert (answer.code, answer.starts, answer.success) == (Status.OUT_OF_TIME, 32 * n, False)
        assert (
            f"not reached within the time limit of 3 s, after {32 * n} of 1000 starts"
            in answer.status
        )
        there = s.fk(answer.q, "tip")
        far = np.linalg.norm(there[:3, 3] - X[:3, 3])
        turn = spatial.log_so3(X[:3, :3].T @ there[:3, :3])
        angle = np.linalg.norm(turn)
        if pointed:
            angle = np.arccos((there[:3, :3] @ axis) @ (X[:3, :3] @ axis))
        assert answer.position_error == pytest.approx(
            0.0 if task in ("direction", "orientation") else far, abs=1e-12
        )
        assert answer.orientation_error == pytest.approx(
            0.0 if task == "position" else angle, abs=1e-9
        )
        assert inside(s, answer.q)
    looks(10**9)
    assert (
        s.ik(X, "tip", task=(task, axis), budget=kempe.Budget(time_limit=3.0)).code
        == Status.NOT_FOUND
    )


@pytest.mark.slow
@pytest.mark.parametrize("threads", [1, 2])
def test_hard_targets_do_not_take_the_time_of_easy_ones(threads, looks):
    """All targets get their first starts before the clock ends the search for those that cannot be
    reached.
    """
    robot = kempe.load("puma560")
    X = robot.fk(robot.random(3, 700), "tool")
    far = np.tile(np.diag([1.0, 1.0, 1.0, 1.0]), (700, 1, 1))
    # inside the reach of the lengths, but not with this orientation
    far[:, :3, 3] = (
        0.0,
        0.0,
        -0.6718,
    )
    mixed = np.stack([far, X], axis=1).reshape(-1, 4, 4)
    looks(300)
    answer = robot.ik(
        mixed, "tool", budget=kempe.Budget(time_limit=0.5, starts=100_000, threads=threads)
    )
    assert not answer.success[::2].any() and (answer.code[::2] == Status.OUT_OF_TIME).any()
    assert answer.success[1::2].mean() > 0.99


@pytest.mark.parametrize("threads", ["two", 0, -1, 1.5, True])
@pytest.mark.parametrize("limit", [None, 1.0])
def test_numbers_of_threads_are_checked_with_a_time_limit_too(limit, threads):
    robot = kempe.load("puma560")
    X = robot.fk(robot.random(3, 600), "tool")
    with pytest.raises(InputError, match="threads is"):
        robot.ik(X, "tool", budget=kempe.Budget(threads=threads, time_limit=limit))


# ---- the time of ik_all


def count_looks(monkeypatch, most: int) -> list[int]:
    """Let the time be up from the look at the clock of this number on; the list counts them."""
    looks = [0]

    def over(self) -> bool:
        looks[0] += 1
        return looks[0] > most

    monkeypatch.setattr(chain_problem.Watch, "is_over", property(over))
    return looks


def test_the_time_limit_leaves_what_is_known_of_a_batch(monkeypatch):
    """The first targets have all their solutions; the others have none, are not complete, and say
    why.
    """
    s = kempe.load("gen3_lite")
    X = s.fk(s.random(3, 200), "tool")
    whole = s.ik_all(X, "tool")
    assert not whole.late.any() and whole.late.shape == (200,)
    monkeypatch.setattr(solve, "ELIMINATED", 64)
    count_looks(monkeypatch, 2)
    part = s.ik_all(X, "tool", budget=kempe.Budget(time_limit=100.0))
    assert part.plan.method.word == "elimination"
    assert part.late.sum() == 72 and part.late[128:].all()
    np.testing.assert_array_equal(part.q[:128][part.mask[:128]], whole.q[:128][whole.mask[:128]])
    np.testing.assert_array_equal(part.complete[:128], whole.complete[:128])
    assert not part.complete[128:].any() and not part.mask[128:].any()
    assert (part.code[128:] == Status.OUT_OF_TIME).all() and not part.success[128:].any()
    assert part.status[150] == "no solution found within the time limit of 100 s: there may be some"
    assert pickle.loads(pickle.dumps(part)).late.sum() == 72


def test_the_time_limit_of_one_target():
    assert (
        solve_all.USUAL.complete_budget(None).time_limit == 30.0
        and solve_all.BATCH.complete_budget(None).time_limit is None
    )


@pytest.mark.parametrize("most", range(6))
def test_a_redundant_arm_whose_time_is_up_says_so_at_every_look(most, monkeypatch):
    """At whichever look at the clock the time is up: what is said to be a solution is one, and
    nothing is complete.
    """
    s = kempe.load("panda")
    q = s.lower + 0.02 * (s.upper - s.lower)
    X = s.fk(q, "panda_hand_tcp")
    count_looks(monkeypatch, most)
    answer = s.ik_all(X, "panda_hand_tcp", budget=kempe.Budget(time_limit=1.0))
    assert not answer.complete
    if answer.late:
        assert "time limit of 1 s" in answer.status
        assert answer.code in (Status.SOLVED, Status.OUT_OF_TIME)
    for x in answer.q:
        np.testing.assert_allclose(s.fk(x, "panda_hand_tcp"), X, atol=1e-8)
    if most == 0:
        assert answer.late and not len(answer) and answer.code is Status.OUT_OF_TIME


@pytest.mark.slow
def test_chains_that_are_singular_everywhere_take_no_numerical_search_at_each_value_of_a_spare_joint(
    monkeypatch,
):
    """Two turns and a slide along one direction but for 1e-7: a search at each of 64 values took
    seconds.
    """
    searches = []
    before = start_search._find_solutions
    monkeypatch.setattr(
        start_search, "_find_solutions", lambda *args: searches.append(1) or before(*args)
    )
    h = np.pi / 2
    rows = [(0.35, -h, 0.1, h, "prismatic"), (0.5, h, 0.0, 0.0, "prismatic"), (0.5, -h, -0.2, h, "revolute"),
            (-0.2, 0.0, 0.5, -h, "revolute"), (0.0, 0.0, 0.5, 0.0, "prismatic"),
            (-0.2, 0.0, 0.5, 0.0, "revolute")]  # fmt: skip
    for seed in (0, 4):
        rng = np.random.default_rng(seed)
        most = 0
        table = [
            {
                "a": a + 1e-7 * rng.normal(),
                "alpha": t + 1e-7 * rng.normal(),
                "d": d + 1e-7 * rng.normal(),
                "theta": x,
                "type": kind,
            }
            for a, t, d, x, kind in rows
        ]
        s = kempe.from_dh(table).build()
        for q in rng.uniform(-3.0, 3.0, (5, 6)):
            X = s.fk(q, "tool")
            searches.clear()
            answer = s.ik_all(X, "tool")
            most = max(most, len(searches))
            assert len(answer) and not answer.complete
            for x in answer.q:
                np.testing.assert_allclose(s.fk(x, "tool"), X, atol=1e-8)
        assert most == 1


def test_the_time_limit_of_a_frame_that_moves_with_loops(monkeypatch):
    """It is that of the assembly modes that answer."""
    given = []
    before = modes.assembly_modes

    def noted(*args, limits, budget):
        given.append(budget.time_limit)
        return before(*args, limits=False, budget=budget)

    monkeypatch.setattr(modes, "assembly_modes", noted)
    s = kempe.load("four_bar")
    q = s.assemble({"A": 0.9}).q
    X = s.fk(q, "coupler")
    assert len(s.ik_all(X, "coupler", budget=kempe.Budget(time_limit=7.0)))
    s.ik_all(X, "coupler")
    assert given == [7.0, 30.0]
    with pytest.raises(InputError, match="starts, which ik_all does not read"):
        s.ik_all(X, "coupler", budget=kempe.Budget(starts=3))


# ---- the time of tasks


def counted_calls(calls: list[int], function):
    """The function, and how often it is called."""

    def called(q):
        calls[0] += 1
        return function(q)

    return called


def test_a_function_that_cannot_hold_ends_the_search(monkeypatch):
    """The calls of the first search are spent, and neither without limits nor alone is there an
    answer.
    """
    s = two_arms()
    L = s.fk(s.mid, "left")
    monkeypatch.setattr(effort, "GLIMPSE", 20)
    for low, never in ((0.5, True), (0.0, False)):
        calls = [0]
        wanted = [
            tasks.Pose("left", L),
            tasks.Function(counted_calls(calls, lambda q, a=low: q[8] ** 2 + a)),
        ]
        answer = s.ik(wanted)
        assert bool(answer) is not never
        if never:
            assert answer.code is Status.NOT_FOUND and not answer.late
            assert "20 calls of functions found nothing" in answer.status and calls[0] < 60_000
    # there is an answer without limits, not for the function inside them
    beyond = tasks.Function(lambda q: q[8] - 50.0)
    answer = s.ik([tasks.Pose("left", L), beyond])
    assert (
        answer.code is Status.NOT_FOUND and "20 calls of functions found nothing" in answer.status
    )


@pytest.mark.parametrize("low", [0.5, 0.0])
def test_an_answer_with_functions_does_not_depend_on_how_fast_the_machine_is(low, monkeypatch):
    """On a clock that goes a hundredth of a second, or none at all, between two looks it is the
    same.
    """
    answers = []
    monkeypatch.setattr(effort, "GLIMPSE", 200)
    monkeypatch.setattr(effort, "SHARE", 100)
    for slow in (0.0, 0.01):
        ticks = itertools.count()
        calls = [0]
        s = two_arms()
        fake = SimpleNamespace(monotonic=lambda slow=slow, ticks=ticks: slow * next(ticks))
        for module in (arguments, clock, effort):
            monkeypatch.setattr(module, "time", fake)
        off = tasks.Function(counted_calls(calls, lambda q: (q[8] - 1.0) ** 2 + low))
        answer = s.ik([tasks.Pose("left", s.fk(s.mid, "left")), off, tasks.Posture(s.mid)])
        answers.append((answer.code, answer.starts, answer.iterations, calls[0], answer.q.tolist()))
    assert answers[0] == answers[1]


def test_a_search_that_is_asked_for_its_starts_has_them():
    """Starts, or a time limit, that the caller names are what is spent."""
    s = two_arms()
    wanted = [tasks.Pose("left", s.fk(s.mid, "left")), tasks.Function(lambda q: q[8] ** 2 + 0.5)]
    assert s.ik(wanted, budget=kempe.Budget(starts=7)).starts == 7
    assert (
        ik_tasks.USUAL.complete_budget(None).time_limit == 30.0
        and ik_tasks.BATCH.complete_budget(None).time_limit is None
    )
    plain = s.ik(tasks.Pose("left", s.fk(s.mid, "left")))
    assert plain.problem.time_limit == 30.0


def test_turns_that_a_function_tells_apart_are_limits_not_a_matter_of_starts():
    s = kempe.load("panda")
    hand = "panda_hand_tcp"
    wanted = [tasks.Position(hand, s.fk(s.mid, hand)[:3, 3]), tasks.Function(lambda q: q[0] - 5.0)]
    answer = s.ik(wanted, budget=kempe.Budget(starts=20))
    assert (
        not answer
        and "more starts" not in answer.status
        and "the limits of 'panda_joint1'" in answer.status
    )


def test_sentences_about_large_systems_take_no_dense_decompositions(monkeypatch):
    """Freedoms that are left are counted up to a number of coordinates, for a sentence would take
    minutes beyond.
    """
    s = kempe.load("panda")
    good = s.fk(s.mid, HAND)[:3, 3]
    bad = np.array([3.0, 0.0, 0.0])
    asked = [lambda p=p: s.ik([tasks.Position(HAND, p)]).status for p in (good, bad)]
    assert "4 freedoms left" in asked[0]()
    monkeypatch.setattr(explain_tasks, "MOST_COORDINATES", s.nv - 1)
    monkeypatch.setattr(explain_tasks, "Local", None)
    monkeypatch.setattr(explain_tasks, "analyse_freedoms", None)
    assert "all hard tasks hold: errors up to" in asked[0]() and "freedom" not in asked[0]()
    assert "not reached" in asked[1]()


def test_targets_of_a_path_are_read_where_it_comes_to_them(looks, monkeypatch):
    """A path of many targets that ends early has not prepared them all."""
    s = kempe.load("panda")
    read = []
    of = ik_tasks.Demands.select_row
    X = s.fk(s.mid + np.linspace(0.0, 0.5, 900)[:, None], HAND)
    monkeypatch.setattr(
        ik_tasks.Demands, "select_row", lambda self, i: read.append(i) or of(self, i)
    )
    looks(9)
    path = s.ik_path(X, HAND, s.mid, budget=kempe.Budget(time_limit=5.0))
    assert path.late and 0 < path.success.sum() < 450 and len(read) < 100


def test_the_clock_is_looked_at_between_large_systems_of_equations(monkeypatch):
    """The answers of many are those of each, and of large ones a few are solved at a time."""
    rng = np.random.default_rng(0)
    looks = []
    A = rng.normal(size=(9, 80, 90))
    b = rng.normal(size=(9, 80))
    whole = solve_many_least_squares(A, b)
    monkeypatch.setattr(newton, "WORK", 2.0 * 80 * 90 * 80)
    with watched_by(lambda: looks.append(1)):
        parts = solve_many_least_squares(A, b)
    np.testing.assert_array_equal(parts, whole)
    assert len(looks) == 5


# ---- the time of batches out of reach


@pytest.fixture
def kernel_calls(monkeypatch):
    """What kernels were called with, so far: (targets, starts) of searches, and targets of
    descents.
    """
    calls: list[tuple[str, int, int]] = []
    search = multi_start.schedule
    nearest = fallback.approach_goals

    def reach(*args):
        calls.append(("search", len(args[4]), args[8]))
        return search.reach_goals(*args)

    def approach(*args):
        calls.append(("descents", len(args[4]), 0))
        return nearest(*args)

    monkeypatch.setattr(multi_start, "schedule", SimpleNamespace(reach_goals=reach))
    monkeypatch.setattr("kempe.kernels.compiled.fallback", SimpleNamespace(approach_goals=approach))
    return calls


def far_away(s: kempe.System, frame: str, count: int) -> np.ndarray:
    """Poses of which a third are reached, some are out of reach by their lengths, and some for
    other reasons.
    """
    X = s.fk(s.random(5, count), frame)
    X[1::3, :3, 3] *= 1.15
    X[2::3, :3, 3] *= 4.0
    return X


@pytest.mark.parametrize("budget", [None, kempe.Budget(time_limit=1000.0), kempe.Budget(threads=1)])
def test_no_call_of_a_kernel_takes_long(budget, kernel_calls):
    """Between two calls Python sees an interrupt and the clock: each has at most 4096 starts, or
    128 descents.
    """
    s = kempe.load("puma560")
    answer = s.ik(far_away(s, "tool", 1500), "tool", budget=budget)
    assert np.isfinite(answer.q).all() and {kind for kind, *_ in kernel_calls} == {
        "search",
        "descents",
    }
    for kind, targets, starts in kernel_calls:
        assert (
            targets <= 128 if kind == "descents" else targets * starts <= max(4096, 8 * starts)
        ), (kind, targets)


def test_a_time_limit_that_does_not_come_changes_nothing():
    """What is nearest to targets that lengths put out of reach is found on demand, with a limit,
    too.
    """
    s = kempe.load("puma560")
    X = far_away(s, "tool", 90)
    plain = s.ik(X, "tool")
    limited = s.ik(X, "tool", budget=kempe.Budget(time_limit=1000.0))
    np.testing.assert_array_equal(limited.code, plain.code)
    solved = np.asarray(plain.success)
    np.testing.assert_array_equal(limited.q[solved], plain.q[solved])
    np.testing.assert_array_equal(limited.q, plain.q)
    np.testing.assert_array_equal(limited.starts, plain.starts)


@pytest.mark.parametrize("most", [0, 1, 3, 9, 30])
def test_the_time_limit_of_a_batch_ends_it_at_the_next_look_at_the_clock(
    most, monkeypatch, kernel_calls
):
    """Whichever look it is: no kernel is called again, and each target says whether it was reached,
    or why not.
    """
    s = kempe.load("puma560")
    X = far_away(s, "tool", 1500)
    looks = [0]
    plain = s.ik(X, "tool")
    np.isfinite(plain.q)
    kernel_calls.clear()

    def monotonic() -> float:
        looks[0] += 1
        return 0.0 if looks[0] <= most + 1 else 1e9

    monkeypatch.setattr(multi_start.time, "monotonic", monotonic)
    answer = s.ik(X, "tool", budget=kempe.Budget(time_limit=5.0, threads=1))
    assert len(kernel_calls) <= most
    code = np.asarray(answer.code)
    assert set(np.unique(code)) <= {
        Status.SOLVED,
        Status.OUT_OF_REACH,
        Status.OUT_OF_TIME,
        Status.NOT_FOUND,
    }
    assert (np.asarray(plain.code)[code == Status.SOLVED] == Status.SOLVED).all()
    assert (np.asarray(plain.code)[code == Status.OUT_OF_REACH] == Status.OUT_OF_REACH).all()
    assert most > 0 or not (code == Status.SOLVED).any()
    monkeypatch.undo()
    assert np.isfinite(answer.q).all() and np.isfinite(answer.position_error).all()


def test_the_work_of_a_thread_that_is_told_to_stop_ends_at_the_next_piece():
    """The work has no end of its own: it is left at the next look at the clock."""
    s = kempe.load("puma560")
    X = far_away(s, "tool", 1500)
    begun = threading.Event()

    def work(number: int, item: int) -> None:
        while True:
            s.ik(X, "tool", budget=kempe.Budget(threads=1))
            begun.set()

    def check(done: int) -> None:
        if begun.is_set():
            raise KeyboardInterrupt

    done, broken = workers.work_in_threads([0], work, 1, check, stops=True)
    assert done == 0 and isinstance(broken, KeyboardInterrupt)
    assert s.ik(X[0], "tool")  # nothing else is told to stop

"""Levels of tasks: none is disturbed by those behind it, compared with the same call without them,
on random robots.
"""

from __future__ import annotations

import math

import numpy as np
import pytest

import kempe
from kempe import Mechanism, System, tasks
from kempe.inverse.answer import Reached

HAND = "panda_hand_tcp"
NAMES = ("panda", "ur5", "xarm6", "iiwa14")
CLOSE = 1e-5
LITTLE = 2e-6
"""By which part of what a level misses, and by how much, it may differ with and without the levels
behind it."""
KINDS = ("Pose", "Position", "Orientation", "Pointing", "OnPlane", "OnLine", "HalfSpace", "Posture")


def solve(s: System, wanted: list[tasks.Task], start=None, **budget) -> Reached:
    answer = s.ik(wanted, start=start, budget=kempe.Budget(**budget))
    assert isinstance(answer, Reached)
    return answer


def arm(rng: np.random.Generator) -> System:
    """Four to seven joints that turn, some within more than a turn, or slide, on the ground or on a
    flying body.
    """
    m = Mechanism("arm")
    before = "ground"
    if rng.random() < 0.2:
        m.free("base", m.ground, m.body("torso"))
        before = "torso"
    for k in range(int(rng.integers(4, 8))):
        at = rng.normal(0.0, 0.3, 3)
        rpy = rng.normal(0.0, 1.5, 3)
        body = m.body(f"b{k}")
        if rng.random() < 0.15:
            m.prismatic(f"j{k}", before, body, at=at, rpy=rpy, limits=(-0.3, 0.3))
        else:
            turn = rng.choice([1.0, 2.0, 3.0, 2.0 * math.pi])
            m.revolute(f"j{k}", before, body, at=at, rpy=rpy, limits=(-turn, turn))
        before = f"b{k}"
    m.frame("tip", before, at=rng.normal(0.0, 0.3, 3))
    return m.build()


def task(s: System, rng: np.random.Generator, q: np.ndarray, level: int, soft: bool) -> tasks.Task:
    """A task that q holds, of any kind."""
    frames = s.frame_names
    kind = KINDS[rng.integers(len(KINDS))]
    frame = frames[int(rng.integers(len(frames) // 2, len(frames)))]
    X = s.fk(q, frame)
    goal = {
        "Pose": (X,),
        "Position": (X[:3, 3],),
        "Orientation": (X[:3, :3],),
        "Pointing": (X[:3, 2],),
    }
    more = {
        "weight": float(rng.uniform(0.2, 3.0)) if soft else None,
        "priority": level,
        "name": f"level {level}",
    }
    if kind == "Posture":
        return tasks.Posture(q, **more)
    return getattr(tasks, kind)(frame, *goal.get(kind, (X[:3, 3], X[:3, 1])), **more)


def missed(s: System, answer: Reached, wanted: tasks.Task) -> float:
    """What a task misses, by the forward model; lengths in those of the solver."""
    if isinstance(wanted, tasks.Posture):
        far = s.configuration_space.difference(np.asarray(wanted.q), answer.q)
        slides = s.structure.layout.vector_v[
            ~s.structure.coordinates.turning[s.structure.layout.vector_v]
        ]
        far[slides] /= answer.problem.packed.loops.length
        return float(np.linalg.norm(far))
    linear, angular = answer.errors[wanted.name]
    return math.hypot(linear / answer.problem.packed.loops.length, angular)


def compare(s: System, wanted: list[tasks.Task], seed: np.ndarray | None) -> None:
    """Each level misses as much, or less, with those behind it, up to the first that misses less or
    is hard and missed, and only a hard task behind them can cost a success.
    """
    before = solve(s, wanted[:1], start=seed, starts=60)
    for n in range(1, len(wanted)):
        after = solve(s, wanted[: n + 1], start=seed, starts=60)
        assert after.success or not before.success or wanted[n].weight is None
        for each in wanted[:n]:
            least = missed(s, before, each)
            now = missed(s, after, each)
            assert now <= least * (1.0 + CLOSE) + LITTLE / after.problem.packed.loops.length, (
                n,
                each,
                least,
                now,
            )
            if now < least * (1.0 - CLOSE) - LITTLE or (each.weight is None and least > 1e-5):
                break
        before = after


def hunted(rng: np.random.Generator, mixed: bool) -> None:
    """One case: two to four levels, most of the later ones out of reach of what the earlier ones
    hold.
    """
    s = arm(rng) if rng.random() < 0.5 else kempe.load(NAMES[rng.integers(len(NAMES))])
    q = s.random(rng)
    count = int(rng.integers(2, 5))
    goals = [q if k == 0 or rng.random() < 0.4 else s.random(rng) for k in range(count)]
    soft = [bool(rng.random() < 0.6) if mixed else k > 0 for k in range(count)]
    wanted = [task(s, rng, goals[k], k, soft[k]) for k in range(count)]
    compare(s, wanted, (q, s.random(rng), None)[rng.integers(3)])


@pytest.mark.parametrize("seed", [856, 1232, 1747, 2020, 2061, 2462])
def test_a_posture_costs_neither_the_place_nor_the_direction(seed):
    """The direction cannot be met in this place: its least leaves next to no freedom, and its rows
    depend on the others.
    """
    s = kempe.load("panda")
    rng = np.random.default_rng(seed)
    q = s.random(rng)
    other = s.random(rng)
    X = s.fk(q, HAND)
    Y = s.fk(other, HAND)
    place = tasks.Position(HAND, X[:3, 3], name="place")
    direction = tasks.Pointing(HAND, Y[:3, 2], weight=1.0, priority=1, name="direction")
    without = solve(s, [place, direction], start=q)
    answer = solve(s, [place, direction, tasks.Posture(other, weight=1.0, priority=2)], start=q)
    assert without.success and answer.success and answer.errors["place"][0] <= 1e-9
    assert answer.errors["direction"][1] == pytest.approx(without.errors["direction"][1], abs=1e-9)


@pytest.mark.parametrize("mixed", [False, True], ids=["soft", "mixed"])
def test_no_level_is_disturbed_by_those_behind_it(mixed, hunt):
    rng = hunt.rng()
    for _ in range(hunt.cases(60)):
        hunted(rng, mixed)


@pytest.mark.slow
@pytest.mark.parametrize("mixed", [False, True], ids=["soft", "mixed"])
def test_no_level_is_disturbed_by_those_behind_it_in_many_cases(mixed, hunt):
    rng = hunt.rng()
    for _ in range(hunt.cases(600)):
        hunted(rng, mixed)


def test_a_turn_is_taken_for_an_earlier_level_whatever_a_later_one_wants():
    """The second posture wants what the first leaves, nothing: the first turns back by a whole turn
    all the same.
    """
    s = kempe.load("ur5")
    frame = s.frame_names[-1]
    q = 0.3 * s.random(0)
    turned = q - 2.0 * math.pi * np.sign(q)
    first = tasks.Posture(q, priority=1, name="first")
    second = tasks.Posture(turned, priority=2, name="second")
    answer = solve(s, [tasks.Pose(frame, s.fk(q, frame)), first, second], start=turned)
    np.testing.assert_allclose(answer.q, q, atol=1e-6)


@pytest.mark.parametrize("frame", ["link4", "link5", "link6"])
def test_a_second_posture_turns_no_angle_of_the_first(frame):
    """The last joint may turn on by a whole turn, which only the second posture would like."""
    s = kempe.load("ur5")
    q = np.array([1.32, 1.216, -0.596, -3.087, 2.055, 5.329])
    first = [-0.866, 6.073, -6.014, -4.11, -0.392, -1.941]
    second = [3.882, 4.747, 3.194, -3.533, 4.034, -2.122]
    place = tasks.Pose(frame, s.fk(q, frame), weight=2.5, name="place")
    wanted = [
        tasks.Posture(x, weight=1.0, priority=k, name=f"posture {k}")
        for k, x in ((1, first), (2, second))
    ]
    compare(s, [place, *wanted], q)


def test_rows_of_a_batch_are_single_calls_whatever_the_threads():
    """A soft place out of reach before a hard direction: each row is also looked at without the
    direction.
    """
    s = kempe.load("ur5")
    rng = np.random.default_rng(3)
    n = 40
    frame = s.frame_names[-1]
    X = 1.3 * s.fk(s.random(rng, n), frame)
    Y = s.fk(s.random(rng, n), frame)
    seed = s.random(rng, n)

    def wanted(i) -> list[tasks.Task]:
        place = tasks.Position(frame, X[i, :3, 3], weight=1.0, name="place")
        return [
            place,
            tasks.Pointing(frame, Y[i, :3, 2], priority=1),
            tasks.Posture(s.mid, priority=2),
        ]

    together = solve(s, wanted(slice(None)), start=seed, threads=1)
    np.testing.assert_array_equal(
        together.q, solve(s, wanted(slice(None)), start=seed, threads=4).q
    )
    for i in range(n):
        np.testing.assert_array_equal(together.q[i], solve(s, wanted(i), start=seed[i]).q)


def lexicographic(
    levels: list[tuple[np.ndarray, np.ndarray]], n: int
) -> tuple[np.ndarray, list[float]]:
    """x (n,) and the least |A x - b| of each level that keeps the levels before at theirs, by dense
    null spaces.
    """
    x = np.zeros(n)
    free = np.eye(n)
    out = []
    for A, b in levels:
        U, sizes, Vt = np.linalg.svd(A @ free, full_matrices=True)
        rank = int((sizes > 1e-9).sum())
        x = x + free @ Vt[:rank].T @ (U[:, :rank].T @ (b - A @ x) / sizes[:rank])
        out.append(float(np.linalg.norm(A @ x - b)))
        free = free @ Vt[rank:].T
    return x, out


def test_levels_of_a_gantry_are_those_of_linear_algebra(hunt):
    """Slides only: each height over a plane is linear in q, so that levels have a closed form."""
    rng = hunt.rng()
    compared = 0
    cases = hunt.cases(60)
    for _ in range(cases):
        count = int(rng.integers(2, 6))
        m = kempe.Mechanism("gantry")
        before = "ground"
        axes = rng.normal(size=(count, 3))
        axes /= np.linalg.norm(axes, axis=1, keepdims=True)
        for k in range(count):
            link = m.body(f"b{k}")
            m.prismatic(f"s{k}", before, link, axis=axes[k])
            before = f"b{k}"
        s = m.build()
        wanted = []
        levels = []
        for priority in range(int(rng.integers(2, 5))):
            rows = int(rng.integers(1, 4))
            A = np.zeros((rows, count))
            b = rng.normal(size=rows)
            for i in range(rows):
                body = int(rng.integers(count))
                n = rng.normal(size=3)
                n /= np.linalg.norm(n)
                A[i, : body + 1] = axes[: body + 1] @ n
                wanted.append(
                    tasks.OnPlane(
                        f"b{body}",
                        b[i] * n,
                        n,
                        weight=1.0,
                        priority=priority + 1,
                        name=f"{priority}.{i}",
                    )
                )
            levels.append((A, b))
        answer = solve(s, wanted)
        (x, leasts) = lexicographic(levels, count)
        # some rows nearly depend on others: which rank they have is a matter of digits
        if np.abs(x).max() > 20.0:
            continue
        compared += 1
        for priority, least in enumerate(leasts):
            found = math.hypot(
                *(answer.errors[t.name][0] for t in wanted if t.priority == priority + 1)
            )
            assert found == pytest.approx(least, abs=1e-6)
    assert compared > 0.5 * cases

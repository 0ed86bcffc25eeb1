"""Steps towards what cannot be had: they settle, with bounded speed, where the error is least.

Judged by `ik`'s nearest configuration, by scipy's minimiser of an error written here, and by the
velocities themselves.
"""

from __future__ import annotations

import math

import numpy as np
import pytest
from hunts import some
from scipy.optimize import minimize

import kempe
from kempe import Mechanism, System, spatial, tasks
from kempe.inverse.chain.serial_chain import find_chain
from kempe.inverse.ik_step import SLIDING, TURNING, list_speed_limits
from kempe.model.characteristic_length import compute_characteristic_length

TIPS = {"panda": "panda_hand_tcp", "ur5": "tool", "iiwa14": "tool"}
STARTS = {
    "panda": [0.0, -0.785, 0.0, -2.356, 0.0, 1.571, 0.785], "ur5": [0.3, -0.8, 1.2, -0.4, 1.0, 0.2],
    "iiwa14": [0.3, 0.5, 0.2, -1.2, 0.3, 0.8, 0.1],
}  # fmt: skip
HUNTED = (
    "panda",
    "ur5",
    "iiwa14",
    "puma560",
    "stanford",
    "xarm6",
    "gen3",
    "irb6640",
    "jaco2",
    "so101",
    "cobra600",
    "youbot",
    "two_link",
)


@pytest.fixture(scope="module")
def robots() -> dict[str, System]:
    return {name: kempe.load(name) for name in HUNTED}


def tip(system: System) -> str:
    """The frame that most joints move."""
    names = system.frame_names
    return max(names, key=lambda f: (len(find_chain(system, f).v_index), names.index(f)))


def motion(system: System, q, wanted, frame=None, dt=0.01, time=5.0, **options) -> np.ndarray:
    """Configurations (n + 1, nq) of a loop that asks for the same in every cycle."""
    out = [np.array(q, dtype=float)]
    for _ in range(round(time / dt)):
        out.append(system.ik_step(out[-1], wanted, frame, dt, **options).q)
    return np.array(out)


def turns_back(Q: np.ndarray, dt: float) -> int:
    """How often velocities change their sign in the last second."""
    v = np.sign(np.diff(Q, axis=0)[-round(1.0 / dt) :])
    return int((np.diff(v, axis=0) != 0.0).sum())


def outside(system: System, q: np.ndarray, frame: str, by: float) -> np.ndarray:
    """The pose of the frame at q, moved away from its base until it is out of reach, and then by
    some metres.
    """
    X = system.fk(q, frame)
    way = X[:3, 3] / np.linalg.norm(X[:3, 3])
    far = np.linspace(0.0, 2.0, 81)
    line = np.tile(X, (81, 1, 1))
    line[:, :3, 3] += far[:, None] * way
    X[:3, 3] += (far[np.flatnonzero(system.ik(line, frame).success)[-1]] + by) * way
    return X


@pytest.mark.parametrize("damping", [0.05, 0.0])
@pytest.mark.parametrize(
    "by", [pytest.param(x, marks=pytest.mark.slow) if x != 0.1 else x for x in (0.01, 0.1, 1.0)]
)
@pytest.mark.parametrize("name", list(TIPS))
def test_out_of_reach_it_settles_at_the_nearest_pose(name, by, damping):
    s = kempe.load(name)
    frame = TIPS[name]
    q = np.array(STARTS[name])
    X = outside(s, q, frame, by)
    Q = motion(s, q, X, frame, damping=damping, time=4.0 if by == 1.0 else 3.0)
    assert turns_back(Q, 0.01) == 0 and not np.diff(Q[-100:], axis=0).any()
    assert np.abs(np.diff(Q, axis=0) / 0.01).max() <= TURNING * (1.0 + 1e-9)
    # the wrist of a UR5 has minima on both sides, and a step does not leave the one that it comes
    # to
    nearest = s.ik(X, frame, start=Q[-1], budget=kempe.Budget(starts=1 if name == "ur5" else 1000))
    rest = s.fk(Q[-1], frame)
    assert abs(np.linalg.norm(rest[:3, 3] - X[:3, 3]) - nearest.position_error) < 1e-4


@pytest.mark.slow
@pytest.mark.parametrize(
    "options", [{}, {"damping": 0.0}, {"velocity_limits": 1.0}, {"keep_direction": True}]
)
@pytest.mark.parametrize("name", ["panda", "ur5"])
def test_a_thousand_cycles_a_second_settle_too(name, options):
    s = kempe.load(name)
    frame = TIPS[name]
    q = np.array(STARTS[name])
    X = outside(s, q, frame, 0.3)
    Q = motion(s, q, X, frame, 0.001, 5.0 if "velocity_limits" in options else 3.0, **options)
    assert turns_back(Q, 0.001) == 0
    assert np.abs(np.diff(Q, axis=0) / 0.001).max() <= options.get("velocity_limits", TURNING) * (
        1.0 + 1e-9
    )


def rests_nearest(s: System, frame: str, X: np.ndarray, q: np.ndarray) -> bool:
    """Whether scipy finds no configuration near q that misses the pose by 1 % or 1 mm less."""
    length = compute_characteristic_length(s)

    def missed(x):
        Y = s.fk(x, frame)
        e = np.concatenate(
            [(X[:3, 3] - Y[:3, 3]) / length, spatial.log_so3(X[:3, :3] @ Y[:3, :3].T)]
        )
        return float(e @ e)

    bounds = list(zip(np.minimum(s.lower, q), np.maximum(s.upper, q), strict=True))
    options = {"ftol": 1e-15, "gtol": 1e-12, "maxiter": 2000}
    least = math.sqrt(minimize(missed, q, method="L-BFGS-B", bounds=bounds, options=options).fun)
    return math.sqrt(missed(q)) - least < max(0.01 * least, 1e-3 / length)


def settles_at_a_minimum(s: System, rng: np.random.Generator) -> bool:
    """One case of the hunt: whether the motion has come to rest."""
    frame = tip(s)
    q = s.random(rng)
    if rng.random() < 0.3:
        q = np.where(rng.random(s.nq) < 0.4, np.where(rng.random(s.nq) < 0.5, s.lower, s.upper), q)
        q = np.where(np.isfinite(q), q, 0.0)
    X = s.fk(s.random(rng), frame)
    far = 10.0 ** rng.uniform(-2.0, 0.0)
    way = rng.normal(size=3) * ([1.0, 1.0, 0.0] if s.dim == 2 else 1.0)
    reach = min((b.largest for b in find_chain(s, frame).bounds), default=1.0)
    X[:3, 3] = (
        way / np.linalg.norm(way) * (reach + far) if rng.random() < 0.7 else X[:3, 3] + far * way
    )
    kind = rng.choice(["pose", "pose", "position", "orientation"])
    w = np.array(
        {"pose": [1] * 6, "position": [1, 1, 1, 0, 0, 0], "orientation": [0, 0, 0, 1, 1, 1]}[kind]
    )
    damping = float(rng.choice([0.0, 0.05]))
    Q = motion(s, q, X, frame, 0.01, 7.0, weights=None if kind == "pose" else w, damping=damping)
    if np.abs(np.diff(Q[-101:], axis=0)).max() > 0.02:
        return False  # on its way: turns of joints with a wide range take longer
    assert turns_back(Q, 0.01) == 0, (s.name, kind, damping)
    scale = 1.0 / compute_characteristic_length(s)

    def missed(x):
        Y = s.fk(x, frame)
        e = w * np.concatenate(
            [scale * (X[:3, 3] - Y[:3, 3]), spatial.log_so3(X[:3, :3] @ Y[:3, :3].T)]
        )
        return float(e @ e)

    low = np.minimum(s.lower, Q[-1])
    high = np.maximum(s.upper, Q[-1])
    found = minimize(missed, Q[-1], method="L-BFGS-B", bounds=list(zip(low, high, strict=True)))
    assert found.fun > missed(Q[-1]) * (1.0 - 1e-4) - 1e-6, (s.name, kind, damping)
    return True


def test_it_settles_at_a_minimum_of_the_error(robots, hunt):
    """Every resting place is a local minimum inside the limits, by scipy, and no velocity turns
    back there.
    """
    rng = hunt.rng()
    cases = hunt.cases(5)
    assert (
        sum(settles_at_a_minimum(robots[str(rng.choice(HUNTED))], rng) for _ in range(cases))
        > 0.5 * cases - 1
    )


@pytest.mark.slow
def test_it_settles_at_a_minimum_of_the_error_often(robots, hunt):
    rng = hunt.rng()
    cases = hunt.cases(80)
    assert (
        sum(settles_at_a_minimum(robots[str(rng.choice(HUNTED))], rng) for _ in range(cases))
        > 0.5 * cases - 1
    )


@pytest.mark.parametrize("name", some(list(TIPS), 3))
def test_a_straight_way_leads_to_the_border_and_then_to_the_nearest_pose(name):
    """Pushed out of reach, the hand stays on its line to 1.5 % of the way until the arm is
    stretched, then slides.
    """
    s = kempe.load(name)
    frame = TIPS[name]
    q = np.array(STARTS[name])
    X = s.fk(q, frame)
    X[:3, 3] += [0.3, 0.9, 0.3]
    Q = motion(s, q, X, frame, keep_direction=True, time=8.0)
    assert not np.diff(Q[-100:], axis=0).any() and turns_at_speed(Q, 0.01, TURNING) == 0
    p = s.fk(Q, frame)[:, :3, 3] - s.fk(q, frame)[:3, 3]
    way = np.array([0.3, 0.9, 0.3]) / math.hypot(0.3, 0.9, 0.3)
    beside = np.linalg.norm(p - (p @ way)[:, None] * way, axis=1)
    smallest = np.linalg.svd(s.jacobian(Q, frame), compute_uv=False)[:, -1]
    free = int(
        np.argmax(
            (smallest < 0.06)
            | (Q <= s.lower + 1e-3).any(axis=1)
            | (Q >= s.upper - 1e-3).any(axis=1)
        )
    )
    assert free > 5 and beside[: free - 1].max() < 0.015 * p[free - 1] @ way + 1e-3
    assert rests_nearest(s, frame, X, Q[-1])


def arm() -> System:
    m = Mechanism("arm", dim=2)
    m.revolute("a", "ground", m.body("u"), at=(0, 0))
    m.revolute("b", "u", m.body("v"), at=(1, 0))
    m.frame("tip", "v", at=(1, 0))
    return m.build()


@pytest.mark.parametrize("target", [(1.0, 0.0), (-2.5, 0.0), (-1.0, 0.0)])
def test_singular_starts_are_left(target):
    """Stretched along the line to the target, no first-order step leads to it."""
    s = arm()
    X = spatial.pose(p=[*target, 0.0])
    Q = motion(s, [0.0, 0.0], X, "tip", weights=[1, 1, 0, 0, 0, 0])
    missed = np.linalg.norm(s.fk(Q[-1], "tip")[:2, 3] - target)
    assert missed == pytest.approx(max(0.0, math.hypot(*target) - 2.0), abs=1e-6)
    assert not np.diff(Q[-100:], axis=0).any()


@pytest.mark.slow
def test_a_target_that_goes_out_of_reach_and_comes_back_is_tracked():
    s = kempe.load("panda")
    frame = TIPS["panda"]
    q = np.array(STARTS["panda"])
    X = s.fk(q, frame)
    worst = 0.0
    fastest = 0.0
    for k in range(1500):
        goal = X.copy()
        before = q
        goal[0, 3] += 0.6 * math.sin(2.0 * math.pi * k / 1000.0) ** 2
        q = s.ik_step(q, goal, frame, 0.01).q
        fastest = max(fastest, float(np.abs(q - before).max()) / 0.01)
        if k % 500 < 100 or k % 500 > 400:
            worst = (
                max(worst, float(np.linalg.norm(s.fk(q, frame)[:3, 3] - goal[:3, 3])))
                if k > 20
                else worst
            )
    assert fastest <= TURNING * (1.0 + 1e-9)
    assert worst < 2e-3  # near the border it is led through by damping


# ---- no joint turns back at once


TWELVE = (
    "puma560",
    "ur5",
    "ur10e",
    "panda",
    "iiwa14",
    "gen3",
    "jaco2",
    "xarm6",
    "stanford",
    "gen3_lite",
    "crx10ia",
    "so101",
)
KINDS = ("twist", "turn", "pose", "far", "turned", "position", "soft", "levels")


def turns_at_speed(Q: np.ndarray, dt: float, speed: float) -> int:
    """Cycles in which a joint's velocity changes its sign, above a twentieth of its limit before
    and after.
    """
    v = np.diff(Q, axis=0) / dt
    fast = np.abs(v) > 0.05 * speed
    return int(((v[1:] * v[:-1] < 0.0) & fast[1:] & fast[:-1]).any(axis=1).sum())


def start_of(s: System, rng: np.random.Generator) -> np.ndarray:
    """A posture, mostly singular, the middle, joints at their limits, or a random configuration."""
    kind = rng.choice(["posture", "mid", "limits", "random"])
    named = s.structure.posture_names
    q = s.random(rng)
    if kind == "posture":
        q = s.q(str(rng.choice(named))) if named and rng.random() < 0.7 else s.neutral
    elif kind == "mid":
        q = s.mid
    elif kind == "limits":
        q = np.where(rng.random(s.nq) < 0.4, np.where(rng.random(s.nq) < 0.5, s.lower, s.upper), q)
    return np.clip(np.where(np.isfinite(q), q, 0.0), s.lower, s.upper)


def asked(kind: str, s: System, frame: str, q: np.ndarray, rng: np.random.Generator):
    """What is wanted, and of which frame: outwards, inwards, along an axis or anywhere."""
    X = s.fk(q, frame)
    out = X[:3, 3] / max(np.linalg.norm(X[:3, 3]), 1e-9)
    way = [np.eye(3)[0], out, -out, rng.normal(size=3)][int(rng.integers(4))]
    way = way / max(np.linalg.norm(way), 1e-9)
    far = {"far": 1.5, "pose": 0.15}.get(kind, 0.15)
    goal = X.copy()
    goal[:3, 3] += far * way
    if kind == "twist":
        return np.append(0.3 * way, np.zeros(3)), frame
    if kind == "turn":
        return np.append(0.1 * way, 0.5 * way), frame
    if kind == "turned":
        goal[:3, :3] = spatial.exp_so3(1.5 * way) @ X[:3, :3]
    if kind in ("pose", "far", "turned"):
        return goal, frame
    soft = None if kind == "position" else 1.0
    first = tasks.Position(frame, goal[:3, 3], weight=soft if kind == "soft" else None)
    rest = {
        "position": [],
        "soft": [tasks.Posture(s.mid, weight=0.05)],
        "levels": [tasks.Posture(s.mid, priority=1)],
    }
    return [first, *rest[kind]], None


def turns_of_a_case(
    s: System, rng: np.random.Generator, kinds=KINDS, cycles: int = 120
) -> tuple[int, tuple]:
    frame = tip(s)
    kind = str(rng.choice(kinds))
    dt = float(rng.choice([0.0005, 0.001, 0.004, 0.01]))
    q = start_of(s, rng)
    wanted, of = asked(kind, s, frame, q, rng)
    options = {"keep_direction": bool(rng.random() < 0.5)} if of else {}
    Q = motion(s, q, wanted, of, dt, cycles * dt, velocity_limits=1.0, **options)
    assert np.abs(np.diff(Q, axis=0)).max() <= dt * (1.0 + 1e-9)
    return turns_at_speed(Q, dt, 1.0), (s.name, kind, dt, options, q.tolist())


def test_no_joint_turns_back_at_once(hunt):
    """Twists, poses and tasks, a direction kept or not, from singular, stretched and limited
    starts.
    """
    rng = hunt.rng()
    bad = []
    for _ in range(hunt.cases(24)):
        count, case = turns_of_a_case(kempe.load(str(rng.choice(TWELVE))), rng, KINDS[:5])
        bad += [(count, case)] if count else []
    for _ in range(hunt.cases(4)):
        count, case = turns_of_a_case(kempe.load(str(rng.choice(TWELVE))), rng, KINDS[5:], 60)
        bad += [(count, case)] if count else []
    assert not bad, bad


@pytest.mark.slow
@pytest.mark.parametrize("name", TWELVE)
def test_no_joint_turns_back_at_once_often(name, hunt):
    rng = hunt.rng()
    s = kempe.load(name)
    bad = []
    for k in range(hunt.cases(84)):
        count, case = turns_of_a_case(s, rng, KINDS if k % 6 == 0 else KINDS[:5])
        bad += [(count, case)] if count else []
    assert not bad, bad


SITUATIONS = ("singular", "stretched", "limit", "unreachable", "reversing", "twist")


def wanted_in(situation: str, s: System, frame: str) -> tuple[np.ndarray, list[np.ndarray]]:
    """A start, and what is wanted: one motion, or one and then its reverse."""
    q = np.where(np.isfinite(s.mid), s.mid, 0.0)
    bent = np.clip(q + 0.4, s.lower, s.upper)
    if situation == "singular":
        return q, [np.array([0.1, 0.05, 0.1, 0.0, 0.0, 0.0])]
    X = s.fk(bent, frame)
    out = X[:3, 3] / max(np.linalg.norm(X[:3, 3]), 1e-9)
    if situation == "stretched":
        return bent, [np.append(0.3 * out, np.zeros(3))]
    if situation == "limit":
        at = np.where(np.arange(s.nq) % 2 == 0, np.minimum(s.upper, 3.0), bent)
        return at, [np.array([-0.1, 0.1, 0.2, 0.3, 0.0, 0.0])]
    if situation == "unreachable":
        X[:3, 3] += 3.0 * out
        return bent, [X]
    twist = np.array([0.1, -0.1, 0.05, 0.2, 0.1, -0.1])
    return bent, [twist, -twist] if situation == "reversing" else [twist]


def count_turns(s: System, situation: str, dt: float, kept: bool, cycles: int) -> int:
    """Cycles in which a joint turns back above a twentieth of its limit of speed, but for those in
    which what is wanted is reversed.
    """
    frame = tip(s)
    q, motions = wanted_in(situation, s, frame)
    turns = 0
    for wanted in motions:
        Q = motion(s, q, wanted, frame, dt, cycles * dt, velocity_limits=1.0, keep_direction=kept)
        q = Q[-1]
        turns += turns_at_speed(Q, dt, 1.0)
        if kept and wanted.ndim == 1 and motions == [wanted]:
            p = s.fk(Q, frame)[:, :3, 3]
            along = (p - p[0]) @ wanted[:3]
            # never back, but for second order
            assert np.diff(along).min() > -1e-4 * dt * float(wanted[:3] @ wanted[:3])
    return turns


@pytest.mark.parametrize("dt", [0.0005, 0.001, 0.004, 0.01])
@pytest.mark.parametrize("name", TWELVE)
def test_no_joint_turns_back_in_any_situation(name, dt):
    s = kempe.load(name)
    for situation in SITUATIONS:
        for kept in (False, True):
            assert count_turns(s, situation, dt, kept, 60) == 0, (situation, kept)


@pytest.mark.slow
@pytest.mark.parametrize("dt", [0.0005, 0.001, 0.004, 0.01])
@pytest.mark.parametrize("name", TWELVE)
def test_no_joint_turns_back_in_a_thousand_cycles(name, dt):
    s = kempe.load(name)
    for situation in SITUATIONS:
        for kept in (False, True):
            assert count_turns(s, situation, dt, kept, 1000) == 0, (situation, kept)


@pytest.mark.parametrize(
    ("name", "q", "twist"),
    some(
        [
            ("panda", [0, -0.5, 0, -2.2, 0, 1.8, 0.8], [0.3, 0, 0]),
            ("ur5", [0.3, -1.2, 1.4, -0.6, 0.9, 0.2], [-0.3, -0.1, 0.1]),
            ("iiwa14", [0.3, 0.6, -0.4, -1.2, 0.5, 0.8, 0.1], [0.3, 0.1, 0]),
        ],
        2,
    ),
)
def test_a_kept_direction_slows_down_and_stops(name, q, twist):
    """The hand goes along the line, never back, to a singular posture: there no pose ahead is
    reached to 2 cm.
    """
    s = kempe.load(name)
    frame = TIPS[name]
    dt = 0.01
    Q = motion(s, q, [*twist, 0, 0, 0], frame, dt, 6.0, velocity_limits=1.0, keep_direction=True)
    X = s.fk(Q, frame)
    way = np.array(twist) / np.linalg.norm(twist)
    along = (X[:, :3, 3] - X[0, :3, 3]) @ way
    beside = np.linalg.norm(X[:, :3, 3] - X[0, :3, 3] - along[:, None] * way, axis=1)
    assert np.diff(along).min() > -1e-9 and beside.max() < 0.02 * along[-1] + 2e-3
    assert np.abs(np.diff(Q[-20:], axis=0)).max() / dt < 0.01  # at rest
    values = np.linalg.svd(s.jacobian(Q[-1], frame), compute_uv=False)
    at_limit = (Q[-1] <= s.lower + 1e-6) | (Q[-1] >= s.upper - 1e-6)
    assert values[-1] < 5e-3 or at_limit.any()


@pytest.mark.parametrize("name", some(["iiwa14", "ur5", "gen3", "jaco2"], 2))
def test_the_hand_travels_from_singular_postures(name):
    s = kempe.load(name)
    q = np.clip(s.q("up") if name == "ur5" else s.mid, s.lower, s.upper)
    frame = tip(s)
    way = np.eye(3)[0]
    goes = motion(s, q, [0.1, 0, 0, 0, 0, 0], frame, 0.01, 1.0, velocity_limits=1.0)
    kept = motion(
        s, q, [0.1, 0, 0, 0, 0, 0], frame, 0.01, 1.0, velocity_limits=1.0, keep_direction=True
    )
    X = s.fk(np.array([goes[-1], kept[-1], q]), frame)[:, :3, 3]
    assert (X[0] - X[2]) @ way > 0.095
    # stretched: a straight way across leaves the sphere of reach at once, as far as a direction is
    # kept to 1 %
    assert 0.005 < (X[1] - X[2]) @ way < 0.05 and np.linalg.norm((X[1] - X[2])[1:]) < 0.002


@pytest.mark.parametrize(
    "k", some(range(5), 2), ids=["hard", "soft", "levels", "soft pair", "look at"]
)
def test_saddle_points_are_left_towards_tasks(k):
    """A straight arm, its target inside on the same ray; an axis that points away from what it is
    to look at.
    """
    s = arm()
    q = np.array([0.2, 0.0])
    P = s.fk(q, "tip")[:3, 3] * 0.8
    wanted = [
        [tasks.Position("tip", P)],
        [tasks.Position("tip", P, weight=1.0)],
        [tasks.Position("tip", P), tasks.Posture(np.array([0.0, 1.0]), priority=1)],
        [tasks.Position("tip", P, weight=1.0), tasks.Posture(np.array([0.2, 0.0]), weight=1e-3)],
        [tasks.LookAt("tip", s.fk(q, "tip")[:3, 3] * 0.4)],
    ][k]
    Q = motion(s, q, wanted, None, 0.02, 4.0, velocity_limits=2.0)
    assert (
        np.abs(np.diff(Q, axis=0)).max() <= 0.04 * (1.0 + 1e-9)
        and turns_at_speed(Q, 0.02, 2.0) == 0
    )
    X = s.fk(Q[-1], "tip")
    if k < 4:
        assert np.linalg.norm(X[:3, 3] - P) < (1e-2 if k == 3 else 1e-6)
    else:
        line = s.fk(q, "tip")[:3, 3] * 0.4 - X[:3, 3]
        assert X[:2, 0] @ line[:2] > (1.0 - 1e-9) * np.linalg.norm(line)


# ---- speeds


def test_without_limits_of_speed_stated_ones_hold():
    m = Mechanism("gantry")
    m.prismatic("rail", "ground", m.body("cart"), axis=(1, 0, 0))
    m.revolute("turn", "cart", m.body("arm"), axis=(0, 0, 1), velocity=9.0)
    m.revolute("geared", "arm", m.body("wheel"), axis=(0, 0, 1), at=(1, 0, 0))
    m.revolute("fast", "wheel", m.body("disc"), axis=(0, 0, 1), at=(1, 0, 0))
    m.couple("fast", {"geared": 4.0})
    m.frame("tip", "disc", at=(0.5, 0.0, 0.0))
    s = m.build()
    assert dict(zip(s.structure.velocity_names, list_speed_limits(s), strict=True)) == {
        "rail": SLIDING,
        "turn": 9.0,
        "geared": TURNING / 4,
    }
    for wanted in (np.full(6, 1e4), spatial.pose(p=[50.0, 30.0, 0.0])):
        assert (
            np.abs(s.ik_step(s.neutral + 0.1, wanted, "tip", 0.01, damping=0.0).velocity)
            <= list_speed_limits(s)
        ).all()
    free = s.ik_step(
        s.neutral + 0.1, np.full(6, 1e4), "tip", 0.01, damping=0.0, velocity_limits=math.inf
    )
    assert np.abs(free.velocity).max() > 100.0


# ---- loops and tasks


@pytest.mark.parametrize(
    ("name", "frame", "by", "weights"),
    [
        ("five_bar", "tip", [0.4, 0.3, 0.0], [1, 1, 0, 0, 0, 0]),
        pytest.param(
            "delta_uu", "platform", [0.4, 0.3, 0.0], [1, 1, 1, 0, 0, 0], marks=pytest.mark.slow
        ),
        pytest.param("stewart", "platform", [0.6, 0.0, 0.3], None, marks=pytest.mark.slow),
    ],
)
def test_under_loops_it_settles_too(name, frame, by, weights):
    s = kempe.load(name)
    q = s.assemble().q
    X = s.fk(q, frame)
    X[:3, 3] += by
    Q = motion(s, q, X, frame, 0.01, 3.0, weights=weights)
    assert turns_back(Q, 0.01) == 0
    assert np.abs(s.loops.closure_error(Q[-1])).max() < 1e-11


def demands_of(name: str, s: System, frame: str, q: np.ndarray) -> list[list]:
    """Tasks that cannot all be held, or that leave a posture behind."""
    X = s.fk(q, frame)
    far = X.copy()
    p = X[:3, 3]
    far[0, 3] += 1.5
    return [
        [tasks.Pose(frame, far)],
        [tasks.Position(frame, far[:3, 3]), tasks.Posture(s.mid, priority=1)],
        [tasks.Position(frame, p + [0.05, 0.0, 0.0]), tasks.Posture(s.mid, priority=1)],
        [tasks.Position(frame, p + [0.2, 0.0, 0.0]), tasks.Position(frame, p - [0.2, 0.1, 0.0])],
        [tasks.Position(frame, far[:3, 3], weight=1.0), tasks.Posture(s.mid, weight=0.1)],
        [
            tasks.HalfSpace(frame, p + [0.1, 0.0, 0.0], [-1.0, 0.0, 0.0]),
            tasks.Position(frame, far[:3, 3], weight=1.0, priority=1),
        ],
    ]


@pytest.mark.slow
@pytest.mark.parametrize(
    "k", some(range(6), 3), ids=["pose", "posture far", "posture", "conflict", "soft", "wall"]
)
@pytest.mark.parametrize("name", ["panda", pytest.param("iiwa14", marks=pytest.mark.slow)])
def test_tasks_that_cannot_be_held_settle(name, k):
    s = kempe.load(name)
    frame = TIPS[name]
    q = np.array(STARTS[name])
    Q = motion(s, q, demands_of(name, s, frame, q)[k], None, 0.01, 2.0)
    v = np.diff(Q, axis=0)[-100:] / 0.01
    v[np.abs(v) < 1e-12] = 0.0  # rounding
    assert not (np.diff(np.sign(v), axis=0) != 0.0).any(), np.abs(v).max()


@pytest.mark.slow
def test_one_task_settles_where_the_step_of_a_frame_does():
    s = kempe.load("panda")
    frame = TIPS["panda"]
    q = np.array(STARTS["panda"])
    X = s.fk(q, frame)
    X[0, 3] += 0.6
    one = motion(s, q, X, frame, weights=[1, 1, 1, 0, 0, 0])
    two = motion(s, q, tasks.Position(frame, X[:3, 3]), None)
    missed = [np.linalg.norm(s.fk(Q[-1], frame)[:3, 3] - X[:3, 3]) for Q in (one, two)]
    assert abs(missed[0] - missed[1]) < 1e-6
    assert abs(missed[0] - s.ik(X, frame, start=q, task="position").position_error) < 1e-4


def straight_way_of_a_case(s: System, rng: np.random.Generator) -> tuple:
    """A straight way towards a pose that is near, far, turned, beyond limits or out of reach, until
    the arm rests.
    """
    frame = tip(s)
    kind = str(rng.choice(["pose", "far", "turned", "away"]))
    dt = float(rng.choice([0.004, 0.01]))
    q = start_of(s, rng)
    if kind == "away":
        X = s.fk(s.random(rng), frame)
        way = rng.normal(size=3)
        X[:3, 3] += 10.0 ** rng.uniform(-2.0, 0.3) * way / np.linalg.norm(way)
    else:
        X = asked(kind, s, frame, q, rng)[0]
    Q = [np.array(q)]
    while len(Q) * dt < 40.0 and (len(Q) < 30 or np.abs(Q[-1] - Q[-25]).max() > 1e-9):
        Q.append(s.ik_step(Q[-1], X, frame, dt, velocity_limits=1.0, keep_direction=True).q)
    case = (s.name, kind, dt, q.tolist())
    assert turns_at_speed(np.array(Q), dt, 1.0) == 0, case
    # some creep, and are there already
    assert np.abs(Q[-1] - Q[-25]).max() < 1e-2 * dt * 25, (
        "does not rest",
        case,
    )
    assert rests_nearest(s, frame, X, Q[-1]), ("not the nearest", case)
    return case


def test_straight_ways_end_at_the_nearest_pose(hunt):
    rng = hunt.rng()
    for _ in range(hunt.cases(12)):
        straight_way_of_a_case(kempe.load(str(rng.choice(TWELVE))), rng)


@pytest.mark.slow
@pytest.mark.parametrize("name", TWELVE)
def test_straight_ways_end_at_the_nearest_pose_often(name, hunt):
    rng = hunt.rng()
    s = kempe.load(name)
    for _ in range(hunt.cases(40)):
        straight_way_of_a_case(s, rng)
